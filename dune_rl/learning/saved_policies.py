"""Trained policies in files, and acting by them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from dune_rl.core.errors import CheckpointError
from dune_rl.learning.algorithm import Algorithm
from dune_rl.learning.checkpoint import interpreting, read_policy_file
from dune_rl.learning.group_policy import Deterministic, GroupPolicy, JointPolicy
from dune_rl.learning.networks.policy import load_weights
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.registry import algorithm_class

# Values of "by" under "selection" in a policy's file.
BEST_EVALUATION, LATEST = "best evaluation", "latest"


def describe_selection(content: Mapping[str, Any]) -> str:
    """Which policy of its run a file holds, in words; `content` is a policy's or a checkpoint's."""
    frames = content["frames"] if "frames" in content else content["counters"]["frames"]
    selection = content.get("selection")
    if selection is None:
        chosen = "a policy (how it was chosen is not recorded)" if content["kind"] == "policy" else LATEST
    elif selection["by"] == BEST_EVALUATION:
        score = f"{selection['measure']} {selection['score']:.3g} of {selection['episodes']} episodes"
        chosen = f"{BEST_EVALUATION} of its run ({score}, seed {selection['seed']})"
    else:
        chosen = f"{selection['by']} of its run"
    return f"{chosen}, after {frames:,} frames"


def policy_entry(learner: Algorithm) -> dict[str, Any]:
    """What a file keeps of a group's policy: the algorithm's name, its spec, its network and the weights."""
    weights = learner.policy.network.state_dict()
    return {
        "algorithm": learner.context.algorithm,
        "spec": learner.context.spec.plain(),
        "network": learner.network_settings(),
        "policy": {key: value.detach().cpu().clone() for key, value in weights.items()},
    }


@dataclass(frozen=True)
class SavedPolicy:
    """One policy of `file`: algorithm's name, spec, network's settings, weights, and its run's settings."""

    file: Path
    algorithm: str
    spec: PolicySpec
    network: Mapping[str, Any]
    weights: Mapping[str, torch.Tensor]
    config: dict[str, Any]

    def make_network(self, device: torch.device | str = "cpu") -> TensorDictModuleBase:
        with interpreting(self.file):
            network: TensorDictModuleBase = algorithm_class(self.algorithm, "the policy").make_network(
                self.spec, self.network, device
            )
            load_weights(network, self.weights)
        return network


def read_saved_policy(path: Path, group: str, here: PolicySpec, *, allow_more: bool) -> SavedPolicy:
    """The policy of a file or run folder for `group`, on the CPU.

    A folder gives its best policy, or its published one; a file with one policy alone serves a group of any
    name. Raises CheckpointError if the file is unreadable, has no policy for the group, or one for another
    spec than `here`, which with `allow_more` may have further parts in its observation.
    """
    return _saved_policy(*read_policy_file(path), group, here, allow_more=allow_more)


def saved_policy_in(file: Path, content: Mapping[str, Any], group: str) -> SavedPolicy:
    """The policy of `group` in the `content` of `file`; raises CheckpointError where there is none."""
    entry = saved_entry(content["groups"], file, group)
    with interpreting(file):
        spec = PolicySpec.from_plain(entry["spec"])
        algorithm_class(entry["algorithm"], str(file))
        # A checkpoint has the weights among the learner's state.
        weights = entry["policy"] if "policy" in entry else entry["learner"]["policy"]
    return SavedPolicy(file, entry["algorithm"], spec, entry["network"], weights, content["config"])


def _saved_policy(
    file: Path, content: Mapping[str, Any], group: str, here: PolicySpec, *, allow_more: bool
) -> SavedPolicy:
    saved = saved_policy_in(file, content, group)
    with interpreting(file):
        saved.spec.require(here.only(saved.spec.keys) if allow_more else here, str(file))
    return saved


def load_group_policy(
    path: Path, group: str, here: PolicySpec, *, trained_as: str | None = None, allow_more: bool = False
) -> tuple[GroupPolicy, dict[str, Any]]:
    """The policy that acts for `group`, and the resolved settings that made it; see `read_saved_policy`.

    It is the policy of the group `trained_as`, by default of the same name.
    """
    saved = read_saved_policy(path, trained_as or group, here, allow_more=allow_more)
    return GroupPolicy(group, saved.spec, saved.make_network()), saved.config


def load_policy(
    path: Path, env: EnvBase, *, allow_more: bool = False
) -> tuple[Deterministic, dict[str, Any]]:
    """The policies of a file or run folder for all groups of `env`: see `load_group_policy`."""
    specs = {group: PolicySpec.of(env, group) for group in env.group_map}
    file, content = read_policy_file(path)
    saved = {
        group: _saved_policy(file, content, group, spec, allow_more=allow_more)
        for group, spec in specs.items()
    }
    policies = [GroupPolicy(group, one.spec, one.make_network()) for group, one in saved.items()]
    for policy in policies:
        policy.watch(env)
    return Deterministic(JointPolicy(policies)), content["config"]


def read_policy_groups(path: Path) -> tuple[list[str], dict[str, Any]]:
    """The groups whose policies a file or run folder has, sorted, and its settings.

    Raises CheckpointError if it cannot be read.
    """
    _, content = read_policy_file(path)
    return sorted(content["groups"]), content["config"]


def saved_entry(groups: Mapping[str, Any], file: Path, group: str) -> Mapping[str, Any]:
    """The entry for `group` among the `groups` of a file; raises CheckpointError where there is none.

    One group alone serves a group of any name.
    """
    if not groups:
        raise CheckpointError(f"{file} has no policies.\nGive another file of the run's folder.")
    if group not in groups and len(groups) > 1:
        raise CheckpointError(
            f"{file} has no policy for the group {group}, but for {', '.join(sorted(groups))}.\n"
            "Use the agents that it was trained with (its run's folder holds its settings), or train again."
        )
    entry: Mapping[str, Any] = groups[group] if group in groups else next(iter(groups.values()))
    return entry
