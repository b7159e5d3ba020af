"""Which runs of an evaluation are complete."""

from collections import Counter
from collections.abc import Iterable

from dune_rl.evaluation.finished import FinishedEpisode
from dune_rl.evaluation.running import EvaluationPlan


def finished_runs(plan: EvaluationPlan, finished: Iterable[FinishedEpisode]) -> set[tuple[int, int]]:
    """Pairs of policy and run of which all steps are there."""
    steps: Counter[tuple[int, int]] = Counter()
    for episode in finished:
        for agents in episode.rows.values():
            steps[episode.policy, agents[0]["run"]] += agents[0]["steps"]
    return {key for key, count in steps.items() if count >= (plan.conf.run_steps or 0)}
