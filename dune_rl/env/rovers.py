"""The robots of one kind, one in each scene: what they do, sense and earn, and when they are done."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.env.drag import drag_forces
from dune_rl.env.encounters import Encounters
from dune_rl.env.latency import Latency
from dune_rl.env.motion import Motion
from dune_rl.env.traction import Traction
from dune_rl.metrics.episode import EpisodeMetrics, MetricsConf
from dune_rl.physics.interface import PhysicsConf, PhysicsRobot
from dune_rl.robots.robot import Robot
from dune_rl.sensors.imu import Imu
from dune_rl.sensors.sensor import Reading
from dune_rl.sensors.suite import SensorSuite
from dune_rl.state import ContactState, EpisodeState, GoalState, GroupState, State
from dune_rl.tasks.point_goal import PointGoalConf
from dune_rl.tasks.rewards import REWARD_TERMS, reward_terms
from dune_rl.tasks.snapshot import Snapshot
from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.tasks.terminations import Endings, endings
from dune_rl.worlds.batched_worlds import BatchedWorlds

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

# A new touch of the same body counts as a new encounter after this long without one.
_ENCOUNTER_GAP_S = 1.0
_EDGE_M = 0.3
_GOAL_TRIES = 16


@dataclass(frozen=True)
class RoverOutcome:
    """What a step gives a scene's robot of one kind, each (M,)."""

    reward: Floats
    terminated: Flags
    truncated: Flags


