"""Bags of episodes: where they lie, and how one is written so that it appears when it is complete."""

import contextlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_writable
from dune_rl.core.paths import file_stem
from dune_rl.core.replaced_folder import replace_folder
from dune_rl.ros.library import MessageTypes, latched_qos, message_types, require_rosbags

# Metadata of rosbag2 that ROS 2 Humble and later read.
_VERSION: Final = 8
_METADATA_FILE = "metadata.yaml"
# In the metadata of a bag: what was recorded.
CUSTOM_KEY = "dune_rl"
# Each scene writes a file, and processes may open some 1,000.
MOST_SCENES = 256


def policy_folders(folder: Path, policies: Sequence[str]) -> list[Path]:
    """A folder in `folder` for the bags of each of `policies`, by their names."""
    found: list[Path] = []
    for name in policies:
        stem, number = file_stem(name), 1
        while (path := folder / (stem if number == 1 else f"{stem}_{number}")) in found:
            number += 1
        found.append(path)
    return found


def episode_path(folder: Path, episode: int) -> Path:
    return folder / f"episode_{episode}"


def check_bags(
    folder: Path, policies: Sequence[str], episodes: Iterable[int], scenes: int, *, overwrite: bool
) -> None:
    """Raise ConfigError where the bags of `episodes` cannot be written: before they are run."""
    require_rosbags()
    if scenes > MOST_SCENES:
        raise ConfigError(
            f"bag={folder} has a file open for each scene; set scenes={MOST_SCENES} or fewer (got {scenes})"
        )
    check_writable(folder)
    if overwrite:
        return
    numbers = list(episodes)
    for path in policy_folders(folder, policies):
        there = [number for number in numbers if path.is_dir() and episode_path(path, number).exists()]
        if there:
            raise ConfigError(
                f"bag={folder} holds {episode_path(path, there[0])} already; choose another folder, or "
                "replace its bags with overwrite=true"
            )


class _DiscardedError(Exception):
    """The bag that is being written is not wanted any more."""


class EpisodeBag:
    """A bag that is being written; `complete` puts it at `path`, in place of one that is there already.

    `metadata` are values of JSON that say what was recorded. Raises ConfigError if another process writes a
    bag at `path`.
    """

    def __init__(self, path: Path, metadata: Mapping[str, Any]) -> None:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        self.types: MessageTypes = message_types()
        self._path = path
        self._replacing = replace_folder(path, lambda: None, last=_METADATA_FILE)
        self._folder = self._replacing.__enter__()
        # Its files are called after the folder in which they are made.
        self._writer = Writer(self._folder / path.name, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.set_custom_data(CUSTOM_KEY, json.dumps(metadata))
        self._writer.open()
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, message: Any, time_ns: int, *, latched: bool = False) -> None:
        """Add a message of `topic`; a `latched` one is kept for those who come later."""
        kind = message.__msgtype__
        if topic not in self._connections:
            profiles = [latched_qos()] if latched else []
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self.types.store, offered_qos_profiles=profiles
            )
        self._writer.write(self._connections[topic], time_ns, self.types.serialize(message))

    def complete(self) -> None:
        """Put the bag in its place."""
        self._writer.close()
        made = self._folder / self._path.name
        for each in list(made.iterdir()):
            each.rename(self._folder / each.name)
        made.rmdir()
        self._replacing.__exit__(None, None, None)

    def discard(self) -> None:
        """Remove what was written."""
        self._writer.abort()
        self._replacing.__exit__(_DiscardedError, _DiscardedError(), None)
        # Of a folder in which no bag was completed nothing is left.
        with contextlib.suppress(OSError):
            self._path.parent.rmdir()
            self._path.parent.parent.rmdir()


def read_metadata(reader: Any) -> dict[str, Any]:
    """What an `EpisodeBag` was given as its metadata; nothing for other bags."""
    text = (reader.storage.metadata.custom or {}).get(CUSTOM_KEY, "{}")
    try:
        metadata = json.loads(text)
    except ValueError:
        metadata = {}
    return metadata if isinstance(metadata, dict) else {}
