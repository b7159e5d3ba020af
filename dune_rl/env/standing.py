"""How kinematic bodies stand on the ground: upright, or leaning on it with their wheels or feet."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.compiled import compile_function
from dune_rl.worlds.batched_worlds import BatchedWorlds

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
