"""A disk cache of worlds by content: a world that takes seconds to build is read in milliseconds."""

import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import warnings
import weakref
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.file_dependencies import record_dependencies
from dune_rl.core.files import sha256_of
from dune_rl.core.paths import assets_folder, cache_folder, package_folder
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.appearance import is_appearance_cached, precompute_appearance
from dune_rl.worlds.cache.folder import CacheFolder, DiskCache
from dune_rl.worlds.cache.serialization import SerializationError, deserialize_world, serialize_world
from dune_rl.worlds.importing.imported_world import ImportedWorldConf
from dune_rl.worlds.importing.sdf.elements import RESOURCE_VARIABLE
from dune_rl.worlds.registry import WORLDS, build_uncached
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World

LIMIT_BYTES = 2 * 2**30
# A pipe takes a line of this length whole or not at all: PIPE_BUF, as Linux has it.
_LONGEST_LINE = 4096
# Of the background process.
_NICENESS, _IDLE_S = 10, 60

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
        self._builder = None if folder is None else _BackgroundBuilder(folder)

    def get(self, conf: WorldSettings) -> World:
        """The world of `conf`, read from the cache or built; warns and raises as building it does."""
        conf = conf.drawn()
        if self.cache is None or conf.disk_cached == "nothing":
            return build_uncached(conf)
        key = world_key(conf)
        if conf.disk_cached == "appearance":
            world = build_uncached(conf)
            world.disk_cache = _appearance_cache(self.cache, key)
            return world
        return self._load(self.cache, key) or self._build_and_cache(self.cache, key, conf)

    def prepare(self, confs: Iterable[WorldSettings], *, with_appearance: bool = False) -> None:
        """Start to build the worlds that are not cached, in a background process and in this order.

        With `with_appearance`, it also computes what cameras need. Returns at once. `get` does not wait for
        the process: both build the same bytes, so it does not matter which of them writes the entry last.
        """
        drawn = [conf.drawn() for conf in confs]
        missing = [conf for conf in drawn if not self.is_cached(conf, with_appearance=with_appearance)]
        if missing and self._builder is not None and self.cache is not None:
            if (code := self._builder.unexpected_end) is not None:
                text = f"the background process that builds worlds ended with code {code}; another is started"
                self.cache.warn("builder", f"{text}, and what it had not built is built when it is needed")
            self._builder.submit(missing, with_appearance)

    def is_cached(self, conf: WorldSettings, *, with_appearance: bool = False) -> bool:
        """Whether the cache has the world and, `with_appearance`, what cameras need; True without a cache."""
        if self.cache is None or conf.disk_cached == "nothing":
            return True
        key = world_key(conf)
        if conf.disk_cached == "world" and not self.cache.contains(key):
            return False
        # The key of an imported world's appearance depends on files that only building it determines.
        return (
            not with_appearance
            or isinstance(conf, ImportedWorldConf)
            or is_appearance_cached(_appearance_cache(self.cache, key))
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
            files, absent = text["files"], text["absent"]
            if text["key"] != key or any(Path(path).exists() for path in absent):
                return None
            if any(_digest(Path(path)) != digest for path, digest in files.items()):
                return None
            world = deserialize_world(text["world"], arrays)
            messages = [str(message) for message in text["warnings"]]
        # An entry with other content counts as damaged.
        except Exception as error:
            fault = f"has unknown content ({type(error).__name__}) and will be rebuilt"
            cache.warn("damaged", f"{cache.entry(key)} {fault}")
            return None
        world.disk_cache = _appearance_cache(cache, key, files, absent)
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
            files, absent = sources.read, sorted(sources.absent)
            world.disk_cache = _appearance_cache(cache, key, files, absent)
            if len(messages) == len(caught):
                text = {"key": key, "files": files, "absent": absent, "warnings": messages}
                try:
                    tree, arrays = serialize_world(world)
                    cache.write(key, {**text, "world": tree}, arrays)
                except SerializationError as error:
                    cache.warn("unserializable", f"worlds of {conf.name} cannot be cached: {error}")
        for warning in caught:
            warnings.warn(warning.message, stacklevel=3)
        return world


def _appearance_cache(
    cache: CacheFolder, key: str, files: Mapping[str, str] = MappingProxyType({}), absent: Sequence[str] = ()
) -> DiskCache:
    # The key changes when a texture of an imported world changes.
    identity = json.dumps([key, sorted(files.items()), list(absent)])
    return DiskCache(cache, hashlib.sha256(identity.encode()).hexdigest())


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
        sums.update(f" {library} {version(library)}".encode())
    package = package_folder()
    for name in _SOURCES:
        for path in sorted((package / name).rglob("*.py")) if not name.endswith(".py") else [package / name]:
            sums.update(f" {path.relative_to(package).as_posix()} ".encode() + path.read_bytes())
    for path in sorted((assets_folder() / "worlds").iterdir()):
        sums.update(f" {path.name} ".encode() + path.read_bytes())
    return sums.hexdigest()


def _digest(path: Path) -> str | None:
    try:
        return sha256_of(path) if path.is_file() else None
    except OSError:
        return None


# Computed on import: later, the source files may have changed and differ from the imported modules.
_code_digest()


class _BackgroundBuilder:
    """A process that builds worlds into the cache in `folder`, from the first request on (`main`).

    It is not a `concurrent.futures.ProcessPoolExecutor`: daemonic workers such as TorchRL's may not have
    children of `multiprocessing`, and a script without `if __name__ == "__main__"` would run twice.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def unexpected_end(self) -> int | None:
        """Exit code of the last process if it failed or was killed, else None."""
        code = None if self._process is None else self._process.poll()
        return None if code in (None, 0, -signal.SIGALRM) else code

    def submit(self, confs: Iterable[WorldSettings], with_appearance: bool) -> None:
        """Request worlds, in this order. It neither blocks nor raises."""
        requests = ({"world": conf.model_dump(mode="json"), "appearance": with_appearance} for conf in confs)
        # Without a process, or if its pipe is full (`write` returns None), `WorldStore.get` builds the world.
        with suppress(OSError):
            if self.pid is None:
                self._start()
            assert self._process is not None and self._process.stdin is not None
            for data in (json.dumps(request).encode() + b"\n" for request in requests):
                if len(data) <= _LONGEST_LINE:
                    self._process.stdin.write(data)

    @property
    def pid(self) -> int | None:
        """Id of the process while it runs, else None; None in a fork, whose parent has the process."""
        return None if self._process is None or self._process.poll() is not None else self._process.pid

    def close(self) -> None:
        """Stop the process; an entry that it has not finished is dropped."""
        if self._process is not None:
            _stop(self._process)
        self._process = None

    def _start(self) -> None:
        self.close()
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        path = os.pathsep.join([str(package_folder().parent), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._process = subprocess.Popen(
            # -P: do not import from the working folder.
            [sys.executable, "-P", "-m", "dune_rl.worlds.cache.store", str(os.getpid())],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads, "PYTHONPATH": path, "DUNE_RL_CACHE": str(self._folder)},
            # Ctrl-C must reach this process only; the other one exits at the end of its input.
            start_new_session=True,
        )
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        weakref.finalize(self, _stop, self._process)


def _stop(process: "subprocess.Popen[bytes]") -> None:
    assert process.stdin is not None
    process.stdin.close()
    # In a fork, both do nothing.
    process.terminate()
    process.wait()


def main() -> None:
    """Build worlds into the disk cache: `python -m dune_rl.worlds.cache.store PARENT`.

    Standard input has a request per line (JSON). The process exits at the end of its input, when the process
    PARENT has ended, and after a minute without work.
    """
    parent = int(sys.argv[1])
    os.nice(_NICENESS)
    warnings.simplefilter("ignore")
    store = shared_store()
    while True:
        # The alarm ends the process.
        signal.alarm(_IDLE_S)
        line = sys.stdin.readline()
        signal.alarm(0)
        # A fork of the parent may hold the input open when the parent is killed.
        if not line or os.getppid() != parent:
            return
        # The process that needs the world raises the same error to its user.
        with suppress(Exception):
            request = json.loads(line)
            kind = WORLDS.settings_class(request["world"]["name"])
            assert kind is not None
            # As JSON, in which a list is a tuple.
            conf = kind.model_validate_json(json.dumps(request["world"]))
            with_appearance = bool(request["appearance"])
            if not store.is_cached(conf, with_appearance=with_appearance):
                world = store.get(conf)
                if with_appearance:
                    precompute_appearance(world)


if __name__ == "__main__":
    main()
