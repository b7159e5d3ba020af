"""Writes the folder of a report: the page, figures as PNG and PDF, tables as LaTeX, Markdown and CSV."""

import io
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from dune_rl.errors import ConfigError
from dune_rl.files import write_atomically
from dune_rl.reporting.figures.style import RC
from dune_rl.reporting.layout import figures_of, tables_of
from dune_rl.reporting.page.blocks import FigureBlock, Section
from dune_rl.reporting.page.render import render_page
from dune_rl.reporting.tables.table import Table, to_csv, to_latex, to_markdown

PAGE, FIGURES, TABLES = "index.html", "figures", "tables"
_WRITERS: tuple[tuple[str, Callable[[Table], str]], ...] = (
    (".tex", to_latex),
    (".md", lambda table: f"{to_markdown(table)}\n{table.caption}\n"),
    (".csv", to_csv),
)
_SUFFIXES = {FIGURES: (".png", ".pdf"), TABLES: tuple(suffix for suffix, _ in _WRITERS)}
_DPI = 200


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
    found = [each for each in out.iterdir() if each.name not in (PAGE, FIGURES, TABLES)]
    for name, suffixes in _SUFFIXES.items():
        folder = out / name
        if folder.is_dir():
            found += [each for each in folder.iterdir() if each.suffix not in suffixes]
    return found


def write_report(
    out: Path,
    title: str,
    summary: Sequence[str],
    sections: Sequence[Section],
    date: str,
    step: Callable[[], None] = lambda: None,
) -> None:
    """Write a report to `out`, in place of one that is there; `step` is called after each figure.

    The page is written last: a folder without it is of a report that was cut off.
    """
    (out / PAGE).unlink(missing_ok=True)
    for name in (FIGURES, TABLES):
        if (out / name).exists():
            shutil.rmtree(out / name)
        (out / name).mkdir(parents=True)
    pictures = {}
    for block in figures_of(sections):
        pictures[block.name] = _write_figure(out / FIGURES, block)
        step()
    for table in tables_of(sections):
        for suffix, render in _WRITERS:
            _write_text(out / TABLES / f"{table.name}{suffix}", render(table))
    _write_text(out / PAGE, render_page(title, summary, sections, pictures, date))


def _write_figure(folder: Path, block: FigureBlock) -> bytes:
    # Without times and versions, equal figures have equal bytes.
    picture = save_figure(block.figure, "png", {"Software": None})
    (folder / f"{block.name}.png").write_bytes(picture)
    document = save_figure(block.figure, "pdf", {"CreationDate": None, "Producer": None, "Creator": None})
    (folder / f"{block.name}.pdf").write_bytes(document)
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
