"""An agent group: equal agents with one body, one controller, one sensor pass, one task and one set of
metrics.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dune_rl.behaviours.paths.follower import PathConf, PathFollower
from dune_rl.behaviours.trajectory import TrajectoryFollower
from dune_rl.bodies.settings import BodySettings
from dune_rl.env.body import Body
from dune_rl.env.collision_counter import CollisionCounter
from dune_rl.env.controllers import Controller
from dune_rl.env.goals import GoalTracker, PathGoals, Spawners
from dune_rl.env.group_metrics import GroupMetrics
from dune_rl.env.kinematic import KinematicBody
from dune_rl.env.visits import Visits
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.metrics.episode import MetricsConf
from dune_rl.physics.interface import PhysicsRobot
from dune_rl.robots.robot import Robot
from dune_rl.sensors.sensor import Bounds, Reading
from dune_rl.sensors.suite import SensorsConf, SensorSuite
from dune_rl.state.state import EnergyState, GoalState, GroupState, ScanQueries, State
from dune_rl.tasks.presence import PresenceConf
from dune_rl.tasks.task import Endings, Task, TaskConf
from dune_rl.worlds.actor_trajectory import ActorTrajectory

RobotFactory = Callable[[int], Robot]


MakeController = Callable[["AgentGroup"], Controller]


@dataclass(frozen=True)
class GroupSetup:
    """Configuration of an agent group: body, controller, sensors, task and metrics.

    `body` is a factory of a model of N robots, or the settings of a kinematic body. A group without
    `controller` that follows nothing is external: its actions come from a user or a learner. `paths` are the
    paths of kinematic agents; with `follows_paths` the agents walk along them. With `follows_trajectories`
    they walk on `trajectories`, or where these are None on those of their world. A group without `task` has
    rewards of 0 and never ends an episode. With `presence` its agents come and go. `settings` is the path of
    its settings, for errors; empty for robots of `robot` or `robots`. `places` (P, 2) [m] are those to which
    the controller is told to go.
    """

    name: str
    count: int
    body: RobotFactory | BodySettings
    controller: MakeController | None = None
    paths: PathConf | None = None
    follows_paths: bool = False
    follows_trajectories: bool = False
    trajectories: tuple[ActorTrajectory, ...] | None = None
    sensors: SensorsConf | None = None
    task: TaskConf | None = None
    metrics: MetricsConf | None = None
    presence: PresenceConf | None = None
    settings: str = ""
    places: tuple[tuple[float, float], ...] = ()

    @property
    def is_external(self) -> bool:
        """Whether a user or a learner gives the actions."""
        return self.controller is None and not self.is_scripted

    @property
    def is_scripted(self) -> bool:
        """Whether kinematic agents are moved along paths or trajectories, without actions."""
        return self.follows_paths or self.follows_trajectories


@dataclass(frozen=True)
class GroupStep:
    """Rewards and ends of a group's agents after a control step, each (N,).

    `terminated` and `truncated` are the ends of each agent's own episode: they are set from the step in
    which it ends until its scene is reset.
    """

    reward: Floats
    terminated: Flags
    truncated: Flags


@dataclass(frozen=True)
class Evaluation:
    """The rewards (N,) of a control step, and the group's state with renewed goals."""

    reward: Floats
    state: GroupState


