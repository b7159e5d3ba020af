"""What a run amounts to: its totals, and means over its steps."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.metrics.catalogue import CATALOGUE
from dune_rl.statistics.measures import average_metrics

Row = Mapping[str, Any]

_CODE = "dune_code_"
_ALSO_TOTALS = ("steps", "return", "goals")


def run_rows(rows: Sequence[Row], *, ends_at_goals: bool) -> list[dict[str, float]]:
    """One row for each run of a policy, of the rows of its episodes.

    "episode" is the run's number, by which runs of several policies pair. Means over time are weighted by the
    steps of each episode, VORT by its time on uneven ground. Episodes that were cut off with the run have a
    share in totals and means, and none in SR, TR and MTT. Those three are of episodes that `ends_at_goals`.
    """
    by_run: dict[int, list[Row]] = {}
    for row in rows:
        by_run.setdefault(int(row["run"]), []).append(row)
    found = []
    for run, episodes in sorted(by_run.items()):
        columns: dict[str, float] = {"episode": float(run), "agent": 0.0}
        columns |= {name: _total(episodes, name) for name in _ALSO_TOTALS if name in episodes[0]}
        if ends_at_goals:
            columns |= _of_finished_episodes([row for row in episodes if row["finished"]])
        columns |= _over_steps(episodes)
        columns |= {name: _total(episodes, name) for name in episodes[0] if name.startswith(_CODE)}
        found.append(columns)
    return found


def describe_runs(rows: Sequence[Row], runs: Sequence[dict[str, float]]) -> list[dict[str, object]]:
    """The rows of runs.csv: for each run its measures by name, without the measures of episodes."""
    names = {measure.name for measure in CATALOGUE}
    found = []
    for run in runs:
        episodes = [row for row in rows if row["run"] == run["episode"]]
        measures = {name: value for name, value in average_metrics([run]).items() if name in names}
        found.append(
            {
                "policy": episodes[0]["policy"],
                "run": int(run["episode"]),
                "episodes": len(episodes),
                "finished": sum(row["finished"] for row in episodes),
                "steps": int(run["steps"]),
                "return": run["return"],
                **measures,
            }
        )
    return found


def _of_finished_episodes(episodes: Sequence[Row]) -> dict[str, float]:
    found = {}
    if episodes and "success" in episodes[0]:
        found["run_success"] = _total(episodes, "success") / len(episodes)
    if episodes and "reached" in episodes[0]:
        found["run_reached"] = _total(episodes, "reached") / len(episodes)
    if episodes and "time_to_goal" in episodes[0]:
        found["run_time_to_goal"] = _mean(episodes, "time_to_goal")
    if not episodes:
        # A run may be shorter than its first episode.
        found = dict.fromkeys(("run_success", "run_reached", "run_time_to_goal"), math.nan)
    return found


def _over_steps(episodes: Sequence[Row]) -> dict[str, float]:
    found = {}
    if "collisions" in episodes[0]:
        found["run_collisions"] = _total(episodes, "collisions")
    for name in ("clearance", "vertical_roughness", "smoothness"):
        if name in episodes[0]:
            found[f"run_{name}"] = _mean(episodes, name, weight="steps")
    if "vort" in episodes[0] and "uneven_time" in episodes[0]:
        found["run_vort"] = _mean(episodes, "vort", weight="uneven_time")
    return found


def _total(rows: Sequence[Row], name: str) -> float:
    return float(sum(row[name] for row in rows if not math.isnan(row[name])))


def _mean(rows: Sequence[Row], name: str, weight: str | None = None) -> float:
    """The mean over the rows with a value; NaN without any."""
    pairs = [(row[name], 1.0 if weight is None else row[weight]) for row in rows if not math.isnan(row[name])]
    total = math.fsum(each for _, each in pairs)
    return math.fsum(value * each for value, each in pairs) / total if total else math.nan
