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

    `was_left` says that its file was there: a process that had the folder was cut off. Raises `if_taken` if
    another process has it. Where there are no such locks, nothing is locked, and the file is a mark alone.
    """

    def __init__(self, folder: Path, if_taken: DuneError) -> None:
        self._file = folder / LOCK_FILE
        handle, self.was_left = _lock(folder, if_taken)
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
        if self._release is None:
            self._file.touch()
        self._set_file_removal(False)

    def finish(self) -> None:
        """Let others have the folder, in which all is whole, and remove the file."""
        if self._release is None:
            self._file.unlink(missing_ok=True)
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


def _lock(folder: Path, if_taken: DuneError) -> tuple[int | None, bool]:
    """The locked file, or None where there are no locks, and whether it was there before."""
    file = folder / LOCK_FILE
    while True:
        was_there = False
        try:
            handle = os.open(file, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644)
        except FileExistsError:
            was_there = True
            try:
                handle = os.open(file, os.O_RDWR)
            except FileNotFoundError:
                continue
        is_locked = try_lock(handle)
        # Who had it before may have removed the file since it was opened here.
        if is_locked and _is_at(handle, file):
            return handle, was_there
        os.close(handle)
        if is_locked is None:
            file.unlink(missing_ok=True)
            warnings.warn(
                f"{folder} is on a file system without locks of files: two processes that write to it would "
                "not notice each other",
                DuneWarning,
                stacklevel=2,
            )
            return None, was_there
        if not is_locked:
            raise if_taken


def _is_at(handle: int, file: Path) -> bool:
    """Whether the open file is still the one of that path."""
    try:
        return os.fstat(handle).st_ino == os.stat(file).st_ino
    except FileNotFoundError:
        return False


def _unlock(handle: int, folder: Path, owner: int, removes: bool) -> None:
    if os.getpid() != owner:
        # After a fork, the lock still belongs to the parent.
        return
    file = folder / LOCK_FILE
    if removes and _is_at(handle, file):
        with contextlib.suppress(OSError):
            file.unlink()
    os.close(handle)
