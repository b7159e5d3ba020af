"""The registry of metrics, and the settings that every metric has."""

from typing import Literal

from dune_rl.settings import Settings
from dune_rl.terms import TermRegistry


class MetricTermConf(Settings):
    """A metric: `reduce` makes one value of an episode's steps.

    `initial` is the value before the first step that has one; null is 0 for a sum and NaN for the others.
    """

    term: str
    reduce: Literal["mean", "sum", "min", "max", "last", "first"] = "mean"
    initial: float | None = None


METRICS = TermRegistry("metric", "dune_rl.metrics.registry:METRICS", own={}, base=MetricTermConf)
