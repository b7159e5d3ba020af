"""The TorchRL environment: a simulation of M scenes with batch size [M]."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from dune_rl.bodies.motion import TurningCircle
from dune_rl.core.errors import ConfigError, DuneWarning
from dune_rl.env.agent_group import AgentGroup, GroupStep
from dune_rl.env.observation_layout import ObservationLayout
from dune_rl.env.pictures import Pictures
from dune_rl.env.render_mode import check_render_mode
from dune_rl.env.replay import CopiedByReplay, RestoreError
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Flags
from dune_rl.sensors.sensor import Bounds

_ENDS = ("done", "terminated", "truncated")
_CPU = torch.device("cpu")


class DuneEnv(CopiedByReplay, EnvBase):
    """TorchRL environment of M scenes, with the keys of TorchRL's multi-agent convention.

    Each group of G external agents has (`group`, `observation`, NAME) of shape (M, G, ...), (`group`,
    `action`) (M, G, A), (`group`, `reward`) (M, G, 1), and `done`, `terminated` and `truncated` (M, G, 1);
    `group_map` lists the agents. The end flags of a group are those of each agent: they are set from the step
    in which it is done until its scene's episode ends; agents that come later are truncated until then. The
    end flags at the root, (M, 1), are those of the scenes, which are reset one by one. With a curriculum,
    `curriculum_level` (M, 1) is its present level. With `flatten`,
    (`group`, `observation`) is one vector, (M, G, D). Raises ConfigError if no group is external.
    """

    batch_locked = True

    def __init__(self, simulation: VectorSimulation, *, flatten: bool = False) -> None:
        super().__init__(
            device=torch.device("cpu"),
            batch_size=torch.Size([simulation.num_scenes]),
            # Agents that have not come yet are done.
            allow_done_after_reset=any(group.presence is not None for group in simulation.external),
        )
        if not simulation.external:
            raise ConfigError("there is no external agent: give a group controller=external")
        self._simulation = simulation
        self._resume_from: dict[str, Any] | None = None
        self._pictures: Pictures | None = None
        self._groups = simulation.external
        self._flat = {group.name: ObservationLayout(group, True) for group in self._groups} if flatten else {}
        self.group_map = {group.name: list(group.names) for group in self._groups}
        self._make_specs()
        # The base class takes an environment that wraps no other library's for closed.
        self.is_closed = False

    def _make_specs(self) -> None:
        scenes = self._simulation.num_scenes
        observation, action, reward, ends = {}, {}, {}, {}
        for group in self._groups:
            shape = (scenes, group.count)
            observation[group.name] = Composite({"observation": self._observation_spec(group)}, shape=shape)
            action[group.name] = Composite({"action": _bounded(group.action_bounds, shape)}, shape=shape)
            reward[group.name] = Composite(
                {"reward": Unbounded((*shape, 1), dtype=torch.float32)}, shape=shape
            )
            ends[group.name] = Composite(_end_specs(shape), shape=shape)
        if self._simulation.curriculum.conf is not None:
            observation["curriculum_level"] = Bounded(
                low=0.0, high=1.0, shape=(scenes, 1), dtype=torch.float32
            )
        self.observation_spec = Composite(observation, shape=(scenes,))
        self.action_spec = Composite(action, shape=(scenes,))
        self.reward_spec = Composite(reward, shape=(scenes,))
        self.done_spec = Composite({**ends, **_end_specs((scenes,))}, shape=(scenes,))

    def _observation_spec(self, group: AgentGroup) -> TensorSpec:
        shape = (self._simulation.num_scenes, group.count)
        if self._flat:
            space = self._flat[group.name].space
            assert isinstance(space, gymnasium.spaces.Box)
            return _bounded((space.low, space.high), shape)
        parts = {key: _bounded(bounds, shape) for key, bounds in group.observation_bounds.items()}
        return Composite(parts, shape=shape)

    @property
    def simulation(self) -> VectorSimulation:
        """The simulation that this environment wraps."""
        return self._simulation

    @property
    def metric_names(self) -> dict[str, tuple[str, ...]]:
        """Column names of the metrics that `EpisodeMetrics` adds, by group; only groups with metrics."""
        return {
            group.name: self._simulation.metric_names(group.name)
            for group in self._groups
            if group.metric_names
        }

    @property
    def turning_circles(self) -> dict[str, TurningCircle]:
        """The tightest curves of the groups whose bodies cannot turn on the spot."""
        return {
            group.name: TurningCircle(group.description.turning_radius_m, group.description.rear_axle_m)
            for group in self._groups
            if group.description.turning_radius_m
        }

    @property
    def privileged(self) -> dict[str, frozenset[str]]:
        """The parts of each group's observation that critics alone may use."""
        return {group.name: group.privileged for group in self._groups}

    # -- EnvBase interface ------------------------------------------------------------------------

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        mask = None
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        if chosen is not None:
            mask = chosen.reshape(self._simulation.num_scenes, -1).any(dim=1).numpy()
        if self._resume_from is not None and (mask is None or mask.all()):
            self._restore(self._resume_from)
            self._resume_from = None
        else:
            self._simulation.reset(mask)
        nobody = np.zeros(self._simulation.num_scenes, bool)
        return self._pack(None, nobody, nobody)

    def _restore(self, saved: dict[str, Any]) -> None:
        try:
            self._simulation.restore(saved)
        except RestoreError as error:
            warnings.warn(f"{error}\nNew episodes are started instead.", DuneWarning, stacklevel=2)
            self._simulation.reset()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        actions = {group.name: tensordict[group.name, "action"].detach().numpy() for group in self._groups}
        result = self._simulation.advance(actions)
        return self._pack(result.groups, result.terminated, result.truncated)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._simulation.reseed(seed)

    def start_at(self, seed: int, first_episode: int) -> None:
        """Let the next reset of all scenes start at episode `first_episode` of `seed`."""
        self._simulation.reseed(seed, first_episode)

    def rest_scenes(self, mask: torch.Tensor) -> None:
        """Leave the scenes in `mask` (M,) out of the physics until they are reset; see `VectorSimulation`."""
        self._simulation.rest(mask.numpy())

    def episode_keys(self) -> tuple[int, NDArray[np.int64]]:
        """The seed and the ids (M,) of the present episodes."""
        return self._simulation.seed, self._simulation.episodes.copy()

    def episode_begins(self, group: str) -> Flags:
        """Whether agents of `group` have not acted yet in their present episodes, (M, G)."""
        simulation = self._simulation
        steps = simulation.state.groups[group].episode.steps
        return (steps < simulation.physics.action_repeat).reshape(simulation.num_scenes, -1)

    # -- packing ----------------------------------------------------------------------------------

    def _pack(self, steps: dict[str, GroupStep] | None, terminated: Flags, truncated: Flags) -> TensorDict:
        """Tensordict of a step, or of a reset if `steps` is None, with batch size [M]."""
        scenes = self._simulation.num_scenes
        out = {
            group.name: self._group_part(group, None if steps is None else steps[group.name])
            for group in self._groups
        }
        if self._simulation.curriculum.conf is not None:
            out["curriculum_level"] = torch.full((scenes, 1), self._simulation.curriculum.level)
        root = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        for name, flags in root.items():
            out[name] = torch.from_numpy(flags[:, None])
        return _unchecked(out, (scenes,))

    def _group_part(self, group: AgentGroup, step: GroupStep | None) -> TensorDict:
        shape = (self._simulation.num_scenes, group.count)
        each = (*shape, 1)
        part: dict[str, Any] = {"observation": self._observation(group, shape)}
        if step is None:
            terminated, truncated = group.terminated, group.truncated
        else:
            terminated, truncated = step.terminated, step.truncated
            part["reward"] = torch.from_numpy(step.reward.reshape(each))
        part["done"] = torch.from_numpy((terminated | truncated).reshape(each))
        part["terminated"] = torch.from_numpy(terminated.reshape(each).copy())
        part["truncated"] = torch.from_numpy(truncated.reshape(each).copy())
        return _unchecked(part, shape)

    def _observation(self, group: AgentGroup, shape: tuple[int, int]) -> TensorDict | torch.Tensor:
        if self._flat:
            return _by_agent(self._flat[group.name].batch(), shape)
        return _unchecked({key: _by_agent(value, shape) for key, value in group.observe().items()}, shape)

    def render(self, mode: str = "rgb_array", scene: int = 0) -> NDArray[np.uint8]:
        """RGB (480, 640, 3) of a scene from behind its first agent; `PixelRenderTransform` calls it."""
        check_render_mode(mode, ("rgb_array",))
        if self._pictures is None:
            self._pictures = Pictures(self._simulation)
        return self._pictures.from_behind(scene)

    # -- state ------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Plain data from which `resume` restores the present state; fit for a checkpoint."""
        return self._simulation.save_state()

    def resume(self, state: dict[str, Any]) -> None:
        """Let the next reset of all scenes restore `state` instead of starting new episodes.

        If the saved episodes cannot be reproduced bit for bit, as on another processor, it warns and starts
        new ones.
        """
        self._resume_from = state

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Release the physics engine."""
        if not self.is_closed:
            self._simulation.close()
        super().close(raise_if_closed=raise_if_closed)


def _unchecked(values: dict[str, Any], shape: tuple[int, ...]) -> TensorDict:
    # Shapes are correct by construction; checking them takes as long as a whole observation.
    return TensorDict._new_unsafe(values, batch_size=torch.Size(shape), device=_CPU)


def _by_agent(values: NDArray[Any], shape: tuple[int, int]) -> torch.Tensor:
    """Rows (N, ...) as a tensor (M, G, ...)."""
    # NumPy takes a fifth of the time that torch takes for a view.
    return torch.from_numpy(values.reshape(*shape, *values.shape[1:]))


def _end_specs(shape: tuple[int, ...]) -> dict[str, Categorical]:
    return {key: Categorical(2, dtype=torch.bool, shape=(*shape, 1)) for key in _ENDS}


def _bounded(bounds: Bounds, shape: tuple[int, ...]) -> Bounded:
    full = (*shape, *bounds[0].shape)
    low, high = (torch.from_numpy(np.array(np.broadcast_to(bound, full))) for bound in bounds)
    return Bounded(low=low, high=high, shape=full, dtype=low.dtype)
