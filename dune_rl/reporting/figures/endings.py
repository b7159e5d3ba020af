"""How episodes ended, from their rows: the kinds of failure, their names, colours and marks."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


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
