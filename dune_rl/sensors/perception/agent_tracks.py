"""The sensor of what moves around a robot, by its LiDAR's scans and its own speed readings."""

from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import wrap_angle
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.imu import YAW
from dune_rl.sensors.lidar import LidarConf, LidarSensor, beam_angles
from dune_rl.sensors.perception.motion_forecast import MotionForecast, read_forecast
from dune_rl.sensors.perception.scan_tracks import ScanTracker
from dune_rl.sensors.sensor import Bounds, Reading, mount_position
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# Of each tracked agent: direction (x, y), velocity (x, y) and two measures of how near it is.
_VALUES = 6
_FASTEST_MPS = 3.0
# The inverse of the distance is limited to that of this one [m].
_NEAREST_M = 0.3
# A segment without a return reads the LiDAR's range, or next to it.
_NO_RETURN_M = 1e-3


class AgentTracksConf(SensorSettings):
    """Tracks of what moves in a LiDAR's scans, each with a Kalman filter.

    Walkers are found by the scans and by odometry alone: the robot's speed, the change of its inertial unit's
    heading, and where the goal is by its reading, since a body that slips sideways feels nothing else of it.
    A static object is a track only while it seems to move.
    """

    sensor: Literal["agent_tracks"] = "agent_tracks"
    realism: None = Field(None, description="none of its own: its LiDAR's")
    lidar: str = Field("lidar", description="name of the LiDAR")
    count: int = Field(3, ge=1, le=16, description="nearest tracks in the reading")
    forecast: str | None = Field(
        None,
        description="a learnt forecast: NAME of assets/forecasts, or FOLDER of python -m dune_rl.forecast; "
        "null: what has moved is an agent, of constant velocity",
    )
    reach_m: float = Field(8.0, gt=0.0, le=100.0, description="distance of the farthest track in it [m]")


