"""Worlds kept on disk by content: what took long to make is read back in milliseconds."""

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

from dune_rl.errors import ConfigError
from dune_rl.paths import cache_folder, package_folder
from dune_rl.worlds.appearance import is_appearance_cached
from dune_rl.worlds.cache.background_builder import Preparation
from dune_rl.worlds.cache.folder import CacheFolder, DiskCache
from dune_rl.worlds.cache.serialization import UnpackableError, pack, unpack
from dune_rl.worlds.construction.build import ConstructionConf
from dune_rl.worlds.flat import FlatConf
from dune_rl.worlds.importing.file_dependencies import FileDependencies, record_dependencies
from dune_rl.worlds.importing.heightmap.build import HeightmapConf
from dune_rl.worlds.importing.mesh.build import MeshConf
from dune_rl.worlds.importing.sdf.build import SdfConf
from dune_rl.worlds.importing.sdf.files import RESOURCE_VARIABLE
from dune_rl.worlds.importing.untrusted_files import WorldWarning
from dune_rl.worlds.inspection.build import InspectionConf
from dune_rl.worlds.island import IslandConf
from dune_rl.worlds.registry import build, own_settings
from dune_rl.worlds.rubicon.build import RubiconConf
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World

_IMPORTED = (MeshConf, HeightmapConf, SdfConf)
# Of users' code nothing is known that would tell when a kept world is out of date; and a plane is built
# faster than it is read.
_KEPT = (InspectionConf, ConstructionConf, RubiconConf, IslandConf, *_IMPORTED)
# Those whose looks are worth keeping.
_SHELVED = (*_KEPT, FlatConf)

LIMIT_BYTES = 2 * 2**30

# All that a world's bytes may depend on beside its settings.
_SOURCES = ("worlds", "geometry", "rendering", "seeding.py", "settings.py")
_LIBRARIES = ("embreex", "numba", "numpy", "pillow", "pycollada", "scipy", "tifffile", "trimesh")


class WorldStore:
    """Worlds by their settings, kept in `folder` (None: nowhere) within `limit_bytes`.

    An entry is found by the settings, the source text of all that makes worlds, the versions of the
    libraries and, for imported ones, the bytes of their files: what has changed in any of these is made
    anew. An entry that is damaged is, too.
    """

    def __init__(self, folder: Path | None, limit_bytes: int = LIMIT_BYTES) -> None:
        self.cache = None if folder is None else CacheFolder(folder / "worlds", limit_bytes)
        self._preparation = None if folder is None else Preparation(folder)

    def get(self, conf: WorldSettings) -> World:
        """The world of `conf`, read or else built and kept; it warns and raises as building it does."""
        if self.cache is None or not isinstance(conf, _SHELVED):
            return build(conf)
        key = world_key(conf)
        if not isinstance(conf, _KEPT):
            world = build(conf)
            world.disk_cache = _appearance_cache(self.cache, key, {}, [])
            return world
        return self._kept(self.cache, key) or self._built(self.cache, key, conf)

    def prepare(self, confs: Iterable[WorldSettings], *, seen: bool = False) -> None:
        """Have the worlds that are not kept built by another process, at low priority and in this order.

        With `seen`, what cameras need is worked out there, too. Returns at once. `get` does not wait for
        it: both make the same bytes, and whoever is last to keep them changes nothing.
        """
        if self._preparation is None:
            return
        missing = [conf for conf in confs if not self.is_kept(conf, seen=seen)]
        if missing:
            self._preparation.ask(request(conf, seen) for conf in missing)

    def is_kept(self, conf: WorldSettings, *, seen: bool = False) -> bool:
        """Whether there is an entry for `get`, and for cameras if `seen`, or none is wanted."""
        if self.cache is None or not isinstance(conf, _SHELVED):
            return True
        key = world_key(conf)
        if isinstance(conf, _KEPT) and not self.cache.entry(key).exists():
            return False
        # Which shelf is an imported world's can only be told with the world.
        return (
            not seen
            or isinstance(conf, _IMPORTED)
            or is_appearance_cached(_appearance_cache(self.cache, key, {}, []))
        )

    @property
    def preparing(self) -> int | None:
        """The number of the process that builds worlds ahead, while it runs."""
        return None if self._preparation is None else self._preparation.pid

    def close(self) -> None:
        """End the process that builds worlds ahead, if there is one."""
        if self._preparation is not None:
            self._preparation.close()

    def _kept(self, cache: CacheFolder, key: str) -> World | None:
        found = cache.read(key)
        if found is None:
            return None
        text, arrays = found
        try:
            if text["key"] != key or not _unchanged(text["files"], text["absent"]):
                return None
            world = unpack(text["world"], arrays)
            told = [str(said) for said in text["warnings"]]
        # An entry of another make is no better than a damaged one.
        except Exception as error:
            cache.warn("damaged", f"{cache.entry(key)} is foreign ({type(error).__name__}) and made anew")
            return None
        world.disk_cache = _appearance_cache(cache, key, text["files"], text["absent"])
        for said in told:
            warnings.warn(said, WorldWarning, stacklevel=3)
        return world

    def _built(self, cache: CacheFolder, key: str, conf: WorldSettings) -> World:
        with warnings.catch_warnings(record=True) as caught, record_dependencies() as sources:
            warnings.simplefilter("always")
            world = build(conf)
            # It would be asked for at once, and takes longer than all the rest of some worlds.
            _ = world.clearance_field
        told = [str(w.message) for w in caught if issubclass(w.category, WorldWarning)]
        if sources.complete and len(told) == len(caught):
            self._keep(cache, key, conf, world, sources, told)
        if sources.complete:
            world.disk_cache = _appearance_cache(cache, key, sources.read, sorted(sources.absent))
        for warning in caught:
            warnings.warn(warning.message, stacklevel=3)
        return world

    def _keep(
        self,
        cache: CacheFolder,
        key: str,
        conf: WorldSettings,
        world: World,
        sources: FileDependencies,
        told: list[str],
    ) -> None:
        try:
            tree, arrays = pack(world)
        except UnpackableError as error:
            cache.warn("unpackable", f"worlds of {conf.name} are not kept: {error}")
            return
        text = {
            "key": key,
            "settings": conf.model_dump(mode="json"),
            "files": sources.read,
            "absent": sorted(sources.absent),
            "warnings": told,
            "world": tree,
        }
        cache.write(key, text, arrays)


