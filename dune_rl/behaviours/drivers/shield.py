"""The shield: the last command is checked against the LiDAR's scan, and braked or turned."""

import numpy as np

from dune_rl.behaviours.drivers.context import BoundBehaviour, DriverContext
from dune_rl.behaviours.drivers.shield_loops import check_commands
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.sensors.lidar import beam_angles
from dune_rl.sensors.perception.scan_tracks import ScanTracker
from dune_rl.sensors.sensor import mount_position

_READINGS = ("lidar", "velocity")
# Gap that is kept: the scan's segments are 3 to 6 cm wide at half a metre.
_MARGIN_M = 0.06
_ACCELERATION_MPS2 = 4.0
# Radius of the disc that stands for what moves.
_MOVER_M = 0.33
# Points on each segment of the scan, so that no body slips between two.
_POINTS_PER_SEGMENT = 2
_NO_RETURN_M = 1e-3


class Shield(BoundBehaviour):
    """Checks the commands (speed, heading) of N bodies by the readings `lidar` and `velocity` alone.

    A command that would touch something within a second, held for 0.3 s and then braked, becomes the nearest
    one that would not: slower, turned by up to 0.7 rad, or a stop. What moves in the scans has tracks
    (`ScanTracker`) and goes on with its velocity. What lies below the scan's plane is not seen.
    """

    def __init__(self, num_rows: int) -> None:
        self._num_rows = num_rows

    def bind(self, context: DriverContext) -> None:
        """Take the vehicle's model and its LiDAR; raises ConfigError without a reading that it needs."""
        lidar = context.require_lidar(_READINGS, "shield=brake")
        super().bind(context)
        vehicle = context.vehicle
        middle = beam_angles(lidar).reshape(lidar.n_segments, -1).mean(axis=1)
        width = np.deg2rad(lidar.fov_deg) / lidar.n_segments
        shares = (np.arange(_POINTS_PER_SEGMENT) + 0.5) / _POINTS_PER_SEGMENT - 0.5
        bearings = middle[:, None] + width * shares
        # Unit vectors (n_segments, points, 2) in the vehicle's frame.
        self._directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
        self._mount = mount_position(lidar.mount_b)[:2]
        self._tracker = ScanTracker(self._num_rows, middle, self._mount)
        self._no_goals = np.full((self._num_rows, 2), np.nan)
        self._range_m = lidar.range_m - _NO_RETURN_M
        self._model = np.array(
            [
                _ACCELERATION_MPS2,
                vehicle.max_yaw_rate_radps,
                vehicle.heading_gain_per_s,
                vehicle.turning_radius_m,
                vehicle.length_m / 2,
                vehicle.width_m / 2,
            ]
        )
        # What a body can reach while it holds a command and brakes.
        self._reach_m = vehicle.max_speed_mps + vehicle.footprint_radius_m + _MARGIN_M

    def reset(self, mask: Flags) -> None:
        """Forget the tracks in `mask` (N,)."""
        self._tracker.forget(mask)

    def check(self, actions: Array, step_s: float) -> Array:
        """`actions` (N, 2: speed [m/s], relative heading [rad]), changed where they would touch something.

        Called once a control step of `step_s` [s], with the readings after the last one.
        """
        readings = self.context.observe()
        ranges = readings["lidar"].astype(np.float64)
        twists = np.ascontiguousarray(readings["velocity"][:, :2], np.float64)
        sees = ranges < self._range_m
        tracker = self._tracker
        tracker.update(ranges, sees, twists, self._no_goals, step_s)
        moves = np.abs(tracker.velocities).max(axis=2) > 0.0
        near = np.repeat(sees & ~moves & (ranges < self._reach_m), _POINTS_PER_SEGMENT, axis=1)
        points = (ranges[:, :, None, None] * self._directions + self._mount).reshape(self._num_rows, -1, 2)
        order = np.argsort(~near, axis=1, kind="stable")
        points = np.take_along_axis(points, order[:, :, None], axis=1)
        movers = np.concatenate([tracker.moving, np.full((*tracker.moving.shape[:2], 1), _MOVER_M)], axis=-1)
        checked = np.array(actions, np.float64)
        check_commands(
            checked, twists, points, near.sum(axis=1), movers, tracker.moving_counts, self._model, _MARGIN_M,
            self.context.vehicle.max_speed_mps,
        )  # fmt: skip
        return checked
