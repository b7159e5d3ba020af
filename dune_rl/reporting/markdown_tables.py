"""The tables and sentences of Markdown files: their settings, the episodes that they read, and their text."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import measure_of
from dune_rl.metrics.measure import Measure
from dune_rl.metrics.number_text import NOTHING, format_difference, format_p, format_value
from dune_rl.reporting.comparisons.collect import collect_comparisons
from dune_rl.reporting.comparisons.comparison import (
    EvaluatedPolicy,
    compare_methods,
    estimate_of,
    estimate_rows,
)
from dune_rl.reporting.csv_rows import read_rows
from dune_rl.reporting.reading import read_inputs
from dune_rl.reporting.runs import Note, ReportInputs
from dune_rl.reporting.tables.methods import PAPER, PAPER_FIGURES
from dune_rl.reporting.tables.table import Cell, Table, escape_markdown, estimate_cell, to_markdown
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import CASE_COLUMNS, cluster_rows
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
    columns = {
        title: [sources.find_method(each) for each in (source if isinstance(source, tuple) else (source,))]
        for title, source in conf.methods.items()
    }
    estimates = {
        title: [estimate_rows(method.rows) for method in methods] for title, methods in columns.items()
    }
    paper = PAPER_FIGURES.get(conf.paper or "", {})
    if conf.paper and not paper:
        raise ConfigError(f"the paper has no figures of {conf.paper}; it has {', '.join(PAPER_FIGURES)}")
    cells: dict[str, dict[str, str]] = {}
    for name in conf.measures:
        cells[name] = {title: _table_cell(name, columns[title], estimates[title], conf) for title in columns}
        if conf.paper:
            unit = " %" if measure_of(name).unit == "%" and name in paper else ""
            cells[name][PAPER] = f"{paper.get(name, '')}{unit}"
    labels = {name: conf.labels.get(name, _label(name)) for name in conf.measures}
    titles = list(next(iter(cells.values())))
    if conf.rows == "measures":
        header = ["", *titles]
        rows = [
            [Cell(labels[name]), *(Cell(cells[name][title]) for title in titles)] for name in conf.measures
        ]
    else:
        header = ["", *labels.values()]
        rows = [[Cell(title), *(Cell(cells[name][title]) for name in conf.measures)] for title in titles]
    # Titles and labels are Markdown of the file's author.
    return to_markdown(Table("", "", "", header, rows, []), escape=False)


def _label(name: str) -> str:
    measure = measure_of(name)
    return f"{name} [{measure.unit}]" if measure.unit not in ("", "%") else name


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
    unit = " %" if measure.unit == "%" else ""
    if len(known) == 1 and conf.intervals:
        return estimate_cell(measure, known[0], unit=unit, decimals=decimals).plain
    values = ", ".join(format_value(measure, found.value, decimals) for found in known)
    return f"{values}{unit}"


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
        [
            {"agent": 0.0, **{key: row[key] for key in ("episode", "success", *CASE_COLUMNS) if key in row}}
            for row in method.rows
        ]
        for method in (first, second)
    ]
    try:
        test = compare_success(*rows)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    names = (escape_markdown(f"`{method.policy}`").replace("\\`", "`") for method in (first, second))
    one, other = names
    clusters, units = cluster_rows(rows[0])
    name = "exact McNemar test" if clusters is None else f"sign-flip test of whole {units}"
    known = not math.isnan(test.p_value)
    p_value = f"p = {format_p(test.p_value)}" if known else "p is not defined, as there is nothing to compare"
    return (
        f"Of {first.episodes} episodes, {one} alone succeeds in {test.only_a}, {other} alone in "
        f"{test.only_b}: {name}, {p_value}.\n"
    )


def make_grid(conf: GridConf, sources: BlockSources) -> str:
    """The Markdown of the table.

    Raises ConfigError where a folder is there without the method or the measure, or where none is there, and
    where a difference is of columns that are not there or of other episodes.
    """
    measure = measure_of(conf.measure)
    found = {row: _methods_of(row, conf, sources) for row in conf.rows}
    if not any(found.values()):
        raise ConfigError("the grid has no folder that is there")
    differences = {title: _differences(title, measure, found, conf) for title in conf.differences}
    table = [
        [
            Cell(row),
            *(_grid_cell(measure, methods.get(title), conf) for title in conf.columns),
            *(Cell(texts.get(row, _MISSING)) for texts in differences.values()),
        ]
        for row, methods in found.items()
    ]
    header = [conf.corner, *conf.columns, *conf.differences]
    return to_markdown(Table("", "", "", header, table, []), escape=False)


def _methods_of(row: str, conf: GridConf, sources: BlockSources) -> dict[str, EvaluatedPolicy]:
    """The methods of a row, by the title of their column, whose folders are there."""
    found = {}
    for title, source in conf.columns.items():
        path = source.folder.replace("{row}", row)
        policy = None if source.policy is None else source.policy.replace("{row}", row)
        if (sources.beside / path).exists():
            found[title] = sources.find_method(SourceConf(folder=path, policy=policy))
    return found


def _grid_cell(measure: Measure, method: EvaluatedPolicy | None, conf: GridConf) -> Cell:
    if method is None:
        return Cell(_MISSING)
    found = estimate_of(measure.name, str(method.runs[0].path), method.rows, estimate_rows(method.rows))
    unit = " %" if measure.unit == "%" else ""
    return estimate_cell(measure, found, unit=unit, decimals=conf.decimals)


def _differences(
    title: str, measure: Measure, found: Mapping[str, Mapping[str, EvaluatedPolicy]], conf: GridConf
) -> dict[str, str]:
    """The text of a column of differences, by row, where both methods are there."""
    pairs: dict[str, PairedComparison] = {}
    for row, methods in found.items():
        unknown = [column for column in conf.differences[title] if column not in conf.columns]
        if unknown:
            raise ConfigError(f"differences: {title}: there is no column {unknown[0]}")
        both = {column: methods[column] for column in conf.differences[title] if column in methods}
        if len(both) == len(conf.differences[title]):
            try:
                (pairs[row],) = compare_methods(both, measure)
            except ValueError as error:
                raise ConfigError(f"differences: {title}: {row}: {error}") from None
    adjusted = holm_adjusted([pair.p_value for pair in pairs.values()])
    return {
        row: _difference_text(replace(pair, adjusted_p=p), conf)
        for (row, pair), p in zip(pairs.items(), adjusted, strict=True)
    }


def _difference_text(pair: PairedComparison, conf: GridConf) -> str:
    ends = (pair.difference.value, pair.difference.low, pair.difference.high)
    value, low, high = (format_difference(pair.measure, end, conf.decimals) for end in ends)
    interval = "" if NOTHING in (low, high) else f" ({low} to {high})"
    p_value = "" if math.isnan(pair.adjusted_p) else f", p = {format_p(pair.adjusted_p)}"
    return f"{value}{interval}{p_value}"
