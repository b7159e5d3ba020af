"""Tables in Markdown files of one measure, such as with a row for each set and a column for each method."""

import math
from collections.abc import Mapping
from dataclasses import replace

from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import measure_of
from dune_rl.metrics.measure import Measure
from dune_rl.metrics.number_text import NOTHING, format_difference, format_p
from dune_rl.reporting.block_sources import BlockSources, SourceConf
from dune_rl.reporting.comparisons.comparison import EvaluatedPolicy, compare_methods
from dune_rl.reporting.comparisons.estimates import estimate_of, estimate_rows
from dune_rl.reporting.tables.table import Cell, Table, estimate_cell, to_markdown
from dune_rl.statistics.paired_comparison import PairedComparison, holm_adjusted

_MISSING = "not run"


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
            *(_cell(measure, methods.get(title), conf) for title in conf.columns),
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


def _cell(measure: Measure, method: EvaluatedPolicy | None, conf: GridConf) -> Cell:
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
        row: _text(replace(pair, adjusted_p=p), conf)
        for (row, pair), p in zip(pairs.items(), adjusted, strict=True)
    }


def _text(pair: PairedComparison, conf: GridConf) -> str:
    ends = (pair.difference.value, pair.difference.low, pair.difference.high)
    value, low, high = (format_difference(pair.measure, end, conf.decimals) for end in ends)
    interval = "" if NOTHING in (low, high) else f" ({low} to {high})"
    p_value = "" if math.isnan(pair.adjusted_p) else f", p = {format_p(pair.adjusted_p)}"
    return f"{value}{interval}{p_value}"
