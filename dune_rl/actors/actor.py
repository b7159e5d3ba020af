"""Moving actors: one class for all of them, whoever decides where they go."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Literal, NamedTuple, Self
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.actors.paths import SPACING_M, PathBank, random_paths, spline_path, there_and_back
from dune_rl.errors import WorldError
from dune_rl.geometry.frames import wrap_angle
from dune_rl.geometry.shared_per_scene import SharedPerScene, query_grouped
from dune_rl.physics.interface import KinematicCapsule
from dune_rl.settings import Settings
from dune_rl.worlds.world import World

Array = NDArray[np.float64]
SamplePoints = Callable[[np.random.Generator, int, float], Array]

_BANK_SIZE = 64
MAX_TURN_RADPS = 3.0
_GOAL_RADIUS_M = 0.5
_START_TRIES = 50


class ActorConf(Settings):
    """A walker, who decides for it, and its path.

    `scripted` walks a path there and back at `speed_mps`; `external` is an
    agent of the environment, whose actions reach up to `speed_mps`. Without
    `waypoints` a random path is drawn at every reset.
    """

    kind: Literal["walker"] = "walker"
    controller: Literal["scripted", "external"] = "scripted"
    speed_mps: float = Field(1.0, gt=0.0, le=5.0)
    radius_m: float = Field(0.25, gt=0.0, le=2.0)
    height_m: float = Field(1.75, gt=0.0, le=5.0)
    waypoints: tuple[tuple[float, float], ...] = ()
    length_range_m: tuple[float, float] = (6.0, 16.0)
    # Distance to the rover at which an episode may start, where the path reaches that far.
    start_distance_m: float = Field(2.0, ge=0.0)

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if len(self.waypoints) == 1:
            raise ValueError("waypoints needs at least two points, or none for a random path (got 1)")
        if any(math.dist(a, b) < 0.1 for a, b in pairwise(self.waypoints)):
            raise ValueError("waypoints must lie at least 0.1 m apart, each from the next")
        if not 1.0 <= self.length_range_m[0] < self.length_range_m[1]:
            raise ValueError(f"length_range_m must rise from at least 1.0 (got {list(self.length_range_m)})")
        if self.height_m <= 2 * self.radius_m:
            raise ValueError(f"height_m ({self.height_m}) must be more than twice radius_m ({self.radius_m})")
        return self


class Actors:
    """The K actors of each of M scenes, as arrays.

    `poses` (M, K, 4) are x, y, z on the ground and yaw, `velocity_w` (M, K, 2)
    the horizontal velocities, `goals_w` (M, K, 2) where each is going. All
    begin in `world`; `enter` moves a scene to another.
    """

    def __init__(
        self,
        confs: tuple[ActorConf, ...],
        world: World,
        sample_points: SamplePoints,
        rng: np.random.Generator,
        num_scenes: int,
    ) -> None:
        self.confs = confs
        self._worlds = SharedPerScene([world] * num_scenes)
        self._extents = np.tile(np.array(world.extent), (num_scenes, 1))
        # By world, for as long as that is there.
        self._paths: WeakKeyDictionary[World, _Paths] = WeakKeyDictionary()
        actors = len(confs)
        self.poses = np.zeros((num_scenes, actors, 4))
        self.velocity_w = np.zeros((num_scenes, actors, 2))
        self.goals_w = np.zeros((num_scenes, actors, 2))
        self.blocked = np.zeros((num_scenes, actors), bool)
        self._loop = np.zeros((num_scenes, actors), np.int64)
        self._travelled = np.zeros((num_scenes, actors))
        self._outbound = np.ones((num_scenes, actors), bool)
        self.top_speed = np.array([conf.speed_mps for conf in confs])
        self.radius = np.array([conf.radius_m for conf in confs])
        self.external = np.flatnonzero([conf.controller == "external" for conf in confs])
        self.scripted = np.flatnonzero([conf.controller == "scripted" for conf in confs])
        self.names = _agent_names(confs)
        self.find_paths(world, sample_points, rng)

    def find_paths(self, world: World, sample_points: SamplePoints, rng: np.random.Generator) -> None:
        """Find the paths that actors walk in `world`, unless they are known.

        `sample_points(rng, n, radius_m)` draws free points (n, 2) of it. Raises
        WorldError where there is no room to walk.
        """
        if self.confs and world not in self._paths:
            self._paths[world] = self._found_paths(world, sample_points, rng)

    def enter(self, scene: int, world: World) -> None:
        """Move a scene to `world`, whose paths have been found; a `reset` of it must follow."""
        self._worlds.put(scene, world)
        self._extents[scene] = world.extent

    def _found_paths(self, world: World, sample_points: SamplePoints, rng: np.random.Generator) -> "_Paths":
        loops: list[Array] = []
        choices: list[NDArray[np.int64]] = []
        for conf in self.confs:
            if conf.waypoints:
                paths = [spline_path(np.asarray(conf.waypoints), world.terrain)]
                if (world.clearance(paths[0][:, :2]) < conf.radius_m).any():
                    raise WorldError(
                        f"the waypoints of a {conf.kind} lead through an obstacle of {world.name}: "
                        "move actors.waypoints"
                    )
            else:
                paths = random_paths(
                    world, sample_points, rng, _BANK_SIZE, conf.radius_m + 0.1, conf.length_range_m
                )
            choices.append(np.arange(len(loops), len(loops) + len(paths)))
            loops += [there_and_back(path) for path in paths]
        return _Paths(PathBank.of(loops), tuple(choices))

    def bodies(self) -> tuple[KinematicCapsule, ...]:
        """What physics must know of each actor."""
        return capsules(self.confs)

    def paths(self, index: int) -> list[Array]:
        """The paths, one way, that actor `index` may walk in the first scene, each (P, 2) [m]."""
        bank, choices = self._paths[self._worlds[0]]
        starts, counts = bank.starts[choices[index]], bank.lengths[choices[index]] // 2 + 1
        return [bank.poses[start : start + n, :2] for start, n in zip(starts, counts, strict=True)]

    def reset(self, scene: int, rng: np.random.Generator, rover_xy: Array) -> None:
        """Start `scene` anew: each actor on a path drawn with `rng`, away from `rover_xy`, (2,) or (R, 2).

        Where no place on an actor's paths is far enough away, it takes the farthest that was tried.
        """
        if not self.confs:
            return
        bank, choices = self._paths[self._worlds[scene]]
        rovers_xy = np.atleast_2d(rover_xy)
        for index, conf in enumerate(self.confs):
            farthest = -1.0
            for _ in range(_START_TRIES):
                loop = rng.choice(choices[index])
                travelled = rng.uniform(0.0, bank.lengths[loop]) * SPACING_M
                pose = bank.pose(loop, np.asarray(travelled))
                apart = float(np.hypot(*(pose[:2] - rovers_xy).T).min())
                if apart > farthest:
                    farthest = apart
                    self._loop[scene, index] = loop
                    self._travelled[scene, index] = travelled
                    self.poses[scene, index] = pose
                    self.goals_w[scene, index] = bank.far_end(loop)[:2]
                if apart >= conf.start_distance_m:
                    break
        self._outbound[scene] = True
        self.velocity_w[scene] = 0.0
        self.blocked[scene] = False

    def move(self, external_actions: Array, step_s: float) -> None:
        """Advance every actor by `step_s`.

        `external_actions` (M, E, 2) are the speed [m/s] and the heading
        relative to the present one [rad] of the E external actors.
        """
        if not self.confs:
            return
        before = self.poses[..., :2].copy()
        if len(self.scripted):
            columns = self.scripted
            self._travelled[:, columns] += self.top_speed[columns] * step_s
            self.poses[:, columns] = query_grouped(
                self._worlds.groups, self._pose, self._loop[:, columns], self._travelled[:, columns]
            )
        if len(self.external):
            self._walk(external_actions, step_s)
        self.velocity_w = (self.poses[..., :2] - before) / step_s

    def _walk(self, actions: Array, step_s: float) -> None:
        columns = self.external
        poses = self.poses[:, columns]
        turn = np.clip(actions[..., 1], -MAX_TURN_RADPS * step_s, MAX_TURN_RADPS * step_s)
        yaw = wrap_angle(poses[..., 3] + turn)
        distance = np.clip(actions[..., 0], 0.0, self.top_speed[columns]) * step_s
        target = poses[..., :2] + distance[..., None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        xmin, xmax, ymin, ymax = self._extents.T[:, :, None]
        inside = (
            (target[..., 0] > xmin + 1.0)
            & (target[..., 0] < xmax - 1.0)
            & (target[..., 1] > ymin + 1.0)
            & (target[..., 1] < ymax - 1.0)
        )
        groups = self._worlds.groups
        free = inside & (query_grouped(groups, World.clearance, target) >= self.radius[columns])
        poses[..., :2] = np.where(free[..., None], target, poses[..., :2])
        poses[..., 2] = query_grouped(groups, _ground, poses[..., :2])
        poses[..., 3] = yaw
        self.poses[:, columns] = poses
        self.blocked[:, columns] = ~free
        goals = self.goals_w[:, columns]
        arrived = np.hypot(*np.moveaxis(goals - poses[..., :2], -1, 0)) < _GOAL_RADIUS_M
        if arrived.any():
            loop = self._loop[:, columns]
            outbound = self._outbound[:, columns] ^ arrived
            ends = np.where(
                outbound[..., None],
                query_grouped(groups, self._far_end, loop)[..., :2],
                query_grouped(groups, self._near_end, loop)[..., :2],
            )
            self.goals_w[:, columns] = np.where(arrived[..., None], ends, goals)
            self._outbound[:, columns] = outbound

    def _pose(self, world: World, loop: NDArray[np.int64], travelled_m: Array) -> Array:
        return self._paths[world].bank.pose(loop, travelled_m)

    def _far_end(self, world: World, loop: NDArray[np.int64]) -> Array:
        return self._paths[world].bank.far_end(loop)

    def _near_end(self, world: World, loop: NDArray[np.int64]) -> Array:
        bank = self._paths[world].bank
        return bank.poses[bank.starts[loop]]


class _Paths(NamedTuple):
    """Of one world: all actors' loops, and which of them each actor may walk."""

    bank: PathBank
    choices: tuple[NDArray[np.int64], ...]


def capsules(confs: tuple[ActorConf, ...]) -> tuple[KinematicCapsule, ...]:
    """What physics must know of each of the actors."""
    return tuple(
        KinematicCapsule(f"actor_{index}", conf.radius_m, conf.height_m) for index, conf in enumerate(confs)
    )


def _ground(world: World, xy: Array) -> Array:
    return world.terrain.height(xy)


def _agent_names(confs: tuple[ActorConf, ...]) -> tuple[str, ...]:
    """Names of the external actors, numbered within their kind: walker_0, walker_1."""
    counts: dict[str, int] = {}
    names = []
    for conf in confs:
        if conf.controller == "external":
            names.append(f"{conf.kind}_{counts.setdefault(conf.kind, 0)}")
            counts[conf.kind] += 1
    return tuple(names)
