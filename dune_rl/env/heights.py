"""How kinematic bodies stand on the ground, and the heights of flying ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.bodies.settings import BodySettings, FlightBand
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.shared_per_scene import query_grouped
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.passage import roof_height
from dune_rl.worlds.world import World

Scenes = NDArray[np.int64]


class Stance:
    """How bodies stand that touch the ground at points of their plane, `supports_b` (P, 2) [m].

    The plane through the ground's heights below these points, by least squares, is that of the body. Bodies
    without such points stand upright on the ground below their origin.
    """

    def __init__(self, supports_b: Array, worlds: BatchedWorlds, count: int) -> None:
        self._supports_b, self._worlds, self._count = supports_b, worlds, count
        self.leans = len(supports_b) > 0
        if self.leans:
            # From heights (P,) to the height at the origin and the rises along x and y.
            columns = np.column_stack([np.ones(len(supports_b)), supports_b])
            self._fit = np.ascontiguousarray(np.linalg.pinv(columns))

    def put(self, poses: Array, scenes: Scenes | None = None) -> None:
        """Set z, roll and pitch of `poses` (N, 6) by their x, y and yaw; `scenes` (S,) are theirs, or all."""
        by_scene = poses.reshape(-1, self._count, 6)
        if not self.leans:
            by_scene[..., 2] = self._worlds.height(by_scene[..., :2], scenes)
            return
        feet = np.empty((len(poses), len(self._supports_b), 2))
        _place_feet(poses, self._supports_b, feet)
        heights = self._worlds.height(feet.reshape(len(by_scene), -1, 2), scenes)
        _lean(heights.reshape(len(poses), -1), self._fit, poses)


@compile_function
def _place_feet(poses: Any, supports_b: Any, found: Any) -> None:
    """Points `found` (N, P, 2) below the supports (P, 2) of bodies at `poses` (N, 6), seen from above."""
    for row in range(len(poses)):
        cos, sin = np.cos(poses[row, 3]), np.sin(poses[row, 3])
        for point in range(len(supports_b)):
            x, y = supports_b[point]
            found[row, point, 0] = poses[row, 0] + cos * x - sin * y
            found[row, point, 1] = poses[row, 1] + sin * x + cos * y


@compile_function
def _lean(heights: Any, fit: Any, poses: Any) -> None:
    """Set z, roll and pitch of `poses` (N, 6) by the plane through `heights` (N, P).

    `fit` (3, P) turns heights into that at the origin and the rises along the body's x and y.
    """
    for row in range(len(poses)):
        z, rise_x, rise_y = 0.0, 0.0, 0.0
        for point in range(heights.shape[1]):
            z += fit[0, point] * heights[row, point]
            rise_x += fit[1, point] * heights[row, point]
            rise_y += fit[2, point] * heights[row, point]
        poses[row, 2] = z
        poses[row, 4] = np.arcsin(rise_y / np.sqrt(1.0 + rise_x * rise_x + rise_y * rise_y))
        poses[row, 5] = -np.arctan(rise_x)


@compile_function
def turning_rates(rotation: Any, before: Any, step_s: float, found: Any) -> None:
    """Mean angular velocities `found` (N, 3) [rad/s], world frame, between rotations (N, 3, 3)."""
    for row in range(len(rotation)):
        change = rotation[row] @ before[row].T
        cos = min(max((change[0, 0] + change[1, 1] + change[2, 2] - 1.0) / 2.0, -1.0), 1.0)
        angle = np.arccos(cos)
        sin = np.sin(angle)
        # Twice the sine, over the angle: 2 for small ones.
        scale = (0.5 if angle < 1e-6 or sin < 1e-6 else angle / (2.0 * sin)) / step_s
        found[row, 0] = scale * (change[2, 1] - change[1, 2])
        found[row, 1] = scale * (change[0, 2] - change[2, 0])
        found[row, 2] = scale * (change[1, 0] - change[0, 1])


_CLIMB = 2


class AltitudeController:
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
