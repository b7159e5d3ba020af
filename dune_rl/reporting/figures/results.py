"""What figures of methods are made of: the rows of episodes by cases and method."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.metrics.catalogue import CATALOGUE, Measure
from dune_rl.metrics.number_text import format_range
from dune_rl.reporting.runs import Row

# Rows of episodes by the title of the cases (a set, or a world and a seed), and in that by method.
Results = Mapping[str, Mapping[str, Sequence[Row]]]
_MEASURES = {measure.metric: measure for measure in CATALOGUE}


def method_names(results: Results) -> list[str]:
    """All methods, in the order in which they appear."""
    return list(dict.fromkeys(name for methods in results.values() for name in methods))


def column(rows: Sequence[Row], name: str) -> Array:
    """The values of a column, NaN where a row has none."""
    return np.array([_number(row.get(name)) for row in rows], float)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def measure_of_metric(metric: str) -> Measure:
    """The measure of a metric; one of its own name for users' metrics."""
    return _MEASURES.get(metric) or Measure(metric, metric)


def axis_label(metric: str) -> str:
    """What a metric is, with its unit; shares are of 1, not in per cent."""
    measure = measure_of_metric(metric)
    # Of an episode, not of their mean.
    text = (measure.meaning or measure.name.replace("_", " ")).removeprefix("mean ")
    unit = "" if measure.unit == "%" else measure.unit
    return f"{text} [{unit}]" if unit else text


def count_text(results: Results) -> str:
    """How many episodes each method has on each set of cases, and on how many sites, in words."""
    episodes = sorted({_episodes(rows) for methods in results.values() for rows in methods.values()})
    sites = sorted({_sites(rows) for methods in results.values() for rows in methods.values()})
    text = f"{format_range(episodes)} episode" + ("" if episodes == [1] else "s")
    return (
        text
        if sites in ([], [0])
        else f"{text} on {format_range(sites)} site" + ("" if sites == [1] else "s")
    )


def _episodes(rows: Sequence[Row]) -> int:
    return len({row.get("episode") for row in rows})


def _sites(rows: Sequence[Row]) -> int:
    seeds = column(rows, "world_seed")
    return len(np.unique(seeds[~np.isnan(seeds)])) or 1


@dataclass(frozen=True)
class Ending:
    """A kind of failure: what it is called, the mark and the colour that show it."""

    name: str
    mark: str
    colour: str


# By the metric that is 1, or more, in an episode with such a failure; the first that applies ended it.
FAILURES = {
    "diverged": Ending("physics diverged", "P", "#f0e442"),
    "flipped": Ending("flipped", "^", "#cc79a7"),
    "stuck": Ending("stuck", "8", "#d55e00"),
    "out_of_world": Ending("left the world", "s", "#000000"),
    "timeout": Ending("out of time", "v", "#8f8f94"),
}
COLLISION = Ending("collision", "x", "#b8003a")
REACHED = Ending("goal reached", "*", "#0072b2")


def ending_of(row: Mapping[str, Any]) -> Ending | None:
    """How an agent's episode ended: a failure or its goal reached; None where its row does not say."""
    for metric, ending in FAILURES.items():
        if _holds(row, metric):
            return ending
    return REACHED if _holds(row, "reached") or _holds(row, "success") else None


def failures_of(row: Mapping[str, Any]) -> list[str]:
    """All failures in an agent's episode: "collision", and the metric of its ending."""
    found = ["collision"] if _holds(row, "collisions") else []
    return found + [metric for metric in FAILURES if _holds(row, metric)]


def _holds(row: Mapping[str, Any], metric: str) -> bool:
    value = row.get(metric)
    return isinstance(value, int | float) and value > 0
