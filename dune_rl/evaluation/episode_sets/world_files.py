"""World files of a set: found by a pattern, named in the set with their checksums, and checked before use."""

import glob
import hashlib
import os
import re
from collections.abc import Sequence
from pathlib import Path

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import sha256_of
from dune_rl.evaluation.episode_sets.files import EpisodeSet

_WILDCARDS = re.compile(r"[*?\[]")


def find_world_files(pattern: str) -> list[Path]:
    """The files that `pattern`, a path that may have wildcards, names: world_2 before world_10.

    Raises ConfigError if there is none.
    """
    path = Path(pattern).expanduser()
    if path.exists():
        return [path]
    if not _WILDCARDS.search(pattern):
        raise ConfigError(f"there is no file {path}: world.path must name one that exists")
    found = [Path(name) for name in glob.glob(str(path), recursive=True)]
    if not found:
        raise ConfigError(f"world.path={pattern} matches no file; name a folder's files as FOLDER/*.world")
    return sorted(found, key=_natural_order)


def _natural_order(path: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", str(path))
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def describe_files(files: Sequence[Path], folder: Path) -> list[dict[str, str]]:
    """The paths and checksums of `files`, as the header of a set in `folder` has them.

    Relative paths are made relative to the folder of the set, so that they hold from anywhere.
    """
    return [{"path": _path_from(file, folder), "sha256": checksum_of(file)} for file in files]


def _path_from(file: Path, folder: Path) -> str:
    return str(file) if file.is_absolute() else Path(os.path.relpath(file, folder)).as_posix()


def checksum_of(path: Path) -> str:
    """SHA-256 (hexadecimal) of a file, or of the names and the contents of a folder's files."""
    if path.is_file():
        return sha256_of(path)
    files = sorted(each for each in path.rglob("*") if each.is_file())
    listed = "\n".join(f"{each.relative_to(path).as_posix()} {sha256_of(each)}" for each in files)
    return hashlib.sha256(listed.encode()).hexdigest()


def world_files(episode_set: EpisodeSet) -> list[Path]:
    """The paths of a set's world files; raises ConfigError where one is missing or was changed."""
    found = []
    for stated in episode_set.header.files:
        path = episode_set.folder / Path(stated.path).expanduser()
        remedy = f"put back the file with which {episode_set.name} was made, or make a set of another name"
        try:
            sha256 = checksum_of(path)
        except OSError as error:
            raise ConfigError(f"{path} cannot be read ({error.strerror or error}); {remedy}") from None
        if not path.exists() or sha256 != stated.sha256:
            fault = "was changed" if path.exists() else "is missing"
            raise ConfigError(f"{path} {fault}; {remedy}")
        found.append(Path(os.path.abspath(path)))
    return found
