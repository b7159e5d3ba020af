"""A folder of arrays and texts by keys, which may be lost, damaged or shared at any time without harm."""

import hashlib
import json
import os
import time
import warnings
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import DuneWarning
from dune_rl.files import write_atomically

Arrays = dict[str, NDArray[Any]]

_SUFFIX = ".npz"
_TEXT, _CHECKSUM = "text", "checksum"
# A temporary file that old was left by a process that was killed.
_ABANDONED_S = 3600.0


class CacheWarning(DuneWarning):
    """A cache that cannot be used as it should: slower, but nothing else."""


class CacheFolder:
    """Entries in the folder `path`, at most `limit_bytes` of them: those unused for longest make room.

    Whatever is wrong with an entry or with the folder costs time alone: reading gives None, writing does
    nothing, and the first time there is a `CacheWarning`. Processes may share it.
    """

    def __init__(self, path: Path, limit_bytes: int) -> None:
        self.path, self.limit_bytes = path, limit_bytes
        self._warned: set[str] = set()

    def entry(self, key: str) -> Path:
        """Where the entry of a hexadecimal `key` lies."""
        if not key or not set(key) <= set("0123456789abcdef"):
            raise ValueError(f"a key is hexadecimal, not {key!r}")
        return self.path / f"{key}{_SUFFIX}"

    def read(self, key: str) -> tuple[Any, Arrays] | None:
        """The text (as JSON has it) and arrays of an entry; None where there is none, or no sound one."""
        path = self.entry(key)
        try:
            with path.open("rb") as file:
                found = _read(file, path.stat().st_size)
        except FileNotFoundError:
            return None
        # A file in a cache may hold anything, and libraries that read it raise as much.
        except Exception as error:
            self.warn("damaged", f"{path} is damaged ({type(error).__name__}) and made anew")
            return None
        with suppress(OSError):
            # By which the longest unused are told: file systems often keep no times of access.
            os.utime(path)
        return found

    def write(self, key: str, text: Any, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Put an entry in place, whole or not at all."""
        path = self.entry(key)
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            data = np.frombuffer(json.dumps(text).encode(), np.uint8)
            everything: dict[str, Any] = {_TEXT: data, **arrays}
            everything[_CHECKSUM] = _checksum(everything)
            with write_atomically(path) as temporary, temporary.open("wb") as file:
                np.savez(file, **everything)
            self._make_room(path)
        except OSError as error:
            self.warn(
                "unwritable", f"{self.path} cannot be written ({error.strerror or error}): nothing is kept"
            )

    def _make_room(self, newest: Path) -> None:
        entries = []
        for path in self.path.iterdir():
            try:
                state = path.stat()
            except FileNotFoundError:
                continue
            if path.suffix == _SUFFIX and path != newest:
                entries.append((state.st_mtime, state.st_size, path))
            elif path.suffix == ".tmp" and time.time() - state.st_mtime > _ABANDONED_S:
                path.unlink(missing_ok=True)
        # Another process may have made room of the newest, too.
        total = sum(size for _, size, _ in entries) + (newest.stat().st_size if newest.exists() else 0)
        for _, size, path in sorted(entries, key=lambda entry: entry[0]):
            if total <= self.limit_bytes:
                break
            path.unlink(missing_ok=True)
            total -= size

    def warn(self, kind: str, text: str) -> None:
        """A `CacheWarning`, the first of its kind alone."""
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(f"cache: {text}", CacheWarning, stacklevel=3)


class DiskCache:
    """What follows from one thing that `key` (hexadecimal) tells from all others: arrays by name."""

    def __init__(self, cache: CacheFolder, key: str) -> None:
        self._cache, self._key = cache, key

    def contains(self, name: str) -> bool:
        """Whether something has been kept under that name."""
        return self._cache.entry(self._entry(name)).exists()

    def _entry(self, name: str) -> str:
        return hashlib.sha256(f"{self._key} {name}".encode()).hexdigest()

    def get_or_compute(self, name: str, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """What `make` gives, read back if it has been kept."""
        key = self._entry(name)
        found = self._cache.read(key)
        if found is not None and found[0] == [self._key, name] and "value" in found[1]:
            return found[1]["value"]
        made = make()
        self._cache.write(key, [self._key, name], {"value": made})
        return made


def _read(file: Any, size: int) -> tuple[Any, Arrays]:
    with zipfile.ZipFile(file) as archive:
        # Nothing was compressed when it was written: what claims to hold more than its size did not come so.
        if sum(member.file_size for member in archive.infolist()) > size:
            raise ValueError("compressed")
    file.seek(0)
    with np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    checksum = arrays.pop(_CHECKSUM)
    if not np.array_equal(checksum, _checksum(arrays)):
        raise ValueError("wrong checksum")
    return json.loads(arrays.pop(_TEXT).tobytes()), arrays


def _checksum(arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
    sums = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        sums.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        sums.update(np.ascontiguousarray(array).data)
    return np.frombuffer(sums.digest(), np.uint8)
