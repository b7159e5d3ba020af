"""Starting a training from what an earlier run learned."""

from collections.abc import Mapping
from pathlib import Path

from dune_rl.errors import CheckpointError
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.checkpoint import (
    CHECKPOINT_FILE,
    POLICY_SOURCES,
    find_checkpoint_file,
    read_checkpoint_file,
)
from dune_rl.learning.run.folder import require_same_networks
from dune_rl.learning.saved_policies import saved_entry
from dune_rl.learning.settings import LearningConf


def start_learners(learners: Mapping[str, Algorithm], conf: LearningConf) -> None:
    """Give the learners of `conf` that are to `start_from` an earlier run its weights.

    Of a run's folder that is its last checkpoint. Raises CheckpointError, which names the setting, where the
    file cannot be read, has nothing for the group, or networks or observations of another shape.
    """
    for group, learner in learners.items():
        setting, location = conf.start_of(group)
        if location is None:
            continue
        try:
            source = find_checkpoint_file(Path(location), CHECKPOINT_FILE, *POLICY_SOURCES)
            content = read_checkpoint_file(source, "policy", "checkpoint")
            entry = saved_entry(content["groups"], source, group)
            require_same_networks(
                learner,
                entry,
                source,
                "Set {}, or start from another run.",
                setting.removesuffix(".start_from"),
            )
        except CheckpointError as error:
            raise CheckpointError(f"{setting}: {error}") from None
        learner.start_from(entry.get("learner", entry))
