"""States for the sensors on wheels: made up, or of a rover that drives in true physics."""

import hashlib
from collections.abc import Iterable

import numpy as np
from scenes import Drive
from sensor_contexts import carrier_of, context_of
from states import begin, group_state, joints_from, measure, motion_of, resting

from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.robots.rover_zero import RoverZeroConf
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.own_motion import Position, PositionConf
from dune_rl.sensors.sensor import Sensor
from dune_rl.sensors.wheels import (
    Currents,
    CurrentsConf,
    DriveGeometry,
    Encoders,
    EncodersConf,
    Odometry,
    OdometryConf,
)
from dune_rl.state import GroupState, JointState

ALL = np.array([True])
WHEELS = 4
TRACK_M = 0.36
LEFT, RIGHT = (0, 2), (1, 3)


def geometry(track_m: float = TRACK_M) -> DriveGeometry:
    return DriveGeometry(RoverZeroConf().drive.wheel_radius_m, track_m, LEFT, RIGHT)


def wheels_state(
    angle: np.ndarray, speed: np.ndarray | float = 0.0, torque: np.ndarray | float = 0.0, step: int = 0
) -> GroupState:
    """Rovers that stand still while their wheels, (N, W), do this."""
    angle = np.asarray(angle, float)
    wheels = JointState(
        angle, *(np.broadcast_to(np.asarray(each, float), angle.shape) for each in (speed, torque))
    )
    return group_state(resting(len(angle), wheels), steps=step)


def reading(sensor: Sensor, row: int = 0) -> np.ndarray:
    (value,) = sensor.read().values()
    return value[row]


def within_bounds(sensor: Sensor) -> bool:
    ((low, high),) = sensor.bounds().values()
    (value,) = sensor.read().values()
    same = value.shape[1:] == low.shape == high.shape and value.dtype == low.dtype == high.dtype == np.float32
    return same and bool(((low <= value) & (value <= high)).all())


class Measured:
    """A rover whose sensors measure every control step of a `Drive`."""

    def __init__(self, drive: Drive, *sensors: Sensor) -> None:
        self.drive = drive
        self.sensors = sensors
        self.steps = 0
        self.begin()

    def _now(self) -> GroupState:
        stage = self.drive.stage
        self.motion = motion_of(stage.state, joints_from(np.array(stage.engine.drive_state())))
        return group_state(self.motion, steps=self.steps)

    def begin(self) -> None:
        self.steps = 0
        now = self._now()
        for sensor in self.sensors:
            begin(sensor, ALL, now)

    def step(self, speed: float, heading: float) -> None:
        self.drive.step(speed, heading)
        self.steps += 1
        now = self._now()
        for sensor in self.sensors:
            measure(sensor, now)


def on_wheels(
    encoders: EncodersConf,
    drive: DriveGeometry | None = None,
    num_rows: int = 1,
    wheels: int = WHEELS,
    **fields,
) -> SensorContext:
    """The context of sensors of wheels, which these encoders count."""
    carrier = carrier_of(num_joints=wheels, drive=drive)
    return context_of(num_rows, carrier=carrier, settings_of=lambda _: encoders, **fields)


def sensors_of_all_kinds(track_m: float = TRACK_M) -> list[Sensor]:
    """One of each, at the defaults, with some drift."""
    context = on_wheels(
        EncodersConf(), geometry(track_m), extent=(-20.0, 20.0, -20.0, 20.0), heights=(-1.0, 2.0)
    )
    drifting = PositionConf(drift_horizontal_m=1.0, drift_vertical_m=2.0)
    return [
        Encoders("encoders", context, EncodersConf()),
        Odometry("odometry", context, OdometryConf()),
        Currents("currents", context, CurrentsConf()),
        Position("position", context, drifting),
    ]


def digests(commands: Iterable[tuple[float, float]] | None = None) -> list[str]:
    """What each sensor tells of a winding drive, every byte of it; a fresh process prints the same."""
    if commands is None:
        commands = [(0.8 - 0.02 * number, np.sin(0.3 * number)) for number in range(60)]
    measured = Measured(Drive(BulletScene), *sensors_of_all_kinds())
    found = [hashlib.sha256() for _ in measured.sensors]
    for speed, heading in commands:
        measured.step(speed, heading)
        for digest, sensor in zip(found, measured.sensors, strict=True):
            assert within_bounds(sensor)
            digest.update(reading(sensor).tobytes())
    return [digest.hexdigest() for digest in found]
