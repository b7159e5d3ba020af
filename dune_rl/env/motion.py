"""The rovers' true motion over a batch, derived once per step from what physics gives."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.frames import roll_pitch_yaw, rotation_matrices, to_body, clip, wrap_angle
from dune_rl.robots.robot import Robot
from dune_rl.state import JointState
from dune_rl.state import Motion as TrueMotion

Array = NDArray[np.float64]

# No rover of ours moves or falls this fast, and no world reaches so far: beyond, physics has diverged.
_MAX_SPEED_MPS = 50.0
_MAX_TURN_RADPS = 200.0


class Motion:
    """Pose and twist of the M rovers.

    `position_w` (M, 3), `rotation` (M, 3, 3) body to world, `velocity_w` and
    `angular_w` (M, 3), the same in the body frame with `_b`, and
    `roll_pitch_yaw` (M, 3). Where physics diverges, the last good state stands
    and `diverged` (M,) says so. The wheels' angles, speeds and torques are kept
    where they are given.
    """

    def __init__(self, num_scenes: int, robot: Robot) -> None:
        self._states = np.zeros((num_scenes, 13))
        self._states[:, 6] = 1.0
        self._drives: Array | None = None
        self._outline = robot.outline()
        self._half_size = np.array([robot.length_m, robot.width_m]) / 2
        self.diverged = np.zeros(num_scenes, bool)
        self._anchor = np.zeros((num_scenes, 2))
        self._since = np.zeros(num_scenes, np.int64)
        self._derive()

    def set_row(self, scene: int, state: tuple[float, ...], drive: tuple[float, ...] | None = None) -> None:
        """Take the physics state of one scene, at the start of an episode; `begin` completes it.

        `drive` is the wheels', as `PhysicsScene.drive_state` orders it.
        """
        self._states[scene] = state
        if drive is not None:
            if self._drives is None:
                self._drives = np.zeros((len(self._states), len(drive)))
            self._drives[scene] = drive

    def begin(self, mask: NDArray[np.bool_]) -> None:
        """Start afresh in the scenes in `mask` (M,)."""
        self.diverged[mask] = False
        self._derive()
        self._anchor[mask] = self.position_w[mask, :2]
        self._since[mask] = 0

    def update(self, states: Array, drives: Array | None = None) -> None:
        """Take the physics states after a step, (M, 13), as `PhysicsScene.body_state` orders them.

        `drives` (M, 3 * W) are the wheels', as `PhysicsScene.drive_state` orders them.
        """
        speed = np.abs(states[:, 7:10]).max(axis=1)
        turn = np.abs(states[:, 10:13]).max(axis=1)
        far = np.abs(states[:, :3]).max(axis=1)
        # No component of a unit quaternion is above 1.
        turned = np.abs(states[:, 3:7]).max(axis=1)
        # Written so that NaN, which compares false, counts as bad.
        good = (speed < _MAX_SPEED_MPS) & (turn < _MAX_TURN_RADPS) & (far < 1e5) & (turned < 1.01)
        self.diverged = ~good
        self._states = states if good.all() else np.where(good[:, None], states, self._states)
        if drives is not None:
            sound = good & np.isfinite(drives).all(axis=1)
            before = np.zeros_like(drives) if self._drives is None else self._drives
            self._drives = drives if sound.all() else np.where(sound[:, None], drives, before)
        self._derive()

    def _derive(self) -> None:
        states = self._states
        self.position_w = states[:, 0:3]
        self.velocity_w = states[:, 7:10]
        self.angular_w = states[:, 10:13]
        self.rotation = rotation_matrices(states[:, 3:7])
        self.roll_pitch_yaw = roll_pitch_yaw(self.rotation)
        self.velocity_b = to_body(self.rotation, self.velocity_w)
        self.angular_b = to_body(self.rotation, self.angular_w)

    @property
    def wheel_speeds(self) -> Array | None:
        """Speeds of the drive joints [rad/s], (M, W), where they are given."""
        return None if self._drives is None else np.split(self._drives, 3, axis=1)[1]

    def tilt(self) -> Array:
        """Angle between the body's z and the world's [rad], (M,)."""
        return np.arccos(clip(self.rotation[:, 2, 2], -1.0, 1.0))

    def bearing(self, points_w: Array) -> Array:
        """Bearing of points (M, 2) from each rover's heading [rad], in [-pi, pi), (M,)."""
        offset = points_w - self.position_w[:, :2]
        return wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - self.roll_pitch_yaw[:, 2])

    def outline_w(self) -> Array:
        """Points (M, P, 2) round each hull [m], seen from above."""
        return self.position_w[:, None, :2] + self._outline @ self.rotation[:, :2, :2].transpose(0, 2, 1)

    def distance_from_hull(self, points_w: Array) -> Array:
        """Distance [m], (M, K), of points (M, K, 2) from each hull's rectangle, seen from above; 0 inside."""
        yaw = self.roll_pitch_yaw[:, 2]
        cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        offset = points_w - self.position_w[:, None, :2]
        ahead = np.abs(cos * offset[..., 0] + sin * offset[..., 1]) - self._half_size[0]
        aside = np.abs(cos * offset[..., 1] - sin * offset[..., 0]) - self._half_size[1]
        return np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0))

    def steps_since_moved(self, radius_m: float) -> NDArray[np.int64]:
        """Steps, (M,), since each rover was last `radius_m` from where it had been. Call it once per step."""
        offset = self.position_w[:, :2] - self._anchor
        moved = np.hypot(offset[:, 0], offset[:, 1]) > radius_m
        self._anchor[moved] = self.position_w[moved, :2]
        self._since += 1
        self._since[moved] = 0
        return self._since.copy()

    def true_motion(self, acceleration_b: Array) -> TrueMotion:
        """The same as a state has it, with accelerations (M, 3)."""
        return TrueMotion(
            self.position_w,
            self.roll_pitch_yaw,
            self.velocity_w,
            self.angular_w,
            self.diverged,
            None if self._drives is None else JointState(*np.split(self._drives, 3, axis=1)),
            rotation=self.rotation,
            velocity_b=self.velocity_b,
            angular_b=self.angular_b,
            acceleration_b=acceleration_b,
        )
