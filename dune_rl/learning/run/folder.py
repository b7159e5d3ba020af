"""The folder of a training run: its checkpoint, and the files of policies and experience."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dune_rl.core.errors import CheckpointError
from dune_rl.core.files import write_atomically
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.checkpoint import (
    BEST_POLICY_FILE,
    CHECKPOINT_FILE,
    LAST_POLICY_FILE,
    write_checkpoint_file,
)
from dune_rl.learning.run.locks import RunLock, check_unused
from dune_rl.learning.saved_policies import BEST_EVALUATION, LATEST, policy_entry

_EXPERIENCE = "replay"


class RunFolder:
    """Writes what a run keeps in `path`; `config` is the resolved configuration, stored beside the weights.

    Raises CheckpointError if the folder cannot be written, if another run is writing there, or with `fresh`
    if it already holds a run.
    """

    def __init__(self, path: Path, config: Mapping[str, Any], *, fresh: bool) -> None:
        self.path = path
        self.config = dict(config)
        if fresh:
            check_unused(path)
        try:
            path.mkdir(parents=True, exist_ok=True)
            with write_atomically(path / ".writable"):
                pass
            (path / ".writable").unlink()
        except OSError as error:
            raise CheckpointError(
                f"The folder {path} cannot be written: {error.strerror or error}.\n"
                "Name another folder for the run."
            ) from error
        self._lock = RunLock(path)

    def release(self) -> None:
        self._lock.release()

    def save_policies(
        self, learners: Mapping[str, Algorithm], frames: int, score: Mapping[str, Any] | None = None
    ) -> None:
        """Write the policies of all groups as the latest or, with the `score` of an evaluation, as the best.

        The file says which it is, under "selection".
        """
        groups = {group: policy_entry(learner) for group, learner in learners.items()}
        selection = {"by": LATEST} if score is None else {"by": BEST_EVALUATION, **score}
        content = {"groups": groups, "config": self.config, "frames": frames, "selection": selection}
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
        content = {"groups": groups, "config": self.config, **progress}
        write_checkpoint_file(self.path / CHECKPOINT_FILE, "checkpoint", content)
        self.save_policies(learners, frames)
        named = {name for entry in groups.values() for name in _files(entry["experience"] or {})}
        for file in self.path.glob(f"{_EXPERIENCE}-*.*"):
            if file.name not in named:
                file.unlink()


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
