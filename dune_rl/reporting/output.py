"""Writes a report: the page, figures as PNG and PDF, tables as LaTeX, Markdown and CSV."""

import base64
import io
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

from dune_rl.core.files import write_atomically
from dune_rl.reporting.figures.style import RC
from dune_rl.reporting.folder import FIGURES, PAGE, SUFFIXES, TABLES
from dune_rl.reporting.page import FigureBlock, Section, figures_of, render_page, tables_of
from dune_rl.reporting.tables.table import Table, escape_markdown, to_csv, to_latex, to_markdown

_WRITERS: Mapping[str, Callable[[Table], str]] = {
    ".tex": to_latex,
    ".md": lambda table: f"{to_markdown(table)}\n{escape_markdown(table.caption)}\n",
    ".csv": to_csv,
}
_DPI = 200
# Speeds are those of the last minutes [s]: the steps of a report are few and long.
_PERIOD_S = 300.0


class ReportProgress(Progress):
    """The present step of a report, the share that is done, and the time left; a bar on terminals alone.

    The amounts of steps are proportional to their time, 1 for about 0.3 s.
    """

    def __init__(self, console: Console) -> None:
        columns = (TextColumn("{task.description}", markup=False), BarColumn(bar_width=None))
        super().__init__(
            *columns, TaskProgressColumn(), TimeRemainingColumn(), TextColumn("left"), console=console,
            disable=not console.is_terminal or bool(os.environ.get("CI")), transient=True, expand=True,
            speed_estimate_period=_PERIOD_S,
        )  # fmt: skip
        self._task: TaskID = self.add_task("", total=None)

    def begin(self, activity: str) -> None:
        """Name the step that begins."""
        self.update(self._task, description=activity, refresh=True)

    def expect(self, total: float) -> None:
        """Set the amount of all steps together."""
        self.update(self._task, total=total)

    def finish(self, amount: float) -> None:
        """Add the amount of a step that has ended."""
        self.advance(self._task, amount)


def write_report(
    folder: Path,
    title: str,
    summary: Sequence[str],
    sections: Sequence[Section],
    date: str,
    progress: ReportProgress,
) -> None:
    """Draw the figures of a report, one after another, and write it to the empty `folder`."""
    for name in (FIGURES, TABLES):
        (folder / name).mkdir()
    figures = figures_of(sections)
    progress.expect(sum(block.amount for block in figures))
    for number, block in enumerate(figures, 1):
        progress.begin(f"drawing figure {number} of {len(figures)}")
        _write_figure(folder / FIGURES, block)
        progress.finish(block.own_amount)
    for table in tables_of(sections):
        for suffix in SUFFIXES[TABLES]:
            _write_text(folder / TABLES / f"{table.name}{suffix}", _WRITERS[suffix](table))
    _write_text(folder / PAGE, render_page(title, summary, sections, date))


def _write_figure(folder: Path, block: FigureBlock) -> None:
    figure = block.draw()
    block.width_in = float(figure.get_figwidth())
    # Without times and versions, equal figures have equal bytes.
    picture = _figure_file(figure, "png", {"Software": None})
    block.picture = base64.b64encode(picture).decode("ascii")
    (folder / f"{block.name}.png").write_bytes(picture)
    document = _figure_file(figure, "pdf", {"CreationDate": None, "Producer": None, "Creator": None})
    (folder / f"{block.name}.pdf").write_bytes(document)


def _figure_file(figure: Figure, kind: str, metadata: dict[str, None]) -> bytes:
    data = io.BytesIO()
    with rc_context(RC):
        figure.savefig(data, format=kind, dpi=_DPI, metadata=metadata)
    return data.getvalue()


def _write_text(path: Path, text: str) -> None:
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
