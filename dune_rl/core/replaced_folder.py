"""Folders whose content is replaced as a whole, or not at all."""

import contextlib
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.core.files import errors_naming
from dune_rl.core.folder_lock import FolderLock


def check_replaceable(
    out: Path, kind: str, find_others: Callable[[Path], Iterable[Path]], *, overwrite: bool
) -> None:
    """Raise ConfigError if `out` holds something that must stay.

    That is what `find_others` finds in it and, unless `overwrite`, also what a command of the `kind`, such as
    "a report", wrote there.
    """
    parent = next(each for each in (out, *out.absolute().parents) if each.exists())
    if not parent.is_dir():
        raise ConfigError(f"cannot write {out}: {parent} is a file; choose another out=FOLDER")
    if not out.exists():
        return
    others = sorted(find_others(out))
    if others:
        raise ConfigError(f"out={out} holds other files ({others[0].name}); choose another folder")
    if any(out.iterdir()) and not overwrite:
        raise ConfigError(f"out={out} holds {kind} already; choose another folder, or add overwrite=true")


@contextmanager
def replace_folder(out: Path, check: Callable[[], None], last: str) -> Iterator[Path]:
    """An empty folder beside `out`, whose entries take the place of those in `out` when the block ends.

    Where the block fails, `out` stays as it was. The entry `last` comes last and goes first: without it, a
    folder is not whole. What a process that was killed left beside `out` is removed. `check` raises
    ConfigError if `out` holds something that must stay; so does this while another process writes to it.
    """
    # A link stays one, and its target is what is on the same file system.
    place = out.resolve()
    aside = place.with_name(f".{place.name}.part")
    made = [each for each in place.parents if not each.exists()]
    new, old = aside / "new", aside / "old"
    lock = _lock(aside, out)
    try:
        # Another process may have ended since the caller looked.
        check()
        for left_over in (new, old):
            _remove(left_over)
        new.mkdir()
        yield new
        check()
        _put_in_place(new, place, old, last)
        made = []
    finally:
        _remove(new)
        lock.release()
        for folder in (aside, *made):
            with contextlib.suppress(OSError):
                folder.rmdir()


def _lock(aside: Path, out: Path) -> FolderLock:
    while True:
        with errors_naming(out):
            aside.mkdir(parents=True, exist_ok=True)
        # Its last owner may have removed it this moment.
        with contextlib.suppress(FileNotFoundError):
            try:
                return FolderLock(aside)
            except CheckpointError:
                raise ConfigError(
                    f"another process is writing to {out}; choose another out=FOLDER, or wait until it ends"
                ) from None


def _put_in_place(new: Path, place: Path, old: Path, last: str) -> None:
    """Move the entries in `new` to `place`; those that are there go to `old`, and come back on failure."""
    if not place.exists():
        new.rename(place)
        return
    # The folder itself stays: it may be the current one, a mount, or have rights of its own.
    old.mkdir()
    placed: list[str] = []
    try:
        for each in sorted(place.iterdir(), key=lambda each: each.name != last):
            shutil.move(each, old / each.name)
        for each in sorted(new.iterdir(), key=lambda each: each.name == last):
            placed.append(each.name)
            shutil.move(each, place / each.name)
    except BaseException:
        for name in placed:
            _remove(place / name)
        for each in list(old.iterdir()):
            shutil.move(each, place / each.name)
        old.rmdir()
        raise
    _remove(old)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
