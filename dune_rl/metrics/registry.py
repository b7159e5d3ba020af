"""The registry of metrics, and the settings that every metric has."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, SerializeAsAny

from dune_rl.state.terms import TermConf, TermRegistry

Reduction = Literal["mean", "sum", "min", "max", "last", "first"]

_TERMS = "dune_rl.metrics.terms"
_OWN = {
    "abs_pitch": "driving:abs_pitch",
    "abs_roll": "driving:abs_roll",
    "actor_gap": "social:actor_gap",
    "battery_share": "driving:BatteryShare",
    "clearance": "paper:clearance",
    "collisions": "paper:collisions",
    "collisions_with": "social:collisions_with",
    "barn_score": "driving:BarnScore",
    "dune_code_attempts": "dune_code:DuneCodeAttempts",
    "dune_code_clearance": "dune_code:DuneCodeClearance",
    "dune_code_collisions": "dune_code:dune_code_collisions",
    "dune_code_goal_time": "dune_code:DuneCodeGoalTime",
    "dune_code_rows": "dune_code:DuneCodeRows",
    "dune_code_smoothness": "dune_code:DuneCodeSmoothness",
    "dune_code_speed": "dune_code:DuneCodeSpeed",
    "dune_code_vertical": "dune_code:dune_code_vertical",
    "duration": "driving:duration",
    "encounters": "social:Encounters",
    "ended_by": "paper:ended_by",
    "energy_wh": "driving:energy_wh",
    "ground_speed": "driving:ground_speed",
    "jerk": "driving:Jerk",
    "near_misses": "social:NearMisses",
    "path_length": "driving:PathLength",
    "range_km": "driving:BatteryRange",
    "risk_seconds": "social:risk_seconds",
    "seconds_near": "social:seconds_near",
    "slip": "driving:slip",
    "smoothness": "paper:smoothness",
    "spl": "driving:Spl",
    "success": "paper:Success",
    "time_in_collision": "paper:time_in_collision",
    "time_on_uneven": "paper:time_on_uneven",
    "time_to_goal": "paper:time_to_goal",
    "vertical_roughness": "paper:vertical_roughness",
    "vort": "paper:vort",
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
    own={name: f"{_TERMS}.{target}" for name, target in _OWN.items()},
    base=MetricTermConf,
)

# Metrics by name; an entry without `term` is the metric that is registered by its name.
MetricTerms = Annotated[
    dict[str, Annotated[SerializeAsAny[MetricTermConf], BeforeValidator(METRICS.parse_settings)]],
    BeforeValidator(METRICS.tag_entries),
]
