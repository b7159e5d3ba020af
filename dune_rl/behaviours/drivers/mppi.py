"""The driver `mppi`: model-predictive path integral control on the LiDAR."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.drivers.context import BoundBehaviour, DriverContext
from dune_rl.behaviours.drivers.path_integral_loops import update_controls
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.sensors.lidar import beam_angles
from dune_rl.sensors.perception.local_map import LocalMap
from dune_rl.sensors.perception.scan_tracks import ScanTracker
from dune_rl.sensors.perception.stuck_recovery import StuckRecovery
from dune_rl.sensors.sensor import mount_position
from dune_rl.state.state import GroupState, State

_STEP_S = 0.1
_LAG_S = 0.15
# Sets of samples, which a row uses one after another, beginning with an episode.
_NOISE_SETS = 16
# The noise is drawn at this many times of the horizon, and linear between them.
_KNOTS = 6
# Points on each segment of the scan, so that no body slips between two.
_POINTS_PER_SEGMENT = 2
# End, way, contact, nearness, backwards, turning: see `path_integral_loops`.
_WEIGHTS = (3.0, 0.5, 100.0, 8.0, 5.0, 0.02)
# Backwards where the LiDAR does not see.
_BLIND_REVERSE_COST_PER_M = 10.0
# Radius of the disc that stands for what moves, and room that it should have.
_MOVER_M = 0.33
_MOVER_MARGIN_M = 0.9
_READINGS = ("goal", "lidar", "velocity")


class Mppi(BoundBehaviour):
    """Drives N bodies by sampled controls, weighted by the cost of where a unicycle model takes them.

    It knows the readings `goal`, `lidar` and `velocity` of its group, with their faults if they have any, and
    the vehicle's own size, limits and LiDAR mount. It knows no map and no slopes: it remembers the returns of
    the last 32 by 32 m (`LocalMap`), in the frame of the odometry that `velocity` gives, and finds its way to
    the goal there. Small objects that move from scan to scan have tracks (`ScanTracker`), and go on with
    their velocity within the horizon; ways through where they have been cost more. Rising ground in the scan
    is an obstacle to it, and what lies below the scan's plane it does not see before it meets it.

    Williams et al., "Information theoretic MPC for model-based reinforcement learning" (2017). `samples` and
    `horizon_s` set its effort; `temperature` is the lambda of the weights; `margin_m` is the distance at
    which obstacles begin to cost; `seed` is that of the noise, which is drawn once: equal readings give equal
    actions in any number of scenes.
    """

    reads_sensors = True

    def __init__(
        self,
        num_rows: int,
        *,
        samples: Annotated[int, Field(ge=8, le=100_000, description="sequences of commands")] = 256,
        horizon_s: Annotated[float, Field(ge=0.5, le=10.0, description="in steps of 0.1 s [s]")] = 2.5,
        temperature: Annotated[float, Field(gt=0.0, le=100.0, description="of their weights")] = 0.2,
        margin_m: Annotated[float, Field(ge=0.01, le=5.0, description="where returns cost [m]")] = 0.4,
        seed: Annotated[int, Field(ge=0, description="of the sequences")] = 0,
    ) -> None:
        self._num_rows, self._samples, self._seed = num_rows, samples, seed
        self._horizon = round(horizon_s / _STEP_S)
        self._temperature, self._margin_m = temperature, margin_m
        self._nominal = np.zeros((num_rows, self._horizon, 2))
        self._steps = np.zeros(num_rows, np.int64)
        self._recovery = StuckRecovery(num_rows)

    def bind(self, context: DriverContext) -> None:
        """Take the vehicle's model and its LiDAR; raises ConfigError without a reading that it needs."""
        lidar = context.require_lidar(_READINGS, "mppi")
        super().bind(context)
        of_beams = beam_angles(lidar).reshape(lidar.n_segments, -1)
        middle, width = of_beams.mean(axis=1), np.deg2rad(lidar.fov_deg) / lidar.n_segments
        shares = (np.arange(_POINTS_PER_SEGMENT) + 0.5) / _POINTS_PER_SEGMENT - 0.5
        bearings = middle[:, None] + width * shares
        # Unit vectors (n_segments, points, 2) in the vehicle's frame.
        self._directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
        self._mount = mount_position(lidar.mount_b)[:2]
        self._tracker = ScanTracker(self._num_rows, middle, self._mount)
        self._map = LocalMap(self._num_rows, middle, self._mount)
        # Its yaw is a sum of yaw rates, whose drift the bearing of the goal does not have.
        self._no_goals = np.full((self._num_rows, 2), np.nan)
        # Whether the scan covers what is behind.
        sees_behind = np.abs(np.abs(of_beams) - np.pi).min() < np.deg2rad(20.0)
        reverse = _WEIGHTS[4] if sees_behind else _BLIND_REVERSE_COST_PER_M
        self._weights = (*_WEIGHTS[:4], reverse, _WEIGHTS[5])
        # Deviations (sets, S, H, 2) of speeds [m/s] and yaw rates [rad/s]; the first sample has none.
        vehicle = context.vehicle
        scale = np.array([0.4 * vehicle.max_speed_mps, 0.5 * vehicle.max_yaw_rate_radps])
        shape = (_NOISE_SETS, self._samples, _KNOTS, 2)
        knots = stream(self._seed, "mppi").normal(size=shape) * scale
        knots[:, 0] = 0.0
        self._noise = _interpolate(knots, np.linspace(0.0, _KNOTS - 1.0, self._horizon))

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Forget the plans of the bodies in `mask` (N,)."""
        self._nominal[mask] = 0.0
        self._steps[mask] = 0
        self._recovery.reset(mask)
        if self._context is not None:
            self._tracker.forget(mask)
            self._map.forget(mask)

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2): speed [m/s] and relative heading [rad], by the readings alone."""
        vehicle = self.context.vehicle
        readings = self.context.observe()
        distance, bearing = np.asarray(readings["goal"], np.float64).T
        goals = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])
        twists = np.ascontiguousarray(readings["velocity"][:, :2], np.float64)
        ranges = readings["lidar"].astype(np.float64)
        points, counts, movers = self._obstacles(ranges, twists, goals, group.episode.step_s)
        limits = (
            vehicle.min_speed_mps,
            vehicle.max_speed_mps,
            vehicle.max_yaw_rate_radps,
            vehicle.turning_radius_m,
            vehicle.length_m / 2,
            vehicle.width_m / 2,
        )
        noise = self._noise[self._steps % _NOISE_SETS]
        model = (_STEP_S, _LAG_S)
        update_controls(
            self._nominal, noise, twists, goals, points, counts, movers, self._tracker.moving_counts,
            (self._tracker.poses, self._map.ways, self._map.origins), limits, self._weights,
            (self._margin_m, _MOVER_MARGIN_M), model, self._temperature,
        )  # fmt: skip
        chosen = self._nominal[:, 0].copy()
        self._recovery.record_command(chosen[:, 0])
        # Plans move on by a control step; the last control is kept.
        place = np.arange(self._horizon) + group.episode.step_s / _STEP_S
        self._nominal = _interpolate(self._nominal, np.minimum(place, self._horizon - 1.0))
        self._steps = self._steps + 1
        heading = np.clip(chosen[:, 1] / vehicle.heading_gain_per_s, -np.pi, np.pi)
        return np.column_stack([chosen[:, 0], heading])

    def _obstacles(
        self, ranges: Array, twists: Array, goals: Array, step_s: float
    ) -> tuple[Array, Counts, Array]:
        """Points (N, P, 2) [m] at rest that count within the horizon, first, and how many; and what moves,
        (N, K, 5): x, y, velocity and radius. All in the vehicles' frames.
        """
        vehicle, lidar = self.context.vehicle, self.context.lidar
        assert lidar is not None
        reach = vehicle.max_speed_mps * self._horizon * _STEP_S + vehicle.footprint_radius_m + self._margin_m
        sees = ranges < lidar.range_m - 1e-3
        tracker = self._tracker
        tracker.update(ranges, sees, twists, self._no_goals, step_s)
        movers = np.concatenate([tracker.moving, np.full((*tracker.moving.shape[:2], 1), _MOVER_M)], axis=-1)
        points = (ranges[:, :, None, None] * self._directions + self._mount).reshape(self._num_rows, -1, 2)
        moves: Flags = np.abs(tracker.velocities).max(axis=2) > 0.0
        # What keeps bodies from moving is an obstacle of their maps, and ends the plans that led there.
        nobody = np.zeros(self._num_rows, bool)
        blocked = self._recovery.update(tracker.poses, nobody, vehicle.length_m, step_s)
        for row in np.flatnonzero(blocked).tolist():
            self._map.block(row, self._recovery.blocked[row][-1])
        self._nominal[blocked] = 0.0
        self._map.update(
            tracker.poses, ranges, sees, moves, goals, movers=(tracker.moving, tracker.moving_counts)
        )
        rests = sees & (ranges < reach) & ~moves
        seen = np.repeat(rests, _POINTS_PER_SEGMENT, axis=1)
        order = np.argsort(~seen, axis=1, kind="stable")
        return np.take_along_axis(points, order[:, :, None], axis=1), seen.sum(axis=1), movers


def _interpolate(values: Array, place: Array) -> Array:
    """The values (..., P, 2) at fractional places (H,) among P, linear between two: (..., H, 2)."""
    low = np.minimum(place.astype(np.int64), values.shape[-2] - 2)
    share = (place - low)[:, None]
    found: Array = values[..., low, :] * (1.0 - share) + values[..., low + 1, :] * share
    return found
