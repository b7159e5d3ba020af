"""M scenes stepped together: physics one after another, everything else as arrays over M."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.actors.actor import ActorConf, Actors
from dune_rl.env.action_log import ActionLog
from dune_rl.env.drag import drag_forces
from dune_rl.env.encounters import Encounters
from dune_rl.env.latency import Latency
from dune_rl.env.motion import Motion
from dune_rl.env.places import Places
from dune_rl.env.scene import standing_pose
from dune_rl.env.senses import Senses
from dune_rl.env.traction import Traction
from dune_rl.env.variety import Variety
from dune_rl.metrics.episode import EpisodeMetrics, MetricsConf
from dune_rl.physics.interface import PhysicsConf, PhysicsScene, SceneSpec
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.robot import Robot
from dune_rl.seeding import stream
from dune_rl.sensors.sensor import Moment, Reading
from dune_rl.sensors.speed import MAX_SENSED_SPEED_MPS
from dune_rl.sensors.suite import SensorsConf
from dune_rl.tasks.point_goal import PointGoalConf
from dune_rl.tasks.rewards import REWARD_TERMS, reward_terms
from dune_rl.tasks.snapshot import Snapshot
from dune_rl.tasks.terminations import Endings, endings
from dune_rl.tasks.walking import walker_observation, walker_reward
from dune_rl.worlds.world import World

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

_SETTLE_S = 0.1
# A new touch of the same body counts as a new encounter after this long without one.
_ENCOUNTER_GAP_S = 1.0
_EDGE_M = 0.3
_GOAL_TRIES = 16
_CLEAR = WeatherConf()


@dataclass(frozen=True)
class Outcome:
    """What a step gives; arrays have the leading axis M, walkers' E as the second."""

    rover_reward: Floats
    walker_reward: Floats
    terminated: Flags
    truncated: Flags


