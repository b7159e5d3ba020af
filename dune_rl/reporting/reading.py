"""Finds runs, evaluations and sweeps in the folders of a report, and says what it leaves out."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import typed_word
from dune_rl.core.untrusted_files import printable
from dune_rl.evaluation.episode_sets.files import read_episode_set, set_names
from dune_rl.evaluation.folder import CONFIG, EPISODES, PART, PROVENANCE, STEPS, changed_files
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.reporting.folder import why_no_folder
from dune_rl.reporting.inputs import EvaluationRun, Note, ReportInputs, TrainingRun, with_unique_names
from dune_rl.reporting.rows import Row, StepTable, is_number, read_rows
from dune_rl.reporting.sweeps import HISTORY, is_sweep, read_sweep, read_yaml

_REQUIRED = ("policy", "episode")
_MOST_EPISODES = 10**12
# Folders below the given one that are searched: experiments/STUDY/seed1 has two.
_DEPTH = 4
# Rows that share these were made on the same episodes.
_MIXED = ("set", "world", "engine", "seed")
# What the parts of a provenance are, where they are there.
_KINDS = {"files": dict, "packages": dict, "git": dict, "hardware": dict, "policies": list, "command": list}


def read_inputs(paths: Sequence[Path], show: Callable[[Path], None] = lambda path: None) -> ReportInputs:
    """All runs, evaluations and sweeps in and below the folders `paths`; `show` is called with each.

    What cannot be used is in `skipped`, with the reason; nothing is raised for it.
    """
    reader = _Reader(show)
    for path in paths:
        reader.add(path)
    return ReportInputs(
        with_unique_names(reader.inputs.training),
        with_unique_names(reader.inputs.evaluations),
        with_unique_names(reader.inputs.sweeps),
        reader.inputs.skipped,
        reader.inputs.notes,
    )


class _Reader:
    def __init__(self, show: Callable[[Path], None]) -> None:
        self.inputs = ReportInputs()
        self._show = show
        self._seen: set[Path] = set()

    def add(self, path: Path) -> None:
        reason = why_no_folder(path)
        if path.resolve() in self._seen:
            reason = "is given twice; read once"
        elif reason is None:
            before = len(self._seen)
            held = self._search(path, _DEPTH)
            if len(self._seen) == before:
                reason = "was read already" if held else "holds no run, no evaluation and no sweep"
        if reason is not None:
            self._skip(path, reason)

    def _skip(self, path: Path, reason: str) -> None:
        self.inputs.skipped.append(Note(path, reason))

    def _note(self, path: Path, text: str) -> None:
        self.inputs.notes.append(Note(path, text))

    def _search(self, path: Path, depth: int) -> bool:
        """Read what is in and below `path`; whether there is anything, read now or before."""
        try:
            names = {each.name for each in path.iterdir()}
        except OSError as error:
            self._skip(path, f"cannot be read ({error.strerror})")
            return False
        held = path.resolve() in self._seen or self._read_folder(path, names)
        if depth:
            for name in sorted(names):
                below = path / name
                # Links could lead round in a circle, or out of what was asked for.
                if below.is_dir() and not below.is_symlink() and not name.startswith("."):
                    held |= self._search(below, depth - 1)
        return held

    def _read_folder(self, path: Path, names: set[str]) -> bool:
        """Read a sweep, a run or an evaluation, or a run with its evaluation; whether `path` is one."""
        sweep = is_sweep(path)
        readable = read_yaml(path / CONFIG) if CONFIG in names else {}
        config = readable if isinstance(readable, dict) else {}
        evaluated = bool(names & {PROVENANCE, PART, f"{EPISODES}.csv"})
        # An evaluation's settings have no number of frames.
        trained = bool(names & {HISTORY, CHECKPOINT_FILE}) or "total_frames" in config
        if not (sweep or evaluated or trained):
            return False
        self._seen.add(path.resolve())
        self._show(path)
        if sweep:
            self._read(path, self._add_sweep)
            return True
        left_out = len(self.inputs.skipped)
        if trained and (HISTORY in names or not evaluated):
            self._read(path, lambda path: self._add_training(path, config))
        if evaluated:
            self._read(path, lambda path: self._add_evaluation(path, config))
        if not isinstance(readable, dict) and len(self.inputs.skipped) == left_out:
            self._note(path, f"{CONFIG} is damaged; its settings are not in the report")
        return True

    def _read(self, path: Path, add: Callable[[Path], None]) -> None:
        try:
            add(path)
        except ConfigError as error:
            self._skip(path, str(error))

    def _add_sweep(self, path: Path) -> None:
        sweep, notes = read_sweep(path)
        self.inputs.notes.extend(notes)
        if not sweep.jobs:
            raise ConfigError("is a sweep without jobs")
        self.inputs.sweeps.append(sweep)

    def _add_training(self, path: Path, config: dict[str, Any]) -> None:
        if not (path / HISTORY).exists():
            raise ConfigError(f"has no {HISTORY}: its training has just begun, or was cut off early")
        history = read_rows(path / HISTORY, empty=None)
        if not history:
            raise ConfigError(f"{HISTORY} has no rows: no episode has ended in its training")
        if any(not is_number(row.get("frames")) or "kind" not in row for row in history):
            raise ConfigError(f"{HISTORY} lacks the columns kind and frames, as those of other programs do")
        run, total = TrainingRun(path, "", config, history), config.get("total_frames")
        if isinstance(total, int) and run.frames < total:
            self._note(path, f"is not finished: {run.frames:,.0f} of {total:,} frames")
        self.inputs.training.append(run)

    def _add_evaluation(self, path: Path, config: dict[str, Any]) -> None:
        provenance = _read_origin(path)
        file = path / f"{EPISODES}.csv"
        if provenance.get("complete") is False:
            done = f"{_finished_episodes(path, provenance)}{_total_episodes(provenance)}"
            raise ConfigError(
                f"was cut off after {done} episodes, of which short ones end first; go on with python -m "
                f"dune_rl.evaluate {typed_word('resume', path)}"
            )
        if not file.exists():
            raise ConfigError(f"has no {file.name}; evaluate again")
        episodes = _read_episodes(file, config)
        changed = {file.name, CONFIG} & set(changed_files(path, provenance))
        if changed:
            raise ConfigError(
                f"{min(changed)} is not as the evaluation wrote it (its checksum differs): evaluate again"
            )
        _check_repeated(file, episodes)
        self.inputs.notes.extend(_notes_on_origin(path, provenance))
        episodes = self._finished_episodes(path, config.get("protocol"), episodes)
        recorded = path / f"{STEPS}.csv"
        steps = StepTable.read(recorded) if recorded.exists() else StepTable()
        parts = _split_mixed(EvaluationRun(path, "", config, provenance, episodes, steps))
        if len(parts) > 1:
            _check_worlds_of_sets(file, parts)
            kinds = ", ".join(part.episodes[0]["set"] or part.episodes[0]["world"] for part in parts)
            self._note(path, f"has several sets, worlds, engines or seeds ({kinds}): kept apart")
        self.inputs.evaluations.extend(parts)

    def _finished_episodes(self, path: Path, protocol: object, episodes: list[Row]) -> list[Row]:
        """The episodes that may be compared: of runs of a protocol those that no end of a run cut off.

        Raises ConfigError where no episode may be.
        """
        if protocol is None:
            return episodes
        if protocol != "paper":
            raise ConfigError(
                f"was made with protocol={protocol}, whose measures are of attempts and runs, not of "
                "episodes: its summary.csv, runs.csv and attempts.csv have them"
            )
        finished = [row for row in episodes if row.get("finished", 1.0) > 0]
        if not finished:
            raise ConfigError("has no episode that ended within its run; take longer runs")
        ended = {row["policy"] for row in finished}
        for policy in dict.fromkeys(row["policy"] for row in episodes if row["policy"] not in ended):
            self._note(
                path,
                f"no episode of {policy} ended within its run: it is not in the report; take longer runs",
            )
        self._note(
            path,
            f"was made with protocol={protocol}: the {len(finished)} episodes are reported that ended within "
            "their run; its summary.csv has the measures of whole runs",
        )
        return finished


def _read_episodes(file: Path, config: Mapping[str, Any]) -> list[Row]:
    episodes = read_rows(file, empty=float("nan"))
    if not episodes:
        raise ConfigError(f"{file.name} has no episodes")
    missing = [name for name in _REQUIRED if name not in episodes[0]]
    if missing:
        raise ConfigError(
            f"{file.name} lacks the column {missing[0]}, as those of other versions do; evaluate again"
        )
    world, physics = config.get("world") or {}, config.get("physics")
    odd = next((index for index, row in enumerate(episodes) if not _is_episode(row["episode"])), None)
    if odd is not None:
        found = printable(str(episodes[odd]["episode"]))
        raise ConfigError(
            f"{file.name}, line {odd + 2}: episode is {found!r}, which is no number of one; evaluate again"
        )
    # The first studies have one agent, and no column for it.
    defaults = {
        "set": "",
        "world": str(world.get("name", "unknown world")),
        "engine": str(physics.get("backend", "")) if isinstance(physics, dict) else "",
        "agent": "agent_0",
    }
    return [{**defaults, **row} for row in episodes]


def _is_episode(value: object) -> bool:
    return isinstance(value, int | float) and 0 <= value < _MOST_EPISODES and value == int(value)


def _check_repeated(file: Path, episodes: list[Row]) -> None:
    seen = set()
    for row in episodes:
        key = tuple(str(row.get(name)) for name in (*_REQUIRED, "agent", *_MIXED))
        if key in seen:
            raise ConfigError(f"{file.name} has episode {row['episode']} of {row['policy']} twice")
        seen.add(key)


def _check_worlds_of_sets(file: Path, parts: Sequence[EvaluationRun]) -> None:
    worlds: dict[str, dict[str, None]] = {}
    for first in (part.episodes[0] for part in parts):
        worlds.setdefault(str(first["set"]), {})[str(first["world"])] = None
    for name, found in worlds.items():
        if name and len(found) > 1:
            raise ConfigError(
                f"{file.name} has rows of {name} in several worlds ({', '.join(found)}); evaluate again"
            )


def _split_mixed(run: EvaluationRun) -> list[EvaluationRun]:
    parts: dict[tuple[str, ...], list[Row]] = {}
    for row in run.episodes:
        parts.setdefault(tuple(str(row.get(name)) for name in _MIXED), []).append(row)
    if len(parts) == 1:
        return [run]
    # Steps do not say which world they were made in.
    return [replace(run, episodes=rows, steps=StepTable()) for rows in parts.values()]


def _read_origin(path: Path) -> dict[str, Any]:
    """The provenance of an evaluation, empty for a study without; raises ConfigError if it is damaged."""
    file = path / PROVENANCE
    if not file.exists():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        content = None
    if isinstance(content, dict):
        known = {str(key): value for key, value in content.items() if value is not None}
        kinds_fit = all(isinstance(known.get(key, kind()), kind) for key, kind in _KINDS.items())
        if kinds_fit and _fit(known.get("policies", ()), known.get("command", ())):
            return known
    raise ConfigError(
        f"{PROVENANCE} is damaged, so that nothing tells whether it is complete; evaluate again"
    )


def _fit(policies: Sequence[object], command: Sequence[object]) -> bool:
    sums = [one.get("sha256") if isinstance(one, dict) else one for one in policies]
    return (
        all(isinstance(one, dict) for one in policies)
        and all(isinstance(one, str | None) for one in sums)
        and all(isinstance(word, str) for word in command)
    )


def _finished_episodes(path: Path, provenance: Mapping[str, Any]) -> Any:
    """How many episodes an evaluation has finished: by the file of them where it was killed."""
    try:
        with (path / PART).open("rb") as file:
            return sum(line.endswith(b"\n") for line in file)
    except OSError:
        return provenance.get("finished", 0)


def _total_episodes(provenance: Mapping[str, Any]) -> str:
    """How many episodes an evaluation was to have, in words; nothing of runs, whose number is not known."""
    episodes = provenance.get("episodes")
    return "" if episodes is None else f" of {episodes * max(1, len(provenance.get('policies', ())))}"


def _notes_on_origin(path: Path, provenance: Mapping[str, Any]) -> list[Note]:
    """What a reader must know of where an evaluation comes from: another set or version, or unknown."""
    if not provenance:
        text = (
            f"has no {PROVENANCE}: nothing says by which command, version and weights its episodes were "
            "made, nor whether they are complete and as they were written"
        )
        return [Note(path, text)]
    texts = []
    used = provenance.get("set")
    if isinstance(used, dict):
        name, checksum = used.get("name"), used.get("sha256")
        installed = installed_checksum(str(name))
        if installed is None:
            texts.append(f"the set {name} is not installed, so it is not checked")
        elif installed != checksum:
            texts.append(
                f"was made on another set {name} than the installed one (checksums {str(checksum)[:12]} and "
                f"{installed[:12]}): kept apart"
            )
    made_with = provenance.get("packages", {}).get("dune_rl")
    if made_with is not None and made_with != installed_version():
        texts.append(f"was made with dune_rl {made_with}; this report is of {installed_version()}")
    return [Note(path, text) for text in texts]


def policy_origins(provenance: Mapping[str, Any], policy: str) -> list[dict[str, Any]]:
    """What the provenance says of the policy of this name, such as the place of its weights."""
    return [each for each in provenance.get("policies", ()) if each.get("name") == policy]


def installed_checksum(name: str) -> str | None:
    """The checksum of the installed episode set `name`; None where it is not among them or damaged."""
    if name not in set_names():
        return None
    try:
        return read_episode_set(name).header.sha256
    except ConfigError:
        return None


def installed_version() -> str:
    """The version of this package."""
    try:
        return version("dune_rl")
    except PackageNotFoundError:
        return "unknown"
