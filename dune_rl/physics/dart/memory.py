"""Memory that DART keeps of collision meshes which nobody uses any more.

For Bullet's detector DART 6.20 copies the triangles of a mesh into a `btTriangleMesh`, which it never deletes
(dart/collision/bullet/BulletCollisionDetector.cpp): 108 bytes of each triangle, for every world that a
process enters. Bullet says where it puts these copies, and they are freed here once nobody uses them, if a
trial shows that DART does not do so itself.
"""

import ctypes
import signal
import threading
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.process_memory import IS_SUPPORTED, read_memory

# Bullet's vectors have four components, the last of which is not used.
_COMPONENTS = 4
_POINTER_BYTES = ctypes.sizeof(ctypes.c_void_p)
_ALIGNMENT = 16
# Arrays are told apart by so many bytes first: a vertex, or six indices.
_HEAD_BYTES = 24
# What a block may have beyond its array's doubled size.
_SLACK_BYTES = 64

_ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t)
_FREE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)

# Three triangles, which no plane holds.
_TRIAL_MESH = (
    ((0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, 1.25, 0.0)),
    ((0.0, 0.0, 0.0), (0.0, 1.25, 0.0), (0.0, 0.0, 1.75)),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 1.75), (1.5, 0.0, 0.0)),
)

# The size [bytes] of each block that Bullet has allocated and not freed, by its address.
Blocks = dict[int, int]


@dataclass(frozen=True)
class MeshCopy:
    """A block of memory with a part of a mesh's copy: `used` bytes from `start` on with this `checksum`."""

    block: int
    start: int
    used: int
    checksum: int


class CopyWatch:
    """Finds the copies that DART makes of meshes, if it keeps them.

    `load(corners)` returns an object that holds a mesh, of these corners (F, 3, 3), in a detector of its own.
    It is called once, for a trial.
    """

    def __init__(self, load: Callable[[Array], Any]) -> None:
        self._load = load

    @contextmanager
    def __call__(self, meshes: Sequence[Array], found: list[MeshCopy]) -> Iterator[None]:
        """Add to `found` the copies that DART makes in the block of meshes with these corners.

        There are none where DART frees them itself, or cannot be asked.
        """
        if not self.is_needed:
            yield
            return
        with _deferred_signals(), _logged_allocations() as blocks:
            yield
        arrays = _Arrays(blocks)
        # The largest first: indices of a small mesh begin like those of a large one.
        for corners in sorted(meshes, key=len, reverse=True):
            found += arrays.take_copies(corners)

    @cached_property
    def is_needed(self) -> bool:
        """Whether DART keeps the copies of a mesh when the detector, and all else that used it, is gone."""
        if _allocator_setter() is None:
            return False
        with _deferred_signals(), _logged_allocations() as blocks:
            loaded = self._load(np.array(_TRIAL_MESH))
            copies = _Arrays(blocks).take_copies(np.array(_TRIAL_MESH))
            del loaded
            return bool(copies) and all(copy.block in blocks for copy in copies)


_unused: list[MeshCopy] = []


def forget_copies(copies: list[MeshCopy]) -> None:
    """Note that nobody will use these copies any more, once what is being deleted at present is gone."""
    _unused.extend(copies)


def free_unused_copies() -> None:
    """Free the copies that nobody uses; to be called before other meshes are loaded."""
    while _unused:
        copy = _unused.pop()
        # What has changed belongs to others.
        content = read_memory(copy.start, copy.used)
        if content is not None and zlib.crc32(content) == copy.checksum:
            _c_library().free(copy.block)


@contextmanager
def _logged_allocations() -> Iterator[Blocks]:
    """Note which blocks Bullet allocates meanwhile and has not freed; yields what is complete at the end."""
    blocks: Blocks = {}
    set_allocator, library = _allocator_setter(), _c_library()
    assert set_allocator is not None

    def allocate(size: int) -> int | None:
        address: int | None = library.malloc(size)
        if address is not None:
            blocks[address] = size
        return address

    def free(address: int | None) -> None:
        if address is not None:
            blocks.pop(address, None)
        library.free(address)

    callbacks = _ALLOCATE(allocate), _FREE(free)
    set_allocator(*(ctypes.cast(callback, ctypes.c_void_p) for callback in callbacks))
    try:
        yield blocks
    finally:
        # Null is what Bullet begins with: malloc and free.
        set_allocator(None, None)


