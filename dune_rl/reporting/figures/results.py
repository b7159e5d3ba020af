"""What figures of methods are made of: the rows of episodes by cases and method."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dune_rl.metrics.catalogue import CATALOGUE, Measure, format_range
from dune_rl.reporting.figures.style import RC
from dune_rl.reporting.rows import Row, column

# Rows of episodes by the title of the cases (a set, or a world and a seed), and in that by method.
Results = Mapping[str, Mapping[str, Sequence[Row]]]
_MEASURES = {measure.metric: measure for measure in CATALOGUE}


def method_names(results: Results) -> list[str]:
    """All methods, in the order in which they appear."""
    return list(dict.fromkeys(name for methods in results.values() for name in methods))


def all_rows(results: Results) -> list[Row]:
    """The rows of all methods on all cases."""
    return [row for methods in results.values() for rows in methods.values() for row in rows]


def axis_label(metric: str) -> str:
    """What a metric is, with its unit; shares are of 1, not in per cent."""
    measure = _MEASURES.get(metric) or Measure(metric, metric)
    # Of an episode, not of their mean.
    text = (measure.meaning or measure.name.replace("_", " ")).removeprefix("mean ")
    unit = "" if measure.unit == "%" else measure.unit
    return f"{text} [{unit}]" if unit else text


def name_panels(figure: Figure, label: str, results: Results, across: int) -> None:
    """Write below panels what they show, and how many episodes each method has, on how many sites."""
    counts = [(_episodes(rows), _sites(rows)) for methods in results.values() for rows in methods.values()]
    episodes, sites = zip(*counts, strict=True)
    text = f"{format_range(episodes)} episode{'' if set(episodes) == {1} else 's'}"
    text += f" on {format_range(sites)} site{'' if set(sites) == {1} else 's'}"
    separator = ";  " if across > 1 else "\n"
    figure.supxlabel(f"{label}{separator}{text}", fontsize=RC["axes.labelsize"])


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
