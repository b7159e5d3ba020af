"""The PettingZoo environment: a batch of one, whose rovers and learnable actors are agents."""

from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from dune_rl.env.batch import Batch
from dune_rl.env.bounds import (
    rover_action_bounds,
    rover_observation_bounds,
    walker_action_bounds,
    walker_observation_bounds,
)
from dune_rl.env.pictures import Pictures
from dune_rl.errors import ConfigError
from dune_rl.sensors.sensor import Bounds, Reading

Observation = dict[str, Reading]
RenderMode = Literal["rgb_array"] | None

ROVER = "rover_0"


def _box(bounds: Bounds) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(bounds[0], bounds[1], dtype=bounds[0].dtype.type)


class ParallelDuneEnv(ParallelEnv):  # type: ignore[misc]
    """`rover_0` and, for each actor with `controller: external`, `walker_0`, `walker_1`, ...

    All agents act at every step until the episode ends, which it does with the
    rover's: where the rover terminates, walkers are truncated. Several robots
    are `rover_0`, `rover_1`, ... in the order of `robots`, each with spaces of
    its own. One that is done stays, stands still whatever it is told and earns
    0 until all are, and only then is terminated or truncated. Observations are
    dicts of float32 boxes; `infos` hold the episode's running metrics of each
    rover, under the same keys at every step, -1 where a value is not defined yet.
    """

    metadata = {  # noqa: RUF012
        "name": "dune_rl_v0",
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "is_parallelizable": True,
    }

    def __init__(self, batch: Batch, render_mode: RenderMode = None) -> None:
        if batch.num_scenes != 1:
            raise ValueError(
                f"the PettingZoo environment wraps a batch of one scene, not of {batch.num_scenes}"
            )
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode must be 'rgb_array' or None (got {render_mode!r})")
        self._batch = batch
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": batch.physics.control_hz}
        self._pictures = Pictures(batch)
        self._rovers = [f"rover_{index}" for index in range(len(batch.rovers))]
        self.possible_agents = [*self._rovers, *batch.actors.names]
        self.agents: list[str] = []
        self.observation_spaces, self.action_spaces = {}, {}
        for index, name in enumerate(self._rovers):
            bounds = rover_observation_bounds(batch, index)
            self.observation_spaces[name] = gymnasium.spaces.Dict({k: _box(v) for k, v in bounds.items()})
            self.action_spaces[name] = _box(rover_action_bounds(batch, index))
        self._walkers = batch.actors.names
        for name in self._walkers:
            self.observation_spaces[name] = gymnasium.spaces.Dict(
                {k: _box(v) for k, v in walker_observation_bounds(batch).items()}
            )
            self.action_spaces[name] = _box(walker_action_bounds(batch))
        self._walker_actions = np.zeros((1, len(self._walkers), 2), np.float32)

    def observation_space(self, agent: str) -> gymnasium.spaces.Dict:
        """The agent's observation space; the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Box:
        """The agent's action space, in physical units; the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, float]]]:
        """Start the next episode; with `seed` the first of that seed."""
        if seed is not None:
            self._batch.reseed(seed)
        self._batch.reset()
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
        """Advance 1 / control_hz seconds; actions of agents that are not in the episode are ignored."""
        if not self.agents:
            return {}, {}, {}, {}, {}
        wanted = [np.asarray(actions[name], np.float32) for name in self._rovers]
        rovers = wanted[0][None] if len(wanted) == 1 else np.concatenate(wanted)[None]
        for index, name in enumerate(self._walkers):
            self._walker_actions[0, index] = actions[name]
        outcome = self._batch.step(rovers, self._walker_actions)
        rewards = {ROVER: float(outcome.rover_reward[0])}
        terminations = {ROVER: bool(outcome.terminated[0])}
        truncations = {ROVER: bool(outcome.truncated[0])}
        # All end in the same step.
        ended = terminations[ROVER] or truncations[ROVER]
        for name, other in zip(self._rovers[1:], outcome.others, strict=True):
            rewards[name] = float(other.reward[0])
            terminations[name], truncations[name] = bool(other.terminated[0]), bool(other.truncated[0])
        for index, name in enumerate(self._walkers):
            rewards[name] = float(outcome.walker_reward[0, index])
            terminations[name], truncations[name] = False, ended
        observations, infos = self._observations(), self._infos()
        if ended:
            self.agents = []
        return observations, rewards, terminations, truncations, infos

    def _observations(self) -> dict[str, Observation]:
        out = {
            name: {key: value[0] for key, value in self._batch.observe(index).items()}
            for index, name in enumerate(self._rovers)
        }
        if self._walkers:
            walkers = self._batch.observe_walkers()
            for index, name in enumerate(self._walkers):
                out[name] = {key: value[0, index] for key, value in walkers.items()}
        return out

    def _infos(self) -> dict[str, dict[str, float]]:
        infos: dict[str, dict[str, float]] = {name: {} for name in self.possible_agents}
        # Wrappers compare infos and freeze their keys, which NaN and missing ones would break.
        for index, name in enumerate(self._rovers):
            values = np.nan_to_num(self._batch.metrics(index)[0], nan=-1.0)
            infos[name] = dict(zip(self._batch.metric_names, values.tolist(), strict=True))
        return infos

    def render(self) -> NDArray[np.uint8] | None:
        """RGB (480, 640, 3) of the first rover from behind, where `render_mode` is "rgb_array"."""
        return self._pictures.from_behind() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free the physics engine's memory."""
        self._batch.close()
