"""Tables in Markdown files of one measure: a row for each set, a column for each method."""

from collections.abc import Mapping
from pathlib import Path

from pydantic import Field

from dune_rl.errors import ConfigError
from dune_rl.reporting.block_sources import SourceConf, find_method
from dune_rl.reporting.comparisons import estimate_rows, measure_of
from dune_rl.reporting.tables.table import Cell, Table, to_markdown
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


def make_grid(conf: GridConf, folder: Path) -> str:
    """The Markdown of the table.

    Raises ConfigError where a folder is there without the method or the measure, or where none is there.
    """
    measure = measure_of(conf.measure)
    unit = " %" if measure.unit == "%" else ""

    def number(value: float) -> str:
        return f"{value * measure.scale:.{measure.decimals}f}"

    def cell(row: str, source: SourceConf) -> str:
        path = source.folder.replace("{row}", row)
        if not (folder / path).exists():
            return _MISSING
        method = find_method(SourceConf(folder=path, policy=source.policy), folder)
        found = estimate_rows(method.rows).get(conf.measure)
        if found is None:
            raise ConfigError(f"{path} has no measure {conf.measure}")
        return f"{number(found.value)}{unit} ({number(found.low)} to {number(found.high)})"

    cells: Mapping[str, list[str]] = {
        row: [cell(row, source) for source in conf.columns.values()] for row in conf.rows
    }
    if all(text == _MISSING for texts in cells.values() for text in texts):
        raise ConfigError("the grid has no folder that is there")
    header = [conf.corner, *conf.columns]
    table = [[Cell(row), *(Cell(text) for text in texts)] for row, texts in cells.items()]
    return to_markdown(Table("", "", "", header, table, []), escape=False)
