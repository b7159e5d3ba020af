"""What a report is made of: training runs, evaluations and sweeps, as they were read from their folders."""

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from dune_rl.reporting.step_table import Row, StepTable

_SEED = re.compile(r"(seed_?)?\d+")


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
    steps: StepTable


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
    for run in runs:
        parts = run.path.resolve().parts
        others = [other.path.resolve().parts for other in runs if other.path.resolve() != run.path.resolve()]
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