@cache
def _c_library() -> Any:
    library = ctypes.CDLL(None)
    library.malloc.argtypes, library.malloc.restype = [ctypes.c_size_t], ctypes.c_void_p
    library.free.argtypes, library.free.restype = [ctypes.c_void_p], None
    return library


@cache
def _allocator_setter() -> Callable[..., None] | None:
    """Bullet's `btAlignedAllocSetCustom(allocate, free)`; None where DART does not offer it."""
    if not IS_SUPPORTED:
        return None
    setter = getattr(ctypes.CDLL(dartpy.__file__), "_Z23btAlignedAllocSetCustomPFPvmEPFvS_E", None)
    if setter is not None:
        setter.argtypes, setter.restype = [ctypes.c_void_p, ctypes.c_void_p], None
    return setter


class _Arrays:
    """Bullet's arrays at the start of blocks of memory."""

    def __init__(self, blocks: Blocks) -> None:
        # Block, start of the array and room in it, by what the array begins with.
        self._by_head: dict[bytes, list[tuple[int, int, int]]] = {}
        for block, length in blocks.items():
            # As Bullet aligns: behind a pointer to the block.
            start = -(-(block + _POINTER_BYTES) // _ALIGNMENT) * _ALIGNMENT
            room = block + length - start
            content = read_memory(start, _HEAD_BYTES) if room >= _HEAD_BYTES else None
            if content is not None:
                self._by_head.setdefault(_head(content), []).append((block, start, room))

    def take_copies(self, corners: Array) -> list[MeshCopy]:
        """The copies of a mesh's vertices and indices, which are not found again."""
        # DART's files have float32.
        vertices = corners.reshape(-1, 3).astype(np.float32).astype(np.float64)
        indices = np.arange(len(vertices), dtype=np.int32).reshape(-1, 1)
        found = self._take(vertices, _COMPONENTS), self._take(indices, 1)
        return [copy for copy in found if copy is not None]

    def _take(self, rows: NDArray[Any], width: int) -> MeshCopy | None:
        """The copy of `rows` (n, k), stored as rows of `width` entries."""
        size = len(rows) * width * rows.itemsize
        places = self._by_head.get(_head(rows.tobytes()), [])
        for place in places:
            block, start, room = place
            # Arrays grow by doubling.
            content = read_memory(start, size) if size <= room <= 2 * size + _SLACK_BYTES else None
            if content is None:
                continue
            stored = np.frombuffer(content, rows.dtype).reshape(-1, width)
            if np.array_equal(stored[:, : rows.shape[1]], rows):
                places.remove(place)
                return MeshCopy(block, start, size, zlib.crc32(content))
        return None


def _head(content: bytes) -> bytes:
    """The first bytes of an array as a key, in which zeros have no sign."""
    return (np.frombuffer(content[:_HEAD_BYTES]) + 0.0).tobytes()


@contextmanager
def _deferred_signals() -> Iterator[None]:
    """Run Python's handlers of signals after the block instead of in it.

    In it they would run within the callbacks of `_logged_allocations`, which cannot raise: Ctrl-C would give
    Bullet no memory, and end the process.
    """
    if threading.current_thread() is not threading.main_thread():
        # Handlers run in the main thread alone.
        yield
        return
    arrived: list[int] = []
    handlers: dict[int, Any] = {}
    try:
        for number in signal.valid_signals():
            handler = signal.getsignal(number)
            if callable(handler):
                handlers[number] = handler
                signal.signal(number, lambda number, frame: arrived.append(number))
        yield
    finally:
        for deferred, handler in handlers.items():
            signal.signal(deferred, handler)
        for deferred in arrived:
            signal.raise_signal(deferred)
