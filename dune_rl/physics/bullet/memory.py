"""Memory that a new PyBullet client fills and hardly uses.

Of the 30 MB of a client 20 MB are buffers for commands, meshes and pictures,
which it sets to zero when it is made. A page of zeros can be given back to the
operating system, which puts a new one in its place when it is used.

Another 7 MB are pools for 4096 contacts and as many collision algorithms. Each
is a free list: an element that is not in use begins with the address of the
next one, the last with zero. A few hundred are plenty, and where the list ends,
Bullet takes memory from the heap. Pages that hold nothing but such links are
given back as well: the list then ends at the first of them, which reads as zeros.
"""

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Flags
from dune_rl.physics.process_memory import (
    IS_SUPPORTED,
    PAGE,
    private_ranges,
    return_pages,
    subtract_ranges,
)

Words = NDArray[np.uint64]

_WORDS = PAGE // 8
# Smaller regions and fewer pages in a row are not worth a look.
_LEAST_REGION, _LEAST_RUN = 2**20, 16
# Elements that a free list keeps, and its least length to be cut. A scene with one robot uses dozens.
_KEPT_ELEMENTS, _LEAST_ELEMENTS = 256, 1024
_WORDS_AT_ONCE = 2**17
_PRESENT = np.uint64(1 << 63)


@contextmanager
def returned_zero_pages() -> Iterator[None]:
    """Give back to the operating system what is allocated in the block and holds zeros or long free lists.

    Reads and writes of zeros give the same afterwards; free lists end earlier. Only addresses count that
    the process did not have before, so that nothing is touched that others own. Does nothing where the
    system has no such means, or while other threads of Python run, which might be writing to that memory.
    """
    if not IS_SUPPORTED or threading.active_count() > 1:
        yield
        return
    try:
        before = private_ranges()
    except OSError:
        yield
        return
    yield
    if threading.active_count() > 1:
        return
    try:
        for start, end in subtract_ranges(private_ranges(), before, _LEAST_REGION):
            for first, count in _runs(_resident(start, end)):
                _return_zeros(start + first * PAGE, count)
            for first, count in _runs(_resident(start, end)):
                # The last link, which is zero, may have been alone in a page that is gone by now.
                _cut_free_lists(start + first * PAGE, min(count + 1, (end - start) // PAGE - first))
    except OSError:
        # A system that tells nobody which pages are resident.
        return


def _resident(start: int, end: int) -> Flags:
    """Which pages of the memory at these addresses are resident."""
    with open("/proc/self/pagemap", "rb", buffering=0) as pagemap:
        # Eight bytes a page; see pagemap in the kernel's documentation.
        pagemap.seek(start // PAGE * 8)
        entries = np.frombuffer(pagemap.read((end - start) // PAGE * 8), np.uint64)
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
    words = _words(address, pages).reshape(pages, -1)
    zero: Flags = ~np.logical_or.reduce(words != 0, axis=1)
    for first, count in _runs(zero):
        return_pages(address + first * PAGE, count)


def _cut_free_lists(address: int, pages: int) -> None:
    """Give back those of so many pages from an address on that hold only the later links of free lists."""
    words = _words(address, pages)
    for first, stride, count in _free_lists(words, address):
        links = first + stride * np.arange(_KEPT_ELEMENTS, count)
        # From the first whole page on; the last element may go beyond the last one.
        start, end = -(-int(links[0]) // _WORDS), int(links[-1]) // _WORDS
        if end <= start:
            continue
        content = words[start * _WORDS : end * _WORDS]
        inside = links[(links >= start * _WORDS) & (links < end * _WORDS)]
        if np.count_nonzero(content) == len(inside):
            return_pages(address + start * PAGE, end - start)


def _free_lists(words: Words, address: int) -> Iterator[tuple[int, int, int]]:
    """Index of the first word, elements' length in words and their number, of each long free list.

    Its elements, no longer than a page, lie side by side in these `words`, which begin at an address.
    """
    places, ahead = _pointers_ahead(words, address)
    lengths, counts = np.unique(ahead, return_counts=True)
    for length in lengths[counts >= _LEAST_ELEMENTS - 1].tolist():
        stride, rest = divmod(length, words.itemsize)
        if rest:
            continue
        linked = places[ahead == length]
        # Chains are runs of links that are a stride apart; a last link stands for none.
        edges = np.flatnonzero(np.diff(linked, prepend=linked[:1], append=linked[-1:]) != stride)
        for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            last = int(linked[end - 1]) + stride
            if end - begin >= _LEAST_ELEMENTS - 1 and last < len(words) and words[last] == 0:
                yield int(linked[begin]), stride, end - begin + 1


def _pointers_ahead(words: Words, address: int) -> tuple[NDArray[np.intp], Words]:
    """Which of the `words`, the first at an address, point up to a page ahead, and how far [bytes]."""
    places, distances = [], []
    # In parts: NumPy asks for large pages for large arrays, which stay resident as a whole for those who get
    # that memory next.
    for first in range(0, len(words), _WORDS_AT_ONCE):
        part = words[first : first + _WORDS_AT_ONCE]
        start = address + first * words.itemsize
        # Unsigned: what points backward is far ahead.
        ahead = part - np.arange(start, start + part.nbytes, words.itemsize, dtype=np.uint64)
        found = np.flatnonzero((ahead > 0) & (ahead <= PAGE))
        places.append(found + first)
        distances.append(ahead[found])
    return np.concatenate(places), np.concatenate(distances)


def _words(address: int, pages: int) -> Words:
    """The memory of so many pages from an address on."""
    content = (ctypes.c_uint8 * (pages * PAGE)).from_address(address)
    return np.ctypeslib.as_array(content).view(np.uint64)
