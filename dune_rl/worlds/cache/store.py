"""A disk cache of worlds by content: a world that takes seconds to build is read in milliseconds."""

import hashlib
import json
import os
import platform
import warnings
from collections.abc import Iterable
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.file_dependencies import record_dependencies
from dune_rl.core.files import sha256_of
from dune_rl.core.paths import assets_folder, cache_folder, package_folder
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.appearance import is_appearance_cached
from dune_rl.worlds.cache.background_builder import BackgroundBuilder
from dune_rl.worlds.cache.folder import CacheFolder, DiskCache
from dune_rl.worlds.cache.serialization import SerializationError, deserialize_world, serialize_world
from dune_rl.worlds.importing.sdf.files import RESOURCE_VARIABLE
from dune_rl.worlds.importing.surface_files import ImportedWorldConf
from dune_rl.worlds.registry import build_uncached, parse_built_in_settings
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World

LIMIT_BYTES = 2 * 2**30

# Source files and libraries that a world depends on, apart from its settings.
_SOURCES = ("worlds", "geometry", "rendering", "core/seeding.py", "core/settings.py")
_LIBRARIES = ("embreex", "numba", "numpy", "pillow", "pycollada", "scipy", "tifffile", "trimesh")


class WorldStore:
    """Builds worlds from their settings, with a cache of `limit_bytes` in `folder` (None: no cache).

    The key of an entry is a hash of the settings, the source code that builds worlds, the versions of the
    libraries and, for imported worlds, the bytes of their files. A world is built again if any of these
    changes, or if its entry is damaged.
    """

    def __init__(self, folder: Path | None, limit_bytes: int = LIMIT_BYTES) -> None:
        self.cache = None if folder is None else CacheFolder(folder / "worlds", limit_bytes)
        self._builder = None if folder is None else BackgroundBuilder(folder)

    def get(self, conf: WorldSettings) -> World:
        """The world of `conf`, read from the cache or built; warns and raises as building it does."""
        if self.cache is None or conf.disk_cached == "nothing":
            return build_uncached(conf)
        key = world_key(conf)
        if conf.disk_cached == "appearance":
            world = build_uncached(conf)
            world.disk_cache = _appearance_cache(self.cache, key, {}, [])
            return world
        return self._load(self.cache, key) or self._build_and_cache(self.cache, key, conf)

    def prepare(self, confs: Iterable[WorldSettings], *, with_appearance: bool = False) -> None:
        """Start to build the worlds that are not cached, in a background process and in this order.

        With `with_appearance`, it also computes what cameras need. Returns at once. `get` does not wait for
        the process: both build the same bytes, so it does not matter which of them writes the entry last.
        """
        if self._builder is None:
            return
        missing = [conf for conf in confs if not self.is_cached(conf, with_appearance=with_appearance)]
        if missing:
            self._builder.submit(encode_request(conf, with_appearance) for conf in missing)

    def is_cached(self, conf: WorldSettings, *, with_appearance: bool = False) -> bool:
        """Whether the cache has the world and, `with_appearance`, what cameras need; True without a cache."""
        if self.cache is None or conf.disk_cached == "nothing":
            return True
        key = world_key(conf)
        if conf.disk_cached == "world" and not self.cache.entry(key).exists():
            return False
        # The key of an imported world's appearance depends on files that only building it determines.
        return (
            not with_appearance
            or isinstance(conf, ImportedWorldConf)
            or is_appearance_cached(_appearance_cache(self.cache, key, {}, []))
        )

    @property
    def builder_pid(self) -> int | None:
        """Id of the background process while it runs, else None."""
        return None if self._builder is None else self._builder.pid

    def close(self) -> None:
        """Stop the background process, if there is one."""
        if self._builder is not None:
            self._builder.close()

    def _load(self, cache: CacheFolder, key: str) -> World | None:
        found = cache.read(key)
        if found is None:
            return None
        text, arrays = found
        try:
            if text["key"] != key or not _unchanged(text["files"], text["absent"]):
                return None
            world = deserialize_world(text["world"], arrays)
            messages = [str(message) for message in text["warnings"]]
        # An entry with other content counts as damaged.
        except Exception as error:
            cache.warn(
                "damaged",
                f"{cache.entry(key)} has unknown content ({type(error).__name__}) and will be rebuilt",
            )
            return None
        world.disk_cache = _appearance_cache(cache, key, text["files"], text["absent"])
        for message in messages:
            warnings.warn(message, WorldWarning, stacklevel=3)
        return world

    def _build_and_cache(self, cache: CacheFolder, key: str, conf: WorldSettings) -> World:
        with warnings.catch_warnings(record=True) as caught, record_dependencies() as sources:
            warnings.simplefilter("always")
            world = build_uncached(conf)
            # Computed now so that it is cached: every spawn needs it, and it may take longer than all else.
            _ = world.clearance_field
        messages = [str(w.message) for w in caught if issubclass(w.category, WorldWarning)]
        if sources.complete:
            world.disk_cache = _appearance_cache(cache, key, sources.read, sorted(sources.absent))
            if len(messages) == len(caught):
                text = {
                    "key": key,
                    "files": sources.read,
                    "absent": sorted(sources.absent),
                    "warnings": messages,
                }
                try:
                    tree, arrays = serialize_world(world)
                    cache.write(key, {**text, "world": tree}, arrays)
                except SerializationError as error:
                    cache.warn("unserializable", f"worlds of {conf.name} cannot be cached: {error}")
        for warning in caught:
            warnings.warn(warning.message, stacklevel=3)
        return world


