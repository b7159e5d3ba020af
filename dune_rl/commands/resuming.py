"""The run that a training goes on with: the one that `resume=FOLDER` names, or its own, `resume=auto`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dune_rl.config.compose import compose, override_value
from dune_rl.config.schema import Conf
from dune_rl.core.errors import CheckpointError, ConfigError, DuneError
from dune_rl.core.folder_lock import LOCK_FILE, FolderLock
from dune_rl.core.suggestions import typed_word
from dune_rl.core.untrusted_files import parse_yaml
from dune_rl.learning.checkpoint import (
    CHECKPOINT_FILE,
    CONFIG_FILE,
    LAST_POLICY_FILE,
    find_checkpoint_file,
    interpreting,
    read_checkpoint_file,
)
from dune_rl.learning.run.locks import remove_leftovers

# In place of a folder: the run's own, which `run_dir` names or the sweep gives it.
AUTO = "auto"
# What a command with `resume=auto` may set otherwise than the run did that it goes on with.
_MAY_DIFFER = ("run_dir", "resume", "total_frames")
_DIFFERENCES_SHOWN = 3


@dataclass(frozen=True)
class SavedRun:
    """A run with a checkpoint, and the settings `conf` with which it goes on.

    `objective` is the mean of that metric in the last evaluation; None before the first one, and in
    checkpoints that do not hold the rows of evaluations yet.
    """

    conf: Conf
    checkpoint: Path
    frames: int
    is_finished: bool
    objective: float | None


def check_own_folder(overrides: Sequence[str], *, is_sweep: bool) -> None:
    """Raise ConfigError unless the command with `resume=auto` names a folder, the same at each start."""
    setting = "hydra.sweep.dir" if is_sweep else "run_dir"
    if override_value(overrides, setting) is None:
        raise ConfigError(
            f"resume={AUTO} looks for the run in its folder, which has a new name at each start: add "
            f"{setting}=FOLDER"
        )


def find_own_run(conf: Conf, folders: Sequence[str], lock: FolderLock) -> SavedRun | None:
    """The run with the settings `conf` in its `run_dir`, of which the caller holds the `lock`.

    None where it has to begin: what a run that was cut off before its first save left there is removed.
    Raises CheckpointError if the folder holds a run of other settings.
    """
    folder = Path(conf.run_dir)
    checkpoint, config = folder / CHECKPOINT_FILE, folder / CONFIG_FILE
    if checkpoint.is_file():
        content = read_checkpoint_file(checkpoint, "checkpoint")
        before = compose(Conf, (), folders, content["config"])
        _require_equal(before, conf, folder)
        changes = {name: getattr(conf, name) for name in _MAY_DIFFER}
        return _saved_run(before.model_copy(update=changes), checkpoint, content, lock.was_left)
    # Each save writes the latest policies, too: where they are, somebody has removed the checkpoint.
    if config.is_file() and not (folder / LAST_POLICY_FILE).exists():
        with interpreting(config):
            saved = parse_yaml(config.read_bytes())
        try:
            before = compose(Conf, (), folders, saved)
        except DuneError as error:
            raise CheckpointError(
                f"{config} has no settings of a run: {error}\nChoose another run_dir, or move the file away."
            ) from None
        _require_equal(before, conf, folder)
        remove_leftovers(folder)
    return None


def find_named_run(source: str, overrides: Sequence[str], folders: Sequence[str]) -> SavedRun:
    """The run in the folder, or of the checkpoint, `source`, with the settings that the overrides change.

    Raises CheckpointError where there is none, ConfigError for a run that is finished, and for changes that
    its weights do not allow.
    """
    if not Path(source).exists():
        raise CheckpointError(
            f"There is no folder {source}; resume={AUTO} goes on with the run that the same command began"
        )
    checkpoint = find_checkpoint_file(Path(source), CHECKPOINT_FILE)
    content = read_checkpoint_file(checkpoint, "checkpoint")
    saved = dict(content["config"])
    if override_value(overrides, "run_dir") is None:
        saved["run_dir"] = str(checkpoint.parent)
    conf, before = compose(Conf, overrides, folders, saved), compose(Conf, (), folders, saved)
    was_cut_off = (checkpoint.parent / LOCK_FILE).exists()
    run = _saved_run(conf, checkpoint, content, was_cut_off)
    if run.is_finished:
        raise ConfigError(
            f"{source} is a finished run of {run.frames:,} frames, and total_frames is "
            f"{conf.total_frames:,}: to train on, set more of them, such as total_frames={2 * run.frames}"
        )
    if conf.physics.action_repeat != before.physics.action_repeat:
        raise ConfigError(
            f"physics.action_repeat={conf.physics.action_repeat}: the run learned with "
            f"{before.physics.action_repeat}; leave it out, or leave out resume and begin a new run"
        )
    for group in conf.external_groups:
        setting, start = conf.learning.start_of(group.name)
        if start != before.learning.start_of(group.name)[1]:
            raise ConfigError(
                f"{setting}={start}: a resumed run goes on with its own weights; leave it out, or leave out "
                "resume and begin a new run"
            )
    return run


def _saved_run(conf: Conf, checkpoint: Path, content: Mapping[str, Any], was_cut_off: bool) -> SavedRun:
    # Imported here: processes that collect import this module, too.
    from dune_rl.statistics.measures import mean_of_known

    with interpreting(checkpoint):
        counters = content["counters"]
        frames = counters["frames"]
        is_at_end = frames >= conf.total_frames and counters["evaluated_at"] == frames
        # A run that was cut off amid its last save has written the checkpoint, perhaps no more.
        is_finished = is_at_end and not was_cut_off
        rows = counters.get("rows", {}).get(conf.driven_group.name)
        objective = mean_of_known(row[conf.objective] for row in rows) if rows else None
    return SavedRun(conf, checkpoint, frames, is_finished, objective)


def _require_equal(before: Conf, conf: Conf, folder: Path) -> None:
    """Raise CheckpointError unless `conf` has the settings of the run in `folder`."""
    run, here = before.model_dump(mode="json"), conf.model_dump(mode="json")
    resolved = conf.learning.resolved(conf.device).model_dump(mode="json")
    # Where a setting leaves a choice to the machine, the run stays with the choice that it made.
    left_open = {path for path, *_ in _differences(here, {**here, "learning": resolved})}
    found = [
        f"{path}={_short(value)} (the run has {_short(of_run)})"
        for path, of_run, value in _differences(run, here)
        if path not in left_open and path not in _MAY_DIFFER
    ]
    if not found:
        return
    more = f" and {len(found) - _DIFFERENCES_SHOWN} more" if len(found) > _DIFFERENCES_SHOWN else ""
    go_on = ""
    if (folder / CHECKPOINT_FILE).is_file():
        go_on = f"; {typed_word('resume', folder)} goes on with changed ones"
    raise CheckpointError(
        f"{folder} holds a run of other settings: {', '.join(found[:_DIFFERENCES_SHOWN])}{more}\n"
        f"Give the settings that it began with, or another folder{go_on}."
    )


def _differences(before: Any, after: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Path, earlier value and value of each setting that differs in two nested mappings."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in {**before, **after}:
            inner = f"{path}.{key}" if path else str(key)
            yield from _differences(before.get(key), after.get(key), inner)
    elif before != after:
        yield path, before, after


def _short(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{...}"
    return yaml.safe_dump(value, default_flow_style=True, width=1_000).removesuffix("...\n").strip()
