"""Tables of runs, by the protocols of the paper and of its published code: totals, and means over steps."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich.console import Console

from dune_rl.evaluation.blocks import FinishedEpisode
from dune_rl.evaluation.protocols.attempts import Attempt, best_window_rate, join_attempts
from dune_rl.evaluation.running import EvaluationPlan
from dune_rl.evaluation.tables import comparison_table, metric_notes, results_table
from dune_rl.metrics.catalogue import CATALOGUE
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import average_metrics, estimate_metrics
from dune_rl.statistics.paired_comparison import PairedComparison, compare_policies

Row = Mapping[str, Any]

_CODE = "dune_code_"
_ALSO_TOTALS = ("steps", "return", "goals")
_TWO = 2
_NOTHING = Estimate(float("nan"), float("nan"), float("nan"), 0)
_CODE_NOTES = (
    "code ...: as the paper's published code computes it; others as the paper defines it. The code has no "
    "MTT and no TR.",
)
_PAPER_NOTES = ("SR, TR and MTT are of finished episodes; the last one of a run is cut off.",)
# In the order of the tables.
_ORDER = {measure.name: place for place, measure in enumerate(CATALOGUE)}


def estimate_runs(
    plan: EvaluationPlan, finished: Sequence[FinishedEpisode], group: str
) -> tuple[dict[str, dict[str, Estimate]], dict[str, list[dict[str, float]]], list[dict[str, object]]]:
    """By policy the measures over its runs and their rows; and the rows of runs.csv."""
    estimates, by_policy, described = {}, {}, []
    is_code = plan.conf.protocol == "dune_code"
    for number, source in enumerate(plan.sources):
        own = [one for one in finished if one.policy == number]
        rows = [row for one in sorted(own, key=lambda one: one.episode) for row in one.rows[group]]
        runs = run_rows(rows, ends_at_goals=not is_code)
        found = estimate_metrics(runs)
        # A few equal runs do not tell how much others differ: no interval, not one of width 0.
        equal = {name: one for name, one in found.items() if one.low == one.high}
        found |= {name: replace(one, low=math.nan, high=math.nan) for name, one in equal.items()}
        if is_code:
            step_s = plan.conf.physics.control_step_s
            # All runs, one after another.
            log = join_attempts(
                [
                    (one.rows[group][0]["steps"] * step_s, [Attempt(**each) for each in one.attempts])
                    for one in sorted(own, key=lambda one: one.episode)
                ]
            )
            for name, whole in (("code best SR", False), ("code best whole SR", True)):
                rate = best_window_rate(log, whole=whole)
                found[name] = Estimate(rate, float("nan"), float("nan"), len(runs))
            found |= {"code MTT": _NOTHING, "code TR": _NOTHING}
        estimates[source.name] = dict(
            sorted(found.items(), key=lambda item: _ORDER.get(item[0], len(_ORDER)))
        )
        by_policy[source.name] = runs
        described += describe_runs(rows, runs)
    return estimates, by_policy, described


def show_runs(
    plan: EvaluationPlan,
    estimates: Mapping[str, Mapping[str, Estimate]],
    runs: Mapping[str, Sequence[Mapping[str, float]]],
    console: Console,
) -> list[PairedComparison]:
    """Print the table of runs, and of pairs of policies where there are several; returns the comparisons."""
    conf = plan.conf
    extent = f"{conf.runs} runs of {conf.run_steps:,} steps"
    title = f"{conf.world.name}, protocol={conf.protocol}: {extent}, seed {conf.seed}"
    notes = _CODE_NOTES if conf.protocol == "dune_code" else _PAPER_NOTES
    shown = metric_notes(conf.metrics, next(iter(estimates.values())))
    console.print(results_table(estimates, title, notes=(*shown, *notes)))
    compared = compare_policies(runs)
    if compared and len(runs) >= _TWO:
        chosen = "SR/run" if conf.protocol == "paper" else "code TC"
        console.print(comparison_table(compared, chosen))
    return compared


def attempt_rows(
    plan: EvaluationPlan, finished: Sequence[FinishedEpisode], group: str
) -> list[dict[str, Any]]:
    """The rows of attempts.csv."""
    return [
        {
            "policy": plan.sources[one.policy].name,
            "run": one.rows[group][0]["run"],
            "episode": one.episode,
            "attempt": number,
            **attempt,
        }
        for one in sorted(finished, key=lambda one: (one.policy, one.episode))
        for number, attempt in enumerate(one.attempts, 1)
    ]


def finished_runs(plan: EvaluationPlan, finished: Iterable[FinishedEpisode]) -> set[tuple[int, int]]:
    """Pairs of policy and run of which all steps are there."""
    steps: Counter[tuple[int, int]] = Counter()
    for episode in finished:
        for agents in episode.rows.values():
            steps[episode.policy, agents[0]["run"]] += agents[0]["steps"]
    return {key for key, count in steps.items() if count >= (plan.conf.run_steps or 0)}


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
        if "collisions" in episodes[0]:
            columns["run_collisions"] = _total(episodes, "collisions")
        for name in ("clearance", "vertical_roughness", "smoothness"):
            if name in episodes[0]:
                columns[f"run_{name}"] = _mean(episodes, name, weight="steps")
        if "vort" in episodes[0] and "uneven_time" in episodes[0]:
            columns["run_vort"] = _mean(episodes, "vort", weight="uneven_time")
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
        numbers = {"run": int(run["episode"]), "episodes": len(episodes)}
        finished = sum(row["finished"] for row in episodes)
        earned = {"finished": finished, "steps": int(run["steps"]), "return": run["return"]}
        found.append({"policy": episodes[0]["policy"], **numbers, **earned, **measures})
    return found


def _of_finished_episodes(episodes: Sequence[Row]) -> dict[str, float]:
    if not episodes:
        # A run may be shorter than its first episode.
        return dict.fromkeys(("run_success", "run_reached", "run_time_to_goal"), math.nan)
    found = {
        f"run_{name}": _total(episodes, name) / len(episodes)
        for name in ("success", "reached")
        if name in episodes[0]
    }
    if "time_to_goal" in episodes[0]:
        found["run_time_to_goal"] = _mean(episodes, "time_to_goal")
    return found


def _total(rows: Sequence[Row], name: str) -> float:
    return float(sum(row[name] for row in rows if not math.isnan(row[name])))


def _mean(rows: Sequence[Row], name: str, weight: str | None = None) -> float:
    """The mean over the rows with a value; NaN without any."""
    pairs = [(row[name], 1.0 if weight is None else row[weight]) for row in rows if not math.isnan(row[name])]
    total = math.fsum(each for _, each in pairs)
    return math.fsum(value * each for value, each in pairs) / total if total else math.nan
