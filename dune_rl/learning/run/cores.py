"""Shares the cores of a machine among jobs that a sweep runs side by side."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_POLL_S = 0.2


@contextmanager
def reserve_cores(
    folder: Path, needed: int, cores: int, waiting: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Hold `needed` of the machine's `cores` (all, if it needs more), among the jobs that share `folder`.

    It waits until so many are free, and calls `waiting` once if they are not. A core is the lock of a file, so
    that the cores of a job that dies are free at once. Where there are no such locks, nobody waits.
    """
    if fcntl is None:
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    held: list[int] = []
    gate = _open(folder / "gate")
    try:
        # One job at a time collects cores, lest two wait for what the other has.
        if not _try_lock(gate):
            waiting()
            waiting = _nothing
            fcntl.flock(gate, fcntl.LOCK_EX)
        free = [_open(folder / f"core{number}") for number in range(cores)]
        while len(held) < min(needed, cores):
            taken = [handle for handle in free if _try_lock(handle)][: min(needed, cores) - len(held)]
            for handle in free:
                if handle not in taken:
                    fcntl.flock(handle, fcntl.LOCK_UN)
            held += taken
            free = [handle for handle in free if handle not in taken]
            if len(held) < min(needed, cores):
                waiting()
                waiting = _nothing
                time.sleep(_POLL_S)
        for handle in free:
            os.close(handle)
        os.close(gate)
        gate = -1
        yield
    finally:
        for handle in (*held, *([gate] if gate >= 0 else [])):
            os.close(handle)


def _nothing() -> None:
    """Called in place of what is to be called once."""


def _open(path: Path) -> int:
    return os.open(path, os.O_CREAT | os.O_RDWR, 0o644)


def _try_lock(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
