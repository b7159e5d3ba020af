"""Rotations and angles of batches. Quaternions are xyzw; suffixes name frames: `_w` world, `_b` body."""

import math
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.compiled import compile_function

# Of a body in its scene: x, y, z [m], yaw, roll, pitch [rad], and the number of the frame of its mesh.
POSE_COLUMNS = 7


def wrap_angle(angle: Array) -> Array:
    """The same angle [rad] in [-pi, pi), any shape."""
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    # The remainder of an angle just below -pi rounds up to the whole turn.
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


def clip(value: Array, low: Array | float, high: Array | float) -> Array:
    """`value` limited to [low, high], any shape; equal to `np.clip`, but several times as fast on few values.

    Unlike Python's `min` and `max`, it passes a NaN on.
    """
    return np.minimum(np.maximum(value, low), high)


def unit_vectors(offset: Array) -> tuple[Array, Array]:
    """Directions (..., 2) of offsets (..., 2), zero for those of no length, and their lengths (...)."""
    length = np.linalg.norm(offset, axis=-1)
    return offset / np.where(length > 1e-9, length, np.inf)[..., None], length


def rotation_matrices(quaternion: Array) -> Array:
    """Body-to-world rotation, shape (..., 3, 3), of unit quaternions xyzw, shape (..., 4)."""
    quaternion = np.ascontiguousarray(quaternion, np.float64)
    found = np.empty((*quaternion.shape[:-1], 3, 3))
    rotate(quaternion.reshape(-1, 4), found.reshape(-1, 3, 3))
    return found


def quaternions(rotation: Array) -> Array:
    """Unit quaternions xyzw (..., 4), with w of at least 0, of rotations (..., 3, 3)."""
    rotation = np.ascontiguousarray(rotation, np.float64)
    found = np.empty((*rotation.shape[:-2], 4))
    find_quaternions(rotation.reshape(-1, 3, 3), found.reshape(-1, 4))
    return found


def rotation_from_yaw(yaw: Array) -> Array:
    """Body-to-world rotation matrices (..., 3, 3) for a `yaw` (...) [rad] about the world's z axis."""
    out = np.zeros((*yaw.shape, 3, 3))
    cos, sin = np.cos(yaw), np.sin(yaw)
    out[..., 0, 0] = out[..., 1, 1] = cos
    out[..., 0, 1], out[..., 1, 0] = -sin, sin
    out[..., 2, 2] = 1.0
    return out


def rotation_from_angles(angles: Array) -> Array:
    """Body-to-world rotation, shape (..., 3, 3), by roll, pitch and yaw (..., 3) [rad]."""
    out = np.empty((*angles.shape[:-1], 3, 3))
    (sr, sp, sy), (cr, cp, cy) = (np.moveaxis(part, -1, 0) for part in (np.sin(angles), np.cos(angles)))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = -sp, cp * sr, cp * cr
    return out


def roll_pitch_yaw(rotation: Array) -> Array:
    """Roll, pitch and yaw [rad], shape (..., 3), of rotations (..., 3, 3), applied in that order.

    Pitch is in [-pi/2, pi/2] and positive nose down (x forward, z up).
    """
    rotation = np.ascontiguousarray(rotation, np.float64)
    found = np.empty(rotation.shape[:-1])
    find_angles(rotation.reshape(-1, 3, 3), found.reshape(-1, 3))
    return found


def to_world(rotation: Array, vector_b: Array) -> Array:
    """World-frame components of body vectors (..., 3); `rotation` (..., 3, 3) is body to world."""
    rotated: Array = np.einsum("...ij,...j->...i", rotation, vector_b)
    return rotated


def to_body(rotation: Array, vector_w: Array) -> Array:
    """Body-frame components of world vectors (..., 3); `rotation` (..., 3, 3) is body to world."""
    rotated: Array = np.einsum("...ji,...j->...i", rotation, vector_w)
    return rotated


def quaternion_on_slope(normal: Array, yaw: Array) -> Array:
    """Quaternion xyzw (..., 4) of a body turned by `yaw` (...) [rad], then tilted onto `normal` (..., 3)."""
    up = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    zero = np.zeros_like(yaw)
    turn = np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], axis=-1)
    axis = np.cross(np.broadcast_to([0.0, 0.0, 1.0], up.shape), up)
    tilt = np.concatenate([axis, 1.0 + up[..., 2:3]], axis=-1)
    tilt /= np.linalg.norm(tilt, axis=-1, keepdims=True)
    return multiply_quaternions(tilt, turn)


def cross(first: Array, second: Array) -> Array:
    """Cross product (..., 3); equal to `np.cross`, and several times as fast on small batches."""
    out = np.empty_like(first)
    x1, y1, z1 = (first[..., i] for i in range(3))
    x2, y2, z2 = (second[..., i] for i in range(3))
    out[..., 0] = y1 * z2 - z1 * y2
    out[..., 1] = z1 * x2 - x1 * z2
    out[..., 2] = x1 * y2 - y1 * x2
    return out


def multiply_quaternions(first: Array, second: Array) -> Array:
    """Hamilton product xyzw (..., 4): the rotation by `second`, followed by `first`."""
    x1, y1, z1, w1 = np.moveaxis(first, -1, 0)
    x2, y2, z2, w2 = np.moveaxis(second, -1, 0)
    return np.stack(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ],
        axis=-1,
    )


def frames_of_poses(poses: Array) -> Array:
    """Plane frames (N, 4: x, y [m], cos and sin of the x axis) of `poses` (N, 3: x, y [m], yaw [rad])."""
    return np.column_stack([poses[:, :2], np.cos(poses[:, 2]), np.sin(poses[:, 2])])


def into_frames(frames: Array, points: Array) -> Array:
    """Points (N, K, 2) [m], of the frame that `frames` (N, 4) lie in, as these have them."""
    right, up = points[..., 0] - frames[:, :1], points[..., 1] - frames[:, 1:2]
    cos, sin = frames[:, 2:3], frames[:, 3:4]
    return np.stack([cos * right + sin * up, cos * up - sin * right], axis=-1)


def out_of_frames(frames: Array, points: Array) -> Array:
    """Points (N, K, 2) [m] in `frames` (N, 4), as the frame that these lie in has them."""
    cos, sin = frames[:, 2:3], frames[:, 3:4]
    x, y = points[..., 0], points[..., 1]
    return np.stack([frames[:, :1] + cos * x - sin * y, frames[:, 1:2] + sin * x + cos * y], axis=-1)


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
def _find_quaternion(rotation: Any, found: Any) -> None:
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    # The products of all pairs of its numbers, times four; from the row of the largest number, as in
    # "Quaternion from rotation matrix", Journal of Guidance and Control 1 (1978).
    rows = (
        (1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz),
        (xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx),
        (xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy),
        (zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz),
    )
    largest = 0
    for k in range(1, 4):
        if rows[k][k] > rows[largest][largest]:
            largest = k
    scale = math.copysign(0.5 / math.sqrt(rows[largest][largest]), rows[largest][3])
    for k in range(4):
        found[k] = scale * rows[largest][k]


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
def find_quaternions(rotations: Any, found: Any) -> None:
    """Unit quaternions `found` (N, 4) of rotations (N, 3, 3)."""
    for row in range(len(rotations)):
        _find_quaternion(rotations[row], found[row])


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