class AgentTracks:
    """Readings of N agents: `name` (N, count * 6), `name`_radial and `name`_tangential (N, n_segments) [m/s].

    The first has the nearest tracks within `reach_m`, nearest first, zeros where there are fewer: the unit
    vector to it, its velocity [m/s], the inverse of its distance [1/m] and 1 - distance / `reach_m`; vectors
    are in the body frame. The others are the velocity of what each segment of the scan sees, away from the
    robot and counter-clockwise, 0 where nothing moves.

    `tracker` reads all `beams` (N, n_beams) [m], and has the odometry by which scans are compared; `ranges`
    (N, n_segments) [m], `sees` and `moves` (N, n_segments) are of the latest scan.
    """

    def __init__(self, name: str, context: SensorContext, conf: AgentTracksConf) -> None:
        self.conf, self._name, self._step_s = conf, name, context.step_s
        sensor = context.sensor_of(conf.lidar)
        if not isinstance(sensor, LidarSensor):
            raise ConfigError(f"sensors.{name}.lidar must be the name of a LiDAR (got {conf.lidar!r})")
        self.lidar: LidarConf = sensor.lidar.conf
        self._sensor = sensor
        self._scan, self._velocity = context.reading_of(conf.lidar), context.reading_of("velocity")
        self._goal = context.reading_of("goal")
        self._imu, self._yaw = context.reading_of("imu"), np.zeros(context.num_rows)
        segments = self.lidar.n_segments
        # Of the segments, in the body frame.
        beams = beam_angles(self.lidar)
        self.bearings: Array = beams.reshape(segments, -1).mean(axis=1)
        self.mount = mount_position(self.lidar.mount_b)[:2]
        self._ahead = np.stack([np.cos(self.bearings), np.sin(self.bearings)], axis=-1)
        self.tracker = ScanTracker(context.num_rows, beams, self.mount)
        self._forecast: MotionForecast | None = None
        if conf.forecast is not None:
            self._forecast = read_forecast(conf.forecast, context.step_s)
        # Where what moves will be after AHEAD_S, (N, T, A, 2) [m] in the frame of the odometry; None without
        # a forecast.
        self.places_ahead: Array | None = None
        self._velocities = np.zeros((context.num_rows, segments, 2))
        self.ranges = np.zeros((context.num_rows, segments))
        self.sees = self.moves = np.zeros((context.num_rows, segments), bool)
        self._nearest = np.zeros((context.num_rows, conf.count * _VALUES))

    def bounds(self) -> dict[str, Bounds]:
        """Lowest and highest values of the readings."""
        fastest = _FASTEST_MPS
        each = np.array([1.0, 1.0, fastest, fastest, 1.0 / _NEAREST_M, 1.0], np.float32)
        low = np.array([-1.0, -1.0, -fastest, -fastest, 0.0, 0.0], np.float32)
        speeds = np.full(len(self.bearings), fastest, np.float32)
        return {
            self._name: (np.tile(low, self.conf.count), np.tile(each, self.conf.count)),
            f"{self._name}_radial": (-speeds, speeds.copy()),
            f"{self._name}_tangential": (-speeds, speeds.copy()),
        }

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Forget the tracks in `mask` (N,): the first scan is taken after the first control step."""
        self.tracker.forget(mask)
        self._velocities[mask] = 0.0
        self._yaw = np.where(mask, self._heading(), self._yaw)
        self._nearest = np.where(mask[:, None], 0.0, self._nearest)
        self._look()
        self.moves = self.moves & ~mask[:, None]

    def measure(self, now: GroupState, state: State) -> None:
        """Take the scan of a control step."""
        self._look()
        beams = self.beams
        yaw = self._heading()
        turned = wrap_angle(yaw - self._yaw)
        self._yaw = yaw
        twists = np.column_stack([self._velocity()[:, 0].astype(np.float64), turned / self._step_s])
        sees = beams < self.lidar.range_m - _NO_RETURN_M
        self.tracker.update(beams, sees, twists, self.goals(), self._step_s)
        if self._forecast is not None:
            self.places_ahead = self._forecast.revise(self.tracker)
        # Of the beam that is the segment's.
        shape = len(beams), len(self.bearings), -1
        nearest = beams.reshape(shape).argmin(axis=2)[:, :, None, None]
        each = self.tracker.velocities.reshape(*shape, 2)
        self._velocities = np.take_along_axis(each, nearest, axis=2)[:, :, 0]
        self.moves = np.abs(self._velocities).max(axis=2) > 0.0
        self._nearest = self._nearest_tracks()

    @property
    def beams(self) -> Array:
        """The latest ranges of all beams (N, n_beams) [m]."""
        return self._sensor.ranges.astype(np.float64)

    @property
    def moving_beams(self) -> Flags:
        """Which beams (N, n_beams) meet what moves."""
        moves: Flags = np.abs(self.tracker.velocities).max(axis=2) > 0.0
        return moves

    def goals(self) -> Array:
        """The goals (N, 2) [m] in the robots' frames, by the reading."""
        distance, bearing = self._goal().astype(np.float64).T
        return np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])

    def _heading(self) -> Array:
        return self._imu()[:, YAW].astype(np.float64)

    def _look(self) -> None:
        self.ranges = self._scan().astype(np.float64)
        self.sees = self.ranges < self.lidar.range_m - _NO_RETURN_M

    def _nearest_tracks(self) -> Array:
        moving, counts = self.tracker.moving, self.tracker.moving_counts
        there = np.arange(moving.shape[1]) < counts[:, None]
        distance = np.where(there, np.hypot(moving[..., 0], moving[..., 1]), np.inf)
        order = np.argsort(distance, axis=1, kind="stable")[:, : self.conf.count]
        chosen = np.take_along_axis(moving, order[..., None], axis=1)
        distance = np.take_along_axis(distance, order, axis=1)
        shown = distance < self.conf.reach_m
        distance = np.where(shown, distance, self.conf.reach_m)
        values = np.concatenate(
            [
                chosen[..., :2] / np.maximum(distance, 1e-3)[..., None],
                np.clip(chosen[..., 2:], -_FASTEST_MPS, _FASTEST_MPS),
                1.0 / np.maximum(distance, _NEAREST_M)[..., None],
                1.0 - distance[..., None] / self.conf.reach_m,
            ],
            axis=-1,
        )
        return np.where(shown[..., None], values, 0.0).reshape(len(values), -1)

    def read(self) -> dict[str, Reading]:
        """The latest readings."""
        velocity = self._velocities
        radial = (velocity * self._ahead).sum(axis=2)
        tangential = velocity[..., 1] * self._ahead[:, 0] - velocity[..., 0] * self._ahead[:, 1]
        found = {
            self._name: self._nearest,
            f"{self._name}_radial": np.clip(radial, -_FASTEST_MPS, _FASTEST_MPS),
            f"{self._name}_tangential": np.clip(tangential, -_FASTEST_MPS, _FASTEST_MPS),
        }
        return {name: values.astype(np.float32) for name, values in found.items()}
