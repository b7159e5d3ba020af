"""Records of episodes beside their metrics: start, goal, the way between them, and by option their steps."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField
from dune_rl.state.state import GroupState
from dune_rl.statistics.measures import MetricsRow

StepRow = dict[str, Any]
START_COLUMNS = (
    *("start_x_m", "start_y_m", "start_yaw_rad", "goal_x_m", "goal_y_m"),
    *("goal_distance_m", "slope_deg"),
)
# Distance of the points at which the slope is looked up on the line from start to goal, at most.
_SLOPE_STEP_M = 0.1


def steepest_slope_deg(terrain: HeightField, start: Array, goal: Array) -> Array:
    """Largest slope [degrees], (A,), on the straight lines from `start` (A, 2) to `goal` (A, 2) [m].

    The slope of the ground, in whichever direction it is steepest, is looked up at both ends and at points
    between them that are equally far apart, at most 0.1 m. The parts of a line outside the terrain count as
    its edge.
    """
    counts = 1 + np.maximum(1, np.ceil(np.linalg.norm(goal - start, axis=-1) / _SLOPE_STEP_M).astype(int))
    # Each line has points of its own, so that its slope does not depend on other agents.
    lines = [np.linspace(first, last, n) for first, last, n in zip(start, goal, counts, strict=True)]
    return np.rad2deg([terrain.slope(points).max() for points in lines])


class EpisodeRecorder:
    """Adds start and goal to the rows of episodes, and collects their steps.

    `steps` says which: none (False), all (True), or each N-th and the last (N). With `actors` there is a row
    for each agent that a controller of its own drives, such as walkers, too; it has a pose and a speed alone.
    `take_steps` returns and forgets the steps of finished episodes.
    """

    def __init__(self, simulation: VectorSimulation, *, steps: bool | int, actors: bool = False) -> None:
        self._simulation, self._every = simulation, int(steps)
        self._groups = simulation.external
        self._actors = tuple(group for group in simulation.groups if not group.is_external) if actors else ()
        self._starts: dict[str, Array] = {}
        self._steps: list[list[StepRow]] = [[] for _ in range(simulation.num_scenes)]
        self._finished: list[StepRow] = []
        self._ended = np.zeros(simulation.num_scenes, bool)

    def begin(self) -> None:
        """Note starts and goals of scenes that have made no step."""
        fresh = self._simulation.steps == 0
        for group in self._groups:
            self._note_starts(group, np.repeat(fresh, group.count))
        for scene in np.flatnonzero(fresh).tolist():
            self._steps[scene] = []
        self._ended[fresh] = False

    def _note_starts(self, group: AgentGroup, chosen: Flags) -> None:
        """Note where the agents in `chosen` (N,) are and are to go."""
        state = self._simulation.state.groups[group.name]
        found = np.column_stack([state.motion.position_w[:, :2], state.motion.yaw, state.goal.position_w])
        before = self._starts.get(group.name, found)
        self._starts[group.name] = np.where(chosen[:, None], found, before)

    def step(self, after: TensorDictBase) -> None:
        for group in self._groups:
            state = self._simulation.state.groups[group.name]
            if state.absent is not None:
                self._note_starts(group, ~state.absent & (state.episode.steps == 0))
        if not self._every:
            return
        over = after["next", "done"].reshape(-1).numpy()
        # Nobody asks for more of scenes whose last episode has ended. They may have ended in this very step,
        # between two control steps of a held action.
        goes_on = ~self._ended
        due = ((self._simulation.steps % self._every == 0) | over) & goes_on
        self._ended |= over
        for group in self._groups:
            state = self._simulation.state.groups[group.name]
            before, now = (part[group.name, "done"].flatten().numpy() for part in (after, after["next"]))
            # An agent's own last step is kept as well, while its scene goes on.
            chosen = (np.repeat(due, group.count) | now) & ~before
            # It makes no step in the one in which it comes.
            chosen &= np.repeat(goes_on, group.count) & (state.episode.steps > 0)
            self._record(group.names, chosen, self._columns(state) | _task_columns(state, after))
        for group in self._actors:
            state = self._simulation.state.groups[group.name]
            self._record(group.names, np.repeat(due, group.count) & ~state.done, self._columns(state))

    def _record(self, agents: tuple[str, ...], chosen: Flags, columns: Mapping[str, NDArray[Any]]) -> None:
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        lists = {key: values[rows].tolist() for key, values in columns.items()}
        for index, row in enumerate(rows.tolist()):
            scene, agent = divmod(row, len(agents))
            values = {key: each[index] for key, each in lists.items()}
            self._steps[scene].append({"agent": agents[agent], **values})

    def _columns(self, state: GroupState) -> dict[str, NDArray[Any]]:
        """The columns of every agent, (N,) each; steps and times count from its episode's start."""
        motion, steps = state.motion, np.repeat(self._simulation.steps, state.count)
        return {
            "episode": state.episode.ids,
            "step": steps,
            "time_s": steps * state.episode.step_s,
            "x_m": motion.position_w[:, 0],
            "y_m": motion.position_w[:, 1],
            "z_m": motion.position_w[:, 2],
            "roll_rad": motion.roll_pitch_yaw[:, 0],
            "pitch_rad": motion.roll_pitch_yaw[:, 1],
            "yaw_rad": motion.yaw,
            "speed_mps": motion.velocity_b[:, 0],
            "yaw_rate_radps": motion.angular_b[:, 2],
        }

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """Add start, goal and what is between them to the rows of an episode that has ended."""
        episode = int(next(iter(rows.values()))[0]["episode"])
        (scene,) = np.flatnonzero(self._simulation.episodes == episode).tolist()
        terrain = self._simulation.worlds.worlds[scene].terrain
        for group, agents in rows.items():
            starts = self._starts[group].reshape(len(self._steps), -1, 5)[scene]
            ways = starts[:, 3:] - starts[:, :2]
            slopes = steepest_slope_deg(terrain, starts[:, :2], starts[:, 3:])
            found = np.column_stack([starts, np.linalg.norm(ways, axis=1), slopes])
            for row in agents:
                row.update(dict(zip(START_COLUMNS, found[int(row["agent"])].tolist(), strict=True)))
        self._finished += self._steps[scene]
        self._steps[scene] = []

    def take_steps(self) -> list[StepRow]:
        """The steps of the episodes that have ended since the last call."""
        found, self._finished = self._finished, []
        return found


def _task_columns(state: GroupState, after: TensorDictBase) -> dict[str, NDArray[Any]]:
    """What agents with a task and actions have besides, (N,) each."""
    actions = after[state.name, "action"].flatten(0, 1).numpy()
    return {
        "goal_x_m": state.goal.position_w[:, 0],
        "goal_y_m": state.goal.position_w[:, 1],
        "goal_distance_m": state.goal.distance,
        "clearance_m": state.clearance,
        "collisions_so_far": state.contacts.total,
        "reward": after["next", state.name, "reward"].flatten().numpy(),
    } | {f"action_{index}": actions[:, index] for index in range(actions.shape[1])}
