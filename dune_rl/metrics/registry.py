"""The metric terms there are: ours, those of packages, and those that a program registers."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.terms import TermConf, TermRegistry

Reduction = Literal["mean", "sum", "min", "max", "last", "first"]

_OWN = {
    "battery_share": "BatteryShare",
    "clearance": "clearance",
    "collisions": "collisions",
    "ended_by": "ended_by",
    "energy_wh": "energy_wh",
    "range_km": "Range",
    "smoothness": "smoothness",
    "success": "Success",
    "time_to_goal": "time_to_goal",
    "vertical_roughness": "vertical_roughness",
    "vort": "vort",
}


class MetricTermConf(TermConf):
    """A metric term and how its values of an episode become one; NaN is no value for any but `last`.

    `initial` is what stands before the first value; null is 0 for a sum and NaN for the others.
    """

    reduce: Reduction = "mean"
    initial: float | None = Field(None, description="before the first value")


METRICS = TermRegistry(
    "metric",
    f"{__name__}:METRICS",
    own={name: f"dune_rl.metrics.terms:{target}" for name, target in _OWN.items()},
    base=MetricTermConf,
)

MetricTerms = Annotated[
    dict[str, Annotated[SerializeAsAny[MetricTermConf], BeforeValidator(METRICS.parse_settings)]],
    BeforeValidator(METRICS.tag_entries),
]
