"""A cheap stand-in for the rover's environment, with the same keys, metrics and contract.

A point turns towards a commanded heading and moves at a commanded speed on an
empty plane. It is what the learning code is developed and tested against.
"""

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from dune_rl.seeding import stream

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


class PointMass(EnvBase):
    """M points, each with a goal of its own; the time limit truncates, the goal terminates."""

    metric_names = METRIC_NAMES

    def __init__(self, num_scenes: int, seed: int, limit: int = 40, beams: int = 32) -> None:
        super().__init__(device="cpu", batch_size=[num_scenes])
        self._limit = limit
        self._beams = beams
        m = num_scenes
        pi = torch.pi

        def box(low: list[float], high: list[float]) -> Bounded:
            return Bounded(
                torch.tensor(low).expand(m, -1).clone(),
                torch.tensor(high).expand(m, -1).clone(),
                dtype=torch.float32,
            )

        self.observation_spec = Composite(
            lidar=box([0.0] * beams, [12.0] * beams),
            imu=box([-50.0] * 9, [50.0] * 9),
            goal=box([0.0, -pi], [100.0, pi]),
            velocity=box([-1.0, -10.0], [1.0, 10.0]),
            metrics=Unbounded((m, len(METRIC_NAMES)), dtype=torch.float32),
            shape=(m,),
        )
        self.action_spec = box([-0.8, -pi], [0.8, pi])
        self.reward_spec = Unbounded((m, 1), dtype=torch.float32)
        self.full_done_spec = Composite(
            {key: Binary(1, shape=(m, 1), dtype=torch.bool) for key in ("done", "terminated", "truncated")},
            shape=(m,),
        )
        self._pending: dict[str, Any] | None = None
        self._set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        m = self.batch_size[0]
        self._seed = int(seed or 0)
        self._next_id = np.arange(m)
        self._id = np.full(m, -1)
        self._pose = np.zeros((m, 3))
        self._goal = np.zeros((m, 2))
        self._velocity = np.zeros((m, 2))
        self._metrics = np.zeros((m, len(METRIC_NAMES)))
        self._trace: list[list[torch.Tensor]] = [[] for _ in range(m)]

    def _begin(self, scene: int, episode: int) -> None:
        draw = stream(self._seed, "point_mass", episode)
        self._pose[scene] = (*draw.uniform(-1, 1, 2), draw.uniform(-np.pi, np.pi))
        self._goal[scene] = self._pose[scene, :2] + draw.uniform(1.5, 3.0) * np.array(
            [np.cos(angle := draw.uniform(-np.pi, np.pi)), np.sin(angle)]
        )
        self._velocity[scene] = 0
        self._id[scene] = episode
        self._next_id[scene] = episode + self.batch_size[0]
        self._trace[scene] = []
        row = dict.fromkeys(METRIC_NAMES, 0.0)
        row |= {"episode": episode, "time_to_goal": np.nan, "vort": np.nan, "clearance": 12}
        self._metrics[scene] = list(row.values())

    def _bearing(self) -> tuple[np.ndarray, np.ndarray]:
        offset = self._goal - self._pose[:, :2]
        heading = np.arctan2(offset[:, 1], offset[:, 0]) - self._pose[:, 2]
        return np.hypot(offset[:, 0], offset[:, 1]), (heading + np.pi) % (2 * np.pi) - np.pi

    def _observe(self) -> dict[str, torch.Tensor]:
        m = self.batch_size[0]
        distance, heading = self._bearing()
        return {
            "lidar": torch.full((m, self._beams), 12.0),
            "imu": torch.zeros(m, 9),
            "goal": torch.tensor(np.stack([distance, heading], -1), dtype=torch.float32),
            "velocity": torch.tensor(self._velocity, dtype=torch.float32),
            "metrics": torch.tensor(self._metrics, dtype=torch.float32),
        }

    def _advance(self, action: np.ndarray, moving: np.ndarray) -> np.ndarray:
        """Move the points of the mask `moving` by one step, and give their rewards."""
        column = {name: i for i, name in enumerate(METRIC_NAMES)}
        before, _ = self._bearing()
        turn = np.clip(action[:, 1], -0.5, 0.5)
        yaw = self._pose[:, 2] + turn
        step = np.stack([np.cos(yaw), np.sin(yaw)], -1) * action[:, :1] * STEP_S
        self._pose[moving] = np.concatenate([self._pose[:, :2] + step, yaw[:, None]], -1)[moving]
        self._velocity[moving] = np.stack([action[:, 0], turn / STEP_S], -1)[moving]
        after, _ = self._bearing()
        reached = (after < GOAL_RADIUS_M) & moving
        progress = (before - after) * moving
        terms = {"reward/progress": progress, "reward/goal": reached * 1.0}
        reward = sum(terms.values())
        for name, value in terms.items():
            self._metrics[:, column[name]] += value
        self._metrics[:, column["return"]] += reward
        self._metrics[:, column["steps"]] += moving
        self._metrics[reached, column["success"]] = 1
        self._metrics[reached, column["reached"]] = 1
        self._metrics[reached, column["time_to_goal"]] = (self._metrics[:, column["steps"]] * STEP_S)[reached]
        late = (self._metrics[:, column["steps"]] >= self._limit) & ~reached & moving
        self._metrics[late, column["timeout"]] = 1
        return np.stack([reward, reached, late], -1)

    def _reset(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        m = self.batch_size[0]
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if self._pending is not None and mask is None:
            self._replay(self._pending)
            self._pending = None
        else:
            chosen = np.ones(m, bool) if mask is None else mask.view(m).numpy()
            for scene in np.flatnonzero(chosen):
                self._begin(scene, int(self._next_id[scene]))
        return TensorDict(self._observe(), [m])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        m = self.batch_size[0]
        action = tensordict["action"]
        for scene in range(m):
            self._trace[scene].append(action[scene].clone())
        out = self._advance(action.double().numpy(), np.ones(m, bool))
        terminated = torch.tensor(out[:, 1:2] > 0)
        truncated = torch.tensor(out[:, 2:3] > 0)
        return TensorDict(
            self._observe()
            | {
                "reward": torch.tensor(out[:, :1], dtype=torch.float32),
                "terminated": terminated,
                "truncated": truncated,
                "done": terminated | truncated,
            },
            [m],
        )

    def state(self) -> dict[str, Any]:
        """Episode ids and the actions since each episode's start."""
        traces = [torch.stack(trace) if trace else torch.zeros(0, 2) for trace in self._trace]
        return {"seed": self._seed, "ids": self._id.tolist(), "actions": traces}

    def resume(self, state: dict[str, Any]) -> None:
        """Make the next full reset replay `state`."""
        self._pending = state

    def _replay(self, state: dict[str, Any]) -> None:
        self._set_seed(state["seed"])
        for scene, episode in enumerate(state["ids"]):
            self._begin(scene, episode)
        lengths = np.array([len(actions) for actions in state["actions"]])
        for k in range(lengths.max(initial=0)):
            action = np.zeros((len(lengths), 2))
            for scene in np.flatnonzero(lengths > k):
                self._trace[scene].append(state["actions"][scene][k].clone())
                action[scene] = state["actions"][scene][k].double().numpy()
            self._advance(action, lengths > k)


def make_point_mass(num_scenes: int, seed: int) -> PointMass:
    """A picklable factory, as the trainer wants it."""
    return PointMass(num_scenes, seed)
