"""The process that engines run in: messages of C code, freed memory, and results that scenes share."""

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar
from weakref import WeakValueDictionary

Key = TypeVar("Key")
Result = TypeVar("Result")

_STDERR_DESCRIPTOR = 2
# Of glibc alone.
_malloc_trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None


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
    if _malloc_trim is not None:
        _malloc_trim(0)


def share_by_identity(make: Callable[[Key], Result]) -> Callable[[Key], Result]:
    """Memoize `make` by its argument's identity, as long as somebody uses the result.

    A result must refer to its argument: otherwise another object could get the same id.
    """
    results: WeakValueDictionary[int, Result] = WeakValueDictionary()

    def load(key: Key) -> Result:
        found = results.get(id(key))
        if found is None:
            results[id(key)] = found = make(key)
        return found

    return load
