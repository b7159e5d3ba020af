"""An agent group: equal agents with one body, one controller, one sensor pass, one task and one set of
metrics.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dune_rl.behaviours.drivers.context import DriverContext, Forecast
from dune_rl.behaviours.drivers.shield import Shield
from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.bodies.settings import BodySettings
from dune_rl.core.errors import ConfigError
from dune_rl.env.body import Body
from dune_rl.env.collision_counter import CollisionCounter
from dune_rl.env.controllers import Controller
from dune_rl.env.goal_tracker import GoalTracker
from dune_rl.env.group_metrics import GroupMetrics
from dune_rl.env.presence import PresenceSchedule
from dune_rl.env.starts.region import Spawners
from dune_rl.env.starts.source import StartSource, Taken
from dune_rl.geometry.arrays import Array, Counts, Flags, Floats
from dune_rl.metrics.episode import MetricsConf, MetricSet
from dune_rl.robots.robot import Robot
from dune_rl.sensors.sensor import Bounds, Reading
from dune_rl.sensors.settings import SensorSettings
from dune_rl.sensors.suite import SensorSuite
from dune_rl.state.state import GoalState, GroupState, ScanQueries, State
from dune_rl.tasks.presence import PresenceConf
from dune_rl.tasks.spawn import Placement
from dune_rl.tasks.task import Endings, Task, TaskConf
from dune_rl.worlds.actor_trajectory import ActorTrajectory

_SPEED_AND_HEADING = 2

RobotFactory = Callable[[int], Robot]

MakeController = Callable[["AgentGroup"], Controller]


@dataclass(frozen=True)
class FileTrajectories:
    """The trajectories that agents are moved on; None: those of their world's file."""

    given: tuple[ActorTrajectory, ...] | None = None


@dataclass(frozen=True)
class GroupSetup:
    """Configuration of an agent group: body, controller, sensors, task and metrics.

    `body` is a factory of a model of N robots, or the settings of a kinematic body. Kinematic agents with a
    `path` start on it; if the group `is_scripted` they are moved along it, without actions. A group that is
    not, and has no `controller`, is external: its actions come from a user or a learner. A group without
    `task` has rewards of 0 and never ends an episode. With `presence` its agents come and go. `settings` is
    the path of its settings, for errors. `places` (P, 2) [m] are those to which the controller is told to go.
    With `is_shielded`, commands that would touch what the LiDAR sees are braked or turned (`Shield`).
    """

    name: str
    count: int
    body: RobotFactory | BodySettings
    controller: MakeController | None = None
    path: PathConf | FileTrajectories | None = None
    is_scripted: bool = False
    sensors: Mapping[str, SensorSettings] | None = None
    task: TaskConf | None = None
    metrics: MetricsConf | None = None
    presence: PresenceConf | None = None
    settings: str = ""
    places: tuple[tuple[float, float], ...] = ()
    is_shielded: bool = False

    @property
    def is_external(self) -> bool:
        """Whether a user or a learner gives the actions."""
        return self.controller is None and not self.is_scripted


@dataclass(frozen=True)
class GroupStep:
    """Rewards and ends of a group's agents after a control step, each (N,).

    `terminated` and `truncated` are the ends of each agent's own episode: they are set from the step in
    which it ends until its scene is reset, or the agent comes into its scene.
    """

    reward: Floats
    terminated: Flags
    truncated: Flags


