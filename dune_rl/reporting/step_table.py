"""The recorded steps of an evaluation, in columns: those of far goals are hundreds of thousands."""

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Self

from dune_rl.core.errors import ConfigError

Row = dict[str, Any]
_TEXT = ("policy", "agent")
_NUMBERS = ("episode", "x_m", "y_m", "speed_mps", "time_s", "collisions_so_far")


class StepTable:
    """Steps of all policies, agents and episodes, with what figures need of them.

    It is false without steps. Rows of all of them would take gigabytes.
    """

    def __init__(self, table: Any) -> None:
        """`table` is of pyarrow, with the columns policy, agent and episode, and any of the others."""
        self._table = table

    @classmethod
    def read(cls, file: Path) -> Self:
        """The steps of a CSV file; raises ConfigError where it cannot be read."""
        # Only now: few reports need it, and it takes a moment to load.
        import pyarrow as arrow
        from pyarrow import csv

        types = dict.fromkeys(_TEXT, arrow.string()) | dict.fromkeys(_NUMBERS, arrow.float64())
        options = csv.ConvertOptions(
            column_types=types, include_columns=list(types), include_missing_columns=True
        )
        try:
            return cls(csv.read_csv(file, convert_options=options))
        except (arrow.ArrowException, OSError) as error:
            reason = str(error).splitlines()[0]
            raise ConfigError(f"{file.name} cannot be read ({reason}); evaluate again") from None

    @classmethod
    def of_rows(cls, rows: Sequence[Row]) -> Self:
        """The same of rows."""
        import pyarrow as arrow

        columns = {name: [row.get(name) for row in rows] for name in (*_TEXT, *_NUMBERS)}
        return cls(arrow.table(columns))

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def of(self, policy: str, episodes: Collection[float]) -> list[Row]:
        """The steps of a policy in some episodes, in their order; what is unknown is NaN."""
        import pyarrow as arrow
        from pyarrow import compute

        if not len(self):
            return []
        chosen = compute.is_in(self._table["episode"], value_set=arrow.array(list(episodes), arrow.float64()))
        mine = self._table.filter(compute.and_(compute.equal(self._table["policy"], policy), chosen))
        return [
            {name: math.nan if value is None else value for name, value in row.items()}
            for row in mine.to_pylist()
        ]
