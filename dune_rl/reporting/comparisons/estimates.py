"""Estimates of measures from the rows of episodes."""

import math
from collections.abc import Mapping, Sequence

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import closest
from dune_rl.evaluation.columns import measured_columns
from dune_rl.metrics.catalogue import measure_of, measures_of
from dune_rl.reporting.csv_rows import is_number
from dune_rl.reporting.runs import Row
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import CASE_COLUMNS, MetricsRow, estimate_metrics


def estimate_rows(rows: Sequence[Row]) -> dict[str, Estimate]:
    """Each measure over the rows of a method with its 95 % interval; those without any value are left out."""
    names = measured_names(rows)
    found: dict[str, Estimate] = {}
    for measure in measures_of([name for name in column_names(rows) if name in names]):
        used = [measure.metric, *([measure.per] if measure.per else [])]
        numeric = numeric_rows(rows, used)
        found |= {
            name: estimate for name, estimate in estimate_metrics(numeric).items() if name == measure.name
        }
    return found


def estimate_of(name: str, method: str, rows: Sequence[Row], estimates: Mapping[str, Estimate]) -> Estimate:
    """The estimate of a measure among those of the rows of a `method`; all NaN where no row has a value.

    Raises ConfigError where the rows have no such measure.
    """
    if name in estimates:
        return estimates[name]
    measure = measure_of(name)
    if measure.metric in column_names(rows) and measure.per in (None, *column_names(rows)):
        return Estimate(math.nan, math.nan, math.nan, 0)
    near = closest(name, estimates)
    raise ConfigError(f"{method} has no measure {name}" + (f"; did you mean {near}?" if near else ""))


def column_names(rows: Sequence[Row]) -> list[str]:
    """The columns of rows, in the order in which they appear."""
    return list(dict.fromkeys(name for row in rows for name in row))


def measured_names(rows: Sequence[Row]) -> set[str]:
    """Metrics that at least one of the rows has a value of."""
    return {
        name for name in measured_columns(column_names(rows)) if any(is_number(row.get(name)) for row in rows)
    }


def numeric_rows(rows: Sequence[Row], names: Sequence[str]) -> list[MetricsRow]:
    """The metrics `names` of rows, their ids as numbers and their sites; NaN where a row has no value."""
    agents = {agent: float(number) for number, agent in enumerate(sorted({row["agent"] for row in rows}))}
    return [
        {
            "episode": row["episode"],
            "agent": agents[row["agent"]],
            **{name: row[name] for name in CASE_COLUMNS if name in row},
            **{name: row[name] if is_number(row.get(name)) else math.nan for name in names},
        }
        for row in rows
    ]
