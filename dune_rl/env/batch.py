"""M scenes stepped together: physics one after another, everything else as arrays over M."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dune_rl.actors.actor import ActorConf, Actors
from dune_rl.actors.shapes import actor_moving_meshes
from dune_rl.env.action_log import ActionLog
from dune_rl.env.figures import robot_moving_mesh
from dune_rl.env.motion import Motion
from dune_rl.env.places import Places
from dune_rl.env.rovers import RoverOutcome, Rovers
from dune_rl.env.scene import standing_pose
from dune_rl.env.sensing import robot_carrier, sensor_context
from dune_rl.env.traction import Traction
from dune_rl.env.variety import Variety
from dune_rl.metrics.episode import MetricsConf
from dune_rl.physics.interface import (
    OtherRobot,
    PhysicsConf,
    PhysicsRobot,
    PhysicsScene,
    SceneSpec,
)
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.robot import Robot
from dune_rl.seeding import stream
from dune_rl.sensors.conf import SensorsConf
from dune_rl.sensors.sensor import Reading
from dune_rl.sensors.suite import SensorSuite
from dune_rl.sensors.velocity import MAX_SENSED_SPEED_MPS
from dune_rl.tasks.point_goal import PointGoalConf
from dune_rl.tasks.snapshot import Snapshot
from dune_rl.tasks.spawn import Placement
from dune_rl.tasks.terminations import Endings
from dune_rl.tasks.walking import walker_observation, walker_reward
from dune_rl.worlds.world import World

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

_SETTLE_S = 0.1
_CLEAR = WeatherConf()


@dataclass(frozen=True)
class Outcome:
    """What a step gives; arrays have the leading axis M, walkers' E as the second.

    What is not of walkers is of the first robot; `others` have that of the
    others, which all end with it.
    """

    rover_reward: Floats
    walker_reward: Floats
    terminated: Flags
    truncated: Flags
    others: tuple[RoverOutcome, ...] = ()


class Batch:
    """The batch core that every environment wraps.

    Scene i runs the episodes `first_episode + i`, `+ i + M`, `+ i + 2M` and so
    on. All that is random in an episode depends on (seed, episode id) alone,
    so any two batches of equal seed start an episode alike. `variety` tells the
    worlds of the episodes, and what else differs between them; without it, or
    where worlds do not differ, all are in `world`.

    `make_others` make further robots of every scene. `rovers` has what is of
    one robot of each scene, the first's before the others'; what the batch
    itself tells of a robot is of the first. Where there are several, a scene's
    episode ends when all of its robots are done, when time is over, or when
    physics diverges; until then the rewards of those that are done are 0.
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
        make_others: tuple[Callable[[int], Robot], ...] = (),
    ) -> None:
        self.task, self.physics = task, physics
        self.weather, self.num_scenes = weather, num_scenes
        self.variety = Variety.none(world, weather) if variety is None else variety
        robots = tuple(make(num_scenes) for make in (make_robot, *make_others))
        self.actor_confs = actors
        self._first_world = world
        self._places = Places(
            world,
            weather,
            self.variety,
            robots,
            make_scene,
            physics,
            task.spawn,
            actors,
            num_scenes,
            measures_work=metrics.energy,
        )
        self.actors = self._new_actors(seed)
        self.sites = self._places.sites
        shapes = [robot_moving_mesh(robot.body) for robot in robots] if make_others else []
        self.rovers = tuple(
            Rovers(
                robot,
                SensorSuite(
                    sensors,
                    sensor_context(
                        self.sites,
                        robot_carrier(robot),
                        [*actor_moving_meshes(actors), *shapes[:index], *shapes[index + 1 :]],
                        num_rows=num_scenes,
                        step_s=physics.control_step_s,
                        worlds_differ=self.variety.of_worlds,
                    ),
                ),
                self.sites,
                physics,
                task,
                metrics,
                spawner_of=partial(self._places.spawner, robot=index),
                bodies=self._places.most_bodies,
                waits=bool(make_others),
                is_late=self.variety.of_latency,
            )
            for index, robot in enumerate(robots)
        )
        self.sensors = self.senses.conf
        self._enlist()
        self.steps = np.zeros(num_scenes, np.int64)
        # Where each robot's numbers end in a row of actions.
        self._ends = np.cumsum([rovers.action_width for rovers in self.rovers]).tolist()
        self._log = ActionLog(num_scenes, self._ends[-1], 2 * len(self.actors.external))
        self.reseed(seed, first_episode)

    def _enlist(self) -> None:
        """Let the robots know what physics has of them, where that may have changed."""
        self._scenes = self._places.physics
        self.rovers[0].engines = self._scenes
        for index, rovers in enumerate(self.rovers[1:]):
            rovers.engines = [scene.others[index] for scene in self._scenes]

    @property
    def robot(self) -> Robot:
        """The first robot of the scenes."""
        return self.rovers[0].robot

    @property
    def senses(self) -> SensorSuite:
        """What the first robots sense."""
        return self.rovers[0].senses

    @property
    def motion(self) -> Motion:
        """The first robots' true motion."""
        return self.rovers[0].motion

    @property
    def traction(self) -> Traction:
        """The first robots' wheels on the ground."""
        return self.rovers[0].traction

    @property
    def goals_w(self) -> Array:
        """The first robots' goals, (M, 2) [m]."""
        return self.rovers[0].goals_w

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
        for rovers in self.rovers:
            rovers.forget(mask, self.episodes)
        self.steps[mask] = 0
        for scene in np.flatnonzero(mask).tolist():
            self._start_scene(scene)
        self._enlist()
        self.variety.prepare(self.seed, (self.episodes[mask] + self.num_scenes).tolist())
        for rovers in self.rovers:
            rovers.begin(mask, self._places.most_bodies)
        for index, rovers in enumerate(self.rovers):
            rovers.begin_senses(mask, self._seen_by(index), self.seed, self.episodes, self.steps)

    def _start_scene(self, scene: int) -> None:
        episode = int(self.episodes[scene])
        physics = self._places.enter(scene, self.seed, episode, self.actors)
        world = self.sites.worlds[scene]
        poses = [
            standing_pose(world, rovers.robot, placement.x, placement.y, placement.yaw)
            for rovers, placement in zip(self.rovers, self._placements(scene, episode), strict=True)
        ]
        starts = np.array([position[:2] for position, _ in poses])
        self.actors.reset(scene, stream(self.seed, "actors", episode), starts)
        for other, (position, quaternion) in zip(physics.others, poses[1:], strict=True):
            other.stand(position.tolist(), quaternion.tolist())
        position, quaternion = poses[0]
        physics.place(position.tolist(), quaternion.tolist(), self.actors.poses[scene])
        engines: tuple[PhysicsRobot, ...] = (physics, *physics.others)
        for rovers, engine, pose in zip(self.rovers, engines, poses, strict=True):
            values = self._places.values[scene]
            self.variety.tell(rovers.traction, scene, values)
            if self.variety.of_latency:
                rovers.latency.begin(scene, self.variety.latency_s(values))
            rovers.traction.begin(scene, world, engine, *pose)
        settle = round(_SETTLE_S * self.physics.physics_hz)
        # The others stand by the commands that they were put down with.
        physics.step(settle, self.robot.body.rest_commands(), self.actors.poses[scene])
        for rovers, engine in zip(self.rovers, engines, strict=True):
            rovers.set_row(scene, engine)

    def _placements(self, scene: int, episode: int) -> list[Placement]:
        """Starts and goals of a scene's robots; those of the first are what they are without the others."""
        found: list[Placement] = []
        for index, rovers in enumerate(self.rovers):
            draws = stream(self.seed, f"spawn rover_{index}" if index else "spawn", episode)
            reach = rovers.robot.footprint_radius_m + self.task.spawn.robots_apart_m
            apart = [reach + other.robot.footprint_radius_m for other in self.rovers[:index]]
            found.append(self._places.spawner(scene, index).sample(draws, found, apart))
            rovers.set_goal(scene, found[-1], draws)
        return found

    def _seen_by(self, rover: int) -> Array:
        """Poses (M, K, 4) of the other moving bodies of each scene."""
        seen = self.actors.poses
        if len(self.rovers) > 1:
            others = [rovers.poses() for index, rovers in enumerate(self.rovers) if index != rover]
            seen = np.concatenate([seen, np.stack(others, axis=1)], axis=1)
        return seen

    # -- a step -----------------------------------------------------------------------------------

    def step(self, rover_actions: Floats, walker_actions: Floats | None = None) -> Outcome:
        """Advance all scenes by one control step.

        `rover_actions` (M, A) are the robot's: (M, 2), speed [m/s] and heading
        relative to the present one [rad], for all that are driven so; those of
        several robots stand side by side. `walker_actions` (M, E, 2) are these
        for the actors that are agents.
        """
        if walker_actions is None:
            walker_actions = np.zeros((self.num_scenes, len(self.actors.external), 2), np.float32)
        self._log.add(self.steps, rover_actions, walker_actions)
        step_s = self.physics.control_step_s
        # A way point reached in this step gives way to the next: progress is toward the one before.
        walker_goals = self.actors.goals_w[:, self.actors.external].copy()
        walker_distance = self._walker_distance(walker_goals)
        wanted = np.split(np.asarray(rover_actions, np.float64), self._ends[:-1], axis=1)
        commands = [
            rovers.commands(actions, step_s) for rovers, actions in zip(self.rovers, wanted, strict=True)
        ]
        self.actors.move(np.asarray(walker_actions, np.float64), step_s)
        self._advance_physics(commands)
        self.steps += 1
        judged = [rovers.judge(self.steps, self.clearance(index)) for index, rovers in enumerate(self.rovers)]
        for index, rovers in enumerate(self.rovers):
            rovers.measure_senses(self._seen_by(index), self.seed, self.episodes, self.steps)
        walked = self._walker_reward(walker_distance - self._walker_distance(walker_goals))
        if len(judged) == 1:
            _, end, rewards = judged[0]
            return Outcome(rewards, walked, end.terminated, end.truncated)
        return self._outcome_of_several(judged, walked)

    def _outcome_of_several(
        self, judged: list[tuple[Snapshot, Endings, Floats]], walker_reward: Floats
    ) -> Outcome:
        for rovers, (_, end, _) in zip(self.rovers, judged, strict=True):
            rovers.finish(end)
        over = np.all([rovers.done for rovers in self.rovers], axis=0)
        # Where one robot has diverged nothing in its scene can be believed.
        over |= np.any([end.diverged for _, end, _ in judged], axis=0)
        first, *others = [
            rovers.outcome(reward, over) for rovers, (_, _, reward) in zip(self.rovers, judged, strict=True)
        ]
        return Outcome(first.reward, walker_reward, first.terminated, first.truncated, tuple(others))

    def _advance_physics(self, commands: list[list[list[float]]]) -> None:
        substeps, poses = self.physics.substeps, self.actors.poses
        for rovers, wanted in zip(self.rovers[1:], commands[1:], strict=True):
            for engine, command in zip(rovers.engines, wanted, strict=True):
                # All but the first robots of scenes take them by themselves.
                cast(OtherRobot, engine).drive(command)
        for rovers in self.rovers:
            rovers.push()
        for scene, command, pose in zip(self._scenes, commands[0], poses, strict=True):
            scene.step(substeps, command, pose)
        for rovers in self.rovers:
            rovers.follow()

    def coast(self) -> None:
        """Advance physics alone by one control step, with wheels and actors as they are; for benchmarks."""
        for scene in self._scenes:
            scene.coast(self.physics.substeps)

    def joint_angles(self, scene: int) -> dict[str, float]:
        """Angles [rad] of the first robot's joints by name: its motors' and those that turn freely."""
        return self.rovers[0].joint_angles(scene)

    def clearance(self, rover: int = 0) -> Array:
        """Distance [m], (M,), from each hull to the nearest obstacle, actor or robot, inf where none is."""
        rovers = self.rovers[rover]
        motion = rovers.motion
        nearest = self.sites.clearance(motion.outline_w()).min(axis=1)
        if len(self.actor_confs):
            apart = motion.distance_from_hull(self.actors.poses[..., :2]) - self.actors.radius
            nearest = np.minimum(nearest, apart.min(axis=1))
        for other in self.rovers:
            if other is not rovers:
                nearest = np.minimum(nearest, rovers.apart_from(other))
        return np.maximum(nearest, 0.0)

    # -- what agents see --------------------------------------------------------------------------

    def observe(self, rover: int = 0) -> dict[str, Reading]:
        """The rovers' observation, each (M, ...); asking twice gives the same."""
        return self.rovers[rover].observe()

    def observe_walkers(self) -> dict[str, Floats]:
        """What the E actors that are agents sense, each (M, E, n), of the rover that is nearest to each."""
        actors, columns = self.actors, self.actors.external
        position, velocity = self._nearest_rover()
        return walker_observation(
            actors.poses[:, columns],
            actors.velocity_w[:, columns],
            actors.goals_w[:, columns],
            position,
            velocity,
            self.farthest_goal_m,
            self.max_closing_speed_mps,
        )

    @property
    def farthest_goal_m(self) -> float:
        """Largest horizontal distance in a world [m]."""
        xmin, xmax, ymin, ymax = self._first_world.extent
        return float(np.hypot(xmax - xmin, ymax - ymin))

    @property
    def max_closing_speed_mps(self) -> float:
        """The fastest that a walker sees the rover come or go [m/s]."""
        return MAX_SENSED_SPEED_MPS + float(self.actors.top_speed[self.actors.external].max(initial=0.0))

    def _walker_distance(self, goals_w: Array) -> Array:
        """Distance [m] of the walkers that are agents from `goals_w` (M, E, 2), (M, E)."""
        offset = goals_w - self.actors.poses[:, self.actors.external, :2]
        return np.hypot(offset[..., 0], offset[..., 1])

    def _nearest_rover(self) -> tuple[Array, Array]:
        """Position and velocity of the rover nearest to each walker, (M, E, 3); (M, 3) where there is one."""
        if len(self.rovers) == 1:
            return self.motion.position_w, self.motion.velocity_w
        positions = np.stack([rovers.motion.position_w for rovers in self.rovers], axis=1)
        velocities = np.stack([rovers.motion.velocity_w for rovers in self.rovers], axis=1)
        walkers = self.actors.poses[:, self.actors.external, :2]
        offset = positions[:, None, :, :2] - walkers[:, :, None]
        nearest = np.hypot(offset[..., 0], offset[..., 1]).argmin(axis=2)[..., None]
        return np.take_along_axis(positions, nearest, 1), np.take_along_axis(velocities, nearest, 1)

    def _walker_reward(self, progress: Array) -> Floats:
        columns = self.actors.external
        rooms = []
        for rovers in self.rovers:
            apart = self._walker_distance(rovers.motion.position_w[:, None, :2])
            rooms.append(np.maximum(apart - self.actors.radius[columns] - rovers.robot.width_m / 2, 0.0))
        room = rooms[0] if len(rooms) == 1 else np.min(rooms, axis=0)
        return walker_reward(progress, room, self.task.walking).astype(np.float32)

    # -- metrics and state ------------------------------------------------------------------------

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the columns of `metrics`."""
        drawn = (f"randomisation/{name}" for name in self.variety.names)
        return (*self.rovers[0].metric_names, *drawn)

    def metrics(self, rover: int = 0) -> Floats:
        """Running values of the present episodes, (M, n), final where an episode has ended."""
        values = self.rovers[rover].metrics()
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
            rover, walkers = np.split(row, [self._ends[-1]], axis=1)
            self.step(rover, walkers.reshape(self.num_scenes, -1, 2))
        if (lengths == 0).any():
            self._start(lengths == 0)

    def close(self) -> None:
        """Free the physics engine's memory."""
        self._places.close()
