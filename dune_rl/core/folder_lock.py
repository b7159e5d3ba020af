"""A lock of a folder: one process at a time writes to it."""

import contextlib
import os
import weakref
from pathlib import Path

from dune_rl.core.errors import DuneError
from dune_rl.core.files import try_lock

LOCK_FILE = ".lock"


class FolderLock:
    """A lock on `folder`, which the system releases when the process ends, however it does.

    Raises `if_taken` if another process has it. Where there are no such locks, nothing is locked.
    """

    def __init__(self, folder: Path, if_taken: DuneError) -> None:
        handle = _lock(folder, if_taken)
        # The lock of a process that fails before it begins to write goes with this object.
        self._release = (
            None if handle is None else weakref.finalize(self, _unlock, handle, folder, os.getpid())
        )

    @property
    def is_held(self) -> bool:
        """Whether the folder is locked; false where there are no such locks."""
        return self._release is not None and self._release.alive

    def release(self, *, keep_file: bool = False) -> None:
        """Let others have the folder; a second call does nothing.

        With `keep_file` its file stays, as after a kill: what was being written may not be whole.
        """
        if self._release is None:
            return
        if keep_file and (held := self._release.detach()) is not None:
            _, _, (handle, _, owner), _ = held
            if os.getpid() == owner:
                os.close(handle)
        self._release()


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
            return None
        if not is_locked:
            raise if_taken


def _unlock(handle: int, folder: Path, owner: int) -> None:
    if os.getpid() != owner:
        # After a fork, the lock still belongs to the parent.
        return
    with contextlib.suppress(OSError):
        (folder / LOCK_FILE).unlink()
    os.close(handle)
