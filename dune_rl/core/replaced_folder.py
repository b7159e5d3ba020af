"""Folders whose content is replaced as a whole, or not at all."""

import contextlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_writable, errors_naming, removing_empty
from dune_rl.core.folder_lock import FolderLock

# Beside a folder: what takes its place, its entries while they leave it, and once all of them have left.
_NEW, _LEAVING, _REPLACED = "new", "leaving", "old"
# Of a mount, which has all of them in itself.
_INSIDE = ".part"


def check_replaceable(
    out: Path,
    kind: str,
    find_others: Callable[[Path], Iterable[Path]],
    *,
    overwrite: bool,
    named: str | None = None,
) -> None:
    """Raise ConfigError if `out`, which the message calls `named`, holds something that must stay.

    That is what `find_others` finds in it and, unless `overwrite`, also what a command of the `kind`, such as
    "a report", wrote there. What a killed process had begun to replace is whole again before.
    """
    named = named or f"out={out}"
    check_writable(out)
    check_writable(_folder_beside(out).parent)
    _finish_replacing(out)
    if not out.exists():
        return
    others = sorted(each for each in find_others(out) if each.name != _INSIDE)
    if others:
        raise ConfigError(f"{named} holds other files ({others[0].name}); choose another folder")
    if _entries(out) and not overwrite:
        raise ConfigError(f"{named} holds {kind} already; choose another folder, or add overwrite=true")


@contextmanager
def replace_folder(out: Path, check: Callable[[], None], last: str) -> Iterator[Path]:
    """An empty folder beside `out`, whose entries take the place of those in `out` when the block ends.

    Where the block fails, `out` stays as it was. The entry `last` comes last and goes first: without it, a
    folder is not whole. What a process that was killed left beside `out` is removed, where the system has
    locks. `check` raises ConfigError if `out` holds something that must stay; so does this while another
    process writes to it.
    """
    place = out.resolve()
    with removing_empty(place.parent), _locked_folder_beside(out) as aside:
        # Another process may have ended since the caller looked.
        check()
        (aside / _NEW).mkdir()
        try:
            yield aside / _NEW
            check()
            _put_in_place(aside, place, last)
        finally:
            if not (aside / _LEAVING).exists() and not (aside / _REPLACED).exists():
                _remove(aside / _NEW)


@contextmanager
def _locked_folder_beside(out: Path) -> Iterator[Path]:
    """The folder for what takes the place of `out` and what it replaces; no other process has it."""
    aside = _folder_beside(out)
    lock = _lock(aside, out)
    try:
        _restore(aside, out.resolve())
        yield aside
    finally:
        lock.release()
        with contextlib.suppress(OSError):
            aside.rmdir()


def _folder_beside(out: Path) -> Path:
    # A link stays one, and its target is what is on the same file system.
    place = out.resolve()
    # Beside a mount is another file system, where a move is a copy, which can be cut off.
    return place / _INSIDE if os.path.ismount(place) else place.with_name(f".{place.name}.part")


def _entries(place: Path) -> list[Path]:
    return [each for each in place.iterdir() if each.name != _INSIDE]


def _finish_replacing(out: Path) -> None:
    """Make `out` whole where a process was killed while it put something in its place."""
    if any((_folder_beside(out) / name).exists() for name in (_LEAVING, _REPLACED)):
        with _locked_folder_beside(out):
            pass


def _restore(aside: Path, place: Path) -> None:
    """Undo what a killed process had begun to put in its place; finish it, where all of the old had left."""
    if place.exists():
        if (aside / _LEAVING).exists():
            _move_entries(aside / _LEAVING, place)
        if (aside / _REPLACED).exists() and (aside / _NEW).exists():
            _move_entries(aside / _NEW, place)
    for left_over in (_NEW, _LEAVING, _REPLACED):
        try:
            _remove(aside / left_over)
        except OSError as error:
            raise ConfigError(
                f"{aside / left_over} of an earlier command cannot be removed ({error.strerror}); remove it"
            ) from None


def _lock(aside: Path, out: Path) -> FolderLock:
    taken = ConfigError(f"another process is writing to {out}; choose another folder, or wait until it ends")
    while True:
        with errors_naming(out):
            aside.mkdir(parents=True, exist_ok=True)
        # Its last owner may have removed it this moment.
        with contextlib.suppress(FileNotFoundError):
            lock = FolderLock(aside, taken)
            break
    if not lock.is_held and any(aside.iterdir()):
        # There are no locks here, which would say whether that process lives.
        raise ConfigError(f"another process is writing to {out}, or was cut off; if so, remove {aside}")
    return lock


def _put_in_place(aside: Path, place: Path, last: str) -> None:
    """Move the new entries to `place`; those that are there leave it before, and come back on failure.

    Each state between, in which the process may be killed, is one that `_restore` undoes or finishes.
    """
    new, leaving, replaced = (aside / name for name in (_NEW, _LEAVING, _REPLACED))
    if not place.exists():
        new.rename(place)
        return
    # The folder itself stays: it may be the current one, a mount, or have rights of its own.
    leaving.mkdir()
    try:
        for each in sorted(_entries(place), key=lambda each: each.name != last):
            each.rename(leaving / each.name)
        leaving.rename(replaced)
        for each in sorted(new.iterdir(), key=lambda each: each.name == last):
            each.rename(place / each.name)
    except BaseException:
        if replaced.exists():
            for each in _entries(place):
                each.rename(new / each.name)
            replaced.rename(leaving)
        _move_entries(leaving, place)
        leaving.rmdir()
        raise
    # The new is in its place; what cannot be removed of the old is told by the next command.
    with contextlib.suppress(OSError):
        _remove(replaced)


def _move_entries(source: Path, target: Path) -> None:
    for each in list(source.iterdir()):
        each.rename(target / each.name)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
