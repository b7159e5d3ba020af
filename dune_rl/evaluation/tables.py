"""Tables of results in CSV and Parquet, with the same rows, columns and order."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dune_rl.core.files import write_atomically
from dune_rl.evaluation.columns import describe_columns
from dune_rl.statistics.measures import write_csv

Row = Mapping[str, Any]


def write_tables(stem: Path, rows: Sequence[Row], metadata: Mapping[str, str]) -> None:
    """Write STEM.csv and STEM.parquet; units and `metadata` are in the schema of the latter.

    Columns are those of all rows; a row without one has no value there.
    """
    import pyarrow
    import pyarrow.parquet

    names = list(dict.fromkeys(name for row in rows for name in row))
    full = [dict.fromkeys(names) | dict(row) for row in rows]
    write_csv(stem.with_suffix(".csv"), full)
    fields, columns = [], []
    for description in describe_columns(names):
        name = description["column"]
        values = [row[name] for row in full]
        kind = _arrow_type(values, pyarrow)
        columns.append(pyarrow.array(values, kind))
        told = {key: description[key] for key in ("unit", "meaning") if description[key]}
        fields.append(pyarrow.field(name, kind, metadata=told))
    schema = pyarrow.schema(fields, metadata=dict(metadata))
    with write_atomically(stem.with_suffix(".parquet")) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns, schema=schema), temporary)


def write_columns(path: Path, names: Sequence[str]) -> None:
    """Write a CSV of units and meanings of columns."""
    write_csv(path, describe_columns(names))


def _arrow_type(values: Sequence[Any], pyarrow: Any) -> Any:
    present = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in present):
        return pyarrow.string()
    return pyarrow.int64() if present and all(isinstance(one, int) for one in present) else pyarrow.float64()


def plain_number(value: float) -> int | float:
    """An int where the value is whole, as it reads better."""
    return int(value) if math.isfinite(value) and float(value).is_integer() else value
