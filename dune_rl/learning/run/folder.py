"""The folder of a training run: its checkpoint, and the files of policies and experience."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from dune_rl.core.files import write_atomically
from dune_rl.core.folder_lock import FolderLock
from dune_rl.core.suggestions import typed_word
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.checkpoint import (
    BEST_POLICY_FILE,
    CHECKPOINT_FILE,
    CONFIG_FILE,
    LAST_POLICY_FILE,
    write_checkpoint_file,
)
from dune_rl.learning.run.locks import check_unused, lock_run
from dune_rl.learning.run.log import CURVE_FILE, METRICS_FILE
from dune_rl.learning.saved_policies import BEST_EVALUATION, LATEST, policy_entry

_EXPERIENCE = "replay"
# Names of the files that a run writes beside their place, and then renames.
_WRITTEN = (
    CONFIG_FILE,
    CHECKPOINT_FILE,
    LAST_POLICY_FILE,
    BEST_POLICY_FILE,
    METRICS_FILE,
    CURVE_FILE,
    f"{_EXPERIENCE}-*",
)


class RunFolder:
    """Writes what a run keeps in `path`; `config` is the resolved configuration, stored beside the weights.

    So is `started_from`: by group, the file of the weights with which a run began, and its SHA-256. The
    caller may hold the folder's `lock`, and then ends it. Raises CheckpointError if the folder cannot be
    written, if another run is writing there, or with `fresh` if it already holds a run.
    """

    def __init__(
        self, path: Path, config: Mapping[str, Any], *, fresh: bool, lock: FolderLock | None = None
    ) -> None:
        self.path = path
        self.config = dict(config)
        self.started_from: Mapping[str, Mapping[str, str]] = {}
        self._lock = lock or lock_run(path)
        self._own_lock = lock is None
        if fresh:
            check_unused(path)
        # Of a run that was killed amid a save, perhaps as large as its replay buffer.
        for name in _WRITTEN if self._lock.is_held else ():
            for file in path.glob(f".{name}.*.tmp"):
                file.unlink(missing_ok=True)

    def save_config(self) -> None:
        """Write the configuration, before any other file: by it `resume=auto` knows whose the others are.

        From now on the lock's file marks a run that was cut off, unless `release` says that all is whole.
        """
        self._lock.keep_file()
        with write_atomically(self.path / CONFIG_FILE) as temporary:
            temporary.write_text(yaml.safe_dump(self.config, sort_keys=False))

    def release(self, *, is_whole: bool = True) -> None:
        """Let others have the folder, unless the caller holds the lock; a second call does nothing."""
        if self._own_lock and is_whole:
            self._lock.finish()
        elif self._own_lock:
            self._lock.release()

    def describe_last_save(self) -> str:
        """What a run that ends without another save can be gone on from."""
        if (self.path / CHECKPOINT_FILE).exists():
            return f"The last save is whole; go on from it with {typed_word('resume', self.path)}"
        return "Nothing was saved to go on from; begin again, with another run_dir"

    def save_policies(
        self, learners: Mapping[str, Algorithm], frames: int, score: Mapping[str, Any] | None = None
    ) -> None:
        """Write the policies of all groups as the latest or, with the `score` of an evaluation, as the best.

        The file says which it is, under "selection".
        """
        groups = {group: policy_entry(learner) for group, learner in learners.items()}
        selection = {"by": LATEST} if score is None else {"by": BEST_EVALUATION, **score}
        content = {**self._common(groups), "frames": frames, "selection": selection}
        name = LAST_POLICY_FILE if score is None else BEST_POLICY_FILE
        write_checkpoint_file(self.path / name, "policy", content)

    def save(
        self,
        learners: Mapping[str, Algorithm],
        frames: int,
        progress: Mapping[str, Any],
        *,
        with_experience: bool,
    ) -> None:
        """Write the checkpoint, with `progress` for whatever is no learner's, and the latest policies.

        The checkpoint names the files beside it, so that no crash can mix two saves.
        """
        groups = {}
        for group, learner in learners.items():
            path = self.path / f"{_EXPERIENCE}-{group}-{frames}"
            entry = policy_entry(learner)
            del entry["policy"]
            experience = learner.save_experience(path) if with_experience else None
            groups[group] = {**entry, "learner": learner.state_dict(), "experience": experience}
        content = {**self._common(groups), **progress}
        write_checkpoint_file(self.path / CHECKPOINT_FILE, "checkpoint", content)
        self.save_policies(learners, frames)
        named = {name for entry in groups.values() for name in _files(entry["experience"] or {})}
        for file in self.path.glob(f"{_EXPERIENCE}-*.*"):
            if file.name not in named:
                file.unlink()

    def _common(self, groups: Mapping[str, Any]) -> dict[str, Any]:
        origins = {group: dict(origin) for group, origin in self.started_from.items()}
        return {"groups": groups, "config": self.config, "started_from": origins}


def _files(experience: Mapping[str, Any]) -> Iterator[str]:
    """The names of the files of saved experience, which may have several parts."""
    for key, value in experience.items():
        if key == "file":
            yield value
        elif isinstance(value, Mapping):
            yield from _files(value)


try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]
