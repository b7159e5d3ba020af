"""The Gymnasium environment: the rover alone."""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dune_rl.env.batch import Batch
from dune_rl.env.pettingzoo import ROVER, Observation, ParallelDuneEnv, RenderMode


class GymnasiumEnv(gymnasium.Env):  # type: ignore[misc]
    """The PettingZoo environment's `rover_0`, for libraries that know one agent.

    Actors must all be scripted; `info` holds the episode's running metrics.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, batch: Batch, render_mode: RenderMode = None) -> None:
        parallel = ParallelDuneEnv(batch, render_mode)
        if parallel.possible_agents != [ROVER]:
            raise ValueError(
                f"{', '.join(parallel.possible_agents[1:])} would act for nobody here: "
                "use dune_rl.parallel_env, or make the actors scripted"
            )
        self._parallel = parallel
        self.observation_space = parallel.observation_space(ROVER)
        self.action_space = parallel.action_space(ROVER)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": parallel.metadata["render_fps"]}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, float]]:
        """Start the next episode; with `seed` the first of that seed."""
        super().reset(seed=seed)
        observations, infos = self._parallel.reset(seed, options)
        return observations[ROVER], infos[ROVER]

    def step(self, action: NDArray[np.floating]) -> tuple[Observation, float, bool, bool, dict[str, float]]:
        """Advance 1 / control_hz seconds with `action`: speed [m/s] and relative heading [rad]."""
        observations, rewards, terminations, truncations, infos = self._parallel.step({ROVER: action})
        if not observations:
            raise gymnasium.error.ResetNeeded("the episode has ended: call reset() before step()")
        return observations[ROVER], rewards[ROVER], terminations[ROVER], truncations[ROVER], infos[ROVER]

    def render(self) -> NDArray[np.uint8] | None:
        """RGB (480, 640, 3) of the rover from behind, where `render_mode` is "rgb_array"."""
        return self._parallel.render()

    def close(self) -> None:
        """Free the physics engine's memory."""
        self._parallel.close()