class AgentGroup:
    """The agents of one group in M scenes, rows scene after scene: N = M * G.

    A control step enters it once for each phase: `leave`, `command`, `body.read`, `measure_goals` and
    `find_endings` (for the state), `evaluate`, `sense`.

    An agent that is done before its scene's episode ends stays in the scene: it stands still, its rewards
    are 0, and its metrics do not change. Where agents come and go, `presence` says when; absent agents count
    as done, and as truncated if they have not ended otherwise.
    """

    def __init__(
        self,
        setup: GroupSetup,
        body: Body,
        starts: StartSource,
        spawners: Spawners,
        num_rows: int,
        collision_gap_steps: int,
        presence: PresenceSchedule | None = None,
    ) -> None:
        self.setup, self.name, self.count = setup, setup.name, setup.count
        self.body, self.starts, self.spawners, self.presence = body, starts, spawners, presence
        self.goals = GoalTracker(starts, num_rows)
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
        self.last_action = np.zeros((num_rows, self.action_size))
        self.description = replace(body.description, avoids=not setup.is_scripted)
        self.num_rows = num_rows
        self.scanner: ScanQueries | None = None
        self.controller: Controller | None = None
        self._shield: Shield | None = None
        self._ends: Endings | None = None
        self._arrived = np.zeros(num_rows, bool)

    @property
    def needs_scan(self) -> bool:
        """Whether a term of the task or a metric reads `GroupState.nearest_return`."""
        return self.measured.needs_scan or (self.task is not None and self.task.needs_scan)

    def start_scans(self) -> None:
        """Have states measured by scans from the next one on."""
        if self.scanner is None:
            self.scanner = self._make_scanner()

    def equip(
        self, suite: SensorSuite | None, make_scanner: Callable[[], ScanQueries], forecast: Forecast
    ) -> None:
        """Set the sensors and create the controller; called once, after all groups have been built.

        `make_scanner` makes the LiDAR that measures for terms, once a term needs it; `forecast` tells drivers
        where the neighbours will be.
        """
        self.suite, self._make_scanner, self.forecast_neighbours = suite, make_scanner, forecast
        if self.needs_scan:
            self.start_scans()
        readers = (suite, self.task, self.measured)
        self.body.reads_joints = any(reader is not None and reader.needs_joints for reader in readers)
        if self.setup.controller is not None:
            self.controller = self.setup.controller(self)
        if self.setup.is_shielded:
            self._shield = Shield(self.num_rows)
            self.bind(self._shield, "shield=brake")

    @property
    def has_speed_and_heading(self) -> bool:
        """Whether these are the numbers of an action."""
        return self.action_size == _SPEED_AND_HEADING

    def bind(self, behaviour: object, name: str) -> None:
        """Bind a behaviour to the group if it wants that; raises ConfigError if it cannot drive here."""
        bind = getattr(behaviour, "bind", None)
        if bind is None:
            return
        if not self.has_speed_and_heading:
            raise ConfigError(
                f"{name} cannot act for the group {self.name}: it outputs a speed and a heading, and the "
                f"action has {self.action_size} components; choose another robot.action"
            )
        context = DriverContext(
            self.name, self.body.vehicle(), None, self.observe, forecast=self.forecast_neighbours
        )
        if self.suite is not None:
            lidar, sensor_of = self.suite.settings_of("lidar"), self.suite.sensors.get
            context = replace(context, lidar=lidar, sensor_of=sensor_of)
        bind(context)

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
        self.last_action = np.where(mask[:, None], 0.0, self.last_action)
        for flags in (self.done, self.terminated, self.truncated):
            flags[mask] = False

    def place(self, scene: int, poses: Array) -> None:
        """Put the bodies of a scene at `poses` (G, 4: x, y, z, yaw); absent ones are parked."""
        if self.starts.faces_free_way:
            poses = self.body.turned_to_free_way(scene, poses)
        self.body.place(scene, poses)
        if self.presence is not None:
            rows = scene * self.count + np.arange(self.count)
            self._park(rows[self.presence.absent[rows]])

    def _park(self, rows: Counts) -> None:
        """Park the agents in `rows` (K,), with goals where they are: nothing is left of earlier ones."""
        self.body.park(rows)
        self.starts.set_goals(rows, self.body.poses[rows, :2])

    def read_start(self, mask: Flags, bodies: int) -> None:
        """Read the start states in `mask` (N,) from physics; a scene has at most `bodies` bodies."""
        self.collisions.make_room(bodies)
        self.body.read_start(mask)
        if self.presence is not None:
            self.truncate(mask & self.presence.absent)

    def begin(self, mask: Flags, state: State) -> None:
        """Start task, metrics, sensors and controller of the agents in `mask` (N,) at `state`."""
        now = state.groups[self.name]
        if self.task is not None:
            self.task.reset(mask, now)
        self.measured.reset(mask, now)
        if self.presence is not None:
            self.measured.clear(mask & self.presence.absent)
        if self.suite is not None:
            self.suite.begin(mask, now, state)
        if self.controller is not None:
            self.controller.reset(mask, now)
        if self._shield is not None:
            self._shield.reset(mask)

    # -- the phases of a control step -------------------------------------------------------------

    def leave(self) -> None:
        """Take the agents that are done out of their scenes, where agents come and go."""
        if self.presence is None:
            return
        gone = self.done & ~self.presence.absent
        if gone.any():
            self.presence.leave(gone)
            rows = np.flatnonzero(gone)
            self._park(rows)
            self.body.teleport(rows)

    def command(self, actions: Array | None, state: State) -> None:
        """Command the bodies for a control step, by `actions` (N, A) of an external group or by the
        controller, which decides on the `state` of the step before.
        """
        now = state.groups[self.name]
        if self.controller is not None:
            actions = self.controller.act(state, now, self.observe)
        assert actions is not None
        if not self.setup.is_scripted and self.done.any():
            # Behaviours may leave the last numbers out.
            rest = self.rest_action[: actions.shape[1]]
            actions = np.where(self.done[:, None], rest, actions)
        if not self.setup.is_scripted:
            self.last_action = self._normalized(actions)
        if self._shield is not None:
            checked = self._shield.check(actions, now.episode.step_s)
            actions = np.where(self.done[:, None], actions, checked)
        known = now.motion if self.suite is None else self.suite.controller_motion(now)
        self.body.command(actions, known)

    def _normalized(self, actions: Array) -> Array:
        """`actions` (N, a) between their bounds, -1 to 1, (N, A); 0 where a behaviour leaves numbers out."""
        size = actions.shape[1]
        low, high = (each[:size] for each in self.body.action_bounds())
        normalized = np.zeros((self.num_rows, self.action_size))
        shares = (2.0 * actions - low - high) / np.maximum(high - low, 1e-12)
        normalized[:, :size] = np.clip(shares, -1.0, 1.0)
        return normalized

    def hold_back(self, scenes: Counts, poses: Array) -> None:
        """Set the bodies of `scenes` (S,) to `poses` (S, G, 6), where robots blocked them."""
        self.body.hold_back(scenes, poses)
        self.starts.hold_back(scenes, poses, None if self.presence is None else self.presence.absent)

    def due(self, steps: Counts) -> list[int]:
        """Rows of agents that are to come after a control step; `steps` (M,) are the scenes'."""
        return [] if self.presence is None else self.presence.due(np.repeat(steps, self.count))

    def come(self, row: int, pose: Array, step: int) -> None:
        """Put an absent agent at `pose` (4: x, y, z, yaw), at the end of a `step` of its scene."""
        assert self.presence is not None
        self.body.come(row, pose)
        self.presence.admit(row, step)
        self._arrived[row] = True

    def begin_arrivals(self) -> None:
        """Begin the states of the agents that came in this step."""
        if self.presence is not None and self._arrived.any():
            self.body.teleport(np.flatnonzero(self._arrived))
            self.collisions.reset(self._arrived)
            self.last_action = np.where(self._arrived[:, None], 0.0, self.last_action)
            self.body.read_start(self._arrived)
            self.goals.begin(self._arrived, self.body.motion)

    def measure_goals(self) -> GoalState:
        """Distances and bearings of the goals after a step; not updated if nothing reads them."""
        return self.goals.measure(self.body.motion) if self._reads_goals else self.goals.latest

    def find_endings(self, state: State) -> Mapping[str, Flags]:
        """The flags (N,) of each termination term of the task by name, after a control step."""
        if self.task is None:
            return {}
        self._ends = self.task.end(state, state.groups[self.name])
        return self._ends.by_term

    def evaluate(self, state: State) -> tuple[Floats, GroupState]:
        """Reward (N,) of the step that `state` describes, and the group's state with which the next begins.

        It differs where goals are renewed or agents have come. Adds the step to the metrics.
        """
        now = state.groups[self.name]
        reward = np.zeros(self.num_rows, np.float32)
        if self.task is not None and self._ends is not None:
            values = self.task.reward(state, now)
            self.measured.update(state, now, values)
            now = self._end(self._ends, now)
            reward = values.astype(np.float32)
        if self.presence is not None:
            now = self._exchange(self.presence, now)
        return reward, now

    def _end(self, ends: Endings, now: GroupState) -> GroupState:
        """Note which agents are done, and renew goals that are reached."""
        renews = ends.renews & ~self.done
        if renews.any():
            now = replace(now, goal=self.goals.renew(renews, now.motion, now.goal))
        ended = ~self.done & (ends.terminated | ends.truncated)
        if ended.any():
            self.terminated |= ended & ends.terminated
            self.truncated |= ended & ~ends.terminated
            self.done |= ended
        return now

    def _exchange(self, presence: PresenceSchedule, now: GroupState) -> GroupState:
        """Truncate the agents whose time is over, and let the agents that have come take part."""
        self.truncate(presence.leaving(now.episode.steps) & ~self.done)
        if not self._arrived.any():
            return now
        for flags in (self.done, self.terminated, self.truncated):
            flags[self._arrived] = False
        return replace(now, done=now.done & ~self._arrived)

    def truncate(self, mask: Flags) -> None:
        """Truncate the agents in `mask` (N,) that have not terminated: their scene's episode, or visit, is
        over.
        """
        self.truncated |= mask & ~self.terminated
        self.done |= mask

    def sense(self, state: State) -> None:
        """Read the sensors at the end of a control step, and begin the episodes of agents that have come."""
        if self.suite is not None:
            self.suite.measure(state.groups[self.name], state)
        if self.presence is not None and self._arrived.any():
            self.begin(self._arrived, state)
            self._arrived = np.zeros(self.num_rows, bool)

    # -- presence ---------------------------------------------------------------------------------

    def own_steps(self, steps: Counts) -> Counts:
        """Control steps (N,) of each agent, of those of the scenes, (M,)."""
        rows = steps if self.count == 1 else np.repeat(steps, self.count)
        return rows if self.presence is None else self.presence.own_steps(rows)

    @property
    def is_there_at_start(self) -> bool:
        """Whether all agents are in their scenes when an episode starts."""
        return self.setup.presence is None or self.setup.presence.is_from_the_start

    def agents_of(self, scene: int) -> list[int]:
        """Numbers of the agents of a scene that are there."""
        if self.presence is None:
            return list(range(self.count))
        rows = slice(scene * self.count, (scene + 1) * self.count)
        return np.flatnonzero(~self.presence.absent[rows]).tolist()

    @property
    def absent(self) -> Flags | None:
        """Flags (N,) of agents that are not in their scenes; None where agents do not come and go."""
        return None if self.presence is None else self.presence.absent.copy()

    def placement(self, scene: int, agent: int) -> Taken:
        """Where an agent is and goes to, and the radius of a disc that holds it [m]."""
        row = scene * self.count + agent
        x, y, _, yaw = self.body.poses[row, :4].tolist()
        goal_x, goal_y = self.starts.goals_w[row].tolist()
        return Placement(x, y, yaw, goal_x, goal_y), self.description.reach_m

    # -- observations and metrics -----------------------------------------------------------------

    def add_metrics(self, conf: MetricsConf, now: GroupState | None) -> MetricSet:
        """Measure `conf` of the episodes as well, from `now` on or, without it, from the next ones on.

        Equal settings share one set. Raises ConfigError without a task.
        """
        if self.task is None:
            raise ConfigError(f"{self.name} has no task, so it has no episodes to measure: give it one")
        found = self.measured.add(conf, now)
        self.body.reads_joints |= found.needs_joints
        if found.needs_scan:
            self.start_scans()
        return found

    @property
    def privileged(self) -> frozenset[str]:
        """Names of the readings that critics alone may use."""
        return frozenset() if self.suite is None else self.suite.privileged

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
        if self.presence is not None:
            sums = np.where(self.presence.came[:, None], sums, np.nan)
        return [self.measured.own.values, sums]
