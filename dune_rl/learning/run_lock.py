"""The lock on a run's folder: one process at a time writes there."""

import contextlib
import os
from pathlib import Path
from typing import IO

from dune_rl.errors import CheckpointError

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
        self._file = None if fcntl is None else _lock(folder)

    def release(self) -> None:
        """Let others have the folder; a second call does nothing."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                (Path(self._file.name)).unlink()
            self._file.close()
            self._file = None


def _lock(folder: Path) -> IO[str] | None:
    while True:
        file = (folder / _LOCK_FILE).open("a")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise CheckpointError(
                f"Another run is writing to {folder}.\n"
                "Name another folder with run_dir, or wait until it ends."
            ) from None
        except OSError:
            # As some network file systems answer.
            file.close()
            return None
        # Who had it before may have removed the file since it was opened here.
        with contextlib.suppress(FileNotFoundError):
            if os.fstat(file.fileno()).st_ino == os.stat(folder / _LOCK_FILE).st_ino:
                return file
        file.close()


def refuse_locked(folder: Path) -> None:
    """Raise CheckpointError if another run is writing to `folder`, which need not exist."""
    if (folder / _LOCK_FILE).exists():
        RunLock(folder).release()
