"""Heights of flying bodies: above the ground, and over obstacles that are lower."""

import numpy as np

from dune_rl.bodies.settings import BodySettings, FlightBand
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.shared_per_scene import query_grouped
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.passage import roof_height
from dune_rl.worlds.world import World

_CLIMB = 2


class Flight:
    """The heights of N flying bodies: each keeps one above the ground, and rises over what is in its way.

    A body that is not yet high enough for what lies ahead waits and climbs; it never passes what needs more
    than its greatest height.
    """

    def __init__(self, conf: BodySettings, band: FlightBand, worlds: BatchedWorlds, count: int) -> None:
        self._band, self._worlds, self._count = band, worlds, count
        self._climb_mps, self._reach_m = conf.limits().max_climb_mps, conf.keep_out_radius_m
        self._altitude_m = np.full(len(worlds) * count, band.usual_m)

    def take_off(self, poses: Array, rows: slice, scene: int) -> None:
        """Set the heights in `rows` of `poses` (N, 6), those of a scene, to the usual one."""
        self._altitude_m[rows] = self._band.usual_m
        ground = self._worlds.height(poses[None, rows, :2], np.array([scene]))[0]
        poses[rows, 2] = ground + self._band.usual_m

    def can_pass(self, poses: Array, xy: Array) -> Flags:
        """Whether bodies can fly over points (N, 2) at all: what is there is not too high, (N,)."""
        ground, least = self._heights(xy)
        passes: Flags = least <= ground + self._band.most_m
        return passes

    def climb(self, poses: Array, xy: Array, actions: Array, free: Flags, step_s: float) -> Flags:
        """Set z of `poses` (N, 6) for a step to `xy` (N, 2), and return which of the bodies are high enough.

        Those that are not `free` to go there stay where they are and keep their height.
        """
        band, most = self._band, self._climb_mps * step_s
        if actions.shape[1] > _CLIMB:
            change = np.clip(actions[:, _CLIMB] * step_s, -most, most)
            self._altitude_m = np.clip(self._altitude_m + change, band.least_m, band.most_m)
        here, there = self._heights(poses[:, :2]), self._heights(xy)
        passable = free & (there[1] <= there[0] + band.most_m)
        wanted = np.maximum(here[0] + self._altitude_m, here[1])
        ahead = np.maximum(there[0] + self._altitude_m, there[1])
        wanted = np.where(passable, np.maximum(ahead, here[1]), wanted)
        z = poses[:, 2] + np.clip(wanted - poses[:, 2], -most, most)
        high_enough = (z >= there[1] - 1e-9) | (there[1] < here[1])
        poses[:, 2] = z
        return passable & high_enough

    def _heights(self, xy: Array) -> tuple[Array, Array]:
        """Height of the ground and least height to fly at [m], each (N,), at points (N, 2)."""
        by_scene = xy.reshape(len(self._worlds), self._count, 2)
        ground = self._worlds.height(by_scene).reshape(-1)
        roof = query_grouped(self._worlds.worlds.groups, self._roof, by_scene).reshape(-1)
        return ground, np.maximum(roof + self._band.room_m, ground + self._band.least_m)

    def _roof(self, world: World, xy: Array) -> Array:
        return roof_height(world, self._reach_m)(xy)
