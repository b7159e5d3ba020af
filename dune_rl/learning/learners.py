"""The learners of a run: new, from an earlier run's weights, from a checkpoint, or frozen policies."""

import warnings
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.core.errors import CheckpointError, ConfigError, DuneWarning
from dune_rl.core.files import sha256_of
from dune_rl.core.suggestions import one_of
from dune_rl.learning.algorithm import Algorithm, LearnerContext
from dune_rl.learning.checkpoint import BEST_POLICY_FILE, CHECKPOINT_FILE, interpreting, read_policy_file
from dune_rl.learning.group_policy import Deterministic, GroupPolicy
from dune_rl.learning.policy_spec import GroupMismatchError, PolicyMismatchError, PolicySpec
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.learning.saved_policies import read_saved_policy, saved_entry
from dune_rl.learning.settings import LearningConf


def build_learner(conf: LearningConf, context: LearnerContext) -> Algorithm:
    """The learner of one group by the algorithm that `conf` is of; raises ConfigError for what is none."""
    learner = ALGORITHMS.build(conf, context)
    if not isinstance(learner, Algorithm):
        raise ConfigError(
            f"the algorithm {conf.name!r} must be a class derived from Algorithm, and is {learner!r:.80}"
        )
    return learner


def build_learners(
    conf: LearningConf, env: EnvBase, total_frames: int, folder: Path, device: torch.device
) -> dict[str, Algorithm]:
    """The learner of each group of agents of `env`, which writes to `folder`; or its frozen policy."""
    learners: dict[str, Algorithm] = {}
    for group, agents in env.group_map.items():
        context = LearnerContext(
            group=group,
            num_agents=len(agents),
            spec=PolicySpec.of(env, group),
            total_frames=total_frames,
            folder=folder,
            device=device,
            algorithm=conf.name,
            critic_spec=PolicySpec.of(env, group, privileged=True),
        )
        frozen = conf.frozen(group)
        if frozen is None:
            learners[group] = build_learner(conf.of_group(group), context)
            learners[group].check_environment(env)
        else:
            learners[group] = FrozenPolicy(context, Path(frozen))
    return learners


class FrozenGroupPolicy(GroupPolicy):
    """A group's policy that acts without noise, also while data are collected."""

    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        return Deterministic(super().forward)(observation)


class FrozenPolicy(Algorithm):
    """The learner of a group that is not to learn: it acts by the policy for the group in `path`.

    Raises CheckpointError, which names the setting, for a file that has no policy for what the group observes
    and does.
    """

    learns = False

    def __init__(self, context: LearnerContext, path: Path) -> None:
        try:
            self._saved = read_saved_policy(path, context.group, context.spec, allow_more=True)
        except PolicyMismatchError as error:
            message = f"learning.groups.{context.group}.frozen: {error}"
            raise GroupMismatchError(message, context.group, str(path)) from None
        except CheckpointError as error:
            raise CheckpointError(f"learning.groups.{context.group}.frozen: {error}") from None
        super().__init__(replace(context, spec=self._saved.spec, algorithm=self._saved.algorithm))

    def make_policy(self, device: torch.device | str = "cpu") -> GroupPolicy:
        return FrozenGroupPolicy(self.context.group, self._saved.spec, self._saved.make_network(device))

    def network_settings(self) -> dict[str, Any]:
        return dict(self._saved.network)

    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Learns nothing."""

    def update(self) -> dict[str, float]:
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """The weights that the run began with, even if the file has others now."""
        super().load_state_dict(state)
        self._saved = replace(self._saved, weights=dict(state["policy"]))


def start_learners(learners: Mapping[str, Algorithm], conf: LearningConf) -> dict[str, dict[str, str]]:
    """Load the weights that `start_from` names into each learner that has it set in `conf`.

    Returns their files by group, each with its SHA-256: a path alone does not say which weights it had.

    Of a run's folder the last checkpoint is read, or where it has none, its policy; a warning tells where
    critics are new. Raises CheckpointError, which names the setting, where the file cannot be
    read, has nothing for the group, or other networks; GroupMismatchError where its policy is for
    other observations or actions.
    """
    origins = {}
    for group, learner in learners.items():
        setting, location = conf.start_of(group)
        if location is None:
            continue
        try:
            source, content = read_policy_file(Path(location), CHECKPOINT_FILE)
            if fault := describe_missing_start(content["groups"], source, group, conf, learners):
                raise CheckpointError(fault)
            entry = saved_entry(content["groups"], source, group)
            remedy, relatives = "Set {}, or start from another run.", learner.starts_from
            with interpreting(source):
                require_same_networks(learner, entry, source, remedy, conf, group, relatives)
        except PolicyMismatchError as error:
            raise GroupMismatchError(f"{setting}: {error}", group, location) from None
        except CheckpointError as error:
            raise CheckpointError(f"{setting}: {error}") from None
        if learner.has_new_critics(entry):
            note = f"{setting}: {source} has a policy alone; its critics, which teach it, begin anew"
            warnings.warn(note, DuneWarning, stacklevel=2)
        try:
            with interpreting(source):
                learner.start_from(entry.get("learner", entry))
        except CheckpointError as error:
            if not isinstance(error.__cause__, RuntimeError):
                raise
            # The policies' networks are the same, by the check above.
            raise CheckpointError(
                f"{setting}: {source} has critics of another shape.\n"
                "Use the privileged sensors and the algorithm's settings of its run, or start from its "
                f"{BEST_POLICY_FILE}, which has a policy alone."
            ) from None
        origins[group] = {"file": str(source), "sha256": sha256_of(source)}
    return origins


def describe_missing_start(
    trained: Collection[str], source: Path | str, group: str, conf: LearningConf, groups: Collection[str]
) -> str:
    """Why `group` cannot start from `source`, which has policies of the groups `trained`; empty if it can.

    `groups` are all groups that act by a policy. A file with one policy serves the only group that learns, or
    a group whose own setting names the file.
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


