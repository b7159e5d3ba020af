"""Gymnasium's vector environment: the whole batch of scenes as one."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dune_rl.core.errors import ConfigError
from dune_rl.env.arguments import action_numbers, check_whole, combined_seed
from dune_rl.env.infos import EpisodeInfos
from dune_rl.env.observation_layout import ObservationLayout, box
from dune_rl.env.pictures import Pictures
from dune_rl.env.render_mode import RenderMode, check_render_mode
from dune_rl.env.replay import CopiedByReplay, gymnasium_state
from dune_rl.env.simulation import SimulationStep, VectorSimulation
from dune_rl.geometry.arrays import Array, Flags, Floats

Observations = dict[str, NDArray[Any]] | Floats


class GymnasiumVectorEnv(CopiedByReplay, VectorEnv):  # type: ignore[misc]
    """Gymnasium `VectorEnv` of M scenes that are stepped together, each with one external agent.

    Actions and observations are those of M `GymnasiumEnv`, as arrays with the leading axis M.
    `autoreset_mode` tells when a scene whose episode has ended starts the next one, as in Gymnasium:
    `next_step` (its action of that step is ignored), `same_step` (the ended episode's last are
    `infos["final_obs"]` and `infos["final_info"]`) or `disabled` (by `reset(options={"reset_mask": ...})`).
    Scene i runs the episodes i, i + M, i + 2 M and so on of the seed. `max_episode_steps` cuts episodes off
    as Gymnasium's `TimeLimit` does, beside the task's own time limit.

    Raises ConfigError unless there is exactly one external agent.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        simulation: VectorSimulation,
        render_mode: RenderMode = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        *,
        flatten: bool = False,
        max_episode_steps: int | None = None,
    ) -> None:
        if len(simulation.agents) != 1:
            raise ConfigError(
                f"Gymnasium has one agent, and here are {', '.join(simulation.agents) or 'none'}: use "
                "dune_rl.parallel_env, or set the controllers of the groups"
            )
        check_render_mode(render_mode, ("rgb_array",))
        if max_episode_steps is not None:
            check_whole("max_episode_steps", max_episode_steps, at_least=1)
        self._max_episode_steps = max_episode_steps
        self.simulation, self.render_mode = simulation, render_mode
        self.num_envs = simulation.num_scenes
        # By this name clients look for it in Gymnasium's own vector environments.
        self.autoreset_mode = self._mode = _autoreset_mode(autoreset_mode)
        self.metadata = {
            **self.metadata,
            "render_fps": simulation.physics.decision_hz,
            "autoreset_mode": self._mode,
        }
        (self._group,) = simulation.external
        self._layout = ObservationLayout(self._group, flatten)
        self.single_observation_space = self._layout.space
        self.single_action_space = box(self._group.action_bounds)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._infos = EpisodeInfos(simulation, self._group)
        self._pictures = Pictures(simulation)
        self._ended = np.zeros(self.num_envs, bool)
        self._all = np.ones(self.num_envs, bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Start the next episode of all scenes, or of those in `options["reset_mask"]` (M,).

        With a `seed`, the first ones of that seed; a list of seeds, one for each scene, stands for one seed.
        Scene i starts as a single environment does with `seed` and `options={"episode": i}`. It has no seed
        of its own, seed + i: the random paths of walkers are those of a seed and a world, for all scenes.
        """
        mask = self._reset_mask(options)
        if seed is not None:
            if not mask.all():
                raise ValueError("a seed is of all scenes: reset without reset_mask, or without seed")
            one = self._one_seed(seed)
            super().reset(seed=one)
            self.simulation.reseed(one)
        self.simulation.reset(mask)
        self._ended = self._ended & ~mask
        return self._observations(), self._infos.batched(mask)

    def _one_seed(self, seed: int | list[int | None]) -> int:
        if isinstance(seed, list | tuple | np.ndarray):
            if len(seed) != self.num_envs:
                raise ValueError(f"there are {self.num_envs} scenes, and {len(seed)} seeds")
            return combined_seed(seed)
        check_whole("seed", seed, at_least=0)
        return int(seed)

    def _reset_mask(self, options: dict[str, Any] | None) -> Flags:
        if options is not None and not isinstance(options, Mapping):
            raise ValueError(f"options must be a mapping with reset_mask (got {options!r})")
        unknown = sorted(map(str, {*(options or {})} - {"reset_mask"}))
        if unknown:
            raise ValueError(f"there are no reset options {', '.join(unknown)}; there is reset_mask")
        if not options:
            return self._all
        mask = np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"options['reset_mask'] must be an array of {self.num_envs} flags, at least one of them True "
                f"(got {options['reset_mask']!r})"
            )
        return mask

    def step(self, actions: NDArray[np.floating]) -> tuple[Observations, Array, Flags, Flags, dict[str, Any]]:
        """Advance all scenes by `action_repeat` control steps with `actions` (M, A).

        Returns observations, rewards (M,), flags (M,) of terminated and of truncated episodes, and infos: the
        metrics of the episodes so far, (M,) each.
        """
        begins = self._ended
        if self._mode is AutoresetMode.DISABLED and begins.any():
            scenes = ", ".join(str(scene) for scene in np.flatnonzero(begins))
            raise gymnasium.error.ResetNeeded(
                f"the episodes of the scenes {scenes} have ended: call reset(options={{'reset_mask': ...}})"
            )
        group = self._group
        shape = (self.num_envs, group.action_size)
        values = action_numbers(actions)
        if values.shape != shape:
            raise ValueError(f"actions must have the shape {shape} (got {values.shape})")
        if begins.any():
            # Whatever the action of an ended episode is, it has no effect.
            values = np.where(begins[:, None], 0.0, values)
        result = self.simulation.advance({group.name: values[:, None]})
        reward = np.where(begins, 0.0, result.groups[group.name].reward.astype(np.float64))
        terminated, truncated = result.terminated & ~begins, self._truncated(result) & ~begins
        ended = terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and ended.any():
            final = self._final(ended)
            self.simulation.reset(ended)
            return self._observations(), reward, terminated, truncated, {**self._infos.batched(), **final}
        if begins.any():
            self.simulation.reset(begins)
        self._ended = ended
        return self._observations(), reward, terminated, truncated, self._infos.batched()

    def _truncated(self, result: SimulationStep) -> Flags:
        """Flags (M,) of the episodes that are cut off by the task, or by `max_episode_steps`."""
        if self._max_episode_steps is None:
            return result.truncated
        late: Flags = self.simulation.steps >= self._max_episode_steps
        return result.truncated | late

    def _final(self, ended: Flags) -> dict[str, Any]:
        """Observations and infos of the episodes that have ended, as Gymnasium's wrappers expect them."""
        observations, final_obs = self._observations(), np.full(self.num_envs, None, object)
        for scene in np.flatnonzero(ended).tolist():
            final_obs[scene] = (
                observations[scene]
                if isinstance(observations, np.ndarray)
                else {key: value[scene] for key, value in observations.items()}
            )
        return {
            "final_obs": final_obs,
            "_final_obs": ended.copy(),
            "final_info": self._infos.batched(ended),
            "_final_info": ended.copy(),
        }

    def _observations(self) -> Observations:
        observations: Observations = self._layout.batch()
        return observations

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """RGB (480, 640, 3) of each scene from behind its agent, where `render_mode` is "rgb_array"."""
        if self.render_mode is None:
            return None
        self.simulation.check_begun()
        return tuple(self._pictures.from_behind(scene) for scene in range(self.num_envs))

    def _own_point(self) -> dict[str, Any]:
        return {"ended": self._ended.tolist(), "gymnasium": gymnasium_state(self)}

    def _return_to(self, own: dict[str, Any]) -> None:
        self._ended = np.array(own["ended"], bool)
        self.__dict__.update(own["gymnasium"])

    def close_extras(self, **kwargs: Any) -> None:
        """Free the physics engine's memory."""
        self.simulation.close()


def _autoreset_mode(mode: str | AutoresetMode) -> AutoresetMode:
    names = {each.name.lower(): each for each in AutoresetMode}
    values = {each.value.lower(): each for each in AutoresetMode}
    found = mode if isinstance(mode, AutoresetMode) else {**values, **names}.get(str(mode).lower())
    if found is None:
        raise ConfigError(f"autoreset_mode must be one of {', '.join(names)} (got {mode!r})")
    return found
