"""Controllers of agent groups, as they are configured: a behaviour, or a trained policy from a file."""

from functools import partial
from pathlib import Path

import numpy as np

from dune_rl.behaviours.destinations import DestinedBehaviour
from dune_rl.behaviours.registry import BEHAVIOURS, BehaviourSettings
from dune_rl.config.controller_settings import Controller as ControllerConf
from dune_rl.config.controller_settings import FrozenPolicyConf
from dune_rl.config.group_files import describe_owner
from dune_rl.core.errors import CheckpointError
from dune_rl.env.agent_group import AgentGroup, MakeController
from dune_rl.env.controllers import BehaviourController, Controller, PolicyController
from dune_rl.geometry.arrays import Array
from dune_rl.sensors.sensor import Reading


def controller_factory(conf: ControllerConf) -> MakeController | None:
    """Factory of a group's controller; None for external groups and groups that walk paths."""
    if isinstance(conf, BehaviourSettings):
        return partial(_behaviour, conf)
    if isinstance(conf, FrozenPolicyConf):
        return partial(_frozen_policy, conf)
    return None


def places_of(conf: ControllerConf) -> tuple[tuple[float, float], ...]:
    """The places [m] to which a controller is told to go; none for most."""
    part = BEHAVIOURS.find(conf.name) if isinstance(conf, BehaviourSettings) else None
    goes = part is not None and isinstance(part.target, type) and issubclass(part.target, DestinedBehaviour)
    return getattr(conf, "places", ()) if goes else ()


def _behaviour(conf: BehaviourSettings, group: AgentGroup) -> Controller:
    behaviour = BEHAVIOURS.build(conf, group.num_rows)
    group.bind(behaviour, conf.name)
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
        found, _ = load_group_policy(
            Path(conf.checkpoint), group.name, spec, trained_as=conf.group, allow_more=True
        )
    except CheckpointError as error:
        setting = f"{group.setup.settings}.controller.checkpoint"
        what_to_do = describe_owner(conf.checkpoint, conf.group or group.name, group.setup.settings)
        # In place of what to do where the robot itself is to be driven by it.
        lines = [str(error).splitlines()[0], what_to_do] if what_to_do else [str(error)]
        raise CheckpointError("\n".join([f"{setting}: {lines[0]}", *lines[1:]])) from None
    policy = Deterministic(found)

    def act(readings: dict[str, Reading]) -> Array:
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
