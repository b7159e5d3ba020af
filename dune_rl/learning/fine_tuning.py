"""Fine-tuning (a warm start): a training that begins with the weights of an earlier run."""

import warnings
from collections.abc import Collection, Mapping
from pathlib import Path

from dune_rl.core.errors import CheckpointError, DuneWarning
from dune_rl.core.suggestions import one_of
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.checkpoint import (
    CHECKPOINT_FILE,
    POLICY_SOURCES,
    find_checkpoint_file,
    read_checkpoint_file,
)
from dune_rl.learning.policy_spec import GroupMismatchError, PolicyMismatchError
from dune_rl.learning.run.folder import require_same_networks
from dune_rl.learning.saved_policies import saved_entry
from dune_rl.learning.settings import LearningConf


def start_learners(learners: Mapping[str, Algorithm], conf: LearningConf) -> None:
    """Load the weights that `start_from` names into each learner that has it set in `conf`.

    Of a run's folder the last checkpoint is read, or where it has none, its policy, of which a warning
    tells that the critics are new. Raises CheckpointError, which names the setting, where the file cannot be
    read, has nothing for the group, or networks of another shape; GroupMismatchError where its policy is for
    other observations or actions.
    """
    for group, learner in learners.items():
        setting, location = conf.start_of(group)
        if location is None:
            continue
        try:
            source = find_checkpoint_file(Path(location), CHECKPOINT_FILE, *POLICY_SOURCES)
            content = read_checkpoint_file(source, "policy", "checkpoint")
            if fault := describe_missing_start(content["groups"], source, group, conf, learners):
                raise CheckpointError(fault)
            entry = saved_entry(content["groups"], source, group)
            require_same_networks(learner, entry, source, "Set {}, or start from another run.", conf, group)
        except PolicyMismatchError as error:
            raise GroupMismatchError(f"{setting}: {error}", group, location) from None
        except CheckpointError as error:
            raise CheckpointError(f"{setting}: {error}") from None
        if "learner" not in entry:
            note = f"{setting}: {source} has a policy alone; its critics, which teach it, begin anew"
            warnings.warn(note, DuneWarning, stacklevel=2)
        learner.start_from(entry.get("learner", entry))


def describe_missing_start(
    trained: Collection[str], source: Path | str, group: str, conf: LearningConf, groups: Collection[str]
) -> str:
    """Why `group` cannot start from `source`, which has policies of the groups `trained`; empty if it can.

    `groups` are all that act by a policy. The only policy of a file is that of the only group that learns,
    or of a group whose own setting names it.
    """
    setting, _ = conf.start_of(group)
    own = f"learning.groups.{group}.start_from"
    learning = [name for name in groups if conf.frozen(name) is None]
    if group in trained or (len(trained) == 1 and (setting == own or len(learning) == 1)):
        return ""
    names = ", ".join(sorted(trained))
    if len(learning) == 1:
        return (
            f"{source} has no policy for the group {group}, but for {names}.\n"
            f"Call the group {one_of(trained)}, after the one whose policy it starts with, or start from "
            "another run."
        )
    return (
        f"{source} has no policy for the group {group}, but for {names}.\n"
        f"Begin with random weights by {own}=null, or with another run by {own}=RUN."
    )
