"""Tables of runs, by the protocols of the paper and of its published code."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich.console import Console

from dune_rl.evaluation.blocks import FinishedEpisode
from dune_rl.evaluation.protocols.attempts import Attempt, attempts_of_rows, best_window_rate, join_attempts
from dune_rl.evaluation.protocols.run_rows import describe_runs, run_rows
from dune_rl.evaluation.running import EvaluationPlan
from dune_rl.evaluation.tables import comparison_table, metric_notes, results_table
from dune_rl.metrics.catalogue import CATALOGUE
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import estimate_metrics
from dune_rl.statistics.paired_comparison import PairedComparison, compare_policies

_TWO = 2
_NOTHING = Estimate(float("nan"), float("nan"), float("nan"), 0)
_CODE_NOTES = (
    "code ...: as the paper's published code computes it; others as the paper defines it. The code has no "
    "MTT and no TR.",
)
_PAPER_NOTES = ("SR, TR and MTT are of finished episodes; the last one of a run is cut off.",)
# In the order of the tables.
_ORDER = [measure.name for measure in CATALOGUE]


def attempts_of_policy(finished: Sequence[FinishedEpisode], group: str, step_s: float) -> list[Attempt]:
    """The attempts of a policy in all of its runs, one after another."""
    return join_attempts(
        [
            (one.rows[group][0]["steps"] * step_s, attempts_of_rows(one.attempts))
            for one in sorted(finished, key=lambda one: one.episode)
        ]
    )


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
        found = {name: _without_a_point(one) for name, one in estimate_metrics(runs).items()}
        if is_code:
            log = attempts_of_policy(own, group, plan.conf.physics.control_step_s)
            for name, whole in (("code best SR", False), ("code best whole SR", True)):
                rate = best_window_rate(log, whole=whole)
                found[name] = Estimate(rate, float("nan"), float("nan"), len(runs))
            found |= {"code MTT": _NOTHING, "code TR": _NOTHING}
        estimates[source.name] = dict(sorted(found.items(), key=lambda item: _place(item[0])))
        by_policy[source.name] = runs
        described += describe_runs(rows, runs)
    return estimates, by_policy, described


def _without_a_point(found: Estimate) -> Estimate:
    """A few equal runs do not tell how much others differ: they have no interval, not one of width 0."""
    return replace(found, low=math.nan, high=math.nan) if found.low == found.high else found


def _place(name: str) -> int:
    return _ORDER.index(name) if name in _ORDER else len(_ORDER)


def show_runs(
    plan: EvaluationPlan,
    estimates: Mapping[str, Mapping[str, Estimate]],
    runs: Mapping[str, Sequence[Mapping[str, float]]],
    console: Console,
) -> list[PairedComparison]:
    """Print the table of runs, and of pairs of policies where there are several; returns the comparisons."""
    conf = plan.conf
    title = (
        f"{conf.world.name}, protocol={conf.protocol}: {conf.runs} runs of {conf.run_steps:,} steps, "
        f"seed {conf.seed}"
    )
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
            **attempt,
        }
        for one in sorted(finished, key=lambda one: (one.policy, one.episode))
        for attempt in one.attempts
    ]


def finished_runs(plan: EvaluationPlan, finished: Iterable[FinishedEpisode]) -> set[tuple[int, int]]:
    """Pairs of policy and run of which all steps are there."""
    steps: Counter[tuple[int, int]] = Counter()
    for episode in finished:
        for agents in episode.rows.values():
            steps[episode.policy, agents[0]["run"]] += agents[0]["steps"]
    return {key for key, count in steps.items() if count >= (plan.conf.run_steps or 0)}
