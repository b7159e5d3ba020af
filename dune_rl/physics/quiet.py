"""Keeping a C library's greetings out of a program's output."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_STANDARD_ERROR = 2


@contextmanager
def silent_stderr() -> Iterator[None]:
    """Send what C code prints on standard error nowhere; does nothing where there is no such output."""
    try:
        kept = os.dup(_STANDARD_ERROR)
    except OSError:
        yield
        return
    if sys.stderr is not None:
        sys.stderr.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, _STANDARD_ERROR)
    try:
        yield
    finally:
        os.dup2(kept, _STANDARD_ERROR)
        os.close(kept)
        os.close(nowhere)
