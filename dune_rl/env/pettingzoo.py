"""The PettingZoo parallel environment of one scene's external agents."""

from collections.abc import Sequence
from copy import copy
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from dune_rl.core.errors import ConfigError
from dune_rl.core.seeding import stream
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.arguments import agent_action, check_whole
from dune_rl.env.infos import EpisodeInfos
from dune_rl.env.live.view import LivePage
from dune_rl.env.observation_layout import Observation, ObservationLayout, box
from dune_rl.env.pictures import Pictures
from dune_rl.env.registration import RENDER_MODES
from dune_rl.env.render_mode import RenderMode, check_render_mode
from dune_rl.env.replay import CopiedByReplay
from dune_rl.env.requests import parse_options
from dune_rl.env.simulation import SimulationStep, VectorSimulation
from dune_rl.geometry.arrays import Floats
from dune_rl.rendering.web.server import require_viser

# Numbers of each agent in the state.
_STATE_SIZE = 14
# What copies take over, beside the simulation's state.
_OWN = ("agents", "np_random", "observation_spaces", "action_spaces")


class ParallelDuneEnv(CopiedByReplay, ParallelEnv):  # type: ignore[misc]
    """PettingZoo `ParallelEnv` of the agents GROUP_0, GROUP_1, ... of every external group.

    Agents of a group have equal spaces. All agents act at every step until the episode ends, when all agents
    of the groups with terminations are done. An agent that is done before the others stays in the scene and
    in `agents`: its actions have no effect and its rewards are 0. All agents are terminated or truncated in
    the episode's last step: those that were done as they were then, the others are truncated. Observations
    are dicts of boxes or, with `flatten`, vectors. `infos` hold each agent's metrics so far, under the same
    keys at every step; a value that is not defined yet is -1.

    Where agents of a group come and go, they are in `agents` only while they are there. One that comes has
    its first observation in the step in which it comes; one that is done, or leaves, is terminated or
    truncated in that step, and does not return. Those that have not come when all others are done do not
    come.

    Raises ValueError if the simulation has several scenes, and ConfigError if no group is external.
    """

    metadata = {  # noqa: RUF012
        "name": "dune_rl_v0",
        "render_modes": RENDER_MODES,
        "render_fps": 20,
        "is_parallelizable": True,
    }

    def __init__(
        self, simulation: VectorSimulation, render_mode: RenderMode = None, *, flatten: bool = False
    ) -> None:
        if simulation.num_scenes != 1:
            raise ValueError(
                f"the PettingZoo environment wraps a simulation of one scene, not of {simulation.num_scenes}"
            )
        check_render_mode(render_mode, ("human", "rgb_array"))
        if not simulation.external:
            raise ConfigError("there is no external agent: give a group controller=external")
        self.simulation = simulation
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": simulation.physics.decision_hz}
        self._pictures = Pictures(simulation)
        self.page: LivePage | None = None
        if render_mode == "human":
            require_viser("render_mode='human'")
        self.possible_agents = list(simulation.agents)
        self.agents: list[str] = []
        # Wrappers draw from it, SuperSuit's frame_skip_v0 for one; no episode depends on it.
        self.np_random = stream(simulation.seed, "wrappers")
        self.observation_spaces, self.action_spaces = {}, {}
        self._layouts = [(group, ObservationLayout(group, flatten)) for group in simulation.external]
        for group, layout in self._layouts:
            for name in group.names:
                self.observation_spaces[name] = copy(layout.space)
                self.action_spaces[name] = box(group.action_bounds)
        self._infos_of = [(group, EpisodeInfos(simulation, group)) for group in simulation.external]

    def observation_space(self, agent: str) -> gymnasium.Space[Any]:
        """Observation space of an agent; the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Box:
        """Action space of an agent, in physical units; the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, float]]]:
        """Start the next episode, or the first one of `seed`.

        `options` may have the number of the `episode`, and `start` (x, y) or (x, y, yaw) and `goal` (x, y) of
        the agent, or of several in mappings. Raises ValueError for other options and for places that are not
        free.
        """
        episode, request = parse_options(options, self.possible_agents)
        if seed is not None:
            check_whole("seed", seed, at_least=0)
            self.np_random = stream(seed, "wrappers")
        if seed is not None or episode is not None:
            self.simulation.reseed(self.simulation.seed if seed is None else seed, episode or 0)
        self.simulation.reset(requests={0: request} if request else {})
        self.agents = self._present()
        self._show()
        return self._observations(self.agents), self._infos(self.agents)

    def step(
        self, actions: dict[str, NDArray[np.floating]]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, float]],
    ]:
        """Advance by `action_repeat` control steps of 1 / control_hz seconds.

        Raises ValueError if an agent's action is missing, has the wrong size or contains NaN; actions of
        unknown agents are ignored.
        """
        if not self.agents:
            self.simulation.check_begun()
            return {}, {}, {}, {}, {}
        result = self.simulation.advance(
            {group.name: self._actions(group, actions) for group in self.simulation.external}
        )
        after = [] if result.done[0] else self._present()
        shown = {*self.agents, *after}
        told = [name for name in self.possible_agents if name in shown]
        rewards, terminations, truncations = self._outcomes(result, told)
        observations, infos = self._observations(told), self._infos(told)
        self.agents = after
        self._show()
        return observations, rewards, terminations, truncations, infos

    def _present(self) -> list[str]:
        """The agents that act in the next step."""
        found: list[str] = []
        for group in self.simulation.external:
            ended = group.done.tolist() if group.presence is not None else [False] * group.count
            found += [name for name, has_ended in zip(group.names, ended, strict=True) if not has_ended]
        return found

    def _actions(self, group: AgentGroup, actions: dict[str, NDArray[np.floating]]) -> Floats:
        """The actions of a group's agents, (1, G, A)."""
        rest = group.rest_action.astype(np.float32)
        each = [
            agent_action(actions, name, group.action_size) if name in self.agents else rest
            for name in group.names
        ]
        return (each[0] if len(each) == 1 else np.stack(each)).reshape(1, group.count, -1)

    def _outcomes(
        self, result: SimulationStep, agents: Sequence[str]
    ) -> tuple[dict[str, float], dict[str, bool], dict[str, bool]]:
        """Rewards, terminations and truncations of these `agents`."""
        rewards: dict[str, float] = {}
        terminations: dict[str, bool] = {}
        truncations: dict[str, bool] = {}
        over = bool(result.done[0])
        for group in self.simulation.external:
            step = result.groups[group.name]
            for row, name in enumerate(group.names):
                if name not in agents:
                    continue
                rewards[name] = float(step.reward[row])
                # The ends of agents that stay are reported in the same step.
                is_told = over or group.presence is not None
                terminations[name] = is_told and bool(step.terminated[row])
                truncations[name] = is_told and not terminations[name] and bool(step.truncated[row])
        return rewards, terminations, truncations

    def _observations(self, agents: Sequence[str]) -> dict[str, Observation]:
        found: dict[str, Observation] = {}
        for group, layout in self._layouts:
            found |= zip(group.names, layout.each(), strict=True)
        return found if len(agents) == len(found) else {name: found[name] for name in agents}

    def _infos(self, agents: Sequence[str]) -> dict[str, dict[str, float]]:
        infos: dict[str, dict[str, float]] = {}
        for group, of_group in self._infos_of:
            infos |= zip(group.names, of_group.each(), strict=True)
        return infos if len(agents) == len(infos) else {name: infos[name] for name in agents}

    def render(self) -> NDArray[np.uint8] | None:
        """RGB image (480, 640, 3) from behind the first agent, where `render_mode` is "rgb_array".

        With "human", a page in a browser shows each step, in real time, and None is returned.
        """
        if self.render_mode != "rgb_array":
            return None
        self.simulation.check_begun()
        return self._pictures.from_behind()

    def _show(self) -> None:
        if self.render_mode != "human":
            return
        if self.page is None:
            self.page = LivePage(self.simulation, self.simulation.group(), 0, announces=True)
        self.page.show()
        self.page.playback.wait(1.0 / self.simulation.physics.decision_hz)

    def state(self) -> Floats:
        """The true state of all groups, scripted ones as well, in `state_space`: what no agent observes.

        For each agent x, y, z [m], roll, pitch, yaw [rad], the velocity (3) [m/s], the angular velocity (3)
        [rad/s], both in the world frame, and the goal's x and y [m]. Of an agent that is not there all are 0.
        """
        self.simulation.check_begun()
        groups = self.simulation.state.groups.values()
        rows = []
        for group in groups:
            motion, goal = group.motion, group.goal.position_w
            values = motion.position_w, motion.roll_pitch_yaw, motion.velocity_w, motion.angular_w, goal
            rows.append(np.concatenate(values, axis=1))
            if group.absent is not None:
                rows[-1][group.absent] = 0.0
        return np.concatenate(rows).ravel().astype(np.float32)

    @property
    def state_space(self) -> gymnasium.spaces.Box:
        """Space of `state`."""
        agents = sum(group.count for group in self.simulation.groups)
        return gymnasium.spaces.Box(-np.inf, np.inf, (_STATE_SIZE * agents,), np.float32)

    def _own_point(self) -> dict[str, Any]:
        return {name: vars(self)[name] for name in _OWN}

    def _return_to(self, own: dict[str, Any]) -> None:
        self.__dict__.update(own)

    def close(self) -> None:
        """Release the physics engine, and close the page."""
        if self.page is not None:
            self.page.close()
            self.page = None
        self.simulation.close()
