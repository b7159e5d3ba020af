"""The memory of this process: which addresses it has, what is there, and giving it back.

Everything here is for Linux with glibc; elsewhere it does nothing.
"""

import ctypes
import mmap
import os
import sys
from collections.abc import Iterator

Ranges = list[tuple[int, int]]

PAGE = mmap.PAGESIZE
IS_SUPPORTED = sys.platform == "linux" and hasattr(mmap, "MADV_DONTNEED")


def private_ranges() -> Ranges:
    """Addresses (start, end) of private memory without a file that may be written, in ascending order."""
    found = []
    with open("/proc/self/maps") as maps:
        for line in maps:
            addresses, access, _, _, inode, *path = line.split()
            if access == "rw-p" and inode == "0" and path in ([], ["[heap]"]):
                start, end = addresses.split("-")
                found.append((int(start, 16), int(end, 16)))
    return found


def subtract_ranges(ranges: Ranges, known: Ranges, least_bytes: int) -> Iterator[tuple[int, int]]:
    """What `ranges` have beyond `known` ones; both ascend. Parts shorter than `least_bytes` are left out."""
    for start, end in ranges:
        if end - start < least_bytes:
            continue
        free = start
        for first, last in [*known, (end, end)]:
            if last <= free or first > end:
                continue
            if first - free >= least_bytes:
                yield free, first
            free = max(free, last)


def read_memory(address: int, count: int) -> bytes | None:
    """So many bytes from an address on; None where nothing is mapped there."""
    try:
        # By the system, not by a pointer: what is not mapped is an error, not the end of the process.
        with open("/proc/self/mem", "rb", buffering=0) as memory:
            content = os.pread(memory.fileno(), count, address)
    except OSError:
        return None
    return content if len(content) == count else None


def return_pages(address: int, pages: int) -> None:
    """Give back so many pages from an address on to the operating system: they read as zeros."""
    start, length = ctypes.c_void_p(address), ctypes.c_size_t(pages * PAGE)
    advise = ctypes.CDLL(None).madvise
    # That it fails, as for memory that is locked, does no harm.
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        # Otherwise the system may join them with their neighbours, later, to a large page that is resident.
        advise(start, length, mmap.MADV_NOHUGEPAGE)
    advise(start, length, mmap.MADV_DONTNEED)


def return_free_memory() -> None:
    """Give back to the operating system what has been freed, where the C library can do it."""
    if IS_SUPPORTED:
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
