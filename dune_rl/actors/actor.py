"""Moving actors: one class for all of them, whoever decides where they go."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.actors.paths import SPACING_M, PathBank, random_paths, spline_path, there_and_back
from dune_rl.errors import WorldError
from dune_rl.geometry.frames import wrap_angle
from dune_rl.physics.interface import KinematicCapsule
from dune_rl.settings import Settings
from dune_rl.worlds.world import World

Array = NDArray[np.float64]

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
    the horizontal velocities, `goals_w` (M, K, 2) where each is going.
    """

    def __init__(
        self,
        confs: tuple[ActorConf, ...],
        world: World,
        sample_points: Callable[[np.random.Generator, int, float], Array],
        rng: np.random.Generator,
        num_scenes: int,
    ) -> None:
        self.confs = confs
        self._world = world
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
        self._choices: list[NDArray[np.int64]] = []
        self._bank = self._fill_bank(sample_points, rng) if confs else None

    def _fill_bank(
        self, sample_points: Callable[[np.random.Generator, int, float], Array], rng: np.random.Generator
    ) -> PathBank:
        loops: list[Array] = []
        for conf in self.confs:
            if conf.waypoints:
                paths = [spline_path(np.asarray(conf.waypoints), self._world.terrain)]
                if (self._world.clearance(paths[0][:, :2]) < conf.radius_m).any():
                    raise WorldError(
                        f"the waypoints of a {conf.kind} lead through an obstacle of {self._world.name}: "
                        "move actors.waypoints"
                    )
            else:
                paths = random_paths(
                    self._world, sample_points, rng, _BANK_SIZE, conf.radius_m + 0.1, conf.length_range_m
                )
            self._choices.append(np.arange(len(loops), len(loops) + len(paths)))
            loops += [there_and_back(path) for path in paths]
        return PathBank.of(loops)

    def bodies(self) -> tuple[KinematicCapsule, ...]:
        """What physics must know of each actor."""
        return tuple(
            KinematicCapsule(f"actor_{index}", conf.radius_m, conf.height_m)
            for index, conf in enumerate(self.confs)
        )

    def paths(self, index: int) -> list[Array]:
        """The paths that actor `index` may walk there and back, each (P, 2) [m] from one end to the other."""
        bank = self._bank
        assert bank is not None
        starts, counts = bank.starts[self._choices[index]], bank.lengths[self._choices[index]] // 2 + 1
        return [bank.poses[start : start + n, :2] for start, n in zip(starts, counts, strict=True)]

    def reset(self, scene: int, rng: np.random.Generator, rover_xy: Array) -> None:
        """Start `scene` anew: each actor on a path drawn with `rng`, away from `rover_xy` (2,).

        Where no place on an actor's paths is far enough away, it takes the farthest that was tried.
        """
        if self._bank is None:
            return
        for index, conf in enumerate(self.confs):
            farthest = -1.0
            for _ in range(_START_TRIES):
                loop = rng.choice(self._choices[index])
                travelled = rng.uniform(0.0, self._bank.lengths[loop]) * SPACING_M
                pose = self._bank.pose(loop, np.asarray(travelled))
                apart = float(np.hypot(*(pose[:2] - rover_xy)))
                if apart > farthest:
                    farthest = apart
                    self._loop[scene, index] = loop
                    self._travelled[scene, index] = travelled
                    self.poses[scene, index] = pose
                    self.goals_w[scene, index] = self._bank.far_end(loop)[:2]
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
        if self._bank is None:
            return
        before = self.poses[..., :2].copy()
        if len(self.scripted):
            columns = self.scripted
            self._travelled[:, columns] += self.top_speed[columns] * step_s
            self.poses[:, columns] = self._bank.pose(self._loop[:, columns], self._travelled[:, columns])
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
        xmin, xmax, ymin, ymax = self._world.extent
        inside = (
            (target[..., 0] > xmin + 1.0)
            & (target[..., 0] < xmax - 1.0)
            & (target[..., 1] > ymin + 1.0)
            & (target[..., 1] < ymax - 1.0)
        )
        free = inside & (self._world.clearance(target) >= self.radius[columns])
        poses[..., :2] = np.where(free[..., None], target, poses[..., :2])
        poses[..., 2] = self._world.terrain.height(poses[..., :2])
        poses[..., 3] = yaw
        self.poses[:, columns] = poses
        self.blocked[:, columns] = ~free
        assert self._bank is not None
        goals = self.goals_w[:, columns]
        arrived = np.hypot(*np.moveaxis(goals - poses[..., :2], -1, 0)) < _GOAL_RADIUS_M
        if arrived.any():
            loop = self._loop[:, columns]
            outbound = self._outbound[:, columns] ^ arrived
            ends = np.where(
                outbound[..., None],
                self._bank.far_end(loop)[..., :2],
                self._bank.poses[self._bank.starts[loop]][..., :2],
            )
            self.goals_w[:, columns] = np.where(arrived[..., None], ends, goals)
            self._outbound[:, columns] = outbound


def _agent_names(confs: tuple[ActorConf, ...]) -> tuple[str, ...]:
    """Names of the external actors, numbered within their kind: walker_0, walker_1."""
    counts: dict[str, int] = {}
    names = []
    for conf in confs:
        if conf.controller == "external":
            names.append(f"{conf.kind}_{counts.setdefault(conf.kind, 0)}")
            counts[conf.kind] += 1
    return tuple(names)
