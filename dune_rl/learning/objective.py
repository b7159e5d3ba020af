"""The objective of a training run: what a sweep optimises."""

import math
from collections.abc import Mapping, Sequence


def measure_objective(metric: str, rows: Sequence[Mapping[str, float]]) -> float:
    """Mean of a metric over the `rows` of episodes that have a value; NaN if none has."""
    values = [float(row[metric]) for row in rows]
    defined = [value for value in values if not math.isnan(value)]
    return sum(defined) / len(defined) if defined else math.nan
