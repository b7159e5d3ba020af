"""Tables in Markdown files that are made from files of results: `python -m dune_rl.report into=README.md`.

A block begins with a comment that says what it is made of, in YAML, and ends with another:

    <!-- report: table
    methods:
      trained: {folder: experiments/inspection, policy: inspection}
    measures: [SR, TR]
    -->
    | method | SR | TR |
    ...
    <!-- end report -->

Folders are relative to the Markdown file. What is between the comments is written anew; the rest stays.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, ValidationError

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import NOTHING, equation_of_p, format_difference, format_value, measure_of
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.comparison import (
    EvaluatedPolicy,
    compare_methods,
    estimate_of,
    estimate_rows,
    select_metrics,
)
from dune_rl.reporting.inputs import Note, ReportInputs
from dune_rl.reporting.reading import read_inputs
from dune_rl.reporting.rows import read_rows
from dune_rl.reporting.tables.methods import PAPER, PAPER_FIGURES
from dune_rl.reporting.tables.table import Cell, Table, escape_markdown, estimate_cell, to_markdown
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import cluster_rows
from dune_rl.statistics.paired_comparison import PairedComparison, compare_success, holm_adjusted


class SourceConf(Settings):
    """A method's episodes: of a folder, and of one of its policies where it has several."""

    folder: str
    policy: str | None = None


class BlockSources:
    """The folders that a Markdown file names, relative to its folder `beside`; each is read once.

    `skipped` and `notes` are what a reader must know of those that were read.
    """

    def __init__(self, beside: Path) -> None:
        self.beside = beside
        self.skipped: list[Note] = []
        self.notes: list[Note] = []
        self._read: dict[Path, ReportInputs] = {}

    def find_method(self, source: str | SourceConf) -> EvaluatedPolicy:
        """The episodes of a source; raises ConfigError unless there is exactly one method."""
        conf = SourceConf(folder=source) if isinstance(source, str) else source
        inputs = self._inputs(self.beside / conf.folder)
        methods = [
            method
            for comparison in collect_comparisons(inputs.evaluations)
            for method in comparison.methods
            if conf.policy in (None, method.policy)
        ]
        if len(methods) == 1:
            return methods[0]
        if not methods:
            reason = f": {inputs.skipped[0].text}" if inputs.skipped else ""
            raise ConfigError(f"{conf.folder} has no episodes of {conf.policy or 'a policy'}{reason}")
        policies = ", ".join(dict.fromkeys(method.policy for method in methods))
        raise ConfigError(f"{conf.folder} has several methods ({policies}); name one folder and policy")

    def _inputs(self, folder: Path) -> ReportInputs:
        if folder not in self._read:
            self._read[folder] = found = read_inputs([folder])
            # Folders may lie in each other.
            self.skipped += [note for note in found.skipped if note not in self.skipped]
            self.notes += [note for note in found.notes if note not in self.notes]
        return self._read[folder]


_MISSING = "not run"


class TableConf(Settings):
    """A table of methods and measures.

    `methods` are by their titles; one of several sources has a figure for each, without interval. `labels`
    name measures otherwise. With `paper`, a world's name, the figures of the DUnE paper are beside ours.
    """

    methods: dict[str, str | SourceConf | tuple[str | SourceConf, ...]] = Field(min_length=1)
    measures: tuple[str, ...] = Field(min_length=1)
    rows: Literal["methods", "measures"] = "methods"
    labels: Mapping[str, str] = Field(default_factory=dict)
    decimals: Mapping[str, int] = Field(default_factory=dict)
    intervals: bool = True
    paper: str | None = None


class PairConf(Settings):
    """A sentence on which of two methods succeeds more often on the same episodes."""

    first: str | SourceConf
    second: str | SourceConf


class GridConf(Settings):
    """One `measure` of several methods on several sets, or among several populations.

    `rows` are titles, such as names of sets or of policies. `columns` are the sources of the cells by their
    titles; in the folder and in the policy of each, `{row}` stands for the title of the row. Where that
    folder is missing, the cell says so.
    `differences` are further columns by their titles: the first minus the second of two columns on the same
    episodes, with its interval and p-value, adjusted by Holm's method over the rows.
    """

    measure: str
    rows: tuple[str, ...] = Field(min_length=1)
    columns: dict[str, SourceConf] = Field(min_length=1)
    differences: dict[str, tuple[str, str]] = Field(default_factory=dict)
    decimals: int | None = Field(default=None, ge=0, le=6)
    corner: str = "set"


