"""The block `grid`: one measure of several methods on several sets."""

import math
from collections.abc import Mapping, Sequence

from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import NOTHING, equation_of_p, format_difference, measure_of
from dune_rl.reporting.comparison import EvaluatedPolicy, compare_methods
from dune_rl.reporting.markdown.seeds import SeedCells, mean_of_seeds
from dune_rl.reporting.markdown.sources import BlockSources, SourceConf, markdown_table
from dune_rl.statistics.paired_comparison import PairedComparison, holm_adjusted

_MISSING = "not run"


class GridConf(Settings):
    """One `measure` of several methods on several sets, or among several populations.

    `rows` are titles, such as names of sets or of policies. `columns` are the sources of the cells by their
    titles; in the folder and in the policy of each, `{row}` stands for the title of the row. Where that
    folder is missing, the cell says so. A source with `{seed}` is read for each of the `seeds` of training:
    metrics of an episode are averaged over these policies, and the cell has the measure of that, with an
    interval for other sites or episodes and the same policies, and then the figure of each.
    `differences` are further columns by their titles: the first minus the second of two columns on the same
    episodes, with its interval and p-value, adjusted by Holm's method over the rows.
    """

    measure: str
    rows: tuple[str, ...] = Field(min_length=1)
    columns: dict[str, SourceConf] = Field(min_length=1)
    seeds: tuple[int, ...] = ()
    differences: dict[str, tuple[str, str]] = Field(default_factory=dict)
    decimals: int | None = Field(default=None, ge=0, le=6)
    corner: str = "set"


def make_grid(conf: GridConf, sources: BlockSources) -> str:
    """The Markdown of the table.

    Raises ConfigError where a folder is there without the method or the measure, or where none is there, and
    where a difference is of columns that are not there or of other episodes.
    """
    if conf.seeds and "{seed}" not in str(conf.columns):
        raise ConfigError("seeds are named, and no column has {seed} in its folder or policy")
    seeds: dict[str, dict[str, list[EvaluatedPolicy]]] = {row: {} for row in conf.rows}
    for row, columns in seeds.items():
        for title, source in conf.columns.items():
            columns[title] = _find_seeds(_sources_of(source, row, conf.seeds), sources)
    if not any(methods for columns in seeds.values() for methods in columns.values()):
        raise ConfigError("the grid has no folder that is there")
    found = {row: _averages(row, columns) for row, columns in seeds.items()}
    differences = [_differences(title, found, conf) for title in conf.differences]
    lines = [
        [
            row,
            *(_grid_cell(found[row].get(title), columns.get(title, []), conf) for title in conf.columns),
            *(texts.get(row, _MISSING) for texts in differences),
        ]
        for row, columns in seeds.items()
    ]
    return markdown_table([[conf.corner, *conf.columns, *conf.differences], *lines])


def _sources_of(source: SourceConf, row: str, seeds: Sequence[int]) -> list[SourceConf]:
    """The source of a row, or of each seed of it."""
    texts = {key: text.replace("{row}", row) for key, text in source if text is not None}
    if not any("{seed}" in text for text in texts.values()):
        return [SourceConf(**texts)]
    if len({*seeds}) < max(len(seeds), 1):
        raise ConfigError(
            f"a source with {{seed}} needs different seeds, seeds: [1, 2, 3] (got {list(seeds)})"
        )
    return [
        SourceConf(**{key: text.replace("{seed}", str(seed)) for key, text in texts.items()})
        for seed in seeds
    ]


def _find_seeds(told: Sequence[SourceConf], sources: BlockSources) -> list[EvaluatedPolicy]:
    """The methods of the sources; none where no folder is there. Raises ConfigError where only some are."""
    missing = [each.folder for each in told if not (sources.beside / each.folder).exists()]
    if len(missing) == len(told):
        return []
    if missing:
        raise ConfigError(f"{missing[0]} is not there, though that of another seed is")
    return [sources.find_method(each) for each in told]


def _averages(row: str, columns: Mapping[str, list[EvaluatedPolicy]]) -> dict[str, EvaluatedPolicy]:
    found = {}
    for title, seeds in columns.items():
        if seeds:
            found[title] = mean_of_seeds(seeds, f"{title}, {row}")
    return found


def _grid_cell(method: EvaluatedPolicy | None, seeds: Sequence[EvaluatedPolicy], conf: GridConf) -> str:
    return _MISSING if method is None else SeedCells(seeds, method).cell(conf.measure, conf.decimals)


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
                compared = compare_methods(both, measure_of(conf.measure))
            except ValueError as error:
                raise ConfigError(f"differences: {title}: {row}: {error}") from None
            if not compared:
                raise ConfigError(
                    f"differences: {title}: {row}: no episode has a value of {conf.measure} by both"
                )
            pairs[row] = compared[0]
    adjusted = holm_adjusted([pair.p_value for pair in pairs.values()])
    return {row: _difference(pairs[row], p, conf) for row, p in zip(pairs, adjusted, strict=True)}


def _difference(pair: PairedComparison, adjusted_p: float, conf: GridConf) -> str:
    ends = (pair.difference.value, pair.difference.low, pair.difference.high)
    value, low, high = (format_difference(pair.measure, end, conf.decimals) for end in ends)
    interval = "" if NOTHING in (low, high) else f" ({low} to {high})"
    p_value = f", {equation_of_p(adjusted_p, is_bound=pair.p_is_bound)}"
    return f"{value}{interval}" + ("" if math.isnan(adjusted_p) else p_value)
