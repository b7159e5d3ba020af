"""Finds runs, evaluations and sweeps in the folders of a report, and says what it leaves out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.folder import CONFIG, EPISODES, PART, PROVENANCE, STEPS, changed_files
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.reporting.csv_rows import read_rows
from dune_rl.reporting.origins import notes_on_origin, read_origin, total_episodes
from dune_rl.reporting.runs import (
    EvaluationRun,
    Note,
    ReportInputs,
    Row,
    Sweep,
    TrainingRun,
    with_unique_names,
)
from dune_rl.reporting.step_table import StepTable
from dune_rl.reporting.sweeps import is_sweep, read_sweep

_HISTORY = "metrics.csv"
_REQUIRED = ("policy", "episode")
# Folders below the given one that are searched: experiments/STUDY/seed1 has two.
_DEPTH = 4
# Rows that share these were made on the same episodes.
_MIXED = ("set", "world", "engine", "seed")


@dataclass
class _Found:
    training: list[TrainingRun] = field(default_factory=list)
    evaluations: list[EvaluationRun] = field(default_factory=list)
    sweeps: list[Sweep] = field(default_factory=list)
    skipped: list[Note] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    seen: set[Path] = field(default_factory=set)
    # Whether the present path holds folders that are in `seen`.
    again: bool = False


def read_inputs(paths: Sequence[Path], show: Callable[[Path], None] = lambda path: None) -> ReportInputs:
    """All runs, evaluations and sweeps in and below the folders `paths`; `show` is called with each.

    What cannot be used is in `skipped`, with the reason; nothing is raised for it.
    """
    found = _Found()
    for path in paths:
        before, found.again = len(found.seen), False
        if not path.exists():
            found.skipped.append(Note(path, "there is no such folder"))
        elif not path.is_dir():
            found.skipped.append(Note(path, "is a file; give the folder of a run or of an evaluation"))
        elif path.resolve() in found.seen:
            found.skipped.append(Note(path, "is given twice; read once"))
        else:
            _search(path, found, show, _DEPTH)
            if len(found.seen) == before:
                reason = "was read already" if found.again else "holds no run, no evaluation and no sweep"
                found.skipped.append(Note(path, reason))
    return ReportInputs(
        with_unique_names(found.training),
        with_unique_names(found.evaluations),
        with_unique_names(found.sweeps),
        found.skipped,
        found.notes,
    )


def _search(path: Path, found: _Found, show: Callable[[Path], None], depth: int) -> None:
    try:
        names = {each.name for each in path.iterdir()}
    except OSError as error:
        found.skipped.append(Note(path, f"cannot be read ({error.strerror})"))
        return
    if is_sweep(path) and path.resolve() not in found.seen:
        found.seen.add(path.resolve())
        show(path)
        _add_sweep(path, found)
    if path.resolve() in found.seen:
        found.again = True
    elif names & {CONFIG, _HISTORY, CHECKPOINT_FILE, PROVENANCE, PART, f"{EPISODES}.csv"}:
        _read_folder(path, names, found, show)
    if depth:
        for name in sorted(names):
            below = path / name
            # Links could lead round in a circle, or out of what was asked for.
            if below.is_dir() and not below.is_symlink() and not name.startswith("."):
                _search(below, found, show, depth - 1)


def _read_folder(path: Path, names: set[str], found: _Found, show: Callable[[Path], None]) -> None:
    readable = _read_config(path)
    config = {} if readable is None else readable
    evaluated = bool(names & {PROVENANCE, PART, f"{EPISODES}.csv"})
    # An evaluation's settings have no number of frames.
    trained = bool(names & {_HISTORY, CHECKPOINT_FILE}) or "total_frames" in config
    if not (evaluated or trained):
        return
    found.seen.add(path.resolve())
    show(path)
    left_out = len(found.skipped)
    if trained and (_HISTORY in names or not evaluated):
        _read(path, found, lambda: _add_training(path, config, found))
    if evaluated:
        _read(path, found, lambda: _add_evaluation(path, config, found))
    if readable is None and len(found.skipped) == left_out:
        found.notes.append(Note(path, f"{CONFIG} is damaged; its settings are not in the report"))


def _read(path: Path, found: _Found, add: Callable[[], None]) -> None:
    try:
        add()
    except ConfigError as error:
        found.skipped.append(Note(path, str(error)))


def _read_config(path: Path) -> dict[str, Any] | None:
    """The settings in a folder, empty without a file; None if it is damaged."""
    file = path / CONFIG
    if not file.exists():
        return {}
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError):
        content = None
    if isinstance(content, dict):
        return {str(key): value for key, value in content.items()}
    return None


def _add_training(path: Path, config: dict[str, Any], found: _Found) -> None:
    if not (path / _HISTORY).exists():
        raise ConfigError(f"has no {_HISTORY}: its training has just begun, or was cut off early")
    history = read_rows(path / _HISTORY, empty=None)
    if not history:
        raise ConfigError(f"{_HISTORY} has no rows: no episode has ended in its training")
    if any("frames" not in row or "kind" not in row for row in history):
        raise ConfigError(f"{_HISTORY} lacks the columns kind and frames, as those of other programs do")
    total, frames = config.get("total_frames"), max(float(row["frames"]) for row in history)
    if isinstance(total, int) and frames < total:
        found.notes.append(Note(path, f"is not finished: {frames:,.0f} of {total:,} frames"))
    found.training.append(TrainingRun(path, "", config, history))


def _add_sweep(path: Path, found: _Found) -> None:
    sweep, notes = read_sweep(path)
    found.notes += notes
    if sweep.jobs:
        found.sweeps.append(sweep)
    else:
        found.skipped.append(Note(path, "is a sweep without jobs"))


def _add_evaluation(path: Path, config: dict[str, Any], found: _Found) -> None:
    provenance = read_origin(path)
    file = path / f"{EPISODES}.csv"
    if provenance.get("complete") is False:
        raise ConfigError(
            f"was cut off after {provenance.get('finished', 0)}{total_episodes(provenance)} episodes, of "
            f"which short ones end first; go on with python -m dune_rl.evaluate resume={path}"
        )
    if not file.exists():
        raise ConfigError(f"has no {file.name}; evaluate again")
    episodes = read_rows(file, empty=float("nan"))
    if not episodes:
        raise ConfigError(f"{file.name} has no episodes")
    missing = [name for name in _REQUIRED if name not in episodes[0]]
    if missing:
        raise ConfigError(
            f"{file.name} lacks the column {missing[0]}, as those of other versions do; evaluate again"
        )
    world = str((config.get("world") or {}).get("name", "unknown world"))
    # The first studies have one agent, and no column for it.
    defaults = {"set": "", "world": world, "engine": _engine(config), "agent": "agent_0"}
    episodes = [{**defaults, **row} for row in episodes]
    changed = {file.name, CONFIG} & set(changed_files(path, provenance))
    if changed:
        raise ConfigError(
            f"{min(changed)} is not as the evaluation wrote it (its checksum differs): evaluate again"
        )
    _check_repeated(file, episodes)
    found.notes += notes_on_origin(path, provenance)
    episodes = _finished_episodes(path, config.get("protocol"), episodes, found)
    recorded = path / f"{STEPS}.csv"
    steps = StepTable.read(recorded) if recorded.exists() else StepTable.of_rows([])
    whole = EvaluationRun(path, "", config, provenance, episodes, steps)
    parts = _split_mixed(whole)
    if len(parts) > 1:
        _check_worlds_of_sets(file, parts)
        kinds = ", ".join(part.episodes[0]["set"] or part.episodes[0]["world"] for part in parts)
        found.notes.append(Note(path, f"has several sets, worlds, engines or seeds ({kinds}): kept apart"))
    found.evaluations += parts


def _finished_episodes(path: Path, protocol: object, episodes: list[Row], found: _Found) -> list[Row]:
    """The episodes that may be compared: of runs of a protocol those that the end of a run did not cut off.

    Raises ConfigError where no episode may be.
    """
    if protocol is None:
        return episodes
    if protocol != "paper":
        raise ConfigError(
            f"was made with protocol={protocol}, whose measures are of attempts and runs, not of episodes: "
            "its summary.csv, runs.csv and attempts.csv have them"
        )
    finished = [row for row in episodes if row.get("finished", 1.0) > 0]
    if not finished:
        raise ConfigError("has no episode that ended within its run; take longer runs")
    ended = {row["policy"] for row in finished}
    for policy in dict.fromkeys(row["policy"] for row in episodes):
        if policy not in ended:
            reason = f"no episode of {policy} ended within its run: it is not in the report; take longer runs"
            found.notes.append(Note(path, reason))
    found.notes.append(
        Note(
            path,
            f"was made with protocol={protocol}: the {len(finished)} episodes are reported that ended within "
            "their run; its summary.csv has the measures of whole runs",
        )
    )
    return finished


def _engine(config: dict[str, Any]) -> str:
    physics = config.get("physics")
    return str(physics.get("backend", "")) if isinstance(physics, dict) else ""


def _check_repeated(file: Path, episodes: list[Row]) -> None:
    seen = set()
    for row in episodes:
        key = tuple(str(row.get(name)) for name in (*_REQUIRED, "agent", *_MIXED))
        if key in seen:
            raise ConfigError(f"{file.name} has episode {row['episode']} of {row['policy']} twice")
        seen.add(key)


def _check_worlds_of_sets(file: Path, parts: Sequence[EvaluationRun]) -> None:
    worlds: dict[str, list[str]] = {}
    for part in parts:
        of_set = worlds.setdefault(str(part.episodes[0]["set"]), [])
        of_set.append(str(part.episodes[0]["world"]))
    for name, found in worlds.items():
        if name and len(set(found)) > 1:
            places = ", ".join(dict.fromkeys(found))
            raise ConfigError(f"{file.name} has rows of {name} in several worlds ({places}); evaluate again")


def _split_mixed(run: EvaluationRun) -> list[EvaluationRun]:
    parts: dict[tuple[str, ...], list[Row]] = {}
    for row in run.episodes:
        parts.setdefault(tuple(str(row.get(name)) for name in _MIXED), []).append(row)
    if len(parts) == 1:
        return [run]
    # Steps do not say which world they were made in.
    return [replace(run, episodes=rows, steps=StepTable.of_rows([])) for rows in parts.values()]
