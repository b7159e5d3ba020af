"""Memory that a new PyBullet client fills with zeros and hardly uses.

Of the 30 MB of a client 20 MB are buffers for commands, meshes and pictures,
which it sets to zero when it is made. A page of zeros can be given back to the
operating system, which puts a new one in its place when it is used.
"""

import ctypes
import mmap
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]

_PAGE = mmap.PAGESIZE
# Smaller regions and fewer pages in a row are not worth a look.
_LEAST_REGION, _LEAST_RUN = 2**20, 16
_PRESENT = np.uint64(1 << 63)
_IS_SUPPORTED = sys.platform == "linux" and hasattr(mmap, "MADV_DONTNEED")


@contextmanager
def returned_zero_pages() -> Iterator[None]:
    """Give back to the operating system what is allocated in the block and holds nothing but zeros.

    Reads and writes of that memory give the same afterwards. Only addresses count that the process did not
    have before, so that nothing is touched that others own. Does nothing where the system has no such
    means, or while other threads of Python run, which might be writing to memory that is still zero.
    """
    if not _IS_SUPPORTED or threading.active_count() > 1:
        yield
        return
    try:
        before = _regions()
    except OSError:
        yield
        return
    yield
    if threading.active_count() > 1:
        return
    try:
        for start, end in _subtract(_regions(), before):
            for first, count in _runs(_resident(start, end)):
                _return_zeros(start + first * _PAGE, count)
    except OSError:
        # A system that tells nobody which pages are resident.
        return


def return_free_memory() -> None:
    """Give back to the operating system what has been freed, where the C library can do it."""
    if _IS_SUPPORTED:
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def _regions() -> list[tuple[int, int]]:
    """Addresses (start, end) of private memory without a file that may be written, in ascending order."""
    found = []
    with open("/proc/self/maps") as maps:
        for line in maps:
            addresses, access, _, _, inode, *path = line.split()
            if access == "rw-p" and inode == "0" and path in ([], ["[heap]"]):
                start, end = addresses.split("-")
                found.append((int(start, 16), int(end, 16)))
    return found


def _subtract(regions: list[tuple[int, int]], known: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """What large `regions` have beyond `known` ones; both ascend. What is left in small parts is left out."""
    for start, end in regions:
        if end - start < _LEAST_REGION:
            continue
        free = start
        for first, last in [*known, (end, end)]:
            if last <= free or first > end:
                continue
            if first - free >= _LEAST_REGION:
                yield free, first
            free = max(free, last)


def _resident(start: int, end: int) -> Flags:
    """Which pages of the memory at these addresses are resident."""
    with open("/proc/self/pagemap", "rb", buffering=0) as pagemap:
        # Eight bytes a page; see pagemap in the kernel's documentation.
        pagemap.seek(start // _PAGE * 8)
        entries = np.frombuffer(pagemap.read((end - start) // _PAGE * 8), np.uint64)
    flags: Flags = (entries & _PRESENT) != 0
    return flags


def _runs(flags: Flags) -> Iterator[tuple[int, int]]:
    """First index and length of each long run of True."""
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    for first, last in edges.reshape(-1, 2).tolist():
        if last - first >= _LEAST_RUN:
            yield first, last - first


def _return_zeros(address: int, pages: int) -> None:
    """Give back those of so many pages from an address on that hold nothing but zeros."""
    content = (ctypes.c_uint8 * (pages * _PAGE)).from_address(address)
    words = np.ctypeslib.as_array(content).view(np.uint64).reshape(pages, -1)
    zero: Flags = ~np.logical_or.reduce(words != 0, axis=1)
    for first, count in _runs(zero):
        start, length = ctypes.c_void_p(address + first * _PAGE), ctypes.c_size_t(count * _PAGE)
        # That it fails, as for memory that is locked, does no harm.
        ctypes.CDLL(None).madvise(start, length, mmap.MADV_DONTNEED)
