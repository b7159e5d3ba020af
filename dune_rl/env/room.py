"""Where kinematic bodies have room: the world's edge, obstacles, steep ground and deep water."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from dune_rl.bodies.settings import BodySettings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.frames import wrap_angle
from dune_rl.geometry.shared_per_scene import query_grouped
from dune_rl.state.surroundings import EDGE_M
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.passage import GridField, GroundLimits, body_clearance, ground_passage, roof_height
from dune_rl.worlds.world import World

_LEVEL, _ANY_DEPTH = 90.0, 100.0
# Headings that `Room.headings_with_way` tries, relative to those drawn [rad], and points on the way of each.
_TURNS = np.deg2rad([0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 120.0, -120.0, 150.0, -150.0, 180.0])
_POINTS_ON_WAY = 4


class Room:
    """Finds whether N bodies of a kind, rows scene after scene, have room at poses.

    A body that is where it has none, such as one that a robot has pushed into an obstacle, has room wherever
    it is less deep in it.
    """

    def __init__(self, conf: BodySettings, worlds: BatchedWorlds, count: int) -> None:
        self._worlds, self._count = worlds, count
        self._along, self._radius_m = conf.discs_b()
        self._edge_m = max(EDGE_M, self._radius_m)
        self._limits = ground_limits(conf)
        self._clearance = _clearance_of(conf)
        self._checks: list[Callable[[Array, Array], Array]] = [self._within_edges]
        if conf.flight is None:
            self._checks.append(self._off_obstacles)
            if self._limits is not None:
                self._checks.append(self._on_ground)

    def is_free(self, xy: Array, yaw: Array, poses: Array, parked: Flags) -> Flags:
        """Whether the bodies can get to `xy` (N, 2) [m] and `yaw` (N,) [rad] from `poses` (N, 6).

        Those that are `parked` (N,) may be anywhere.
        """
        free = np.ones(len(xy), bool)
        for measure in self._checks:
            room = measure(xy, yaw)
            enough = (room >= 0.0) | parked
            if not enough.all():
                enough |= room > measure(poses[:, :2], poses[:, 3])
            free &= enough
        return free

    def headings_with_way(self, scene: int, poses: Array, way_m: float) -> Array:
        """Headings (G,) [rad] in which bodies of a scene, at `poses` (G, 4), can drive `way_m` straight on.

        Of twelve it is the one that is nearest to the pose's own, and this one itself where there is none.
        """
        rows = slice(scene * self._count, (scene + 1) * self._count)
        all_poses = np.zeros((len(self._worlds) * self._count, 4))
        elsewhere = np.ones(len(all_poses), bool)
        elsewhere[rows], all_poses[rows] = False, poses
        headings, is_open = poses[:, 3].copy(), np.zeros(len(poses), bool)
        for turn in _TURNS:
            yaw = all_poses[:, 3] + turn
            ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
            free = np.ones(len(poses), bool)
            for way in np.linspace(0.0, way_m, _POINTS_ON_WAY):
                free &= self.is_free(all_poses[:, :2] + way * ahead, yaw, all_poses, elsewhere)[rows]
            headings = np.where(free & ~is_open, yaw[rows], headings)
            is_open |= free
            if is_open.all():
                break
        return np.where(np.abs(headings) > np.pi, wrap_angle(headings), headings)

    def _within_edges(self, xy: Array, yaw: Array) -> Array:
        """Distance [m], (N,), inside the border that bodies keep to the world's edge."""
        found = np.empty(len(xy))
        _measure_edges(xy, yaw, self._along, self._worlds.extents, self._edge_m, self._count, found)
        return found

    def _off_obstacles(self, xy: Array, yaw: Array) -> Array:
        """Distance [m], (N,), of the bodies' discs from obstacles, negative inside them."""
        discs = self._discs(xy, yaw)
        by_scene = discs.reshape(len(self._worlds), -1, 2)
        apart = query_grouped(self._worlds.worlds.groups, self._clearance, by_scene)
        found: Array = apart.reshape(len(discs), -1).min(axis=1) - self._radius_m
        return found

    def _on_ground(self, xy: Array, yaw: Array) -> Array:
        """Distance [m], (N,), inside the ground that bodies can cross."""
        assert self._limits is not None
        passage = partial(_passage, limits=self._limits)
        by_scene = xy.reshape(len(self._worlds), -1, 2)
        return query_grouped(self._worlds.worlds.groups, passage, by_scene).reshape(-1)

    def _discs(self, xy: Array, yaw: Array) -> Array:
        """Centres (N, D, 2) [m] of the discs that cover the bodies."""
        if len(self._along) == 1:
            return xy[:, None]
        found = np.empty((len(xy), len(self._along), 2))
        _place_discs(xy, yaw, self._along, found)
        return found


