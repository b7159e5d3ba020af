"""The registry of metrics, and the settings that every metric has."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, SerializeAsAny

from dune_rl.terms import TermConf, TermRegistry

Reduction = Literal["mean", "sum", "min", "max", "last", "first"]

_OWN = {
    "battery_share": "BatteryShare",
    "clearance": "clearance",
    "collisions": "collisions",
    "ended_by": "ended_by",
    "energy_wh": "energy_wh",
    "range_km": "BatteryRange",
    "smoothness": "smoothness",
    "success": "Success",
    "time_to_goal": "time_to_goal",
    "vertical_roughness": "vertical_roughness",
    "vort": "vort",
}


class MetricTermConf(TermConf):
    """A metric: `reduce` makes one value of an episode's steps; NaN is the value of a step that has none.

    `initial` is the value before the first step that has one; null is 0 for a sum and NaN for the others.
    """

    reduce: Reduction = "mean"
    initial: float | None = None


METRICS = TermRegistry(
    "metric",
    "dune_rl.metrics.registry:METRICS",
    own={name: f"dune_rl.metrics.terms:{target}" for name, target in _OWN.items()},
    base=MetricTermConf,
)

# Metrics by name; an entry without `term` is the metric that is registered by its name.
MetricTerms = Annotated[
    dict[str, Annotated[SerializeAsAny[MetricTermConf], BeforeValidator(METRICS.parse_settings)]],
    BeforeValidator(METRICS.tag_entries),
]
