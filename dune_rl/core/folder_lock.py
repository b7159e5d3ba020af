"""A lock of a folder: one process at a time writes to it."""

import contextlib
import os
import warnings
import weakref
from pathlib import Path

from dune_rl.core.errors import DuneError, DuneWarning
from dune_rl.core.files import try_lock

LOCK_FILE = ".lock"


class FolderLock:
    """A lock on `folder`, which the system releases when the process ends, however it does.

    `was_left` says that its file was there: a process that had the folder was killed, or still has it. Raises
    `if_taken` if another process has it. Where there are no such locks, nothing is locked.
    """

    def __init__(self, folder: Path, if_taken: DuneError) -> None:
        self.was_left = (folder / LOCK_FILE).exists()
        handle = _lock(folder, if_taken)
        # The lock of a process that fails before it begins to write goes with this object, and its file, too.
        self._release = (
            None if handle is None else weakref.finalize(self, _unlock, handle, folder, os.getpid(), True)
        )

    @property
    def is_held(self) -> bool:
        """Whether the folder is locked; false where there are no such locks."""
        return self._release is not None and self._release.alive

    def keep_file(self) -> None:
        """Leave the file where it is when the lock ends, as after a kill, unless by `finish`.

        It says that what was being written may not be whole.
        """
        self._set_file_removal(False)

    def finish(self) -> None:
        """Let others have the folder, in which all is whole, and remove the file."""
        self._set_file_removal(True)
        self.release()

    def release(self) -> None:
        """Let others have the folder; a second call does nothing."""
        if self._release is not None:
            self._release()

    def _set_file_removal(self, removes: bool) -> None:
        if self._release is not None and (held := self._release.detach()) is not None:
            handle, folder, owner, _ = held[2]
            self._release = weakref.finalize(self, _unlock, handle, folder, owner, removes)


def _lock(folder: Path, if_taken: DuneError) -> int | None:
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
            warnings.warn(
                f"{folder} is on a file system without locks of files: two processes that write to it would "
                "not notice each other",
                DuneWarning,
                stacklevel=2,
            )
            return None
        if not is_locked:
            raise if_taken


def _unlock(handle: int, folder: Path, owner: int, removes: bool) -> None:
    if os.getpid() != owner:
        # After a fork, the lock still belongs to the parent.
        return
    if removes:
        with contextlib.suppress(OSError):
            (folder / LOCK_FILE).unlink()
    os.close(handle)
