"""Groups training runs that differ in nothing but their seed, and what each came to."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

from dune_rl.reporting.runs import TrainingRun, differing_settings, unique_name

_SHOWN = 3
# Settings that change neither what is learnt nor on what.
_INDIFFERENT = ("seed", "run_dir", "resume", "film", "device", "objective")


@dataclass(frozen=True)
class TrainingGroup:
    """Runs with equal settings, but for their seeds."""

    name: str
    runs: list[TrainingRun]

    @property
    def seeds(self) -> list[str]:
        """The seed of each run."""
        return [str(run.config.get("seed", "?")) for run in self.runs]


def group_runs(runs: Sequence[TrainingRun]) -> list[TrainingGroup]:
    """The runs, those together that only their seeds tell apart; runs without settings stay alone."""
    groups: dict[str, list[TrainingRun]] = {}
    for run in runs:
        key = _settings_key(run.config) if run.config else f"alone: {run.name}"
        groups.setdefault(key, []).append(run)
    found: list[TrainingGroup] = []
    names = [_common_name(members) for members in groups.values()]
    for name, members in zip(names, groups.values(), strict=True):
        same = [each for known, each in zip(names, groups.values(), strict=True) if known == name]
        if len(same) > 1:
            # As the settings that tell them apart, such as those that a sweep varies.
            told = _differences(members[0].config, [each[0].config for each in same])
            seeds = f", {len(members)} seeds" if len(members) > 1 else ""
            name = f"{', '.join(told[:_SHOWN])}{seeds}" if told else name
        found.append(TrainingGroup(unique_name(name, [group.name for group in found]), members))
    return found


def _differences(config: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> list[str]:
    """The settings of `config` that are not the same in all `others`, as name=value."""
    return [
        f"{path.rpartition('.')[2]}={value}"
        for path, value in differing_settings(config, others).items()
        if path not in _INDIFFERENT
    ]


def _settings_key(config: Mapping[str, Any]) -> str:
    kept = {name: value for name, value in config.items() if name not in _INDIFFERENT}
    return json.dumps(kept, sort_keys=True, default=str)


def _common_name(runs: Sequence[TrainingRun]) -> str:
    """What the names of the runs have in common: the folder that they are in, or their beginning."""
    if len(runs) == 1:
        return runs[0].name
    parents = {run.path.resolve().parent for run in runs}
    # Names are ends of paths.
    beginning = _common_beginning([run.name for run in runs]).rstrip("/_-. ").removesuffix("seed")
    beginning = beginning.rstrip("/_-. ")
    if not beginning and len(parents) == 1:
        beginning = parents.pop().name
    return f"{beginning or runs[0].name}, {len(runs)} seeds"


def _common_beginning(names: Sequence[str]) -> str:
    equal = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return "".join(letters[0] for letters in equal)


def agent_groups(run: TrainingRun) -> list[str]:
    """The groups of agents that it trained; one without a name where there is only one."""
    return list(dict.fromkeys(str(row.get("group", "")) for row in run.history))
