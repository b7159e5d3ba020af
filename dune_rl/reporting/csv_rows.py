"""Reads tables of results: numbers as floats, names as text; faults are told with their line."""

import csv
import math
from pathlib import Path

from dune_rl.core.errors import ConfigError
from dune_rl.reporting.runs import Row

# Columns that are text even where they look like numbers.
_TEXT = ("policy", "set", "world", "engine", "agent", "kind", "group")


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
    columns = [_parse_column(file, name, [cells[i] for cells in body]) for i, name in enumerate(header)]
    rows: list[Row] = []
    for values in zip(*columns, strict=True):
        row = dict(zip(header, values, strict=True))
        if empty is None:
            rows.append({name: value for name, value in row.items() if value is not None})
        else:
            rows.append({name: empty if value is None else value for name, value in row.items()})
    return rows


def _parse_column(file: Path, name: str, cells: list[str]) -> list[float | str | None]:
    if name in _TEXT:
        return list(cells)
    numbers = [_number(cell) for cell in cells]
    odd = next((index for index, value in enumerate(numbers) if isinstance(value, str)), None)
    if odd is None:
        return list(numbers)
    if any(isinstance(value, float) for value in numbers):
        raise ConfigError(f"{file.name}, line {odd + 2}: {name} is {cells[odd]!r}, which is no number")
    return list(cells)


def _number(cell: str) -> float | str | None:
    if not cell.strip():
        return None
    if cell in ("True", "False"):
        return float(cell == "True")
    try:
        return float(cell)
    except ValueError:
        return cell


def is_number(value: object) -> bool:
    """Whether a cell has a number that is not NaN."""
    return isinstance(value, int | float) and not math.isnan(value)
