"""Writes the folder of a report: the page, figures as PNG and PDF, tables as LaTeX, Markdown and CSV."""

import contextlib
import io
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.learning.run.locks import RunLock
from dune_rl.reporting.figures.style import RC
from dune_rl.reporting.layout import figures_of, tables_of
from dune_rl.reporting.page.render import FigureBlock, Section, render_page
from dune_rl.reporting.tables.table import Table, escape_markdown, to_csv, to_latex, to_markdown

_WRITERS: Mapping[str, Callable[[Table], str]] = {
    ".tex": to_latex,
    ".md": lambda table: f"{to_markdown(table)}\n{escape_markdown(table.caption)}\n",
    ".csv": to_csv,
}
_DPI = 200


def write_report(
    folder: Path,
    title: str,
    summary: Sequence[str],
    sections: Sequence[Section],
    date: str,
    step: Callable[[], None] = lambda: None,
) -> None:
    """Write a report to the empty `folder`; `step` is called after each figure."""
    for name in (FIGURES, TABLES):
        (folder / name).mkdir()
    pictures = {}
    for block in figures_of(sections):
        pictures[block.name] = _write_figure(folder / FIGURES, block)
        step()
    for table in tables_of(sections):
        for suffix in SUFFIXES[TABLES]:
            _write_text(folder / TABLES / f"{table.name}{suffix}", _WRITERS[suffix](table))
    _write_text(folder / PAGE, render_page(title, summary, sections, pictures, date))


def _write_figure(folder: Path, block: FigureBlock) -> bytes:
    # Without times and versions, equal figures have equal bytes.
    picture = save_figure(block.figure, "png", {"Software": None})
    (folder / f"{block.name}.png").write_bytes(picture)
    document = save_figure(block.figure, "pdf", {"CreationDate": None, "Producer": None, "Creator": None})
    (folder / f"{block.name}.pdf").write_bytes(document)
    # What was drawn for it stays in memory as long as its parts do.
    block.figure.clear()
    return picture


def save_figure(figure: Figure, kind: str, metadata: dict[str, None]) -> bytes:
    """The bytes of a figure as a file of this kind."""
    data = io.BytesIO()
    with rc_context(RC):
        figure.savefig(data, format=kind, dpi=_DPI, metadata=metadata)
    return data.getvalue()


def _write_text(path: Path, text: str) -> None:
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


PAGE, FIGURES, TABLES = "index.html", "figures", "tables"
# By folder, the endings of the files that a report has there.
SUFFIXES = {FIGURES: (".png", ".pdf"), TABLES: (".tex", ".md", ".csv")}
# The page comes last: a folder without it has no whole report.
_ENTRIES = (FIGURES, TABLES, PAGE)


def check_folder(out: Path, *, overwrite: bool) -> None:
    """Raise ConfigError if `out` holds something that must stay; reports alone may be overwritten."""
    parent = next((each for each in (out, *out.parents) if each.exists()), Path())
    if not parent.is_dir():
        raise ConfigError(f"cannot write {out}: {parent} is a file; choose another out=FOLDER")
    if not out.exists():
        return
    others = sorted(_foreign_files(out))
    if others:
        raise ConfigError(f"out={out} holds other files ({others[0].name}); choose another folder")
    if any(out.iterdir()) and not overwrite:
        raise ConfigError(f"out={out} holds a report already; choose another folder, or add overwrite=true")


def _foreign_files(out: Path) -> list[Path]:
    found = [each for each in out.iterdir() if each.name not in _ENTRIES]
    for name, suffixes in SUFFIXES.items():
        folder = out / name
        if folder.is_dir():
            found += [each for each in folder.iterdir() if each.suffix not in suffixes]
    return found


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