@compile_function
def _place_discs(xy: Any, yaw: Any, along: Any, found: Any) -> None:
    """Points `found` (N, D, 2) that are `along` (D,) [m] ahead of `xy` (N, 2) at `yaw` (N,) [rad]."""
    for row in range(len(xy)):
        cos, sin = np.cos(yaw[row]), np.sin(yaw[row])
        for disc in range(len(along)):
            found[row, disc, 0] = xy[row, 0] + along[disc] * cos
            found[row, disc, 1] = xy[row, 1] + along[disc] * sin


@compile_function
def _measure_edges(
    xy: Any, yaw: Any, along: Any, extents: Any, edge_m: float, count: int, found: Any
) -> None:
    """Least distances `found` (N,) of discs inside a border of `edge_m` in `extents` (M, 4).

    On the border is outside.
    """
    for row in range(len(xy)):
        xmin, xmax, ymin, ymax = extents[row // count]
        cos, sin = np.cos(yaw[row]), np.sin(yaw[row])
        nearest = np.inf
        for disc in range(len(along)):
            x, y = xy[row, 0] + along[disc] * cos, xy[row, 1] + along[disc] * sin
            aside = min(x - (xmin + edge_m), (xmax - edge_m) - x)
            nearest = min(nearest, aside, y - (ymin + edge_m), (ymax - edge_m) - y)
        found[row] = nearest if nearest != 0.0 else -1e-300


def ground_limits(conf: BodySettings) -> GroundLimits | None:
    """The ground that a body can stand on; None if it can stand on any, or flies."""
    if conf.flight is not None or (conf.max_slope_deg >= _LEVEL and conf.max_water_m >= _ANY_DEPTH):
        return None
    length, width, _ = conf.size_m
    return GroundLimits(conf.max_slope_deg, conf.max_water_m, (length + width) / 4, conf.max_bump_m)


def needs_in_words(conf: BodySettings) -> str:
    """What ground a body needs, in words that follow others; empty where it needs none, or any will do."""
    limits = ground_limits(conf)
    if limits is None:
        return ""
    words = "" if conf.max_slope_deg >= _LEVEL else f", for its wheels or feet up to {conf.max_slope_deg:g}"
    words += "" if conf.max_water_m >= _ANY_DEPTH else f", water up to {conf.max_water_m:g} m"
    return words


def has_room(conf: BodySettings, world: World, xy: Array) -> Flags:
    """Whether a body can be at points (..., 2) of a world, as far as its ground and roofs are concerned."""
    if conf.flight is not None:
        flight = conf.flight
        roof = roof_height(world, conf.keep_out_radius_m)(xy)
        return roof + flight.room_m <= world.terrain.height(xy) + flight.usual_m
    limits = ground_limits(conf)
    passage = None if limits is None else ground_passage(world, limits)
    return np.ones(xy.shape[:-1], bool) if passage is None else passage(xy) >= 0.0


def _passage(world: World, xy: Array, limits: GroundLimits) -> Array:
    field: GridField | None = ground_passage(world, limits)
    return np.full(xy.shape[:-1], np.inf) if field is None else field(xy)


def _clearance_of(conf: BodySettings) -> Callable[[World, Array], Array]:
    if conf.is_round:
        return World.clearance
    height = conf.size_m[2]
    return lambda world, xy: body_clearance(world, height)(xy)
