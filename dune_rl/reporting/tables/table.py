"""A table of a report, free of any format, and its LaTeX (booktabs), Markdown and CSV."""

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dune_rl.metrics.catalogue import MINUS, NOTHING, Measure, format_value
from dune_rl.statistics.intervals import Estimate

_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "°": r"$^\circ$",
    "²": r"$^2$",
    "³": r"$^3$",
    MINUS: r"$-$",
    NOTHING: "--",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
    "±": r"$\pm$",
    "\n": " ",
    "\r": " ",
}
# Letters that LaTeX joins to others: -- to a dash, '' and `` to quotation marks, and ?` to a Spanish one.
_LIGATURES = re.compile(r"([-'`,?!])(?=[-'`,])")
_MARKDOWN = re.compile(r"[\\`*<|]|(?<=\])\(")


@dataclass(frozen=True)
class Cell:
    """What a cell shows: `detail` is its interval, or another small print; the best of a column is marked."""

    text: str
    detail: str = ""
    best: bool = False

    @property
    def plain(self) -> str:
        """All of it in one line."""
        return f"{self.text} ({self.detail})" if self.detail else self.text


@dataclass(frozen=True)
class Table:
    """A table with a title and a caption; `name` is the stem of its files.

    The first `heads` cells of each row say what the row is about. `data` are the figures themselves, for the
    CSV file, with more digits than the cells show. `sources` are the files that they were computed from.
    """

    name: str
    title: str
    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    data: Sequence[Mapping[str, object]]
    sources: Sequence[Path] = field(default_factory=list)
    heads: int = 1


def to_markdown(table: Table, *, escape: bool = True) -> str:
    """A Markdown table, with its text as it reads; without `escape`, its text is Markdown already."""
    shown = escape_markdown if escape else str
    lines = [
        "| " + " | ".join(shown(one) for one in table.header) + " |",
        "|" + "|".join(["---"] * table.heads + ["---:"] * (len(table.header) - table.heads)) + "|",
    ]
    for row in table.rows:
        cells = []
        for cell in row:
            text = shown(cell.plain)
            cells.append(f"**{text}**" if cell.best else text)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def to_latex(table: Table) -> str:
    """A LaTeX table for the package booktabs, with caption and label."""
    columns = "l" * table.heads + "r" * (len(table.header) - table.heads)
    lines = [
        "% Needs \\usepackage{booktabs}.",
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{escape_latex(f'{table.title}. {table.caption}'.strip())}}}",
        rf"\label{{tab:{re.sub(r'[^A-Za-z0-9-]', '-', table.name)}}}",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        " & ".join(_protected(escape_latex(one)) for one in table.header) + r" \\",
        r"\midrule",
    ]
    for row in table.rows:
        cells = [
            rf"\textbf{{{escape_latex(cell.plain)}}}" if cell.best else escape_latex(cell.plain)
            for cell in row
        ]
        lines.append(" & ".join(_protected(cell) for cell in cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def to_csv(table: Table) -> str:
    """The figures of a table, a line each."""
    text = io.StringIO()
    names = list(dict.fromkeys(name for row in table.data for name in row))
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(table.data)
    return text.getvalue()


def escape_latex(text: str) -> str:
    """Text as LaTeX shows it letter by letter."""
    escaped = "".join(_LATEX.get(letter, letter) for letter in _LIGATURES.sub("\\1\0", text))
    return escaped.replace("\0", "{}")


def _protected(cell: str) -> str:
    # After \\ and before a row, LaTeX takes a bracket for an option.
    return f"{{}}{cell}" if cell.startswith(("[", "*")) else cell


def escape_markdown(text: str) -> str:
    """Text that cannot end a cell, begin a tag or make a link."""
    return _MARKDOWN.sub(lambda found: "\\" + found[0], " ".join(text.split()))


def text_table(
    name: str, title: str, caption: str, data: Sequence[Mapping[str, object]], sources: Sequence[Path]
) -> Table:
    """A table of words; columns in which no row has any are left out."""
    # Long lists have their place in the CSV alone.
    shown = [
        key for key in data[0] if key != "methods" and any(row[key] not in ("", NOTHING) for row in data)
    ]
    rows = [[Cell(str(row[key])) for key in shown] for row in data]
    return Table(name, title, caption, shown, rows, data, sources, heads=len(shown))


def estimate_cell(
    measure: Measure, estimate: Estimate | None, *, best: bool = False, unit: str = "",
    decimals: int | None = None,
) -> Cell:  # fmt: skip
    """A value with its interval; `unit` is put behind it, and `decimals` are the measure's by default."""
    if estimate is None or math.isnan(estimate.value):
        return Cell(NOTHING)
    value = f"{format_value(measure, estimate.value, decimals)}{unit}"
    if math.isnan(estimate.low):
        return Cell(value, best=best)
    low, high = (format_value(measure, end, decimals) for end in (estimate.low, estimate.high))
    return Cell(value, f"{low} to {high}", best)


def measure_title(measure: Measure) -> str:
    """The name of a measure with its unit."""
    return f"{measure.name} [{measure.unit}]" if measure.unit else measure.name
