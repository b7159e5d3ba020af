"""Reads tables of results: numbers as floats, names as text; faults are told with their line."""

import csv
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from dune_rl.core.errors import ConfigError
from dune_rl.core.untrusted_files import first_line, printable
from dune_rl.geometry.arrays import Array

Row = dict[str, Any]
# Columns that are text even where they look like numbers.
_TEXT = ("policy", "set", "world", "engine", "agent", "kind", "group")
# The columns of steps that figures need.
_STEP_TEXT = ("policy", "agent")
# Figures overflow beyond it.
_LARGEST = 1e15
_STEP_NUMBERS = ("episode", "x_m", "y_m", "speed_mps", "time_s", "collisions_so_far")


def read_rows(file: Path, *, empty: float | None) -> list[Row]:
    """The rows of a CSV file; empty cells are `empty`, or left out where that is None.

    A column whose cells are no numbers is text. Raises ConfigError, which names the line, for a row with more
    or fewer cells than the header, and for a column that mixes numbers and text.
    """
    try:
        with file.open(newline="", encoding="utf-8") as opened:
            lines = list(csv.reader(opened))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{file.name} cannot be read ({error})") from None
    if not lines:
        return []
    header, *body = lines
    if len(set(header)) < len(header):
        raise ConfigError(f"{file.name} has a column twice")
    for number, cells in enumerate(body, 2):
        if len(cells) != len(header):
            raise ConfigError(
                f"{file.name}, line {number}: {len(cells)} cells under {len(header)} columns; half-written"
            )
    columns = [_parse_column(file, *column) for column in zip(header, zip(*body, strict=True), strict=False)]
    rows = [dict(zip(header, values, strict=True)) for values in zip(*columns, strict=True)]
    if empty is None:
        return [{name: value for name, value in row.items() if value is not None} for row in rows]
    return [{name: empty if value is None else value for name, value in row.items()} for row in rows]


def _parse_column(file: Path, name: str, cells: Sequence[str]) -> Sequence[float | str | None]:
    if name in _TEXT:
        return cells
    numbers = [_parse_number(cell) for cell in cells]
    odd = next((index for index, value in enumerate(numbers) if isinstance(value, str)), None)
    if odd is None:
        large = next((index for index, value in enumerate(numbers) if _is_too_large(value)), None)
        if large is not None:
            raise ConfigError(
                f"{file.name}, line {large + 2}: {printable(name)} is {printable(cells[large])}, larger than "
                "any measure"
            )
        return numbers
    if any(isinstance(value, float) for value in numbers):
        raise ConfigError(
            f"{file.name}, line {odd + 2}: {printable(name)} is {printable(cells[odd])!r}, which is no number"
        )
    return cells


def _is_too_large(value: float | str | None) -> bool:
    return isinstance(value, float) and math.isfinite(value) and abs(value) > _LARGEST


def _parse_number(cell: str) -> float | str | None:
    if not cell.strip():
        return None
    if cell in ("True", "False"):
        return float(cell == "True")
    try:
        return float(cell)
    except ValueError:
        return cell


def is_number(value: object) -> bool:
    """Whether a cell has a number that is finite."""
    return isinstance(value, int | float) and math.isfinite(value)


def column(rows: Sequence[Mapping[str, Any]], name: str) -> Array:
    """The values of a column, NaN where a row has none."""
    values = (row.get(name) for row in rows)
    return np.array([value if isinstance(value, int | float) else math.nan for value in values], float)


class StepTable:
    """The recorded steps of all policies, agents and episodes of an evaluation; false without steps.

    They are kept in columns, as those of far goals are hundreds of thousands: rows would take gigabytes.
    """

    def __init__(self, table: Any = None) -> None:
        """`table` is of pyarrow, with the columns policy, agent and episode, and any of the others."""
        self._table = table

    @classmethod
    def read(cls, file: Path) -> Self:
        """The steps of a CSV file; raises ConfigError where it cannot be read."""
        # Only now: few reports need it, and it takes a moment to load.
        import pyarrow as arrow
        from pyarrow import csv

        types = dict.fromkeys(_STEP_TEXT, arrow.string()) | dict.fromkeys(_STEP_NUMBERS, arrow.float64())
        options = csv.ConvertOptions(
            column_types=types, include_columns=list(types), include_missing_columns=True
        )
        try:
            return cls(csv.read_csv(file, convert_options=options))
        except (arrow.ArrowException, OSError) as error:
            raise ConfigError(f"{file.name} cannot be read ({first_line(error)}); evaluate again") from None

    def __len__(self) -> int:
        return 0 if self._table is None else int(self._table.num_rows)

    def of(self, policy: str, episodes: Collection[float]) -> list[Row]:
        """The steps of a policy in some episodes, in their order; what is unknown is NaN."""
        if not len(self):
            return []
        import pyarrow as arrow
        from pyarrow import compute

        chosen = compute.is_in(self._table["episode"], value_set=arrow.array(list(episodes), arrow.float64()))
        mine = self._table.filter(compute.and_(compute.equal(self._table["policy"], policy), chosen))
        return [
            {name: math.nan if value is None else value for name, value in row.items()}
            for row in mine.to_pylist()
        ]
