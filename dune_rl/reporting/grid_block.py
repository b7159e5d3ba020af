"""Tables in Markdown files of one measure: a row for each set, a column for each method."""

from pydantic import Field

from dune_rl.errors import ConfigError
from dune_rl.reporting.block_sources import BlockSources, SourceConf
from dune_rl.reporting.comparisons.estimates import estimate_rows, measure_of
from dune_rl.reporting.tables.table import Cell, Table, estimate_cell, to_markdown
from dune_rl.settings import Settings

_MISSING = "not run"


class GridConf(Settings):
    """One `measure` of several methods on several sets.

    `rows` are titles, such as names of sets. `columns` are the methods by their titles; in the folder of
    each, `{row}` stands for the title of the row. Where that folder is missing, the cell says so.
    """

    measure: str
    rows: tuple[str, ...] = Field(min_length=1)
    columns: dict[str, SourceConf] = Field(min_length=1)
    corner: str = "set"


def make_grid(conf: GridConf, sources: BlockSources) -> str:
    """The Markdown of the table.

    Raises ConfigError where a folder is there without the method or the measure, or where none is there.
    """
    measure = measure_of(conf.measure)
    unit = " %" if measure.unit == "%" else ""

    def cell(row: str, source: SourceConf) -> Cell:
        path = source.folder.replace("{row}", row)
        if not (sources.beside / path).exists():
            return Cell(_MISSING)
        method = sources.find_method(SourceConf(folder=path, policy=source.policy))
        found = estimate_rows(method.rows).get(conf.measure)
        if found is None:
            raise ConfigError(f"{path} has no measure {conf.measure}")
        return estimate_cell(measure, found, unit=unit)

    table = [[Cell(row), *(cell(row, source) for source in conf.columns.values())] for row in conf.rows]
    if all(one.text == _MISSING for _, *cells in table for one in cells):
        raise ConfigError("the grid has no folder that is there")
    return to_markdown(Table("", "", "", [conf.corner, *conf.columns], table, []), escape=False)