def restore_learners(
    learners: Mapping[str, Algorithm],
    saved: Mapping[str, Mapping[str, Any]],
    source: Path,
    conf: LearningConf,
) -> None:
    """Continue from the groups `saved` in the checkpoint `source`; raises CheckpointError if they differ."""
    if saved.keys() != learners.keys():
        raise CheckpointError(
            f"{source} trains {', '.join(sorted(saved))}, and the groups here are "
            f"{', '.join(sorted(learners))}.\n"
            "Resume with the agents that it was started with, or train again."
        )
    for group, learner in learners.items():
        entry = saved[group]
        with interpreting(source):
            require_same_networks(learner, entry, source, "Resume with {}, or train again.", conf, group)
            learner.load_state_dict(entry["learner"])
            if entry["experience"] is not None:
                learner.load_experience(source.parent, entry["experience"])


def require_same_networks(
    learner: Algorithm,
    entry: Mapping[str, Any],
    source: Path,
    remedy: str,
    conf: LearningConf,
    group: str,
    relatives: Collection[str] = (),
) -> None:
    """Raise CheckpointError unless `entry`, of the file `source`, has the networks of the learner of `group`.

    `remedy` says what to do, with {} for what to set, which depends on where `conf` has the group's settings.
    `relatives` are other algorithms whose policies will do.
    """
    context = learner.context
    if entry["algorithm"] not in (context.algorithm, *relatives):
        other = entry["algorithm"]
        raise CheckpointError(f"{source} was trained with {other}. {remedy.format(f'learning={other}')}")
    PolicySpec.from_plain(entry["spec"]).require(context.spec, str(source))
    # Published policies are older than `learning.networks` and `learning.prior`.
    older: dict[str, Any] = {"networks": {}, "prior": None, "prior_weight": 0.0}
    theirs, ours = {**older, **entry["network"]}, learner.network_settings()
    settings = f"learning.groups.{group}" if conf.groups.get(group) else "learning"
    different = list(_differences(settings, theirs, ours))
    if different:
        raise CheckpointError(f"{source} has other networks. {remedy.format(' '.join(different))}")


def _differences(name: str, theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> Iterator[str]:
    """What to set below `name` so that `ours` becomes `theirs`, in words without spaces, to be pasted."""
    for key, value in theirs.items():
        own = ours.get(key, value)
        if value and isinstance(value, Mapping) and isinstance(own, Mapping) and value.keys() == own.keys():
            yield from _differences(f"{name}.{key}", value, own)
        elif value != own:
            yield f"{name}.{key}={'null' if value is None else value}".replace(" ", "")
