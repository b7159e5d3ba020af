"""The folder of an evaluation: its settings, where it comes from, and rows that outlive an interruption."""

import contextlib
import json
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml

from dune_rl.config.checks import validate
from dune_rl.config.commands import EvaluateConf
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.core.files import sha256_of, write_atomically, write_csv
from dune_rl.core.folder_lock import LOCK_FILE, FolderLock
from dune_rl.core.suggestions import typed_word
from dune_rl.core.untrusted_files import parse_yaml
from dune_rl.evaluation.blocks import FinishedEpisode
from dune_rl.evaluation.columns import describe_columns
from dune_rl.evaluation.tables import write_tables

CONFIG, PROVENANCE, COLUMNS = "config.yaml", "provenance.json", "columns.csv"
EPISODES, STEPS, COMPARISON, SUMMARY = "episodes", "steps", "comparison", "summary"
RUNS, ATTEMPTS = "runs", "attempts"
PART = "episodes.part.jsonl"
# The folder of the transitions of finished episodes, until they are a dataset.
TRANSITIONS = "transitions.part"
_TABLES = tuple(f"{stem}{suffix}" for stem in (EPISODES, STEPS) for suffix in (".csv", ".parquet"))
_FILES = (CONFIG, PROVENANCE, COLUMNS, PART, *_TABLES)
_FILES += tuple(f"{stem}.csv" for stem in (COMPARISON, SUMMARY, RUNS, ATTEMPTS))
# Tables that follow from the rows of others.
_FOLLOWING = (COLUMNS, f"{EPISODES}.parquet", f"{STEPS}.parquet", f"{COMPARISON}.csv", f"{SUMMARY}.csv")


class ResultsFolder:
    """A folder that one evaluation writes to; other processes are kept out while it is open.

    `finished` has the episodes by (number of the policy, episode), and `is_new` says whether the folder was
    made for this evaluation. Every finished episode is appended to a file at once, from which the tables are
    written at the end, or when the evaluation is interrupted. Raises ConfigError, with `if_taken` for what
    helps, where another process has the folder.
    """

    def __init__(
        self, path: Path, provenance: dict[str, Any], if_taken: str = "choose another out=FOLDER"
    ) -> None:
        self.path, self.provenance = path, provenance
        self.finished: dict[tuple[int, int], FinishedEpisode] = {}
        self.is_new = False
        taken = ConfigError(f"another evaluation is writing to {path}; {if_taken}")
        self._lock = FolderLock(path, taken)

    @classmethod
    def create(
        cls, path: Path, conf: EvaluateConf, provenance: dict[str, Any], *, overwrite: bool
    ) -> "ResultsFolder":
        """A new folder; raises ConfigError if something is there that must not be overwritten."""
        check_free_for_results(path, overwrite=overwrite)
        path.mkdir(parents=True, exist_ok=True)
        folder = cls(path, provenance)
        folder.is_new = True
        left_over = [each for each in path.iterdir() if _is_temporary(each.name)]
        for old in (*(path / name for name in _FILES), *left_over):
            old.unlink(missing_ok=True)
        shutil.rmtree(path / TRANSITIONS, ignore_errors=True)
        with write_atomically(path / CONFIG) as temporary:
            text = yaml.safe_dump(conf.model_dump(mode="json"), sort_keys=False)
            temporary.write_text(text, encoding="utf-8")
        folder.write_provenance(complete=False)
        return folder

    @classmethod
    def reopen(cls, path: Path) -> "ResultsFolder":
        """The folder of an evaluation that was cut off, with the episodes that it finished."""
        # Its episodes are wanted, and no other folder has them.
        folder = cls(path, read_provenance(path), "wait until it has ended, or end it")
        try:
            lines = (path / PART).read_text(encoding="utf-8", errors="replace").splitlines()
        except FileNotFoundError:
            lines = []
        whole = []
        for line in lines:
            # One may have been cut off with the process; its episode is run again.
            with contextlib.suppress(ValueError, TypeError, RecursionError):
                episode = FinishedEpisode(**json.loads(line))
                folder.finished[episode.policy, episode.episode] = episode
                whole.append(line)
        if len(whole) < len(lines):
            with write_atomically(path / PART) as temporary:
                temporary.write_text("".join(f"{line}\n" for line in whole), encoding="utf-8", newline="\n")
        return folder

    def discard(self) -> None:
        """Remove what was written, and the folder if nothing else is in it."""
        for name in _FILES:
            (self.path / name).unlink(missing_ok=True)
        shutil.rmtree(self.path / TRANSITIONS, ignore_errors=True)
        self._lock.release()
        with contextlib.suppress(OSError):
            self.path.rmdir()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()

    def add(self, episode: FinishedEpisode) -> None:
        """Keep a finished episode."""
        with (self.path / PART).open("a", encoding="utf-8", newline="\n") as file:
            file.write(json.dumps(vars(episode)) + "\n")
        self.finished[episode.policy, episode.episode] = episode

    def rows(self) -> list[dict[str, Any]]:
        """The rows of all finished episodes: by policy, then by group, then by episode."""
        ordered = [self.finished[key] for key in sorted(self.finished)]
        found = []
        for policy in sorted({one.policy for one in ordered}):
            mine = [one for one in ordered if one.policy == policy]
            # Of a group whose agents come and go, nobody may have come in some episodes.
            for group in dict.fromkeys(group for one in mine for group in one.rows):
                found += [row for one in mine for row in one.rows.get(group, [])]
        return found

    def write(self) -> None:
        """Write the tables of what is finished."""
        rows = self.rows()
        metadata = {"provenance": json.dumps(self.provenance)}
        if rows:
            write_tables(self.path / EPISODES, rows, metadata)
            steps = [step for key in sorted(self.finished) for step in self.finished[key].steps]
            if steps:
                write_tables(self.path / STEPS, steps, metadata)
            names = dict.fromkeys(name for row in [*rows, *steps[:1]] for name in row)
            write_csv(self.path / COLUMNS, describe_columns(list(names)))
        self.write_provenance(complete=False)

    def complete(self) -> None:
        """Note the checksums of all files that were written, and that there is no more to resume."""
        self.write_provenance(complete=True)
        (self.path / PART).unlink(missing_ok=True)
        shutil.rmtree(self.path / TRANSITIONS, ignore_errors=True)

    def write_provenance(self, *, complete: bool) -> None:
        """Write provenance.json, which has the files' checksums and says whether they are `complete`."""
        files = [name for name in _FILES if name not in (PROVENANCE, PART) and (self.path / name).is_file()]
        content = {
            **self.provenance,
            "complete": complete,
            "finished": len(self.finished),
            "files": {name: sha256_of(self.path / name) for name in files},
        }
        with write_atomically(self.path / PROVENANCE) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def check_free_for_results(path: Path, *, overwrite: bool) -> None:
    """Raise ConfigError unless `path` is free for results, or has some that may be replaced (`overwrite`)."""
    if path.suffix in (".csv", ".parquet"):
        raise ConfigError(f"out={path}: results are a folder of several files; write out={path.stem}")
    if not path.is_dir():
        return
    names = sorted(each.name for each in path.iterdir())
    known = (*_FILES, TRANSITIONS, LOCK_FILE)
    others = [name for name in names if name not in known and not _is_temporary(name)]
    if others:
        raise ConfigError(f"out={path} holds other files ({others[0]}); choose another folder")
    if overwrite or not any(name in _FILES for name in names) or _holds_settings_alone(path, names):
        return
    try:
        complete = bool(read_provenance(path).get("complete"))
    except ConfigError:
        complete = True
    going_on = "" if complete else f"go on with {typed_word('resume', path)}, "
    raise ConfigError(
        f"out={path} holds results already; choose another folder, {going_on}or replace them with "
        "overwrite=true"
    )


