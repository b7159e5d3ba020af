"""What a reader must know of a comparison: episodes that are missing, sites of training, other robots."""

from typing import get_args

from dune_rl.config.commands import BuiltInPolicy
from dune_rl.evaluation.episode_sets import read_episode_set
from dune_rl.reporting.comparisons.comparison import Cases, Comparison, EvaluatedPolicy
from dune_rl.reporting.origins import installed_checksum


def describe_oddities(comparison: Comparison) -> list[str]:
    """What is odd about a comparison, a sentence each."""
    notes = []
    if len(comparison.thresholds) > 1:
        values = ", ".join(f"{value:g}°" for value in comparison.thresholds)
        notes.append(f"VORT was measured with different thresholds ({values}) and does not compare.")
    counts = {method.name: len(method.rows) for method in comparison.methods}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        notes.append(
            f"The methods have different numbers of episodes ({told}); pairs are compared on the "
            f"{len(comparison.common_episodes())} that all have."
        )
    elif len(comparison.methods) > 1 and len(comparison.common_episodes()) < max(counts.values()):
        notes.append("The methods have different episodes; pairs are compared on those that all have.")
    for method in comparison.methods:
        if method.episodes == 1:
            notes.append(f"{method.name} has one episode, which has no interval.")
    total = _episodes_of_set(comparison.cases)
    short = {f"{method.name} {method.episodes}" for method in comparison.methods if method.episodes < total}
    if short:
        notes.append(f"The set has {total} episodes, of which there are: {', '.join(sorted(short))}.")
    for method in comparison.methods:
        if sites := _sites_of_training(method):
            notes.append(f"{method.name} was trained on {sites} of these sites: these are not unseen ones.")
    trained = [method.name for method in comparison.methods if _is_at_home(comparison.cases, method)]
    if trained:
        notes.append(
            f"{', '.join(trained)}: measured on the site that it was trained on; on others it may do worse."
        )
    robots = {
        str((run.config.get("robot") or {}).get("name")) for one in comparison.methods for run in one.runs
    }
    if len(robots) > 1:
        notes.append(f"The robots differ: {', '.join(sorted(robots))}.")
    return notes


def _episodes_of_set(cases: Cases) -> int:
    """How many episodes the set has; 0 where it is not installed, or has changed."""
    if not cases.set_name or installed_checksum(cases.set_name) != cases.checksum:
        return 0
    return read_episode_set(cases.set_name).header.episodes


def _sites_of_training(method: EvaluatedPolicy) -> int:
    """On how many of the set's sites the policy was trained, as its evaluation notes."""
    for run in method.runs:
        policies = run.provenance.get("policies")
        for each in policies if isinstance(policies, list) else []:
            if isinstance(each, dict) and each.get("name") == method.policy:
                return len(each.get("sites_of_training") or ())
    return 0


def _is_at_home(cases: Cases, method: EvaluatedPolicy) -> bool:
    """Whether a policy was measured on the one site of its training, as far as its folder tells."""
    if cases.set_name or method.policy in get_args(BuiltInPolicy):
        return False
    for run in method.runs:
        world, drawn = run.config.get("world"), run.config.get("randomisation")
        # Beside a training, the settings are those of the training.
        has_site = isinstance(world, dict) and world.get("seed") is not None and "total_frames" in run.config
        if has_site and not (isinstance(drawn, dict) and drawn.get("world_seed")):
            return True
    return False
