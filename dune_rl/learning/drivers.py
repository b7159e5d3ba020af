"""Scripted drivers, which read the simulation's state, as policies of agent groups."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.core.errors import ConfigError
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.state.state import GroupState

DRIVERS = ("dwa", "dwa_oracle", "mppi", "oracle", "planner")


class BoundDriver:
    """The behaviour `name` for the agents of `group`, called once for each action of theirs.

    It forgets an agent's past where its episode begins. Raises ConfigError where the behaviour cannot drive.
    """

    def __init__(self, name: str, simulation: VectorSimulation, group: AgentGroup, seed: int = 0) -> None:
        settings = {"name": name, "seed": seed} if name == "mppi" else {"name": name}
        self.behaviour: Any = BEHAVIOURS.build(BEHAVIOURS.parse_settings(settings), group.num_rows)
        self._simulation, self._group = simulation, group
        self._is_new = True
        group.bind(self.behaviour, name)

    def _observe(self) -> GroupState:
        """The group's state, in which a step takes as long as an action is held."""
        now = self._simulation.state.groups[self._group.name]
        period_s = now.episode.step_s * self._simulation.physics.action_repeat
        begins = now.episode.steps == 0
        if self._is_new or begins.any():
            self.behaviour.reset(begins | self._is_new, now)
            self._is_new = False
        return replace(now, episode=replace(now.episode, step_s=period_s))

    def act(self) -> Array:
        """The driver's actions (N, A), within their bounds."""
        low, high = self._group.action_bounds
        actions = self.behaviour.act(self._simulation.state, self._observe())
        return np.asarray(actions.astype(low.dtype).clip(low, high))

    @property
    def has_costs(self) -> bool:
        """Whether the driver has costs of given actions; they are asked for in place of `act`."""
        return hasattr(self.behaviour, "action_costs")

    def costs(self, actions: Array, cap: float) -> Array:
        """Costs (N, C) of `actions` (C, A) above the best one's, at most `cap`; `record` must follow."""
        found: Array = self.behaviour.action_costs(self._simulation.state, self._observe(), actions, cap)
        return found

    def record(self, actions: Array) -> None:
        """Tell the driver the actions (N, A) that are executed, which may be another's."""
        record = getattr(self.behaviour, "record_actions", None)
        if record is not None:
            record(actions)


class DriverPolicy:
    """Lets a driver act for a group, by the state of the environment's simulation."""

    def __init__(self, name: str, simulation: VectorSimulation, group: AgentGroup, seed: int = 0) -> None:
        self._driver = BoundDriver(name, simulation, group, seed)
        self._key = (group.name, "action")
        self._shape = (simulation.num_scenes, group.count, group.action_size)

    def __call__(self, observation: TensorDictBase) -> TensorDictBase:
        return observation.set(self._key, torch.from_numpy(self._driver.act().reshape(self._shape)))


def simulation_of(name: str, env: EnvBase) -> VectorSimulation:
    """The simulation that the driver `name` reads; raises ConfigError where it is in another process."""
    simulation = getattr(env, "simulation", None)
    if not isinstance(simulation, VectorSimulation):
        raise ConfigError(
            f"{name} needs the simulation in its own process: take an environment without workers"
        )
    return simulation


def driver_policies(name: str, env: EnvBase, seed: int) -> list[DriverPolicy]:
    """The driver `name` for every group of `env`, which must run in this process."""
    simulation = simulation_of(name, env)
    return [DriverPolicy(name, simulation, group, seed) for group in simulation.external]
