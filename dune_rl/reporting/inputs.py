"""What a report is made of: training runs, evaluations and sweeps, as they were read from their folders."""

import json
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any, TypeVar

from dune_rl.reporting.rows import Row, StepTable

_SEED = re.compile(r"(seed_?)?\d+")
_SHOWN = 3
# Settings that change neither what is learnt nor on what.
_INDIFFERENT = ("seed", "run_dir", "resume", "film", "device", "objective")


@dataclass(frozen=True)
class TrainingRun:
    """A finished or unfinished run of `dune_rl.train`.

    `history` has the rows of metrics.csv with numbers as floats: the kind ("train", "eval", "warmup"),
    frames, measures by name, and the group where there are several. `name` is unique in a report.
    """

    path: Path
    name: str
    config: Mapping[str, Any]
    history: list[Row]

    @property
    def frames(self) -> float:
        """The frames that it has made."""
        return max(float(row["frames"]) for row in self.history)

    @property
    def agent_groups(self) -> list[str]:
        """The groups of agents that it trained; one without a name where there is only one."""
        return list(dict.fromkeys(str(row.get("group", "")) for row in self.history))


@dataclass(frozen=True)
class EvaluationRun:
    """The folder of an evaluation, or of a published study, which has no provenance.

    `episodes` has the rows of the table, with numbers as floats and NaN for empty cells; "policy", "set",
    "world", "engine" and "agent" stay text. `steps` is empty unless steps were recorded.
    `name` is unique in a report.
    """

    path: Path
    name: str
    config: Mapping[str, Any]
    provenance: Mapping[str, Any]
    episodes: list[Row]
    steps: StepTable = field(default_factory=StepTable)


@dataclass(frozen=True)
class SweepJob:
    """A job of a sweep: what it changed, and its objective, NaN where it did not get so far."""

    path: Path
    name: str
    parameters: Mapping[str, str]
    objective: float


@dataclass(frozen=True)
class Sweep:
    """A sweep of `dune_rl.train -m`; `best` is the name of its best job, None where no job has an objective.

    `metric` is what its objective measures, and `maximise` says which way is better.
    """

    path: Path
    name: str
    metric: str
    maximise: bool
    jobs: list[SweepJob]
    best: str | None = None


@dataclass(frozen=True)
class Note:
    """Something about an input that a reader must know: why it was left out, or what is odd about it."""

    path: Path
    text: str


@dataclass(frozen=True)
class ReportInputs:
    """All that a report is made from; `skipped` are the inputs that could not be used."""

    training: list[TrainingRun] = field(default_factory=list)
    evaluations: list[EvaluationRun] = field(default_factory=list)
    sweeps: list[Sweep] = field(default_factory=list)
    skipped: list[Note] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)

    @property
    def usable(self) -> bool:
        """Whether there is anything to report."""
        return bool(self.training or self.evaluations or self.sweeps)


def unique_name(name: str, taken: Container[str]) -> str:
    """The name, with a number behind it where it is among the names `taken`."""
    unique, number = name, 1
    while unique in taken:
        number += 1
        unique = f"{name} ({number})"
    return unique


Named = TypeVar("Named", TrainingRun, EvaluationRun, Sweep)


def with_unique_names(runs: Sequence[Named]) -> list[Named]:
    """The runs with the shortest ends of their paths that tell them apart; equal paths get numbers."""
    names: list[str] = []
    paths = [run.path.resolve() for run in runs]
    for path in paths:
        parts, others = path.parts, [other.parts for other in paths if other != path]
        # "seed1" alone tells nothing.
        length = 2 if _SEED.fullmatch(parts[-1]) else 1
        while length < len(parts) and any(other[-length:] == parts[-length:] for other in others):
            length += 1
        names.append(unique_name("/".join(parts[-length:]), names))
    return [replace(run, name=name) for run, name in zip(runs, names, strict=True)]


def differing_settings(config: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The settings of `config` that are not the same in all `others`, by their names with dots."""
    flat, all_flat = _flatten(config), [_flatten(other) for other in others]
    return {
        name: value for name, value in flat.items() if any(other.get(name) != value for other in all_flat)
    }


def _flatten(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in config.items():
        if isinstance(value, Mapping):
            found |= _flatten(value, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = value
    return found


def last_evaluation(history: Sequence[Row], group: str | None = None) -> Row:
    """The last evaluation of a group of agents, by default of the first one; empty without one."""
    rows = [row for row in history if row.get("kind") == "eval"]
    wanted = str(rows[0].get("group", "")) if rows and group is None else group
    return next((row for row in reversed(rows) if str(row.get("group", "")) == wanted), {})


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
    by_settings: dict[str, list[TrainingRun]] = {}
    for run in runs:
        kept = {name: value for name, value in run.config.items() if name not in _INDIFFERENT}
        key = json.dumps(kept, sort_keys=True, default=str) if run.config else f"alone: {run.name}"
        by_settings.setdefault(key, []).append(run)
    named = [(_common_name(members), members) for members in by_settings.values()]
    found: list[TrainingGroup] = []
    for name, members in named:
        same = [each[0].config for known, each in named if known == name]
        # Groups of one name are called by the settings that tell them apart, such as those of a sweep.
        told = [
            f"{path.rpartition('.')[2]}={value}"
            for path, value in differing_settings(members[0].config, same).items()
            if path not in _INDIFFERENT
        ]
        if told:
            name = ", ".join(told[:_SHOWN]) + (f", {len(members)} seeds" if len(members) > 1 else "")
        found.append(TrainingGroup(unique_name(name, [group.name for group in found]), members))
    return found


def _common_name(runs: Sequence[TrainingRun]) -> str:
    """What the names of the runs have in common: the folder that they are in, or their beginning."""
    if len(runs) == 1:
        return runs[0].name
    # Names are ends of paths.
    equal = takewhile(lambda letters: len(set(letters)) == 1, zip(*(run.name for run in runs), strict=False))
    beginning = "".join(letters[0] for letters in equal).rstrip("/_-. ").removesuffix("seed").rstrip("/_-. ")
    parents = {run.path.resolve().parent for run in runs}
    if not beginning and len(parents) == 1:
        beginning = parents.pop().name
    return f"{beginning or runs[0].name}, {len(runs)} seeds"
