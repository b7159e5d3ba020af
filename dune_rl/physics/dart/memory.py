"""Memory that DART keeps of collision meshes which nobody uses any more.

For Bullet's detector DART 6.20 copies the triangles of a mesh into a `btTriangleMesh`, which it never deletes
(dart/collision/bullet/BulletCollisionDetector.cpp): 108 bytes of each triangle, for every world that a
process enters. Bullet says where it puts these copies, and their pages are given back to the operating system
once nobody uses them. What is lost then is address space, of which there is plenty.
"""

import ctypes
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.process_memory import IS_SUPPORTED, PAGE, read_memory, return_pages

# Bullet's vectors have four components, the last of which is not used.
_COMPONENTS = 4
_POINTER_BYTES = ctypes.sizeof(ctypes.c_void_p)
_ALIGNMENT = 16

_ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t)


@dataclass(frozen=True)
class MeshCopy:
    """The whole pages of a block that Bullet has allocated for a copy of a mesh.

    They begin at `address`; the first `used` bytes have the copy, with this `checksum`, the rest is room.
    """

    address: int
    pages: int
    used: int
    checksum: int


@contextmanager
def watch_copies(meshes: Sequence[NDArray[np.float64]], found: list[MeshCopy]) -> Iterator[None]:
    """Add to `found` the copies that DART makes in the block of meshes with these corners, (F, 3, 3) each."""
    blocks: dict[int, int] = {}
    with _logged_allocations(blocks):
        yield
    for corners in meshes:
        # DART's files have float32.
        vertices = corners.reshape(-1, 3).astype(np.float32).astype(np.float64)
        # Indices of a small mesh begin like those of a large one, but they are as long as they must be.
        for rows, width in (
            (vertices, _COMPONENTS),
            (np.arange(len(vertices), dtype=np.int32).reshape(-1, 1), 1),
        ):
            found += _find_array(rows, width, blocks)


_unused: list[MeshCopy] = []


def forget_copies(copies: list[MeshCopy]) -> None:
    """Note that nobody will use these copies any more, once what is being deleted at present is gone."""
    _unused.extend(copies)


def return_unused_copies() -> None:
    """Give back the pages of copies that nobody uses; to be called before other meshes are loaded."""
    while _unused:
        copy = _unused.pop()
        # What has changed belongs to others: it was freed after all, and used again.
        content = read_memory(copy.address, copy.used)
        if content is not None and zlib.crc32(content) == copy.checksum:
            return_pages(copy.address, copy.pages)


@contextmanager
def _logged_allocations(blocks: dict[int, int]) -> Iterator[None]:
    """Note the size [bytes] of each large block that Bullet allocates meanwhile, by its address."""
    set_allocator = _bullets_allocator_setter()
    if set_allocator is None:
        yield
        return
    allocate = ctypes.CDLL(None).malloc
    allocate.argtypes, allocate.restype = [ctypes.c_size_t], ctypes.c_void_p

    def logged(size: int) -> int | None:
        address: int | None = allocate(size)
        if address is not None and size >= 2 * PAGE:
            blocks[address] = size
        return address

    callback = _ALLOCATE(logged)
    # Null is what Bullet begins with: malloc and free.
    set_allocator(ctypes.cast(callback, ctypes.c_void_p), None)
    try:
        yield
    finally:
        set_allocator(None, None)


def _bullets_allocator_setter() -> Any:
    """Bullet's `btAlignedAllocSetCustom(allocate, free)`; None where DART does not offer it."""
    if not IS_SUPPORTED:
        return None
    setter = getattr(ctypes.CDLL(dartpy.__file__), "_Z23btAlignedAllocSetCustomPFPvmEPFvS_E", None)
    if setter is not None:
        setter.argtypes, setter.restype = [ctypes.c_void_p, ctypes.c_void_p], None
    return setter


def _find_array(rows: NDArray[Any], width: int, blocks: Mapping[int, int]) -> Iterator[MeshCopy]:
    """The copies of `rows` (n, k), stored as rows of `width` entries, at the start of one of the blocks."""
    size = len(rows) * width * rows.itemsize
    if size < 2 * PAGE:
        return
    for block, length in blocks.items():
        # As Bullet aligns: behind a pointer to the block.
        first = -(-(block + _POINTER_BYTES) // _ALIGNMENT) * _ALIGNMENT
        if first + size > block + length:
            continue
        content = read_memory(first, size)
        if content is None:
            continue
        stored = np.frombuffer(content, rows.dtype).reshape(-1, width)
        if not np.array_equal(stored[:, : rows.shape[1]], rows):
            continue
        start, end = -(-first // PAGE) * PAGE, (block + length) // PAGE * PAGE
        used = content[start - first :]
        yield MeshCopy(start, (end - start) // PAGE, len(used), zlib.crc32(used))