def _holds_settings_alone(path: Path, names: Collection[str]) -> bool:
    """Whether an evaluation was cut off in `path`, which has files of these `names`, before it began."""
    if any(name in (*_FILES, TRANSITIONS) for name in names if name != CONFIG):
        return False
    try:
        # Others have a file of that name, too, such as trainings.
        read_settings(path)
    except DuneError:
        return False
    return True


def _is_temporary(name: str) -> bool:
    """Whether a process that was killed left a file of this name."""
    return name.endswith(".tmp") and name.startswith(tuple(f".{each}." for each in _FILES))


def changed_files(path: Path, provenance: Mapping[str, Any]) -> list[str]:
    """The files in `path` that are not as the evaluation wrote them, by their checksums.

    Absent files that follow from the rows are left out: results may be kept without them.
    """
    changed = []
    for name, sha256 in provenance.get("files", {}).items():
        # A name with a folder is of no file that the evaluation wrote.
        try:
            same = Path(name).name == name and sha256_of(path / name) == sha256
        except OSError:
            same = name in _FOLLOWING and not (path / name).exists()
        changed += [] if same else [name]
    return changed


def read_provenance(path: Path) -> dict[str, Any]:
    """provenance.json of a results folder; raises ConfigError if there is none."""
    if not path.exists():
        raise ConfigError(f"there is no folder {path}")
    try:
        content = json.loads((path / PROVENANCE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or not _has_sources(content):
        raise ConfigError(
            f"{path} holds no results of an evaluation ({PROVENANCE} is missing or damaged); give a folder "
            "that python -m dune_rl.evaluate wrote"
        )
    return content


def _has_sources(content: Mapping[str, Any]) -> bool:
    policies, is_files = content.get("policies"), isinstance(content.get("files", {}), dict)
    return (
        isinstance(policies, list)
        and all(isinstance(one, dict) and isinstance(one.get("location"), str) for one in policies)
        and all("sha256" in one and isinstance(one["sha256"], str | None) for one in policies)
        and isinstance(content.get("forecasts"), dict | None)
        and isinstance(content.get("set"), dict | None)
        and is_files
    )


def read_settings(path: Path) -> EvaluateConf:
    """The settings of a results folder; raises ConfigError if they cannot be read."""
    try:
        content = parse_yaml((path / CONFIG).read_bytes())
    except (OSError, ValueError):
        content = None
    if not isinstance(content, Mapping):
        raise ConfigError(f"{path / CONFIG} is missing or damaged; evaluate again")
    return validate(EvaluateConf, content)
