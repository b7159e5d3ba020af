"""Behaviours as policies of a TorchRL environment."""

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.core.errors import ConfigError
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.driver_context import bind_to_group
from dune_rl.env.simulation import VectorSimulation


class DriverPolicy:
    """Lets the behaviour `name` drive the agents of `group`, by the state of the environment's simulation.

    It forgets an agent's past where its episode begins. Raises ConfigError where the behaviour cannot drive.
    """

    def __init__(self, name: str, simulation: VectorSimulation, group: AgentGroup, seed: int = 0) -> None:
        settings = {"name": name, "seed": seed} if name == "mppi" else {"name": name}
        self._behaviour = BEHAVIOURS.build(BEHAVIOURS.parse_settings(settings), group.num_rows)
        self._simulation, self._group = simulation, group
        bind_to_group(self._behaviour, name, group)

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes the action of every agent of the group."""
        group = self._group
        state = self._simulation.state
        now = state.groups[group.name]
        begins = now.episode.steps == 0
        if begins.any():
            self._behaviour.reset(begins, now)
        low, high = group.action_bounds
        actions = self._behaviour.act(state, now).astype(low.dtype).clip(low, high)
        shape = (self._simulation.num_scenes, group.count, group.action_size)
        return observation.set((group.name, "action"), torch.from_numpy(actions.reshape(shape)))


def driver_policies(name: str, env: EnvBase, seed: int) -> list[DriverPolicy]:
    """The behaviour `name` for every group of `env`, which must run in this process."""
    simulation = getattr(env, "simulation", None)
    if not isinstance(simulation, VectorSimulation):
        raise ConfigError(
            f"{name} needs the simulation in its own process: take an environment without workers"
        )
    return [DriverPolicy(name, simulation, group, seed) for group in simulation.external]