class Batch:
    """The batch core that every environment wraps.

    Scene i runs the episodes `first_episode + i`, `+ i + M`, `+ i + 2M` and so
    on. All that is random in an episode depends on (seed, episode id) alone,
    so any two batches of equal seed start an episode alike. `variety` tells the
    worlds of the episodes, and what else differs between them; without it, or
    where worlds do not differ, all are in `world`.
    """

    def __init__(
        self,
        *,
        world: World,
        make_robot: Callable[[int], Robot],
        make_scene: Callable[[SceneSpec], PhysicsScene],
        actors: tuple[ActorConf, ...],
        sensors: SensorsConf,
        physics: PhysicsConf,
        task: PointGoalConf,
        metrics: MetricsConf,
        num_scenes: int,
        seed: int = 0,
        first_episode: int = 0,
        weather: WeatherConf = _CLEAR,
        variety: Variety | None = None,
    ) -> None:
        self.task, self.physics = task, physics
        self.weather, self.num_scenes = weather, num_scenes
        self.variety = Variety.none(world, weather) if variety is None else variety
        self.robot = make_robot(num_scenes)
        self.actor_confs = actors
        self._first_world = world
        self._places = Places(
            world,
            weather,
            self.variety,
            self.robot,
            make_scene,
            physics,
            task.spawn,
            actors,
            num_scenes,
            measures_work=metrics.energy,
        )
        self.actors = self._new_actors(seed)
        self.sites = self._places.sites
        self.senses = Senses(
            sensors, self.sites, self.robot, self.actors, physics, worlds_differ=self.variety.of_worlds
        )
        self.sensors = self.senses.conf
        self.motion = Motion(num_scenes, self.robot)
        self._scenes = self._places.physics
        self.traction = Traction(self.robot, physics, num_scenes)
        self._latency: Latency | None = None
        if self.variety.of_latency:
            self._latency = Latency(num_scenes, self.robot.body.rest_commands(), physics.control_hz)
        self._metrics = EpisodeMetrics(metrics, num_scenes)
        self._measures_energy = metrics.energy
        self._encounters = Encounters(
            num_scenes, self._places.most_bodies, round(_ENCOUNTER_GAP_S * physics.control_hz)
        )
        self._touches: list[tuple[int, int]] = []
        self.steps = np.zeros(num_scenes, np.int64)
        self.goals_w = np.zeros((num_scenes, 2))
        self._goal_distance = np.zeros(num_scenes)
        self._reward_sums = np.zeros((num_scenes, len(REWARD_TERMS)))
        self._goal_streams: list[np.random.Generator | None] = [None] * num_scenes
        self._action_width = len(self.robot.action_bounds()[0])
        self._log = ActionLog(num_scenes, self._action_width, 2 * len(self.actors.external))
        self.reseed(seed, first_episode)

    def _new_actors(self, seed: int) -> Actors:
        world = self._first_world
        points = self._places.spawner_in(world).sample_points
        return Actors(self.actor_confs, world, points, stream(seed, "paths"), self.num_scenes)

    @property
    def world(self) -> World:
        """The world of the first scene; `sites` tells those of all."""
        return self.sites.worlds[0]

    @property
    def drawn(self) -> dict[str, Array]:
        """The values that were drawn for the present episodes, (M,) each, by property."""
        return dict(zip(self.variety.names, self._places.values.T, strict=True))

    # -- episodes ---------------------------------------------------------------------------------

    def reseed(self, seed: int, first_episode: int = 0) -> None:
        """Begin again at episode `first_episode` of `seed`; the next `reset` must be of all scenes."""
        if getattr(self, "seed", seed) != seed:
            self.actors = self._new_actors(seed)
        self.seed = seed
        self.episodes = first_episode + np.arange(self.num_scenes) - self.num_scenes

    def reset(self, mask: Flags | None = None) -> None:
        """Start the next episode in the scenes in `mask` (M,), in all without one."""
        if mask is None:
            mask = np.ones(self.num_scenes, bool)
        self.episodes = np.where(mask, self.episodes + self.num_scenes, self.episodes)
        self._start(mask)

    def _start(self, mask: Flags) -> None:
        """Put the scenes in `mask` (M,) at the beginning of their present episodes."""
        self.robot.reset(mask)
        self._metrics.reset(mask, self.episodes)
        self.steps[mask] = 0
        self._reward_sums[mask] = 0.0
        self._encounters.begin(mask)
        settle = round(_SETTLE_S * self.physics.physics_hz)
        still = self.robot.body.rest_commands()
        for scene in np.flatnonzero(mask).tolist():
            episode = int(self.episodes[scene])
            physics = self._places.enter(scene, self.seed, episode, self.actors)
            draws = stream(self.seed, "spawn", episode)
            placement = self._places.spawner(scene).sample(draws)
            self._goal_streams[scene] = draws
            self.goals_w[scene] = placement.goal_x, placement.goal_y
            position, quaternion = standing_pose(
                self.sites.worlds[scene], self.robot, placement.x, placement.y, placement.yaw
            )
            self.actors.reset(scene, stream(self.seed, "actors", episode), position[:2])
            physics.place(position.tolist(), quaternion.tolist(), self.actors.poses[scene])
            self.variety.tell(self.traction, scene, self._places.values[scene])
            if self._latency is not None:
                self._latency.begin(scene, self.variety.latency_s(self._places.values[scene]))
            self.traction.begin(scene, self.sites.worlds[scene], physics, position, quaternion)
            physics.step(settle, still, self.actors.poses[scene])
            if self._measures_energy:
                physics.work_j()
            drive = physics.drive_state() if self._needs_wheels else None
            self.motion.set_row(scene, physics.body_state(), drive)
        self._scenes = self._places.physics
        self._encounters.make_room(self._places.most_bodies)
        self.variety.prepare(self.seed, (self.episodes[mask] + self.num_scenes).tolist())
        self.motion.begin(mask)
        self.senses.begin(mask, self._moment())
        distance = self._distance_to_goal()
        self._goal_distance = np.where(mask, distance, self._goal_distance)

    def _moment(self) -> Moment:
        return self.motion.moment(self.actors.poses, self.seed, self.episodes, self.steps)

    def _distance_to_goal(self) -> Array:
        offset = self.goals_w - self.motion.position_w[:, :2]
        return np.hypot(offset[:, 0], offset[:, 1])

    # -- a step -----------------------------------------------------------------------------------

    def step(self, rover_actions: Floats, walker_actions: Floats | None = None) -> Outcome:
        """Advance all scenes by one control step.

        `rover_actions` (M, A) are the robot's: (M, 2), speed [m/s] and heading
        relative to the present one [rad], for all that are driven so;
        `walker_actions` (M, E, 2) are these for the actors that are agents.
        """
        if walker_actions is None:
            walker_actions = np.zeros((self.num_scenes, len(self.actors.external), 2), np.float32)
        self._log.add(self.steps, rover_actions, walker_actions)
        step_s = self.physics.control_step_s
        # A way point reached in this step gives way to the next: progress is toward the one before.
        walker_goals = self.actors.goals_w[:, self.actors.external].copy()
        walker_distance = self._walker_distance(walker_goals)
        wanted = np.asarray(rover_actions, np.float64)
        commands = self.robot.commands(wanted, self.motion, step_s)
        if self._latency is not None:
            commands = self._latency.late(commands)
        self.actors.move(np.asarray(walker_actions, np.float64), step_s)
        self._advance_physics(commands.tolist())
        self.steps += 1
        self.senses.measure(self._moment())
        now = self._snapshot()
        end = endings(now, self.task.termination)
        terms = reward_terms(now, self.task.reward, end.reached, end.stuck, end.flipped)
        rewards = terms.sum(axis=1)
        self._reward_sums += terms
        self._measure(now, end, rewards)
        if self.task.termination.continue_after_goal:
            self._renew_goals(end.reached & ~end.terminated & ~end.truncated)
        return Outcome(
            rewards.astype(np.float32),
            self._walker_reward(walker_distance - self._walker_distance(walker_goals), now),
            end.terminated,
            end.truncated,
        )

    def _advance_physics(self, commands: list[list[float]]) -> None:
        substeps, poses = self.physics.substeps, self.actors.poses
        self._touches = []
        needs_wheels = self._needs_wheels
        states, drives = [], []
        force = self._forces()
        if force is not None:
            for scene, pushed in zip(self._scenes, force.tolist(), strict=True):
                scene.push(pushed)
        for index, scene in enumerate(self._scenes):
            scene.step(substeps, commands[index], poses[index])
            states.append(scene.body_state())
            if needs_wheels:
                drives.append(scene.drive_state())
            self._touches += [(index, body) for body in scene.touched()]
        self.motion.update(np.array(states), np.array(drives) if needs_wheels else None)

    @property
    def _needs_wheels(self) -> bool:
        return self.senses.needs_wheels or self.traction.needs_wheels

    def _forces(self) -> Array | None:
        """What grass and soft ground hold the rovers back with [N], (M, 3), world frame; None: nothing."""
        rolling = self.traction.update(self._scenes, self.motion)
        grass = drag_forces(self.sites, self.motion, self.robot)
        if rolling is None or grass is None:
            return grass if rolling is None else rolling
        return rolling + grass

    def joint_angles(self, scene: int) -> dict[str, float]:
        """Angles [rad] of a robot's joints by name: its motors' and those that turn freely."""
        body = self.robot.body
        names = [*body.drive_joints, *(joint.joint for joint in body.passive)]
        return dict(zip(names, self._scenes[scene].joint_angles(names), strict=True))

    def coast(self) -> None:
        """Advance physics alone by one control step, with wheels and actors as they are; for benchmarks."""
        for scene in self._scenes:
            scene.coast(self.physics.substeps)

    def clearance(self) -> Array:
        """Distance [m], (M,), from each hull to the nearest obstacle or actor, inf where there is none."""
        nearest = self.sites.clearance(self.motion.outline_w()).min(axis=1)
        if len(self.actor_confs):
            apart = self.motion.distance_from_hull(self.actors.poses[..., :2]) - self.actors.radius
            nearest = np.minimum(nearest, apart.min(axis=1))
        return np.maximum(nearest, 0.0)

    def _snapshot(self) -> Snapshot:
        motion = self.motion
        previous, self._goal_distance = self._goal_distance, self._distance_to_goal()
        begun, touching = self._encounters.update(self._touches, self.steps)
        clearance = self.clearance()
        clearance[touching] = 0.0
        xmin, xmax, ymin, ymax = self.sites.extents.T
        x, y = motion.position_w[:, 0], motion.position_w[:, 1]
        outside = (x < xmin + _EDGE_M) | (x > xmax - _EDGE_M) | (y < ymin + _EDGE_M) | (y > ymax - _EDGE_M)
        return Snapshot(
            position_w=motion.position_w,
            roll_pitch_yaw=motion.roll_pitch_yaw,
            tilt=motion.tilt(),
            speed=motion.velocity_b[:, 0],
            angular_b=motion.angular_b,
            acceleration_b=self.senses.acceleration_b,
            goal_distance=self._goal_distance,
            previous_goal_distance=previous,
            goal_heading=motion.bearing(self.goals_w),
            clearance=clearance,
            new_collisions=begun,
            touching=touching,
            steps=self.steps,
            steps_since_moved=motion.steps_since_moved(self.task.termination.stuck_distance_m),
            out_of_world=outside,
            diverged=motion.diverged,
        )

    def _measure(self, now: Snapshot, end: Endings, rewards: Array) -> None:
        velocity = self.motion.velocity_w
        self._metrics.update(
            steps=self.steps,
            step_s=self.physics.control_step_s,
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
        work = np.array([scene.work_j() for scene in self._scenes])
        return self.robot.battery.drawn_wh(work, self.physics.control_step_s)

    def _renew_goals(self, mask: Flags) -> None:
        for scene in np.flatnonzero(mask).tolist():
            draws = self._goal_streams[scene]
            assert draws is not None
            here = self.motion.position_w[scene]
            for _ in range(_GOAL_TRIES):
                goal = self._places.spawner(scene).sample(draws)
                self.goals_w[scene] = goal.goal_x, goal.goal_y
                if (
                    np.hypot(goal.goal_x - here[0], goal.goal_y - here[1])
                    >= self.task.spawn.min_goal_distance_m
                ):
                    break
        if mask.any():
            self._goal_distance = self._distance_to_goal()

    # -- what agents see --------------------------------------------------------------------------

    def observe(self) -> dict[str, Reading]:
        """The rovers' observation, each (M, ...); asking twice gives the same."""
        return self.senses.observe(self._goal_distance, self.motion.bearing(self.goals_w))

    def observe_walkers(self) -> dict[str, Floats]:
        """What the E actors that are agents sense, each (M, E, n)."""
        actors, columns = self.actors, self.actors.external
        return walker_observation(
            actors.poses[:, columns],
            actors.velocity_w[:, columns],
            actors.goals_w[:, columns],
            self.motion.position_w,
            self.motion.velocity_w,
            self.senses.farthest_goal_m,
            self.max_closing_speed_mps,
        )

    @property
    def max_closing_speed_mps(self) -> float:
        """The fastest that a walker sees the rover come or go [m/s]."""
        return MAX_SENSED_SPEED_MPS + float(self.actors.top_speed[self.actors.external].max(initial=0.0))

    def _walker_distance(self, goals_w: Array) -> Array:
        """Distance [m] of the walkers that are agents from `goals_w` (M, E, 2), (M, E)."""
        offset = goals_w - self.actors.poses[:, self.actors.external, :2]
        return np.hypot(offset[..., 0], offset[..., 1])

    def _walker_reward(self, progress: Array, now: Snapshot) -> Floats:
        columns = self.actors.external
        apart = self._walker_distance(now.position_w[:, None, :2])
        room = np.maximum(apart - self.actors.radius[columns] - self.robot.width_m / 2, 0.0)
        return walker_reward(progress, room, self.task.walking).astype(np.float32)

    # -- metrics and state ------------------------------------------------------------------------

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the columns of `metrics`."""
        drawn = (f"randomisation/{name}" for name in self.variety.names)
        return (*self._metrics.names, *(f"reward/{name}" for name in REWARD_TERMS), *drawn)

    def metrics(self) -> Floats:
        """Running values of the present episodes, (M, n), final where an episode has ended."""
        values = [self._metrics.values, self._reward_sums]
        if self.variety.names:
            values.append(self._places.values)
        return np.concatenate(values, axis=1).astype(np.float32)

    def state(self) -> dict[str, Any]:
        """All that brings this moment back, as plain containers: each episode's id and actions so far."""
        return {
            "seed": self.seed,
            "episodes": self.episodes.tolist(),
            "actions": self._log.plain(self.steps),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Bring a `state` back, bit for bit, by playing its episodes again from their starts."""
        self.reseed(int(state["seed"]))
        self.episodes = np.array(state["episodes"], np.int64)
        lengths = np.array([len(actions) for actions in state["actions"]])
        rows = self._log.aligned(state["actions"])
        self._start(np.ones(self.num_scenes, bool))
        for turn, row in enumerate(rows):
            # The shorter episodes begin later, so that all arrive together.
            late = lengths == len(rows) - turn
            if late.any():
                self._start(late)
            rover, walkers = np.split(row, [self._action_width], axis=1)
            self.step(rover, walkers.reshape(self.num_scenes, -1, 2))
        if (lengths == 0).any():
            self._start(lengths == 0)

    def close(self) -> None:
        """Free the physics engine's memory."""
        self._places.close()
