"""Records of episodes beside their metrics: start, goal, and by option every step."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase

from dune_rl.env.simulation import VectorSimulation
from dune_rl.learning.measures import MetricsRow

StepRow = dict[str, Any]
START_COLUMNS = ("start_x_m", "start_y_m", "start_yaw_rad", "goal_x_m", "goal_y_m")


class EpisodeRecorder:
    """Adds start and goal to the rows of episodes, and collects their steps, if `steps`.

    `take_steps` returns and forgets the steps of finished episodes.
    """

    def __init__(self, simulation: VectorSimulation, *, steps: bool) -> None:
        self._simulation, self._keeps_steps = simulation, steps
        self._groups = simulation.external
        self._starts: dict[str, NDArray[np.float64]] = {}
        self._steps: list[list[StepRow]] = [[] for _ in range(simulation.num_scenes)]
        self._finished: list[StepRow] = []

    def begin(self) -> None:
        """Note starts and goals of scenes that have made no step."""
        fresh = self._simulation.steps == 0
        for group in self._groups:
            state = self._simulation.state.groups[group.name]
            found = np.column_stack(
                [state.motion.position_w[:, :2], state.motion.yaw, state.goal.position_w]
            ).reshape(len(fresh), group.count, -1)
            before = self._starts.get(group.name, found)
            self._starts[group.name] = np.where(fresh[:, None, None], found, before)
        for scene in np.flatnonzero(fresh).tolist():
            self._steps[scene] = []

    def step(self, after: TensorDictBase) -> None:
        """Note the step, before scenes that are done are reset."""
        if self._keeps_steps:
            for group in self._groups:
                self._record(group.name, group.names, after)

    def _record(self, name: str, agents: tuple[str, ...], after: TensorDictBase) -> None:
        state = self._simulation.state.groups[name]
        motion = state.motion
        columns = {
            "episode": state.episode.ids,
            "step": state.episode.steps,
            "time_s": state.episode.steps * state.episode.step_s,
            "x_m": motion.position_w[:, 0],
            "y_m": motion.position_w[:, 1],
            "z_m": motion.position_w[:, 2],
            "roll_rad": motion.roll_pitch_yaw[:, 0],
            "pitch_rad": motion.roll_pitch_yaw[:, 1],
            "yaw_rad": motion.yaw,
            "speed_mps": motion.velocity_b[:, 0],
            "yaw_rate_radps": motion.angular_b[:, 2],
            "goal_x_m": state.goal.position_w[:, 0],
            "goal_y_m": state.goal.position_w[:, 1],
            "goal_distance_m": state.goal.distance,
            "clearance_m": state.clearance,
            "collisions_so_far": state.contacts.total,
            "reward": after["next", name, "reward"].flatten().numpy(),
        }
        actions = after[name, "action"].flatten(0, 1).numpy()
        columns |= {f"action_{index}": actions[:, index] for index in range(actions.shape[1])}
        lists = {key: values.tolist() for key, values in columns.items()}
        for row in np.flatnonzero(~state.done).tolist():
            scene, agent = divmod(row, len(agents))
            values = {key: each[row] for key, each in lists.items()}
            self._steps[scene].append({"agent": agents[agent], **values})

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """Add start and goal to the rows of an episode that has ended."""
        episode = int(next(iter(rows.values()))[0]["episode"])
        (scene,) = np.flatnonzero(self._simulation.episodes == episode).tolist()
        for group, agents in rows.items():
            for row, start in zip(agents, self._starts[group][scene].tolist(), strict=True):
                row.update(dict(zip(START_COLUMNS, start, strict=True)))
        self._finished += self._steps[scene]
        self._steps[scene] = []

    def take_steps(self) -> list[StepRow]:
        """The steps of the episodes that have ended since the last call."""
        found, self._finished = self._finished, []
        return found
