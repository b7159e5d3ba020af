"""A disk cache: a folder of arrays and texts by key. Lost or damaged entries are computed again."""

import hashlib
import json
import os
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import DuneWarning
from dune_rl.core.files import write_atomically
from dune_rl.core.untrusted_files import load_npz

Arrays = dict[str, NDArray[Any]]

_SUFFIX = ".npz"
_TEXT = "text"
# Older temporary files were left by processes that were killed.
_ABANDONED_S = 3600.0


class CacheWarning(DuneWarning):
    """A cache cannot be read or written; results stay the same, but take longer."""


class CacheFolder:
    """A least-recently-used cache in the folder `path`, of at most `limit_bytes`.

    It does not raise on damaged entries or an unwritable folder: reading returns None, writing does nothing,
    and the first fault of a kind gives a `CacheWarning`. Several processes may share the folder.
    """

    def __init__(self, path: Path, limit_bytes: int) -> None:
        self.path, self.limit_bytes = path, limit_bytes
        self._warned: set[str] = set()

    def entry(self, key: str) -> Path:
        """Path of the entry of a `key`."""
        return self.path / f"{key}{_SUFFIX}"

    def contains(self, key: str) -> bool:
        """Whether there is an entry of this `key`; False in a folder that cannot be read."""
        # Unlike Path.exists, which raises where permission is missing.
        return os.path.exists(self.entry(key))

    def read(self, key: str) -> tuple[Any, Arrays] | None:
        """Text (decoded from JSON) and arrays of an entry; None if it is missing or damaged."""
        path = self.entry(key)
        try:
            arrays = load_npz(path)
            text = json.loads(arrays.pop(_TEXT).tobytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            self.warn("unreadable", f"{path} cannot be read ({error.strerror or error}) and will be rebuilt")
            return None
        # A damaged file may make the libraries that read it raise anything.
        except Exception as error:
            self.warn("damaged", f"{path} is damaged ({type(error).__name__}) and will be rebuilt")
            return None
        with suppress(OSError):
            # The time of last use, for eviction: many file systems do not record access times.
            os.utime(path)
        return text, arrays

    def write(self, key: str, text: Any, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write an entry atomically; `text` must be serialisable as JSON."""
        path = self.entry(key)
        everything: dict[str, Any] = {_TEXT: np.frombuffer(json.dumps(text).encode(), np.uint8), **arrays}
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            with write_atomically(path) as temporary, temporary.open("wb") as file:
                np.savez(file, **everything)
            self._evict(path)
        except OSError as error:
            reason = error.strerror or error
            self.warn("unwritable", f"{self.path} cannot be written ({reason}): nothing is cached")

    def _evict(self, newest: Path) -> None:
        entries = []
        for path in self.path.iterdir():
            # Another process may remove entries at the same time.
            with suppress(FileNotFoundError):
                state = path.stat()
                if path.suffix == _SUFFIX:
                    entries.append((path != newest, -state.st_mtime, state.st_size, path))
                elif path.suffix == ".tmp" and time.time() - state.st_mtime > _ABANDONED_S:
                    path.unlink(missing_ok=True)
        total = 0
        # The newest entry stays, even if it is too large by itself.
        for is_older, _, size, path in sorted(entries):
            total += size
            if is_older and total > self.limit_bytes:
                path.unlink(missing_ok=True)

    def warn(self, kind: str, text: str) -> None:
        """Issue a `CacheWarning` with `text`, unless one of this kind was issued before."""
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(f"cache: {text}", CacheWarning, stacklevel=3)


class DiskCache:
    """Arrays by name that were computed from one object, which `key` (hexadecimal) identifies."""

    def __init__(self, cache: CacheFolder, key: str) -> None:
        self._cache, self._key = cache, key

    def contains(self, name: str) -> bool:
        """Whether there is an entry of this name."""
        return self._cache.contains(self._entry(name))

    def _entry(self, name: str) -> str:
        return hashlib.sha256(f"{self._key} {name}".encode()).hexdigest()

    def get_or_compute(self, name: str, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """The cached array of this name; if there is none, the result of `make`, which is then cached."""
        key = self._entry(name)
        found = self._cache.read(key)
        if found is not None and found[0] == [self._key, name] and "value" in found[1]:
            return found[1]["value"]
        value = make()
        self._cache.write(key, [self._key, name], {"value": value})
        return value
