"""Rotations and angles of batches, compiled; see `frames` for the conventions."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function


@compile_function
def _rotate(quaternion: Any, found: Any) -> None:
    x, y, z, w = quaternion
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    found[0, 0], found[0, 1], found[0, 2] = 1 - 2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)
    found[1, 0], found[1, 1], found[1, 2] = 2 * (xy + wz), 1 - 2 * (xx + zz), 2 * (yz - wx)
    found[2, 0], found[2, 1], found[2, 2] = 2 * (xz - wy), 2 * (yz + wx), 1 - 2 * (xx + yy)


@compile_function
def _find_angles(rotation: Any, found: Any) -> None:
    found[0] = np.arctan2(rotation[2, 1], rotation[2, 2])
    found[1] = -np.arcsin(min(max(rotation[2, 0], -1.0), 1.0))
    found[2] = np.arctan2(rotation[1, 0], rotation[0, 0])


@compile_function
def rotate(quaternions: Any, found: Any) -> None:
    """Body-to-world rotations `found` (N, 3, 3) of unit quaternions (N, 4)."""
    for row in range(len(quaternions)):
        _rotate(quaternions[row], found[row])


@compile_function
def find_angles(rotations: Any, found: Any) -> None:
    """Roll, pitch and yaw `found` (N, 3) [rad] of rotations (N, 3, 3)."""
    for row in range(len(rotations)):
        _find_angles(rotations[row], found[row])


@compile_function
def derive_motion(states: Any, acceleration_w: Any, rotations: Any, angles: Any, vectors_b: Any) -> None:
    """What `states` (N, 13: position, quaternion, velocity, angular velocity) are in the bodies' frames.

    Rotations (N, 3, 3), roll, pitch and yaw as `angles` (N, 3), and `vectors_b` (3, N, 3): velocity, angular
    velocity and `acceleration_w` (N, 3) in the body frame.
    """
    for row in range(len(states)):
        state, rotation = states[row], rotations[row]
        _rotate(state[3:7], rotation)
        _find_angles(rotation, angles[row])
        for axis in range(3):
            velocity = angular = acceleration = 0.0
            for part in range(3):
                share = rotation[part, axis]
                velocity += share * state[7 + part]
                angular += share * state[10 + part]
                acceleration += share * acceleration_w[row, part]
            vectors_b[0, row, axis] = velocity
            vectors_b[1, row, axis] = angular
            vectors_b[2, row, axis] = acceleration
