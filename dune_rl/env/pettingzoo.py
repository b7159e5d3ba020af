"""The PettingZoo parallel environment of one scene's external agents."""

from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.arguments import agent_action
from dune_rl.env.pictures import Pictures
from dune_rl.env.simulation import SimulationStep, VectorSimulation
from dune_rl.errors import ConfigError
from dune_rl.sensors.sensor import Bounds, Reading

Observation = dict[str, Reading]
RenderMode = Literal["rgb_array"] | None


def _box(bounds: Bounds) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(bounds[0], bounds[1], dtype=bounds[0].dtype.type)


class ParallelDuneEnv(ParallelEnv):  # type: ignore[misc]
    """PettingZoo `ParallelEnv` of the agents GROUP_0, GROUP_1, ... of every external group.

    Agents of a group have equal spaces. All agents act at every step until the episode ends, when all agents
    of the groups with terminations are done. An agent that is done before the others stays in the scene and
    in `agents`: its actions have no effect and its rewards are 0. All agents are terminated or truncated in
    the episode's last step: those that were done as they were then, the others are truncated. Observations
    are dicts of boxes. `infos` hold each agent's metrics so far, under the same keys at every step; a value
    that is not defined yet is -1.

    Raises ValueError if the simulation has several scenes, and ConfigError if no group is external.
    """

    metadata = {  # noqa: RUF012
        "name": "dune_rl_v0",
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "is_parallelizable": True,
    }

    def __init__(self, simulation: VectorSimulation, render_mode: RenderMode = None) -> None:
        if simulation.num_scenes != 1:
            raise ValueError(
                f"the PettingZoo environment wraps a simulation of one scene, not of {simulation.num_scenes}"
            )
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode must be 'rgb_array' or None (got {render_mode!r})")
        if not simulation.external:
            raise ConfigError("there is no external agent: give a group controller=external")
        self.simulation = simulation
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": simulation.physics.control_hz}
        self._pictures = Pictures(simulation)
        self.possible_agents = list(simulation.agents)
        self.agents: list[str] = []
        self.observation_spaces, self.action_spaces = {}, {}
        for group in simulation.external:
            for name in group.names:
                self.observation_spaces[name] = gymnasium.spaces.Dict(
                    {key: _box(bounds) for key, bounds in group.observation_bounds.items()}
                )
                self.action_spaces[name] = _box(group.action_bounds)
        self._metric_names = {
            group.name: simulation.metric_names(group.name) if group.metric_names else ()
            for group in simulation.external
        }

    def observation_space(self, agent: str) -> gymnasium.spaces.Dict:
        """Observation space of an agent; the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Box:
        """Action space of an agent, in physical units; the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, float]]]:
        """Start the next episode, or the first one of `seed`; `options` are ignored."""
        if seed is not None:
            self.simulation.reseed(seed)
        self.simulation.reset()
        self.agents = self.possible_agents[:]
        return self._observations(), self._infos()

    def step(
        self, actions: dict[str, NDArray[np.floating]]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, float]],
    ]:
        """Advance by a control step of 1 / control_hz seconds.

        Raises ValueError if an agent's action is missing, has the wrong size or contains NaN; actions of
        unknown agents are ignored.
        """
        if not self.agents:
            self.simulation.check_begun()
            return {}, {}, {}, {}, {}
        result = self.simulation.step(
            {group.name: self._actions(group, actions) for group in self.simulation.external}
        )
        rewards, terminations, truncations = self._outcomes(result)
        observations, infos = self._observations(), self._infos()
        if result.done[0]:
            self.agents = []
        return observations, rewards, terminations, truncations, infos

    def _actions(self, group: AgentGroup, actions: dict[str, NDArray[np.floating]]) -> NDArray[np.float32]:
        """The actions of a group's agents, (1, G, A)."""
        each = [agent_action(actions, name, group.action_size) for name in group.names]
        return (each[0] if len(each) == 1 else np.stack(each)).reshape(1, group.count, -1)

    def _outcomes(self, result: SimulationStep) -> tuple[dict[str, float], dict[str, bool], dict[str, bool]]:
        rewards: dict[str, float] = {}
        terminations: dict[str, bool] = {}
        truncations: dict[str, bool] = {}
        over = bool(result.done[0])
        for group in self.simulation.external:
            step = result.groups[group.name]
            for row, name in enumerate(group.names):
                rewards[name] = float(step.reward[row])
                # The ends of all agents are reported in the same step.
                terminations[name] = over and bool(step.terminated[row])
                truncations[name] = over and not terminations[name]
        return rewards, terminations, truncations

    def _observations(self) -> dict[str, Observation]:
        out = {}
        for group in self.simulation.external:
            readings = group.observe()
            for row, name in enumerate(group.names):
                out[name] = {key: value[row] for key, value in readings.items()}
        return out

    def _infos(self) -> dict[str, dict[str, float]]:
        infos: dict[str, dict[str, float]] = {}
        for group in self.simulation.external:
            names = self._metric_names[group.name]
            if not names:
                infos |= {name: {} for name in group.names}
                continue
            # Wrappers compare infos and rely on constant keys, so NaN and missing keys would break them.
            values = np.nan_to_num(self.simulation.metrics(group.name)[0], nan=-1.0)
            for name, row in zip(group.names, values.tolist(), strict=True):
                infos[name] = dict(zip(names, row, strict=True))
        return infos

    def render(self) -> NDArray[np.uint8] | None:
        """RGB image (480, 640, 3) from behind the first agent; None unless `render_mode` is "rgb_array"."""
        return self._pictures.from_behind() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Release the physics engine."""
        self.simulation.close()
