"""The TorchRL environment: a batch of M scenes with batch size [M]."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from dune_rl.env.batch import Batch
from dune_rl.env.bounds import (
    rover_action_bounds,
    rover_observation_bounds,
    walker_action_bounds,
    walker_observation_bounds,
)
from dune_rl.sensors.sensor import Bounds

_ENDS = ("done", "terminated", "truncated")


class DuneEnv(EnvBase):
    """M scenes, reset one by one as their episodes end.

    Where the rover is the only agent, its observations, `action` and `reward`
    stand at the root. Where actors are agents too, agents are grouped as in
    TorchRL's multi-agent convention: (`rover`, `observation`, ...) with shape
    (M, 1, n) and (`walker`, `observation`, ...) with shape (M, E, n), each group
    with its own `action`, `reward` and ends, and `group_map` names the agents.

    `metrics` (M, n) are the present episodes' running values, final where
    `done`; `metric_names` names the columns.
    """

    batch_locked = True

    def __init__(self, batch: Batch) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([batch.num_scenes]))
        self._core = batch
        self._resume_from: dict[str, Any] | None = None
        self.metric_names = batch.metric_names
        walkers = list(batch.actors.names)
        self._walkers = len(walkers)
        self.group_map = {"rover": ["rover_0"]} | ({"walker": walkers} if walkers else {})
        self._make_specs()

    def _make_specs(self) -> None:
        scenes = self._core.num_scenes
        metrics = {"metrics": Unbounded((scenes, len(self.metric_names)), dtype=torch.float32)}
        rover_obs = rover_observation_bounds(self._core)
        rover_act = rover_action_bounds(self._core)
        root_ends = {key: Categorical(2, dtype=torch.bool, shape=(scenes, 1)) for key in _ENDS}
        if not self._walkers:
            shape: tuple[int, ...] = (scenes,)
            self.observation_spec = Composite(
                {**{key: _bounded(value, shape) for key, value in rover_obs.items()}, **metrics}, shape=shape
            )
            self.action_spec = _bounded(rover_act, shape)
            self.reward_spec = Unbounded((scenes, 1), dtype=torch.float32)
            self.done_spec = Composite(root_ends, shape=shape)
            return
        groups = {
            "rover": (1, rover_obs, rover_act),
            "walker": (
                self._walkers,
                walker_observation_bounds(self._core),
                walker_action_bounds(self._core),
            ),
        }
        observation, action, reward, ends = {}, {}, {}, {}
        for name, (count, obs, act) in groups.items():
            shape = (scenes, count)
            inner = Composite({key: _bounded(value, shape) for key, value in obs.items()}, shape=shape)
            observation[name] = Composite({"observation": inner}, shape=shape)
            action[name] = Composite({"action": _bounded(act, shape)}, shape=shape)
            reward[name] = Composite({"reward": Unbounded((*shape, 1), dtype=torch.float32)}, shape=shape)
            ends[name] = Composite(
                {key: Categorical(2, dtype=torch.bool, shape=(*shape, 1)) for key in _ENDS}, shape=shape
            )
        self.observation_spec = Composite({**observation, **metrics}, shape=(scenes,))
        self.action_spec = Composite(action, shape=(scenes,))
        self.reward_spec = Composite(reward, shape=(scenes,))
        self.done_spec = Composite({**ends, **root_ends}, shape=(scenes,))

    @property
    def batch(self) -> Batch:
        """The batch core inside."""
        return self._core

    # -- TorchRL's three -----------------------------------------------------------------------------

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        mask = None
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        if chosen is not None:
            mask = chosen.reshape(self._core.num_scenes, -1).any(dim=1).numpy()
        if self._resume_from is not None and (mask is None or mask.all()):
            self._core.restore(self._resume_from)
            self._resume_from = None
        else:
            self._core.reset(mask)
        nobody = np.zeros(self._core.num_scenes, bool)
        return self._pack([self._observation(), self._ends(nobody, nobody)])

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        if not self._walkers:
            outcome = self._core.step(tensordict["action"].detach().numpy())
            reward: dict[str, Any] = {"reward": torch.from_numpy(outcome.rover_reward).unsqueeze(-1)}
        else:
            rover = tensordict["rover", "action"].detach().numpy()[:, 0]
            outcome = self._core.step(rover, tensordict["walker", "action"].detach().numpy())
            reward = {
                "rover": {"reward": torch.from_numpy(outcome.rover_reward)[:, None, None]},
                "walker": {"reward": torch.from_numpy(outcome.walker_reward)[..., None]},
            }
        return self._pack([reward, self._observation(), self._ends(outcome.terminated, outcome.truncated)])

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._core.reseed(seed)

    # -- its parts ------------------------------------------------------------------------------------

    def _pack(self, parts: list[dict[str, Any]]) -> TensorDict:
        merged = _merged(parts)
        if self._walkers:
            for group, members in self.group_map.items():
                merged[group] = TensorDict(merged[group], (*self.batch_size, len(members)))
        return TensorDict(merged, self.batch_size)

    def _observation(self) -> dict[str, Any]:
        rover = {key: torch.from_numpy(value) for key, value in self._core.observe().items()}
        out: dict[str, Any] = {"metrics": torch.from_numpy(self._core.metrics())}
        if not self._walkers:
            return out | rover
        out["rover"] = {"observation": {key: value.unsqueeze(1) for key, value in rover.items()}}
        walkers = self._core.observe_walkers()
        out["walker"] = {"observation": {key: torch.from_numpy(value) for key, value in walkers.items()}}
        return out

    def _ends(self, terminated: NDArray[np.bool_], truncated: NDArray[np.bool_]) -> dict[str, Any]:
        done = terminated | truncated
        root = {
            key: torch.from_numpy(value).unsqueeze(-1)
            for key, value in zip(_ENDS, (done, terminated, truncated), strict=True)
        }
        if not self._walkers:
            return root
        # The rover's end is the others' truncation: their own task was not over.
        shape = (self._core.num_scenes, self._walkers, 1)
        ended = root["done"].unsqueeze(1).expand(shape)
        return {
            **root,
            "rover": {key: value.unsqueeze(1) for key, value in root.items()},
            "walker": {"done": ended, "terminated": torch.zeros(shape, dtype=torch.bool), "truncated": ended},
        }

    # -- state ----------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """All that brings this moment back, as plain containers fit for a checkpoint."""
        return self._core.state()

    def resume(self, state: dict[str, Any]) -> None:
        """Make the next reset of all scenes return to `state` instead of starting new episodes."""
        self._resume_from = state

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the physics engine's memory."""
        if not self.is_closed:
            self._core.close()
        super().close(raise_if_closed=raise_if_closed)


def _bounded(bounds: Bounds, shape: tuple[int, ...]) -> Bounded:
    full = (*shape, *bounds[0].shape)
    low, high = (torch.from_numpy(np.array(np.broadcast_to(bound, full))) for bound in bounds)
    return Bounded(low=low, high=high, shape=full, dtype=low.dtype)


def _merged(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """One nested dict of several; equal keys hold dicts."""
    out: dict[str, Any] = {}
    for part in parts:
        for key, value in part.items():
            out[key] = _merged([out[key], value]) if key in out else value
    return out
