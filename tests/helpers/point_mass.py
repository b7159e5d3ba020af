"""A cheap stand-in for the real TorchRL environment, with its keys by agent group, its metrics and its ends.

Points turn towards a commanded heading and move at a commanded speed on an
empty plane. It is what the learning code is developed and tested against.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from dune_rl.core.seeding import stream

METRIC_NAMES = (
    "episode",
    "steps",
    "return",
    "success",
    "reached",
    "collisions",
    "time_to_goal",
    "clearance",
    "min_clearance",
    "vertical_roughness",
    "vort",
    "smoothness",
    "diverged",
    "stuck",
    "flipped",
    "out_of_world",
    "timeout",
    "reward/progress",
    "reward/goal",
)
STEP_S = 0.25
GOAL_RADIUS_M = 0.5
_ENDS = ("done", "terminated", "truncated")
_COLUMN = {name: index for index, name in enumerate(METRIC_NAMES)}


class PointMass(EnvBase):
    """M scenes with `groups` (name -> G) of points, each with a goal of its own.

    The goal terminates a point's own episode: it then stays and earns nothing.
    The scene's episode ends when all points are done, or after `limit` steps,
    which truncate those that are not. `image` (height, width, channels) adds a camera.
    Arrays have rows N = M * (all G), scene by scene.
    """

    def __init__(
        self,
        num_scenes: int,
        seed: int,
        limit: int = 40,
        beams: int = 32,
        groups: Mapping[str, int] | None = None,
        image: tuple[int, int, int] | None = None,
    ) -> None:
        super().__init__(device="cpu", batch_size=[num_scenes])
        self._limit, self._beams, self._image = limit, beams, image
        counts = dict(groups or {"rover": 1})
        self.group_map = {name: [f"{name}_{i}" for i in range(n)] for name, n in counts.items()}
        self.metric_names = dict.fromkeys(counts, METRIC_NAMES)
        self._agents = sum(counts.values())
        ends = np.cumsum([0, *counts.values()]).tolist()
        self._slices = {name: slice(ends[i], ends[i + 1]) for i, name in enumerate(counts)}
        self._make_specs(counts)
        self._pending: dict[str, Any] | None = None
        self._set_seed(seed)

    def _make_specs(self, counts: Mapping[str, int]) -> None:
        m, pi = self.batch_size[0], torch.pi

        def box(low: list[float], high: list[float], n: int) -> Bounded:
            return Bounded(
                torch.tensor(low).expand(m, n, -1).clone(),
                torch.tensor(high).expand(m, n, -1).clone(),
                dtype=torch.float32,
            )

        observation, action, reward, done = {}, {}, {}, {}
        for name, n in counts.items():
            parts: dict[str, Any] = {
                "lidar": box([0.0] * self._beams, [12.0] * self._beams, n),
                "imu": box([-50.0] * 9, [50.0] * 9, n),
                "goal": box([0.0, -pi], [100.0, pi], n),
                "velocity": box([-1.0, -10.0], [1.0, 10.0], n),
            }
            if self._image is not None:
                parts["camera_rgb"] = Bounded(0, 255, shape=(m, n, *self._image), dtype=torch.uint8)
            observation[name] = Composite(
                observation=Composite(parts, shape=(m, n)),
                metrics=Unbounded((m, n, len(METRIC_NAMES)), dtype=torch.float32),
                shape=(m, n),
            )
            action[name] = Composite(action=box([-0.8, -pi], [0.8, pi], n), shape=(m, n))
            reward[name] = Composite(reward=Unbounded((m, n, 1), dtype=torch.float32), shape=(m, n))
            done[name] = Composite(
                {key: Binary(1, shape=(m, n, 1), dtype=torch.bool) for key in _ENDS}, shape=(m, n)
            )
        root = {key: Binary(1, shape=(m, 1), dtype=torch.bool) for key in _ENDS}
        self.observation_spec = Composite(observation, shape=(m,))
        self.action_spec = Composite(action, shape=(m,))
        self.reward_spec = Composite(reward, shape=(m,))
        self.full_done_spec = Composite({**done, **root}, shape=(m,))

    def _set_seed(self, seed: int | None) -> None:
        m, n = self.batch_size[0], self.batch_size[0] * self._agents
        self._seed = int(seed or 0)
        self._next_id = np.arange(m)
        self._id = np.full(m, -1)
        self._pose = np.zeros((n, 3))
        self._goal = np.zeros((n, 2))
        self._velocity = np.zeros((n, 2))
        self._metrics = np.zeros((n, len(METRIC_NAMES)))
        self._ended = np.zeros((n, 2), bool)
        self._trace: list[list[np.ndarray]] = [[] for _ in range(m)]

    def _begin(self, scene: int, episode: int) -> None:
        draw = stream(self._seed, "point_mass", episode)
        for row in range(scene * self._agents, (scene + 1) * self._agents):
            self._pose[row] = (*draw.uniform(-1, 1, 2), draw.uniform(-np.pi, np.pi))
            self._goal[row] = self._pose[row, :2] + draw.uniform(1.5, 3.0) * np.array(
                [np.cos(angle := draw.uniform(-np.pi, np.pi)), np.sin(angle)]
            )
            values = dict.fromkeys(METRIC_NAMES, 0.0)
            values |= {"episode": episode, "time_to_goal": np.nan, "vort": np.nan, "clearance": 12}
            self._metrics[row] = list(values.values())
            self._velocity[row] = 0
            self._ended[row] = False
        self._id[scene] = episode
        self._next_id[scene] = episode + self.batch_size[0]
        self._trace[scene] = []

    def _bearing(self) -> tuple[np.ndarray, np.ndarray]:
        offset = self._goal - self._pose[:, :2]
        heading = np.arctan2(offset[:, 1], offset[:, 0]) - self._pose[:, 2]
        return np.hypot(offset[:, 0], offset[:, 1]), (heading + np.pi) % (2 * np.pi) - np.pi

    def _pack(self, reward: np.ndarray | None = None) -> TensorDict:
        m = self.batch_size[0]
        distance, heading = self._bearing()
        rows = {
            "goal": np.stack([distance, heading], -1),
            "velocity": self._velocity,
            "metrics": self._metrics,
        }
        rows |= {} if reward is None else {"reward": reward[:, None]}
        values = {key: torch.tensor(value, dtype=torch.float32) for key, value in rows.items()}
        terminated, truncated = torch.tensor(self._ended)[:, :1], torch.tensor(self._ended)[:, 1:]
        values |= {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        by_scene = {key: value.unflatten(0, (m, self._agents)) for key, value in values.items()}
        groups = {name: self._pack_group(by_scene, agents) for name, agents in self._slices.items()}
        done = by_scene["done"].all(1)
        terminated = by_scene["terminated"].all(1)
        root = {"done": done, "terminated": terminated, "truncated": done & ~terminated}
        return TensorDict({**groups, **root}, [m])

    def _pack_group(self, by_scene: Mapping[str, torch.Tensor], agents: slice) -> TensorDict:
        values = {key: value[:, agents] for key, value in by_scene.items()}
        shape = values["goal"].shape[:2]
        observation = {key: values.pop(key) for key in ("goal", "velocity")}
        observation |= {"lidar": torch.full((*shape, self._beams), 12.0), "imu": torch.zeros(*shape, 9)}
        if self._image is not None:
            # Brighter where the goal is nearer, on the side on which it is.
            bright = (255 * torch.exp(-observation["goal"][..., 0])).to(torch.uint8)
            image = bright[..., None, None, None].expand(*shape, *self._image).clone()
            image[..., : self._image[1] // 2, :] *= (observation["goal"][..., 1] > 0)[..., None, None, None]
            observation["camera_rgb"] = image
        return TensorDict({"observation": TensorDict(observation, shape), **values}, shape)

    def _advance(self, action: np.ndarray, scenes: np.ndarray) -> np.ndarray:
        """Move the points of the scenes in the mask `scenes` (M,) that are not done; their rewards (N,)."""
        metrics = self._metrics
        moving = np.repeat(scenes, self._agents) & ~self._ended.any(1)
        before, _ = self._bearing()
        turn = np.clip(action[:, 1], -0.5, 0.5)
        yaw = self._pose[:, 2] + turn
        step = np.stack([np.cos(yaw), np.sin(yaw)], -1) * action[:, :1] * STEP_S
        self._pose[moving] = np.concatenate([self._pose[:, :2] + step, yaw[:, None]], -1)[moving]
        self._velocity[moving] = np.stack([action[:, 0], turn / STEP_S], -1)[moving]
        after, _ = self._bearing()
        reached = (after < GOAL_RADIUS_M) & moving
        terms = {"reward/progress": (before - after) * moving, "reward/goal": reached * 1.0}
        reward = sum(terms.values())
        for name, value in terms.items():
            metrics[:, _COLUMN[name]] += value
        metrics[:, _COLUMN["return"]] += reward
        metrics[:, _COLUMN["steps"]] += moving
        metrics[reached, _COLUMN["success"]] = 1
        metrics[reached, _COLUMN["reached"]] = 1
        metrics[reached, _COLUMN["time_to_goal"]] = (metrics[:, _COLUMN["steps"]] * STEP_S)[reached]
        late = (metrics[:, _COLUMN["steps"]] >= self._limit) & ~reached & moving
        metrics[late, _COLUMN["timeout"]] = 1
        self._ended |= np.stack([reached, late], -1)
        return np.asarray(reward)

    def _reset(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        m = self.batch_size[0]
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if self._pending is not None and mask is None:
            self._repeat(self._pending)
            self._pending = None
        else:
            chosen = np.ones(m, bool) if mask is None else mask.view(m).numpy()
            for scene in np.flatnonzero(chosen):
                self._begin(scene, int(self._next_id[scene]))
        return self._pack()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        m = self.batch_size[0]
        actions = torch.cat([tensordict[group, "action"] for group in self.group_map], 1)
        for scene in range(m):
            self._trace[scene].append(actions[scene].double().numpy())
        return self._pack(self._advance(actions.double().numpy().reshape(-1, 2), np.ones(m, bool)))

    def episode_keys(self) -> tuple[int, np.ndarray]:
        """The seed and the ids (M,) of the present episodes."""
        return self._seed, self._id

    def episode_begins(self, group: str) -> np.ndarray:
        """Whether no step has been made yet, (M, G)."""
        begins = np.array([not trace for trace in self._trace])
        return np.repeat(begins[:, None], len(self.group_map[group]), 1)

    def rest_scenes(self, mask: torch.Tensor) -> None:
        """A point that is done stands still by itself."""

    def state(self) -> dict[str, Any]:
        """Episode ids and the actions since each episode's start."""
        traces = [torch.tensor(np.array(trace).reshape(-1, self._agents, 2)) for trace in self._trace]
        return {"seed": self._seed, "ids": self._id.tolist(), "actions": traces}

    def resume(self, state: dict[str, Any]) -> None:
        """Make the next full reset return to `state`."""
        self._pending = state

    def _repeat(self, state: dict[str, Any]) -> None:
        self._set_seed(state["seed"])
        for scene, episode in enumerate(state["ids"]):
            self._begin(scene, episode)
        lengths = np.array([len(actions) for actions in state["actions"]])
        for k in range(lengths.max(initial=0)):
            action = np.zeros((len(lengths), self._agents, 2))
            for scene in np.flatnonzero(lengths > k):
                action[scene] = state["actions"][scene][k].numpy()
                self._trace[scene].append(action[scene].copy())
            self._advance(action.reshape(-1, 2), lengths > k)


def make_point_mass(num_scenes: int, seed: int) -> PointMass:
    """One point a scene, by a picklable factory, as the trainer wants it."""
    return PointMass(num_scenes, seed)


def make_team(num_scenes: int, seed: int) -> PointMass:
    """Three equal points a scene."""
    return PointMass(num_scenes, seed, groups={"rover": 3})


def make_two_groups(num_scenes: int, seed: int) -> PointMass:
    """A rover and two walkers a scene."""
    return PointMass(num_scenes, seed, groups={"rover": 1, "walker": 2})