def make_table(conf: TableConf, sources: BlockSources) -> str:
    paper = PAPER_FIGURES.get(conf.paper or "", {})
    if conf.paper and not paper:
        raise ConfigError(f"the paper has no figures of {conf.paper}; it has {', '.join(PAPER_FIGURES)}")
    units = {name: measure_of(name).unit for name in conf.measures}
    labels = {name: f"{name} [{unit}]" if unit not in ("", "%") else name for name, unit in units.items()}
    lines = [["", *(conf.labels.get(name, label) for name, label in labels.items())]]
    for title, source in conf.methods.items():
        chosen = source if isinstance(source, tuple) else (source,)
        methods = [sources.find_method(each) for each in chosen]
        estimates = [estimate_rows(method.rows) for method in methods]
        lines.append([title, *(_table_cell(name, methods, estimates, conf) for name in conf.measures)])
    if conf.paper:
        told = (f"{paper[name]}{_percent(name)}" if name in paper else "" for name in conf.measures)
        lines.append([PAPER, *told])
    if conf.rows == "measures":
        lines = [list(line) for line in zip(*lines, strict=True)]
    return _to_markdown(lines)


def _to_markdown(lines: Sequence[Sequence[str]]) -> str:
    """A table from its lines, whose texts are Markdown of the file's author."""
    header, *rows = lines
    return to_markdown(Table("", "", "", header, [list(map(Cell, row)) for row in rows], []), escape=False)


def _percent(name: str) -> str:
    return " %" if measure_of(name).unit == "%" else ""


def _table_cell(
    name: str, methods: list[EvaluatedPolicy], estimates: Sequence[Mapping[str, Estimate]], conf: TableConf
) -> str:
    if name == "episodes":
        return ", ".join(f"{method.episodes}" for method in methods)
    if name == "frames":
        return ", ".join(_frames(method) for method in methods)
    known = [
        estimate_of(name, str(method.runs[0].path), method.rows, found)
        for method, found in zip(methods, estimates, strict=True)
    ]
    measure, decimals = measure_of(name), conf.decimals.get(name)
    if len(known) == 1 and conf.intervals:
        return estimate_cell(measure, known[0], unit=_percent(name), decimals=decimals).plain
    return ", ".join(format_value(measure, found.value, decimals) for found in known) + _percent(name)


def _frames(method: EvaluatedPolicy) -> str:
    file = method.runs[0].path / "metrics.csv"
    if not file.exists():
        raise ConfigError(f"{file.parent} has no metrics.csv, so that its frames are not known")
    rows = read_rows(file, empty=None)
    if not rows or any("frames" not in row for row in rows):
        raise ConfigError(f"{file} lacks the column frames, or has rows without it; its frames are not known")
    frames = max(float(row["frames"]) for row in rows)
    # The collector's last batch goes a little beyond what was asked for.
    return f"{frames:,.0f}" if frames < 1e6 else f"{frames / 1e6:.1f} million"


def make_pair(conf: PairConf, sources: BlockSources) -> str:
    first, second = (sources.find_method(source) for source in (conf.first, conf.second))
    rows = [
        [{**row, "agent": 0.0} for row in select_metrics(method.rows, ["success"])]
        for method in (first, second)
    ]
    try:
        test = compare_success(*rows)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    one, other = (escape_markdown(f"`{method.policy}`").replace("\\`", "`") for method in (first, second))
    clusters, units = cluster_rows(rows[0])
    name = "exact McNemar test" if clusters is None else f"sign-flip test of whole {units}"
    p_value = equation_of_p(test.p_value, is_bound=test.p_is_bound)
    if math.isnan(test.p_value):
        p_value = "p is not defined, as there is nothing to compare"
    return (
        f"Of {first.episodes} episodes, {one} alone succeeds in {test.only_a}, {other} alone in "
        f"{test.only_b}: {name}, {p_value}.\n"
    )


def make_grid(conf: GridConf, sources: BlockSources) -> str:
    """The Markdown of the table.

    Raises ConfigError where a folder is there without the method or the measure, or where none is there, and
    where a difference is of columns that are not there or of other episodes.
    """
    found: dict[str, dict[str, EvaluatedPolicy]] = {row: {} for row in conf.rows}
    for row, methods in found.items():
        for title, source in conf.columns.items():
            told = SourceConf(**{key: text.replace("{row}", row) for key, text in source if text is not None})
            if (sources.beside / told.folder).exists():
                methods[title] = sources.find_method(told)
    if not any(found.values()):
        raise ConfigError("the grid has no folder that is there")
    differences = [_differences(title, found, conf) for title in conf.differences]
    lines = [
        [
            row,
            *(_grid_cell(methods.get(title), conf) for title in conf.columns),
            *(texts.get(row, _MISSING) for texts in differences),
        ]
        for row, methods in found.items()
    ]
    return _to_markdown([[conf.corner, *conf.columns, *conf.differences], *lines])


