"""The process that engines run in: what their C code prints, and the memory that they have freed."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_STDERR_DESCRIPTOR = 2


@contextmanager
def suppress_stderr() -> Iterator[None]:
    """Discard everything written to the standard error file descriptor inside the block.

    Works for C code, unlike `contextlib.redirect_stderr`. Does nothing in a process without standard error.
    """
    try:
        original = os.dup(_STDERR_DESCRIPTOR)
    except OSError:
        yield
        return
    if sys.stderr is not None:
        sys.stderr.flush()
    null_device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, _STDERR_DESCRIPTOR)
    try:
        yield
    finally:
        os.dup2(original, _STDERR_DESCRIPTOR)
        os.close(original)
        os.close(null_device)


def return_free_memory() -> None:
    """Return freed memory to the operating system, where the C library has `malloc_trim` (glibc)."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