def _appearance_cache(cache: CacheFolder, key: str, files: dict[str, str], absent: list[str]) -> DiskCache:
    # The key changes when a texture of an imported world changes.
    identity = json.dumps([key, sorted(files.items()), absent])
    return DiskCache(cache, hashlib.sha256(identity.encode()).hexdigest())


def encode_request(conf: WorldSettings, with_appearance: bool) -> str:
    """A request to the background process, as one line of JSON; `decode_request` is the inverse."""
    return json.dumps({"world": conf.model_dump(mode="json"), "with_appearance": with_appearance})


def decode_request(line: str) -> tuple[WorldSettings, bool]:
    """Settings and `with_appearance` of a request; raises ValueError or KeyError for an invalid line."""
    request = json.loads(line)
    return parse_built_in_settings(request["world"]), bool(request["with_appearance"])


def shared_store() -> WorldStore:
    """The store in `cache_folder()`, of DUNE_RL_CACHE_GB (default 2); the same object at every call."""
    return _store_in(cache_folder(), os.environ.get("DUNE_RL_CACHE_GB", ""))


@lru_cache(maxsize=4)
def _store_in(folder: Path | None, gigabytes: str) -> WorldStore:
    try:
        limit = int(float(gigabytes) * 2**30) if gigabytes else LIMIT_BYTES
    except (ValueError, OverflowError):
        raise ConfigError(f"DUNE_RL_CACHE_GB must be a number of gigabytes (got {gigabytes!r})") from None
    return WorldStore(folder, limit)


def world_key(conf: WorldSettings) -> str:
    """Hash of the settings, code, libraries and files that the world of `conf` depends on (hexadecimal)."""
    key: dict[str, Any] = {"code": _code_digest(), "settings": conf.model_dump(mode="json")}
    if isinstance(conf, ImportedWorldConf):
        path = Path(conf.path).expanduser().absolute()
        key |= {"path": str(path), "bytes": _digest(path), "resources": os.environ.get(RESOURCE_VARIABLE, "")}
    return hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()


@lru_cache(maxsize=1)
def _code_digest() -> str:
    # A hash of the source code cannot be forgotten in a change, as a version number can.
    sums = hashlib.sha256(f"{platform.machine()} {platform.python_version()}".encode())
    for library in _LIBRARIES:
        try:
            sums.update(f" {library} {version(library)}".encode())
        except PackageNotFoundError:
            sums.update(f" {library} unknown".encode())
    package = package_folder()
    for name in _SOURCES:
        for path in sorted((package / name).rglob("*.py")) if not name.endswith(".py") else [package / name]:
            sums.update(f" {path.relative_to(package).as_posix()} ".encode() + path.read_bytes())
    for path in sorted((assets_folder() / "worlds").iterdir()):
        sums.update(f" {path.name} ".encode() + path.read_bytes())
    return sums.hexdigest()


def _digest(path: Path) -> str | None:
    try:
        if not path.is_file():
            return None
        return sha256_of(path)
    except OSError:
        return None


def _unchanged(files: dict[str, str], absent: list[str]) -> bool:
    return not any(Path(path).exists() for path in absent) and all(
        _digest(Path(path)) == digest for path, digest in files.items()
    )


# Computed on import: later, the source files may have changed and differ from the imported modules.
_code_digest()
