"""The kinds of sensors: their settings, their realism, and how each is built."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.camera_sensor import CameraSensor
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.currents import Currents, CurrentsConf
from dune_rl.sensors.depth_strip import DepthStrip, DepthStripConf
from dune_rl.sensors.encoders import Encoders, EncodersConf
from dune_rl.sensors.function_sensor import FunctionSensor
from dune_rl.sensors.goal import Goal
from dune_rl.sensors.height_scan import HeightScan, HeightScanConf
from dune_rl.sensors.imu import ImuConf, ImuSensor
from dune_rl.sensors.lidar import Lidar, LidarConf
from dune_rl.sensors.lidar_3d import Lidar3d, Lidar3dConf
from dune_rl.sensors.medium import Compose, RangeEffect, effects_of
from dune_rl.sensors.navigation import EstimatedGoal, EstimatedVelocity, Navigation
from dune_rl.sensors.nearest_agent import NearestAgent, NearestAgentConf
from dune_rl.sensors.neighbours import Neighbours, NeighboursConf
from dune_rl.sensors.odometry import Odometry, OdometryConf
from dune_rl.sensors.position import Position, PositionConf
from dune_rl.sensors.realism.camera import CameraRealismConf, realistic_camera
from dune_rl.sensors.realism.defaults import LEG_SPEED
from dune_rl.sensors.realism.lidar import BeamFaults, LidarRealismConf
from dune_rl.sensors.realism.pipeline import (
    EncoderRealismConf,
    GoalRealismConf,
    ImuRealismConf,
    OdometryRealismConf,
    PositionRealismConf,
    ReadingRealismConf,
    RealismConf,
    SpeedRealismConf,
    realistic,
)
from dune_rl.sensors.registry import SENSORS, ReadingBounds
from dune_rl.sensors.scanner import Scanner
from dune_rl.sensors.sensor import Sensor
from dune_rl.sensors.velocity import MAX_SENSED_SPEED_MPS, PlanarVelocity, Velocity

MountPoint = Literal["scanner", "camera", "imu"]


class NoSensorSettings(Settings):
    """Of a sensor that has nothing to set."""


@dataclass(frozen=True)
class SensorRequest:
    """One sensor to be built: its name, its settings on the carrier, and its realism (None: a perfect one).

    `readings` are the names of those of its readings that are observed. `past_s` is the age of a LiDAR's past
    scan, and `encoders` are the encoders by which odometry counts. With `navigation`, what is derived from
    the robot's motion is computed from its readings instead of the truth.
    """

    name: str
    kind: str
    settings: Any
    realism: Any
    readings: tuple[str, ...]
    past_s: float
    encoders: EncodersConf
    navigation: Navigation | None = None


@dataclass(frozen=True)
class SensorKind:
    """A kind of sensor: the class of its settings, what builds one, and the class of its realism, if any.

    `mount` is where the carrier holds a sensor whose `mount_b` is None. Where `has_outputs`, the settings
    have `outputs`, and the readings are named "<name>_<output>"; otherwise there is one, "<name>".
    """

    settings: type[Settings]
    build: Callable[[SensorRequest, SensorContext], Sensor]
    realism: type[RealismConf] | None = None
    mount: MountPoint | None = None
    has_outputs: bool = False


def _plain(sensor: Sensor, request: SensorRequest, context: SensorContext) -> Sensor:
    return realistic(sensor, request.realism, context.num_rows, context.step_s)


def _lidar(request: SensorRequest, context: SensorContext) -> Sensor:
    conf: LidarConf = request.settings
    lidar = Lidar(conf, context.solid, context.meshes)
    limits_m = (conf.min_range_m, conf.range_m)
    effects: list[RangeEffect] = [
        *effects_of(context.air, request.name, lidar.directions_b, conf.mount_b, limits_m)
    ]
    if request.realism is not None:
        effects.append(BeamFaults(request.realism, conf, request.name))
    delay_steps = max(1, round(request.past_s / context.step_s))
    effect = Compose(effects) if effects else None
    scanner = Scanner(
        lidar, request.readings, context.num_rows, delay_steps, effect, request.name, request.navigation
    )
    return _plain(scanner, request, context)


def _lidar_3d(request: SensorRequest, context: SensorContext) -> Sensor:
    conf: Lidar3dConf = request.settings
    faults = None
    if request.realism is not None:
        limits_m, count = (conf.min_range_m, conf.range_m), conf.n_rings * conf.n_beams
        faults = BeamFaults.of_rings(request.realism, limits_m, count, request.name.replace("_", " "))
    lidar = Lidar3d(
        conf,
        context.solid,
        context.surfaces,
        context.meshes,
        context.num_rows,
        context.air,
        faults,
        request.name,
    )
    return _plain(lidar, request, context)


def _depth_strip(request: SensorRequest, context: SensorContext) -> Sensor:
    strip = DepthStrip(
        request.settings, context.solid, context.meshes, context.num_rows, context.air, request.name
    )
    return _plain(strip, request, context)


def _height_scan(request: SensorRequest, context: SensorContext) -> Sensor:
    scan = HeightScan(request.settings, context.solid, context.terrain, context.num_rows, request.name)
    return _plain(scan, request, context)


def _camera(request: SensorRequest, context: SensorContext) -> Sensor:
    camera = CameraSensor(context.make_cameras(request.settings), context.num_rows, request.name)
    return realistic_camera(camera, request.realism, context.num_rows, context.step_s, request.name)


def _imu(request: SensorRequest, context: SensorContext) -> Sensor:
    sensor = ImuSensor(request.settings, context.num_rows, context.step_s, request.name)
    return _plain(sensor, request, context)


def _goal(request: SensorRequest, context: SensorContext) -> Sensor:
    rows, farthest_m = context.num_rows, context.diagonal_m
    if request.navigation is not None and request.realism is None:
        return EstimatedGoal(request.navigation, rows, farthest_m, request.name)
    return _plain(Goal(rows, farthest_m, request.name), request, context)


def _velocity(request: SensorRequest, context: SensorContext) -> Sensor:
    return _plain(Velocity(context.num_rows, request.name), request, context)


def _planar_velocity(request: SensorRequest, context: SensorContext) -> Sensor:
    sensor = PlanarVelocity(context.num_rows, context.carrier.max_speed_mps, request.name)
    return _plain(sensor, request, context)


def _nearest_agent(request: SensorRequest, context: SensorContext) -> Sensor:
    closing_mps = MAX_SENSED_SPEED_MPS + context.carrier.max_speed_mps
    sensor = NearestAgent(request.settings, context.num_rows, context.diagonal_m, closing_mps, request.name)
    return _plain(sensor, request, context)


def _neighbours(request: SensorRequest, context: SensorContext) -> Sensor:
    closing_mps = MAX_SENSED_SPEED_MPS + context.carrier.max_speed_mps
    sensor = Neighbours(request.settings, context.num_rows, closing_mps, request.name)
    return _plain(sensor, request, context)


def _encoders(request: SensorRequest, context: SensorContext) -> Sensor:
    wheels = context.carrier.num_joints
    sensor = Encoders(request.settings, context.num_rows, wheels, context.step_s, request.name)
    return _plain(sensor, request, context)


def _odometry(request: SensorRequest, context: SensorContext) -> Sensor:
    drive = context.carrier.drive
    if drive is None:
        raise ConfigError("odometry is of wheels, and this robot has none; leave it out of sensors.enabled")
    sensor = Odometry(
        request.settings,
        request.encoders,
        drive,
        context.num_rows,
        context.carrier.num_joints,
        context.step_s,
        request.name,
    )
    return _plain(sensor, request, context)


def _currents(request: SensorRequest, context: SensorContext) -> Sensor:
    sensor = Currents(request.settings, context.num_rows, context.carrier.num_joints, request.name)
    return _plain(sensor, request, context)


def _position(request: SensorRequest, context: SensorContext) -> Sensor:
    sensor = Position(
        request.settings, context.extent, context.heights, context.num_rows, context.step_s, request.name
    )
    return _plain(sensor, request, context)


SENSOR_KINDS: dict[str, SensorKind] = {
    "lidar": SensorKind(LidarConf, _lidar, LidarRealismConf, "scanner"),
    "lidar_3d": SensorKind(Lidar3dConf, _lidar_3d, LidarRealismConf, "scanner", has_outputs=True),
    "depth_strip": SensorKind(DepthStripConf, _depth_strip, ReadingRealismConf, "scanner"),
    "height_scan": SensorKind(HeightScanConf, _height_scan, ReadingRealismConf),
    "camera": SensorKind(CameraConf, _camera, CameraRealismConf, "camera", has_outputs=True),
    "imu": SensorKind(ImuConf, _imu, ImuRealismConf, "imu"),
    "goal": SensorKind(NoSensorSettings, _goal, GoalRealismConf),
    "velocity": SensorKind(NoSensorSettings, _velocity, SpeedRealismConf),
    "planar_velocity": SensorKind(NoSensorSettings, _planar_velocity, ReadingRealismConf),
    "nearest_agent": SensorKind(NearestAgentConf, _nearest_agent, ReadingRealismConf),
    "neighbours": SensorKind(NeighboursConf, _neighbours, ReadingRealismConf),
    "encoders": SensorKind(EncodersConf, _encoders, EncoderRealismConf),
    "odometry": SensorKind(OdometryConf, _odometry, OdometryRealismConf),
    "currents": SensorKind(CurrentsConf, _currents, ReadingRealismConf),
    "position": SensorKind(PositionConf, _position, PositionRealismConf),
}


def build_sensor(request: SensorRequest, context: SensorContext) -> Sensor:
    """The sensor that `request` describes."""
    kind = SENSOR_KINDS.get(request.kind)
    if kind is not None:
        return kind.build(request, context)
    part = SENSORS.part_of(request.settings)
    if part.signature.is_class:
        return _plain(SENSORS.build(request.settings, request.name, context), request, context)
    bounds: ReadingBounds = part.target.sensor_bounds  # type: ignore[attr-defined]
    params = part.signature.arguments(request.settings)
    sensor = FunctionSensor(request.name, part.target, context.num_rows, bounds, params, part.origin)
    return _plain(sensor, request, context)


def build_navigation(requests: Mapping[str, SensorRequest], context: SensorContext) -> Navigation:
    """What the robots know of their motion, from instruments "imu", "velocity", "odometry" and "position".

    A velocity with realism of its own is measured with these faults; otherwise the speed is that of the
    odometry, on a body without wheels that of its legs, and the yaw rate the gyroscope's.
    """
    rows, step_s = context.num_rows, context.step_s
    imu = build_sensor(requests["imu"], context)
    instruments: dict[str, Sensor] = {"imu": imu}
    own = requests["velocity"].realism
    if own is not None:
        instruments["velocity"] = realistic(Velocity(rows), own, rows, step_s)
    elif context.carrier.drive is not None:
        instruments["odometry"] = build_sensor(requests["odometry"], context)
        instruments["velocity"] = EstimatedVelocity(instruments["odometry"], imu, rows)
    else:
        legs = realistic(Velocity(rows), LEG_SPEED, rows, step_s)
        instruments |= {"legs": legs, "velocity": EstimatedVelocity(legs, imu, rows)}
    if "position" in requests:
        instruments["position"] = build_sensor(requests["position"], context)
    return Navigation(instruments, rows, step_s)
