"""Sorts evaluations into comparisons: methods that met the same episodes, whatever folders they are in."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from dune_rl.config.commands import BuiltInPolicy
from dune_rl.config.saved import robot_names, split_groups
from dune_rl.evaluation.episode_sets.files import read_episode_set
from dune_rl.reporting.comparison import Cases, Comparison, EvaluatedPolicy
from dune_rl.reporting.inputs import EvaluationRun, differing_settings
from dune_rl.reporting.reading import installed_checksum, policy_origins
from dune_rl.reporting.rows import Row, is_number

# What decides how an episode runs, apart from the policy: it must be equal for results to pair.
_DECISIVE = ("world", "weather", "randomisation", "protocol", "run_steps")
_DECISIVE_IN_TASK = ("spawn", "terminations")
_SETTINGS_SHOWN, _SHOWN_OF_SUM = 3, 12


def collect_comparisons(evaluations: Sequence[EvaluationRun]) -> list[Comparison]:
    """The comparisons that evaluations give, by cases; each group of agents has its own.

    A policy of one name in several folders is one method where its rows are the same, and else each
    is called after its folder too.
    """
    comparisons: dict[str, Comparison] = {}
    for run in evaluations:
        for group, rows in _by_group(run.episodes).items():
            cases = cases_of(run, group)
            comparison = comparisons.setdefault(cases.key, Comparison(cases, []))
            for policy in dict.fromkeys(str(row["policy"]) for row in rows):
                mine = [row for row in rows if str(row["policy"]) == policy]
                _add_method(comparison, policy, mine, run)
    for comparison in comparisons.values():
        _name_apart(comparison.methods)
        comparison.notes += describe_oddities(comparison)
    _tell_apart(list(comparisons.values()))
    return list(comparisons.values())


def cases_of(run: EvaluationRun, group: str) -> Cases:
    """The cases of a group of agents in an evaluation whose episodes are all of one set, world and seed."""
    first = run.episodes[0]
    name, world, engine = (str(first.get(key, "")) for key in ("set", "world", "engine"))
    seed = int(first["seed"]) if is_number(first.get("seed")) else None
    used, population = run.provenance.get("set"), run.provenance.get("population")
    checksum = str(used.get("sha256", "")) if isinstance(used, dict) else ""
    settings = _decisive_settings(run.config)
    decisive: list[Any] = [name, checksum] if name else [world, seed, settings]
    title = name or (world if seed is None else f"{world}, seed {seed}")
    if isinstance(population, dict):
        # Of a cross-play: other actors than those of the set, or by other weights.
        decisive = [decisive, population.get("sha256"), settings["actors"]]
        title += f" among {population.get('name')}"
    text = json.dumps([decisive, engine, group], sort_keys=True, default=str)
    protocol = run.config.get("protocol")
    title += "" if protocol is None else f", protocol={protocol}"
    title += f" ({engine})" if engine not in ("", "bullet") else ""
    title += f", {group}" if len(_by_group(run.episodes)) > 1 else ""
    return Cases(hashlib.sha256(text.encode()).hexdigest(), title, world, name, checksum, engine, seed)


def _decisive_settings(config: Mapping[str, Any]) -> dict[str, Any]:
    task, physics = config.get("task"), config.get("physics")
    parts = {name: config.get(name) for name in _DECISIVE}
    robots, parts["actors"] = split_groups(config)
    if sum(group.get("count", 1) for group in robots.values()) > 1:
        parts["robots"] = robots
    if isinstance(physics, dict):
        # A time limit is a number of control steps.
        parts["physics.control_hz"] = physics.get("control_hz")
    if isinstance(task, dict):
        parts |= {f"task.{name}": task.get(name) for name in _DECISIVE_IN_TASK}
    return parts


def _by_group(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by the group of their agents, which are called GROUP_NUMBER."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(re.sub(r"_\d+$", "", str(row["agent"])), []).append(row)
    return found


def _add_method(comparison: Comparison, policy: str, rows: list[Row], run: EvaluationRun) -> None:
    for known in comparison.methods:
        if known.policy == policy and _same_rows(known.rows, rows):
            known.runs.append(run)
            return
    ordered = sorted(rows, key=lambda row: (row["episode"], str(row["agent"])))
    cases = comparison.cases
    comparison.methods.append(EvaluatedPolicy(policy, policy, ordered, [run], cases.title, cases.key))


def _same_rows(first: Sequence[Row], second: Sequence[Row]) -> bool:
    a, b = ({(row["episode"], row["agent"]): row for row in rows} for rows in (first, second))
    return a.keys() == b.keys() and all(
        value == b[key][name] or (value != value and b[key][name] != b[key][name])
        for key, row in a.items()
        for name, value in row.items()
        if name in b[key]
    )


def _name_apart(methods: list[EvaluatedPolicy]) -> None:
    for policy in {method.policy for method in methods}:
        same = [method for method in methods if method.policy == policy]
        if len(same) > 1:
            for method in same:
                folder = method.runs[0].name
                method.name = folder if policy in ("trained", Path(folder).name) else f"{policy} ({folder})"


def _tell_apart(comparisons: Sequence[Comparison]) -> None:
    """Number the comparisons of equal titles, and say in what they differ."""
    titles = [one.cases.title for one in comparisons]
    for title in {title for title in titles if titles.count(title) > 1}:
        same = [one for one in comparisons if one.cases.title == title]
        note = (
            f"{len(same)} sets of cases are called {title}, and have numbers here: {_difference(same)}. "
            "Methods on one of them met other episodes than methods on another, and do not compare with them."
        )
        for number, one in enumerate(same, 1):
            one.cases = replace(one.cases, title=f"{title} (cases {number})")
            for method in one.methods:
                method.cases = one.cases.title
            one.numbered = note
            one.notes.append(note)


def _difference(same: Sequence[Comparison]) -> str:
    if same[0].cases.set_name:
        sums = ", ".join(one.cases.checksum[:_SHOWN_OF_SUM] or "unknown" for one in same)
        return f"the set's episodes are not the same (checksums {sums})"
    settings = [_decisive_settings(one.methods[0].runs[0].config) for one in same]
    names = list(dict.fromkeys(name for each in settings for name in differing_settings(each, settings)))
    more = f" and {len(names) - _SETTINGS_SHOWN} others" if len(names) > _SETTINGS_SHOWN else ""
    return f"their episodes have other settings ({', '.join(names[:_SETTINGS_SHOWN])}{more})"


def describe_oddities(comparison: Comparison) -> list[str]:
    """What is odd about a comparison, a sentence each."""
    notes, methods, cases = [], comparison.methods, comparison.cases
    if len(comparison.thresholds) > 1:
        values = ", ".join(f"{value:g}°" for value in comparison.thresholds)
        notes.append(f"VORT was measured with different thresholds ({values}) and does not compare.")
    counts = {method.name: len(method.rows) for method in methods}
    common = len(comparison.common_episodes())
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        notes.append(
            f"The methods have different numbers of episodes ({told}); pairs are compared on the {common} "
            "that all have."
        )
    elif common < max(counts.values()):
        notes.append("The methods have different episodes; pairs are compared on those that all have.")
    single = [method.name for method in methods if method.episodes == 1]
    notes += [f"{name} has one episode, which has no interval." for name in single]
    total = _episodes_of_set(cases)
    short = sorted({f"{method.name} {method.episodes}" for method in methods if method.episodes < total})
    if short:
        notes.append(f"The set has {total} episodes, of which there are: {', '.join(short)}.")
    for method in methods:
        if sites := _sites_of_training(method):
            notes.append(f"{method.name} was trained on {sites} of these sites: these are not unseen ones.")
    trained = ", ".join(method.name for method in methods if _is_at_home(cases, method))
    if trained:
        notes.append(f"{trained}: measured on the site that it was trained on; on others it may do worse.")
    robots = {", ".join(robot_names(run.config)) for one in methods for run in one.runs}
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
    origins = [each for run in method.runs for each in policy_origins(run.provenance, method.policy)]
    return len(origins[0].get("sites_of_training") or ()) if origins else 0


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
