"""The lock on a run's folder: one process at a time writes there."""

import contextlib
import os
import weakref
from pathlib import Path

from dune_rl.core.errors import CheckpointError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_LOCK_FILE = ".lock"


class RunLock:
    """A lock on `folder`, which the system releases when the process ends, however it does.

    Raises CheckpointError if another run has it. Where there are no such locks, nothing is locked.
    """

    def __init__(self, folder: Path) -> None:
        handle = None if fcntl is None else _lock(folder)
        # The lock of a run that fails before it begins goes with this object.
        self._release = (
            None if handle is None else weakref.finalize(self, _unlock, handle, folder, os.getpid())
        )

    def release(self) -> None:
        """Let others have the folder; a second call does nothing."""
        if self._release is not None:
            self._release()


def _lock(folder: Path) -> int | None:
    while True:
        handle = os.open(folder / _LOCK_FILE, os.O_CREAT | os.O_RDWR, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise CheckpointError(
                f"Another run is writing to {folder}.\n"
                "Name another folder with run_dir, or wait until it ends."
            ) from None
        except OSError:
            # As some network file systems answer.
            os.close(handle)
            return None
        # Who had it before may have removed the file since it was opened here.
        with contextlib.suppress(FileNotFoundError):
            if os.fstat(handle).st_ino == os.stat(folder / _LOCK_FILE).st_ino:
                return handle
        os.close(handle)


def _unlock(handle: int, folder: Path, owner: int) -> None:
    if os.getpid() != owner:
        # After a fork, the lock still belongs to the parent.
        return
    with contextlib.suppress(OSError):
        (folder / _LOCK_FILE).unlink()
    os.close(handle)


def refuse_locked(folder: Path) -> None:
    """Raise CheckpointError if another run is writing to `folder`, which need not exist."""
    if (folder / _LOCK_FILE).exists():
        RunLock(folder).release()
