"""The folder of a report: what may stand in its place, and how it is put there as a whole."""

import contextlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.learning.run.locks import RunLock

PAGE, FIGURES, TABLES = "index.html", "figures", "tables"
# By folder, the endings of the files that a report has there.
SUFFIXES = {FIGURES: (".png", ".pdf"), TABLES: (".tex", ".md", ".csv")}
# The page comes last: a folder without it has no whole report.
_ENTRIES = (FIGURES, TABLES, PAGE)


def why_no_folder(path: Path) -> str | None:
    """Why nothing can be read from `path`; None for a folder."""
    if not path.exists():
        return "there is no such folder"
    return None if path.is_dir() else "is a file; give the folder of a run or of an evaluation"


def check_folder(out: Path, *, overwrite: bool) -> None:
    """Raise ConfigError if `out` holds something that must stay; reports alone may be overwritten."""
    parent = next((each for each in (out, *out.parents) if each.exists()), Path())
    if not parent.is_dir():
        raise ConfigError(f"cannot write {out}: {parent} is a file; choose another out=FOLDER")
    if not out.exists():
        return
    others = [each for each in out.iterdir() if each.name not in _ENTRIES]
    for name, suffixes in SUFFIXES.items():
        if (out / name).is_dir():
            others += [each for each in (out / name).iterdir() if each.suffix not in suffixes]
    if others:
        raise ConfigError(f"out={out} holds other files ({min(others).name}); choose another folder")
    if any(out.iterdir()) and not overwrite:
        raise ConfigError(f"out={out} holds a report already; choose another folder, or add overwrite=true")


@contextmanager
def write_aside(out: Path, *, overwrite: bool) -> Iterator[Path]:
    """An empty folder beside `out` that takes its place when the block ends, and goes where the block fails.

    What a process that was killed left there is removed. Raises ConfigError if `out` holds something that
    must stay, or while another process writes a report to it.
    """
    # A link stays one, and its target is what is on the same file system.
    place = out.resolve()
    aside = place.with_name(f".{place.name}.part")
    made = [each for each in place.parents if not each.exists()]
    new, old = aside / "new", aside / "old"
    lock = _lock(aside, out)
    try:
        # Another process may have ended since this one looked.
        check_folder(out, overwrite=overwrite)
        for left_over in (new, old):
            _remove(left_over)
        new.mkdir()
        yield new
        check_folder(out, overwrite=overwrite)
        _put_in_place(new, place, old)
        made = []
    finally:
        _remove(new)
        lock.release()
        for folder in (aside, *made):
            with contextlib.suppress(OSError):
                folder.rmdir()


def _lock(aside: Path, out: Path) -> RunLock:
    while True:
        aside.mkdir(parents=True, exist_ok=True)
        # Its last owner may have removed it this moment.
        with contextlib.suppress(FileNotFoundError):
            try:
                return RunLock(aside)
            except CheckpointError:
                raise ConfigError(
                    f"another process is writing a report to {out}; choose another out=FOLDER, or wait until "
                    "it ends"
                ) from None


def _put_in_place(new: Path, place: Path, old: Path) -> None:
    """Move the report in `new` to `place`; the one that is there goes to `old`, and comes back on failure."""
    if not place.exists():
        new.rename(place)
        return
    # The folder itself stays: it may be the current one, a mount, or have rights of its own.
    old.mkdir()
    placed = []
    try:
        for name in reversed(_ENTRIES):
            if (place / name).exists():
                shutil.move(place / name, old / name)
        for name in _ENTRIES:
            placed.append(name)
            shutil.move(new / name, place / name)
    except BaseException:
        for name in _ENTRIES:
            if name in placed or (old / name).exists():
                _remove(place / name)
            if (old / name).exists():
                shutil.move(old / name, place / name)
        old.rmdir()
        raise
    _remove(old)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
