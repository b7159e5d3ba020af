"""The Gymnasium environment of a single external agent."""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import ConfigError
from dune_rl.env.live.view import LivePage
from dune_rl.env.observation_layout import Observation
from dune_rl.env.pettingzoo import ParallelDuneEnv
from dune_rl.env.registration import RENDER_METADATA
from dune_rl.env.render_mode import RenderMode
from dune_rl.env.replay import CopiedByReplay, gymnasium_state
from dune_rl.env.simulation import VectorSimulation


class GymnasiumEnv(CopiedByReplay, gymnasium.Env):  # type: ignore[misc]
    """The PettingZoo environment's only agent, for libraries that know one.

    All other groups are driven by behaviours or frozen policies; `info` holds the episode's running metrics.
    """

    metadata = RENDER_METADATA

    def __init__(
        self, simulation: VectorSimulation, render_mode: RenderMode = None, *, flatten: bool = False
    ) -> None:
        parallel = ParallelDuneEnv(simulation, render_mode, flatten=flatten)
        if len(parallel.possible_agents) > 1:
            raise ConfigError(
                f"Gymnasium has one agent, and here are {', '.join(parallel.possible_agents)}: use "
                "dune_rl.parallel_env, or give the other groups a controller"
            )
        self._parallel = parallel
        self.simulation = simulation
        self.agent = parallel.possible_agents[0]
        self.observation_space = parallel.observation_space(self.agent)
        self.action_space = parallel.action_space(self.agent)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": parallel.metadata["render_fps"]}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, float]]:
        """Start the next episode; with `seed` the first of that seed.

        `options` as of `ParallelDuneEnv.reset`: `episode`, `start` and `goal`.
        """
        super().reset(seed=seed)
        observations, infos = self._parallel.reset(seed, options)
        return observations[self.agent], infos[self.agent]

    def step(self, action: NDArray[np.floating]) -> tuple[Observation, float, bool, bool, dict[str, float]]:
        """Advance `action_repeat` control steps with `action`, for most robots speed [m/s] and relative
        heading [rad].
        """
        agent = self.agent
        observations, rewards, terminations, truncations, infos = self._parallel.step({agent: action})
        if not observations:
            raise gymnasium.error.ResetNeeded("the episode has ended: call reset() before step()")
        return observations[agent], rewards[agent], terminations[agent], truncations[agent], infos[agent]

    @property
    def page(self) -> LivePage | None:
        """The page of `render_mode="human"`, once an episode has begun."""
        return self._parallel.page

    def render(self) -> NDArray[np.uint8] | None:
        """RGB (480, 640, 3) of the agent from behind, where `render_mode` is "rgb_array".

        With "human", a page in a browser shows each step, in real time, and None is returned.
        """
        return self._parallel.render()

    def _own_point(self) -> dict[str, Any]:
        return {"agents": self._parallel.agents, "gymnasium": gymnasium_state(self)}

    def _return_to(self, own: dict[str, Any]) -> None:
        self._parallel.agents = own["agents"]
        self.__dict__.update(own["gymnasium"])

    def close(self) -> None:
        """Free the physics engine's memory."""
        self._parallel.close()
