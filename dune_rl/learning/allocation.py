"""Keeps freed memory in the process, which makes an update of small networks about a seventh faster."""

import ctypes
import sys

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 1 << 30


def keep_freed_memory() -> None:
    """Stop glibc from handing activations back to the kernel after every update; elsewhere, do nothing.

    An update allocates and frees the same half-megabyte blocks again and
    again; with glibc's defaults each costs fresh pages.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)
