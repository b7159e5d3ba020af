"""Locks of files: one run at a time writes to a folder, and jobs of a sweep share the cores of a machine."""

import contextlib
import os
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

from dune_rl.core.errors import CheckpointError
from dune_rl.core.files import try_lock
from dune_rl.learning.checkpoint import CHECKPOINT_FILE

LOCK_FILE = ".lock"
# Files of a run, which may have no checkpoint: it was cut off early, or published without it.
_OF_A_RUN = ("events.out.tfevents.*", "metrics.csv", "policy_*.pt", "replay-*")
_POLL_S = 0.2


class RunLock:
    """A lock on `folder`, which the system releases when the process ends, however it does.

    Raises CheckpointError if another run has it. Where there are no such locks, nothing is locked.
    """

    def __init__(self, folder: Path) -> None:
        handle = _lock(folder)
        # The lock of a run that fails before it begins goes with this object.
        self._release = (
            None if handle is None else weakref.finalize(self, _unlock, handle, folder, os.getpid())
        )

    @property
    def is_held(self) -> bool:
        """Whether the folder is locked; false where there are no such locks."""
        return self._release is not None and self._release.alive

    def release(self, *, keep_file: bool = False) -> None:
        """Let others have the folder; a second call does nothing.

        With `keep_file` its file stays, as after a kill: what the run was writing may not be whole.
        """
        if self._release is None:
            return
        if keep_file and (held := self._release.detach()) is not None:
            _, _, (handle, _, owner), _ = held
            if os.getpid() == owner:
                os.close(handle)
        self._release()


def _lock(folder: Path) -> int | None:
    while True:
        handle = os.open(folder / LOCK_FILE, os.O_CREAT | os.O_RDWR, 0o644)
        is_locked = try_lock(handle)
        # Who had it before may have removed the file since it was opened here.
        with contextlib.suppress(FileNotFoundError):
            if is_locked and os.fstat(handle).st_ino == os.stat(folder / LOCK_FILE).st_ino:
                return handle
        os.close(handle)
        if is_locked is None:
            (folder / LOCK_FILE).unlink(missing_ok=True)
            return None
        if not is_locked:
            raise CheckpointError(
                f"Another run is writing to {folder}.\n"
                "Name another folder with run_dir, or wait until it ends."
            )


def _unlock(handle: int, folder: Path, owner: int) -> None:
    if os.getpid() != owner:
        # After a fork, the lock still belongs to the parent.
        return
    with contextlib.suppress(OSError):
        (folder / LOCK_FILE).unlink()
    os.close(handle)


def check_unused(folder: Path) -> None:
    """Raise CheckpointError if `folder`, which need not exist, holds files of a run.

    A new run would mix its files with those.
    """
    if (folder / CHECKPOINT_FILE).exists():
        raise CheckpointError(
            f"{folder} already holds a run; continue it with resume={folder}, or choose another run_dir"
        )
    if (folder / LOCK_FILE).exists():
        RunLock(folder).release()
    left = next((file for pattern in _OF_A_RUN for file in folder.glob(pattern)), None)
    if left is not None:
        raise CheckpointError(
            f"{folder} holds {left.name} of an earlier run, and no {CHECKPOINT_FILE} to go on with: choose "
            "another run_dir"
        )


def remove_leftovers(folder: Path) -> None:
    """Remove the files of a run in `folder` that was cut off before its first save.

    Raises CheckpointError if that run is still going on.
    """
    lock = RunLock(folder)
    for file in [file for pattern in _OF_A_RUN for file in folder.glob(pattern)]:
        file.unlink()
    lock.release()


@contextlib.contextmanager
def reserve_cores(
    folder: Path, needed: int, cores: int, waiting: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Hold `needed` of the machine's `cores` (all, if it needs more), among the jobs that share `folder`.

    It waits until so many are free, and calls `waiting` once if they are not. A core is the lock of a file,
    so that the cores of a job that dies are free at once. Where there are no such locks, nobody waits.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held, contextlib.ExitStack() as collecting:
        # One job at a time collects cores, lest two wait for each other's.
        gate = collecting.enter_context((folder / "gate").open("a"))
        free = [(folder / f"core{number}").open("a") for number in range(cores)]
        missing = min(needed, cores)
        has_gate = has_told = False
        while missing:
            has_gate = has_gate or try_lock(gate.fileno()) is not False
            for core in list(free) if has_gate else ():
                if missing and try_lock(core.fileno()) is not False:
                    free.remove(held.enter_context(core))
                    missing -= 1
            if missing:
                if not has_told:
                    waiting()
                has_told = True
                time.sleep(_POLL_S)
        for core in free:
            core.close()
        collecting.close()
        yield