class Rovers:
    """M robots of a kind, one in each scene, each with a goal of its own.

    `engines` are what physics has of them, which the owner gives. A robot that is done
    waits for the others of its scene where it is one of several (`waits`): it
    stands still, earns nothing, and its metrics are final. `done` (M,) tells.
    `spawner_of` a scene draws goals. Where it `is_late`, commands reach the motors
    as late as `latency` is told.
    """

    def __init__(
        self,
        robot: Robot,
        senses: SensorSuite,
        sites: BatchedWorlds,
        physics: PhysicsConf,
        task: PointGoalConf,
        metrics: MetricsConf,
        *,
        spawner_of: Callable[[int], Spawner],
        bodies: int,
        waits: bool = False,
        is_late: bool = False,
    ) -> None:
        num_scenes = len(sites)
        self.robot, self.senses = robot, senses
        self.motion = Motion(num_scenes, robot)
        self._accelerometer = Imu(senses.conf.imu, num_scenes)
        self.traction = Traction(robot, physics, num_scenes)
        self.latency = Latency(num_scenes, robot.body.rest_commands(), physics.control_hz)
        self._is_late = is_late
        self.goals_w = np.zeros((num_scenes, 2))
        self.engines: Sequence[PhysicsRobot] = ()
        self.touches: list[tuple[int, int]] = []
        self.done = np.zeros(num_scenes, bool)
        self.action_width = len(robot.action_bounds()[0])
        self._sites, self._physics, self._task, self._waits = sites, physics, task, waits
        self._spawner_of = spawner_of
        self._terminated = np.zeros(num_scenes, bool)
        self._metrics = EpisodeMetrics(metrics, num_scenes, robot.battery.capacity_wh)
        self._measures_energy = metrics.energy
        self._encounters = Encounters(num_scenes, bodies, round(_ENCOUNTER_GAP_S * physics.control_hz))
        self._goal_distance = np.zeros(num_scenes)
        self._reward_sums = np.zeros((num_scenes, len(REWARD_TERMS)))
        self._goal_streams: list[np.random.Generator | None] = [None] * num_scenes

    # -- episodes ---------------------------------------------------------------------------------

    def forget(self, mask: Flags, episodes: Counts) -> None:
        """Begin the episodes with ids `episodes` (M,) in the scenes in `mask` (M,): nothing has happened."""
        self.robot.reset(mask)
        self._metrics.reset(mask, episodes)
        self._reward_sums[mask] = 0.0
        self._encounters.begin(mask)
        self.done[mask] = False
        self._terminated[mask] = False

    def set_goal(self, scene: int, placement: Placement, draws: np.random.Generator) -> None:
        """Set a scene's goal; `draws` give those to come."""
        self._goal_streams[scene] = draws
        self.goals_w[scene] = placement.goal_x, placement.goal_y

    def set_row(self, scene: int, engine: PhysicsRobot) -> None:
        """Take the state of a scene's robot in `engine`, after it has settled."""
        if self._measures_energy:
            engine.work_j()
        drive = engine.drive_state() if self.needs_wheels else None
        self.motion.set_row(scene, engine.body_state(), drive)

    def begin(self, mask: Flags, bodies: int) -> None:
        """All scenes in `mask` (M,) have their rows, and at most so many `bodies`."""
        self._encounters.make_room(bodies)
        self.motion.begin(mask)

    def begin_senses(
        self, mask: Flags, neighbours: Array, seed: int, episodes: Counts, steps: Counts
    ) -> None:
        """Read the sensors at the start of the episodes in `mask` (M,)."""
        motion = self.motion
        self._accelerometer.begin(mask, motion.rotation, motion.velocity_w, motion.angular_w)
        distance = self._distance_to_goal()
        self._goal_distance = np.where(mask, distance, self._goal_distance)
        now, state = self._state(neighbours, seed, episodes, steps)
        self.senses.begin(mask, now, state)

    def measure_senses(self, neighbours: Array, seed: int, episodes: Counts, steps: Counts) -> None:
        """Read the sensors at the end of a control step."""
        now, state = self._state(neighbours, seed, episodes, steps)
        self.senses.measure(now, state)

    def _state(
        self, neighbours: Array, seed: int, episodes: Counts, steps: Counts
    ) -> tuple[GroupState, State]:
        distance, zero = self._goal_distance, np.zeros(len(steps), np.int64)
        now = GroupState(
            "rover",
            1,
            EpisodeState(seed, episodes, steps, episodes, self._physics.control_step_s),
            self.motion.true_motion(self._accelerometer.acceleration_b),
            ContactState(zero > 0, zero, zero),
            neighbours,
            self.done,
            lambda: np.full(len(steps), np.inf),
            GoalState(self.goals_w, distance, distance, self.motion.bearing(self.goals_w)),
        )
        return now, State({"rover": now}, self._sites, len(steps))

    # -- a step -----------------------------------------------------------------------------------

    def commands(self, actions: Array, step_s: float) -> list[list[float]]:
        """Commands of the motors, one list for each scene, for `actions` (M, A)."""
        if self._waits:
            actions = np.where(self.done[:, None], self.robot.rest_action(), actions)
        commands = self.robot.commands(actions, self.motion, step_s)
        if self._is_late:
            commands = self.latency.late(commands)
        told: list[list[float]] = commands.tolist()
        return told

    def push(self) -> None:
        """Let grass and soft ground hold the robots back in the next step of physics."""
        force = self._forces()
        if force is not None:
            for engine, pushed in zip(self.engines, force.tolist(), strict=True):
                engine.push(pushed)

    def follow(self) -> None:
        """Take the states and touches of the step that physics has made."""
        needs_wheels = self.needs_wheels
        states, drives = [], []
        self.touches = []
        for scene, engine in enumerate(self.engines):
            states.append(engine.body_state())
            if needs_wheels:
                drives.append(engine.drive_state())
            self.touches += [(scene, body) for body in engine.touched()]
        self.motion.update(np.array(states), np.array(drives) if needs_wheels else None)

    @property
    def needs_wheels(self) -> bool:
        """Whether the wheels' states are to be asked for."""
        return self.senses.needs_joints or self.traction.needs_wheels

    def _forces(self) -> Array | None:
        """What grass and soft ground hold the rovers back with [N], (M, 3), world frame; None: nothing."""
        rolling = self.traction.update(self.engines, self.motion)
        grass = drag_forces(self._sites, self.motion, self.robot)
        if rolling is None or grass is None:
            return grass if rolling is None else rolling
        return rolling + grass

    def judge(self, steps: Counts, clearance: Array) -> tuple[Snapshot, Endings, Floats]:
        """What the control step that physics has made comes to: rewards (M,), and all they follow from.

        `steps` (M,) have been made in each episode; `clearance` (M,) is that of
        `Batch.clearance`, and becomes 0 where something is touched.
        """
        motion = self.motion
        self._accelerometer.measure(
            motion.rotation, motion.velocity_w, motion.angular_w, self._physics.control_step_s
        )
        now = self._snapshot(steps, clearance)
        end = endings(now, self._task.termination)
        terms = reward_terms(now, self._task.reward, end.reached, end.stuck, end.flipped)
        over = self.done if self._waits and self.done.any() else None
        if over is not None:
            terms[over] = 0.0
        rewards = terms.sum(axis=1)
        self._reward_sums += terms
        final = None if over is None else self._metrics.values[over].copy()
        self._measure(now, end, rewards)
        if over is not None:
            self._metrics.values[over] = final
        if self._task.termination.continue_after_goal:
            self._renew_goals(end.reached & ~end.terminated & ~end.truncated & ~self.done)
        return now, end, rewards.astype(np.float32)

    def finish(self, end: Endings) -> None:
        """Take down who is done in this step."""
        now = ~self.done & (end.terminated | end.truncated)
        self._terminated |= now & end.terminated
        self.done |= now

    def outcome(self, reward: Floats, over: Flags) -> RoverOutcome:
        """What the step gives, where the scenes in `over` (M,) have ended with it; `finish` comes first."""
        return RoverOutcome(reward, over & self._terminated, over & ~self._terminated)

    def _distance_to_goal(self) -> Array:
        offset = self.goals_w - self.motion.position_w[:, :2]
        return np.hypot(offset[:, 0], offset[:, 1])

    def _snapshot(self, steps: Counts, clearance: Array) -> Snapshot:
        motion = self.motion
        previous, self._goal_distance = self._goal_distance, self._distance_to_goal()
        begun, touching = self._encounters.update(self.touches, steps)
        clearance[touching] = 0.0
        xmin, xmax, ymin, ymax = self._sites.extents.T
        x, y = motion.position_w[:, 0], motion.position_w[:, 1]
        outside = (x < xmin + _EDGE_M) | (x > xmax - _EDGE_M) | (y < ymin + _EDGE_M) | (y > ymax - _EDGE_M)
        return Snapshot(
            position_w=motion.position_w,
            roll_pitch_yaw=motion.roll_pitch_yaw,
            tilt=motion.tilt(),
            speed=motion.velocity_b[:, 0],
            angular_b=motion.angular_b,
            acceleration_b=self._accelerometer.acceleration_b,
            goal_distance=self._goal_distance,
            previous_goal_distance=previous,
            goal_heading=motion.bearing(self.goals_w),
            clearance=clearance,
            new_collisions=begun,
            touching=touching,
            steps=steps,
            steps_since_moved=motion.steps_since_moved(self._task.termination.stuck_distance_m),
            out_of_world=outside,
            diverged=motion.diverged,
        )

    def _measure(self, now: Snapshot, end: Endings, rewards: Array) -> None:
        velocity = self.motion.velocity_w
        self._metrics.update(
            steps=now.steps,
            step_s=self._physics.control_step_s,
            reward=rewards,
            clearance=now.clearance,
            acceleration_b=now.acceleration_b,
            angular_b=now.angular_b,
            ground_speed=np.hypot(velocity[:, 0], velocity[:, 1]),
            tilt=now.tilt,
            new_collisions=now.new_collisions,
            reached=end.reached,
            flags={
                "diverged": end.diverged,
                "stuck": end.stuck,
                "flipped": end.flipped,
                "out_of_world": end.out_of_world,
                "timeout": end.timeout,
            },
            energy_wh=self._energy_wh() if self._measures_energy else None,
        )

    def _energy_wh(self) -> Array:
        work = np.array([engine.work_j() for engine in self.engines])
        # Of diverged physics that may be anything.
        work[self.motion.diverged] = 0.0
        return self.robot.battery.drawn_wh(work, self._physics.control_step_s)

    def _renew_goals(self, mask: Flags) -> None:
        for scene in np.flatnonzero(mask).tolist():
            draws = self._goal_streams[scene]
            assert draws is not None
            here = self.motion.position_w[scene]
            for _ in range(_GOAL_TRIES):
                goal = self._spawner_of(scene).sample(draws)
                self.goals_w[scene] = goal.goal_x, goal.goal_y
                if (
                    np.hypot(goal.goal_x - here[0], goal.goal_y - here[1])
                    >= self._task.spawn.min_goal_distance_m
                ):
                    break
        if mask.any():
            self._goal_distance = self._distance_to_goal()

    # -- what there is to be told -----------------------------------------------------------------

    def observe(self) -> dict[str, Reading]:
        """The observation, each part (M, ...); asking twice gives the same."""
        return self.senses.observe()

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the columns of `metrics`."""
        return (*self._metrics.names, *(f"reward/{name}" for name in REWARD_TERMS))

    def metrics(self) -> list[Array]:
        """Running values of the present episodes, (M, n) when put side by side."""
        return [self._metrics.values, self._reward_sums]

    def joint_angles(self, scene: int) -> dict[str, float]:
        """Angles [rad] of a robot's joints by name: its motors' and those that turn freely."""
        body = self.robot.body
        names = [*body.drive_joints, *(joint.joint for joint in body.passive)]
        return dict(zip(names, self.engines[scene].joint_angles(names), strict=True))

    # -- several in a scene -----------------------------------------------------------------------

    def poses(self) -> Array:
        """Place [m] and yaw [rad] of the origins, (M, 4), as `GroupState.neighbours` has them."""
        return np.column_stack([self.motion.position_w, self.motion.roll_pitch_yaw[:, 2]])

    def apart_from(self, other: "Rovers") -> Array:
        """Distance [m], (M,), between the hulls of each scene's robot and its `other`, seen from above."""
        mine = other.motion.distance_from_hull(self.motion.outline_w()).min(axis=1)
        return np.minimum(mine, self.motion.distance_from_hull(other.motion.outline_w()).min(axis=1))
