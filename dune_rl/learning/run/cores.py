"""Shares the cores of a machine among jobs that a sweep runs side by side."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TextIO

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

    It waits until so many are free, and calls `waiting` once if they are not. A core is the lock of a file,
    so that the cores of a job that dies are free at once. Where there are no such locks, nobody waits.
    """
    if fcntl is None:
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as held:
        with (folder / "gate").open("a") as gate:
            # One job at a time collects cores, lest two wait for each other's.
            has_told = not _try_lock(gate)
            if has_told:
                waiting()
                fcntl.flock(gate, fcntl.LOCK_EX)
            free = [(folder / f"core{number}").open("a") for number in range(cores)]
            missing = min(needed, cores)
            while missing:
                for core in list(free):
                    if missing and _try_lock(core):
                        free.remove(held.enter_context(core))
                        missing -= 1
                if missing and not has_told:
                    waiting()
                    has_told = True
                if missing:
                    time.sleep(_POLL_S)
            for core in free:
                core.close()
        yield


def _try_lock(file: TextIO) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