class AgentGroup:
    """The agents of one group in M scenes, rows scene after scene: N = M * G.

    An agent that is done before its scene's episode ends stays in the scene: it stands still, its rewards
    are 0, and its metrics do not change. Where agents come and go, `visits` says when; those that are not in
    their scenes count as done, and as truncated if they have not ended otherwise.
    """

    def __init__(
        self,
        setup: GroupSetup,
        body: Body,
        goals: GoalTracker,
        spawners: Spawners,
        num_rows: int,
        collision_gap_steps: int,
        visits: Visits | None = None,
    ) -> None:
        self.setup, self.name, self.count = setup, setup.name, setup.count
        self.body, self.goals, self.spawners, self.visits = body, goals, spawners, visits
        self.suite: SensorSuite | None = None
        self.names = tuple(f"{setup.name}_{agent}" for agent in range(setup.count))
        self.collisions = CollisionCounter(num_rows, collision_gap_steps)
        self.task = None if setup.task is None else Task(setup.task, num_rows)
        self.measured = GroupMetrics(None if self.task is None else setup.metrics, num_rows)
        self.done = np.zeros(num_rows, bool)
        self.terminated = np.zeros(num_rows, bool)
        self.truncated = np.zeros(num_rows, bool)
        low, high = body.action_bounds()
        self.action_bounds = low.astype(np.float32), high.astype(np.float32)
        self.action_size = len(low)
        self.rest_action = body.rest_action()
        self.description = replace(body.description, avoids=not setup.is_scripted)
        self._ends: Endings | None = None
        self.num_rows = num_rows
        self._controller: Controller | None = None
        self.scanner: ScanQueries | None = None

    @property
    def needs_scan(self) -> bool:
        """Whether a term of the task or a metric reads `GroupState.nearest_return`."""
        return self.measured.needs_scan or (self.task is not None and self.task.needs_scan)

    def start_scans(self) -> None:
        """Have states measured by scans from the next one on."""
        if self.scanner is None:
            self.scanner = self._make_scanner()

    def equip(self, suite: SensorSuite | None, make_scanner: Callable[[], ScanQueries]) -> None:
        """Set the sensors and create the controller; called once, after all groups have been built.

        `make_scanner` makes the LiDAR that measures for terms, once a term needs it.
        """
        self.suite, self._make_scanner = suite, make_scanner
        if self.needs_scan:
            self.start_scans()
        by_sensors = suite is not None and suite.needs_joints
        self.body.reads_joints = by_sensors or self.measured.needs_joints
        if self.setup.controller is not None:
            self._controller = self.setup.controller(self)

    @property
    def is_external(self) -> bool:
        """Whether a user or a learner gives the actions."""
        return self.setup.is_external

    @property
    def _reads_goals(self) -> bool:
        return self.task is not None or self.suite is not None or self.setup.controller is not None

    @property
    def ends_episodes(self) -> bool:
        """Whether a scene's episode lasts until all agents of the group are done."""
        return self.task is not None and self.task.has_ends

    @property
    def observation_bounds(self) -> Mapping[str, Bounds]:
        """(low, high) of each observation by name, in order."""
        return {} if self.suite is None else self.suite.bounds

    # -- a new episode ----------------------------------------------------------------------------

    def reset(self, mask: Flags) -> None:
        """Clear the history of the agents in `mask` (N,)."""
        self.body.reset(mask)
        self.collisions.reset(mask)
        for flags in (self.done, self.terminated, self.truncated):
            flags[mask] = False

    def read_start(self, mask: Flags, engines: Sequence[PhysicsRobot], bodies: int) -> None:
        """Read the start states in `mask` (N,) from physics; a scene has at most `bodies` bodies."""
        self.collisions.make_room(bodies)
        self.body.read_start(mask, engines)
        if self.visits is not None:
            self.truncate(mask & self.visits.absent)

    def begin(self, mask: Flags, state: State) -> None:
        """Start task, metrics, sensors and controller of the agents in `mask` (N,) at `state`."""
        now = state.groups[self.name]
        if self.task is not None:
            self.task.reset(mask, now)
        self.measured.reset(mask, now)
        if self.visits is not None:
            self.measured.clear(mask & self.visits.absent)
        if self.suite is not None:
            self.suite.begin(mask, now, state)
        if self._controller is not None:
            self._controller.reset(mask, now)

    # -- a step -----------------------------------------------------------------------------------

    def act(self, actions: Array | None, state: State, engines: Sequence[PhysicsRobot]) -> None:
        """Command the bodies for a control step, by `actions` (N, A) of an external group or by the
        controller.
        """
        now = state.groups[self.name]
        if self.setup.is_scripted and isinstance(self.body, KinematicBody):
            assert isinstance(self.goals.source, PathGoals)
            follower, step_s = self.goals.source.follower, now.episode.step_s
            timed = isinstance(follower, TrajectoryFollower)
            self.body.move_to(follower.advance(step_s if timed else self.body.limits.max_speed_mps * step_s))
            return
        if self._controller is not None:
            actions = self._controller.act(state, now, self.observe)
        assert actions is not None
        if self.done.any():
            # Behaviours may leave the last numbers out.
            rest = self.rest_action[: actions.shape[1]]
            actions = np.where(self.done[:, None], rest, actions)
        known = now.motion if self.suite is None else self.suite.controller_motion(now)
        self.body.command(actions, known, engines)

    def hold_back(self, scenes: NDArray[np.int64], poses: Array) -> None:
        """Set the kinematic bodies of `scenes` (S,) to `poses` (S, G, 6), where robots blocked them."""
        assert isinstance(self.body, KinematicBody)
        self.body.hold_back(scenes, poses)
        if self.setup.is_scripted:
            assert isinstance(self.goals.source, PathGoals)
            follower = self.goals.source.follower
            if self.visits is not None:
                assert isinstance(follower, PathFollower), "trajectories have times of their own"
                absent = self.visits.absent.reshape(-1, self.count)[scenes]
                poses = np.where(absent[..., None], follower.targets(scenes), poses[..., :4])
            follower.hold_back(scenes, poses)

    def read(self, engines: Sequence[PhysicsRobot]) -> list[tuple[int, int]]:
        """Read the bodies' states after a physics step; returns contacts as pairs of row and body number."""
        return self.body.read(engines)

    @property
    def energy(self) -> EnergyState | None:
        """Motor work in the last control step, and the battery; None unless it is measured."""
        return self.body.energy

    def measure_goals(self) -> GoalState:
        """Distances and bearings of the goals after a step; not updated if nothing reads them."""
        return self.goals.measure(self.body.motion) if self._reads_goals else self.goals.latest

    def find_endings(self, state: State) -> Mapping[str, Flags]:
        """The flags (N,) of each termination term of the task by name, after a control step."""
        if self.task is None:
            return {}
        self._ends = self.task.end(state, state.groups[self.name])
        return self._ends.by_term

    def evaluate(self, state: State) -> Evaluation:
        """Evaluate the task's terms and the metrics of the step that `state` describes."""
        now = state.groups[self.name]
        if self.task is None or self._ends is None:
            return Evaluation(np.zeros(len(self.done), np.float32), now)
        ends = self._ends
        reward = self.task.reward(state, now)
        self.measured.update(state, now, reward)
        renews = ends.renews & ~self.done
        if renews.any():
            now = replace(now, goal=self.goals.renew(renews, now.motion, now.goal))
        ended = ~self.done & (ends.terminated | ends.truncated)
        if ended.any():
            self.terminated |= ended & ends.terminated
            self.truncated |= ended & ~ends.terminated
            self.done |= ended
        return Evaluation(reward.astype(np.float32), now)

    def truncate(self, mask: Flags) -> None:
        """Truncate the agents in `mask` (N,) that have not terminated: their scene's episode, or visit, is
        over.
        """
        self.truncated |= mask & ~self.terminated
        self.done |= mask

    def admit(self, mask: Flags) -> None:
        """Let the agents in `mask` (N,), who have just come, take part from the next step on."""
        for flags in (self.done, self.terminated, self.truncated):
            flags[mask] = False

    def own_steps(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Control steps (N,) of each agent, of those of the scenes, (M,)."""
        rows = steps if self.count == 1 else np.repeat(steps, self.count)
        return rows if self.visits is None else self.visits.own_steps(rows)

    @property
    def is_there_at_start(self) -> bool:
        """Whether all agents are in their scenes when an episode starts."""
        return self.setup.presence is None or self.setup.presence.is_from_the_start

    def agents_of(self, scene: int) -> list[int]:
        """Numbers of the agents of a scene that are there."""
        if self.visits is None:
            return list(range(self.count))
        rows = slice(scene * self.count, (scene + 1) * self.count)
        return np.flatnonzero(~self.visits.absent[rows]).tolist()

    @property
    def absent(self) -> Flags | None:
        """Flags (N,) of agents that are not in their scenes; None where agents do not come and go."""
        return None if self.visits is None else self.visits.absent.copy()

    def sense(self, state: State) -> None:
        """Read the sensors at the end of a control step."""
        if self.suite is not None:
            self.suite.measure(state.groups[self.name], state)

    # -- observations and metrics -----------------------------------------------------------------

    def observe(self) -> dict[str, Reading]:
        """Observations by sensor name, each (N, ...). Repeated calls return the same values."""
        return {} if self.suite is None else self.suite.observe()

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the columns of `metrics`."""
        if self.measured.own is None or self.task is None:
            return ()
        return (*self.measured.own.names, *self.task.reward_names)

    def metrics(self) -> list[Array]:
        """Metrics of the present episodes so far: arrays (N, ...) whose concatenation has the columns
        `metric_names`; final for agents that are done.
        """
        if self.measured.own is None or self.task is None:
            return []
        sums = self.task.reward_sums
        if self.visits is not None:
            sums = np.where(self.visits.came[:, None], sums, np.nan)
        return [self.measured.own.values, sums]
