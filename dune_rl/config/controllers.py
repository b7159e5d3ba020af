"""Controllers of agent groups, as they are configured: a behaviour, or a trained policy from a file."""

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dune_rl.behaviours.registry import BEHAVIOURS, BehaviourSettings
from dune_rl.config.agents import Controller as ControllerConf
from dune_rl.config.agents import FrozenPolicyConf
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.env.agent_group import AgentGroup, MakeController
from dune_rl.env.controllers import BehaviourController, Controller, PolicyController
from dune_rl.env.driver_context import bind_to_group
from dune_rl.errors import CheckpointError
from dune_rl.sensors.sensor import Reading


def controller_factory(conf: ControllerConf) -> MakeController | None:
    """Factory of a group's controller; None for external groups and groups that walk paths."""
    if isinstance(conf, BehaviourSettings):
        return partial(_behaviour, conf)
    if isinstance(conf, FrozenPolicyConf):
        return partial(_frozen_policy, conf)
    return None


def check_policies(conf: EnvConf) -> None:
    """Raise CheckpointError, which names every setting at fault, unless all groups that play a trained policy
    have one to play.

    Whether it fits what the group observes and does is known once an environment is made.
    """
    played = {
        f"controller.checkpoint of the group {group.name}": (group.name, group.controller.checkpoint)
        for group in conf.groups
        if isinstance(group.controller, FrozenPolicyConf)
    }
    if isinstance(conf, Conf):
        for group in conf.external_groups:
            frozen = conf.learning.frozen(group.name)
            if frozen is not None:
                played[f"learning.groups.{group.name}.frozen"] = (group.name, frozen)
    if not played:
        return
    from dune_rl.learning.saved_policies import check_has_policy

    faults = []
    for setting, (name, location) in played.items():
        try:
            check_has_policy(Path(location), name)
        except CheckpointError as error:
            faults.append(f"{setting}: {error}")
    if faults:
        raise CheckpointError("\n".join(faults))


def _behaviour(conf: BehaviourSettings, group: AgentGroup) -> Controller:
    behaviour = BEHAVIOURS.build(conf, group.num_rows)
    bind_to_group(behaviour, conf.name, group)
    return BehaviourController(behaviour)


def _frozen_policy(conf: FrozenPolicyConf, group: AgentGroup) -> Controller:
    """Raises `CheckpointError`, which names the group's setting, where the file has no policy for what the
    group observes and does.
    """
    # Only now: most groups need no PyTorch.
    import torch
    from tensordict import TensorDict

    from dune_rl.learning.group_policy import Deterministic
    from dune_rl.learning.policy_spec import PolicySpec
    from dune_rl.learning.saved_policies import load_group_policy

    spec = PolicySpec.of_bounds(group.observation_bounds, group.action_bounds)
    try:
        found, _ = load_group_policy(Path(conf.checkpoint), group.name, spec, allow_more=True)
    except CheckpointError as error:
        raise CheckpointError(
            f"the controller of the group {group.name} (controller.checkpoint): {error}\n"
            f"A policy of another group does not fit: give {group.name} the body and sensors of the one "
            "that was trained, or take another checkpoint."
        ) from None
    policy = Deterministic(found)

    def act(readings: dict[str, Reading]) -> NDArray[np.float64]:
        rows = group.num_rows
        observation = {
            key: torch.from_numpy(reading).reshape(-1, group.count, *reading.shape[1:])
            for key, reading in readings.items()
        }
        size = (rows // group.count, group.count)
        inputs = TensorDict({group.name: {"observation": observation}}, batch_size=size[:1])
        inputs[group.name].batch_size = size
        inputs[group.name, "observation"].batch_size = size
        action: torch.Tensor = policy(inputs)[group.name, "action"]
        return action.reshape(rows, -1).numpy().astype(np.float64)

    return PolicyController(act)
