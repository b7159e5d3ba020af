"""Writes the folder of a report: the page, figures as PNG and PDF, tables as LaTeX, Markdown and CSV."""

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from dune_rl.core.files import write_atomically
from dune_rl.reporting.figures.style import RC
from dune_rl.reporting.folder import FIGURES, PAGE, SUFFIXES, TABLES
from dune_rl.reporting.layout import figures_of, tables_of
from dune_rl.reporting.page.blocks import FigureBlock, Section
from dune_rl.reporting.page.render import render_page
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