def _appearance_cache(cache: CacheFolder, key: str, files: dict[str, str], absent: list[str]) -> DiskCache:
    # An imported world is told from what it was before a texture of it changed.
    known = json.dumps([key, sorted(files.items()), absent])
    return DiskCache(cache, hashlib.sha256(known.encode()).hexdigest())


def request(conf: WorldSettings, seen: bool) -> str:
    """A line for the process that builds worlds ahead (`requested`)."""
    return json.dumps({"world": conf.model_dump(mode="json"), "seen": seen})


def requested(line: bytes) -> tuple[WorldSettings, bool]:
    """What a line asks for; `ValueError` or `KeyError` where it makes no sense."""
    asked = json.loads(line)
    return own_settings(asked["world"]), bool(asked["seen"])


def shared_store() -> WorldStore:
    """The store in `cache_folder()`, of DUNE_RL_CACHE_GB (default 2); the same one each time."""
    return _store_in(cache_folder(), os.environ.get("DUNE_RL_CACHE_GB", ""))


@lru_cache(maxsize=4)
def _store_in(folder: Path | None, gigabytes: str) -> WorldStore:
    try:
        limit = int(float(gigabytes) * 2**30) if gigabytes else LIMIT_BYTES
    except (ValueError, OverflowError):
        raise ConfigError(f"DUNE_RL_CACHE_GB is a number of gigabytes, not {gigabytes!r}") from None
    return WorldStore(folder, limit)


def world_key(conf: WorldSettings) -> str:
    """Names the world of `conf`, as it would be built now: hexadecimal, and safe as a file's name."""
    key: dict[str, Any] = {"code": _code(), "settings": conf.model_dump(mode="json")}
    if isinstance(conf, _IMPORTED):
        path = Path(conf.path).expanduser().absolute()
        key |= {"path": str(path), "bytes": _digest(path), "resources": os.environ.get(RESOURCE_VARIABLE, "")}
    return hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()


@lru_cache(maxsize=1)
def _code() -> str:
    # The text itself rather than a number to be raised, which would be forgotten.
    sums = hashlib.sha256(f"{platform.machine()} {platform.python_version()}".encode())
    for library in _LIBRARIES:
        try:
            sums.update(f" {library} {version(library)}".encode())
        except PackageNotFoundError:
            sums.update(f" {library} unknown".encode())
    package = package_folder()
    for name in _SOURCES:
        for path in sorted((package / name).rglob("*.py")) if "." not in name else [package / name]:
            sums.update(f" {path.relative_to(package).as_posix()} ".encode() + path.read_bytes())
    return sums.hexdigest()


def _digest(path: Path) -> str | None:
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _unchanged(files: dict[str, str], absent: list[str]) -> bool:
    return not any(Path(path).exists() for path in absent) and all(
        _digest(Path(path)) == digest for path, digest in files.items()
    )


# Now, while the text is that of the modules just imported: it may change under a process that goes on.
_code()