def _grid_cell(method: EvaluatedPolicy | None, conf: GridConf) -> str:
    if method is None:
        return _MISSING
    found = estimate_of(conf.measure, str(method.runs[0].path), method.rows, estimate_rows(method.rows))
    unit = _percent(conf.measure)
    return estimate_cell(measure_of(conf.measure), found, unit=unit, decimals=conf.decimals).plain


def _differences(
    title: str, found: Mapping[str, Mapping[str, EvaluatedPolicy]], conf: GridConf
) -> dict[str, str]:
    """The text of a column of differences, by row, where both methods are there."""
    columns = conf.differences[title]
    unknown = [column for column in columns if column not in conf.columns]
    if unknown:
        raise ConfigError(f"differences: {title}: there is no column {unknown[0]}")
    pairs: dict[str, PairedComparison] = {}
    for row, methods in found.items():
        if methods.keys() >= {*columns}:
            try:
                both = {column: methods[column] for column in columns}
                (pairs[row],) = compare_methods(both, measure_of(conf.measure))
            except ValueError as error:
                raise ConfigError(f"differences: {title}: {row}: {error}") from None
    adjusted = holm_adjusted([pair.p_value for pair in pairs.values()])
    return {row: _difference(pairs[row], p, conf) for row, p in zip(pairs, adjusted, strict=True)}


def _difference(pair: PairedComparison, adjusted_p: float, conf: GridConf) -> str:
    ends = (pair.difference.value, pair.difference.low, pair.difference.high)
    value, low, high = (format_difference(pair.measure, end, conf.decimals) for end in ends)
    interval = "" if NOTHING in (low, high) else f" ({low} to {high})"
    p_value = f", {equation_of_p(adjusted_p, is_bound=pair.p_is_bound)}"
    return f"{value}{interval}" + ("" if math.isnan(adjusted_p) else p_value)


_MAKERS: Mapping[str, tuple[type[Settings], Callable[[Any, BlockSources], str]]] = {
    "table": (TableConf, make_table),
    "pair": (PairConf, make_pair),
    "grid": (GridConf, make_grid),
}
_BEGIN = re.compile(r"<!-- report: (\w+)\r?\n(.*?)^-->(\r?\n)", flags=re.MULTILINE | re.DOTALL)
_END = "<!-- end report -->"
_CODE = re.compile(r"(^```.*?^```\r?$)", flags=re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Rewritten:
    """The text of a file with its blocks written anew, and how many there are.

    `skipped` and `notes` are what is to be known of the folders that they were made from.
    """

    text: str
    blocks: int
    skipped: Sequence[Note]
    notes: Sequence[Note]


def rewrite_file(file: Path) -> Rewritten:
    """Write the blocks of a Markdown file anew, with the line endings that they have.

    Raises ConfigError, and changes nothing, where there is none, or one that cannot be made.
    """
    try:
        text = file.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise ConfigError(f"into={file}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"into={file} cannot be read as text: {error}") from None
    found = rewrite_text(text, file)
    if not found.blocks:
        raise ConfigError(
            f"{file} has no block that begins with <!-- report: table; see docs/how_to/report.md"
        )
    if found.text != text:
        with write_atomically(file) as temporary:
            temporary.write_text(found.text, encoding="utf-8", newline="")
    return found


def rewrite_text(text: str, file: Path) -> Rewritten:
    """The text of `file` with its blocks written anew; code in fences stays."""
    parts = _CODE.split(text)
    sources = BlockSources(file.parent)
    count, done = 0, ""
    for part in parts:
        if part.startswith("```"):
            done += part
            continue
        while found := _BEGIN.search(part):
            end = part.find(_END, found.end())
            following = _BEGIN.search(part, found.end())
            if end < 0 or (following and following.start() < end):
                raise ConfigError(f"{file}: the block '<!-- report: {found[1]}' has no {_END}")
            made = make_block(found[1], found[2], file, sources)
            done += part[: found.end()] + made.replace("\n", found[3]) + _END
            part = part[end + len(_END) :]
            count += 1
        done += part
    return Rewritten(done, count, sources.skipped, sources.notes)


def make_block(kind: str, settings: str, file: Path, sources: BlockSources) -> str:
    """The Markdown of a block of `file` from its settings; raises ConfigError where they are wrong."""
    if kind not in _MAKERS:
        raise ConfigError(f"{file}: there is no block {kind!r}; there are {', '.join(_MAKERS)}")
    model, make = _MAKERS[kind]
    try:
        conf = model.model_validate(yaml.safe_load(settings))
    except yaml.YAMLError as error:
        raise ConfigError(f"{file}: the block of {kind} is not YAML: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{file}: the block of {kind}: {where}: {first['msg']}") from None
    try:
        return make(conf, sources)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from None
