"""Settings of a group's sensors: which are observed, how each works, and what faults they have."""

import difflib
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal, Self, cast

from pydantic import BeforeValidator, Field, SerializeAsAny, ValidationInfo, create_model, field_validator

from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.context import SensorCarrier
from dune_rl.sensors.currents import CurrentsConf
from dune_rl.sensors.depth_strip import DepthStripConf
from dune_rl.sensors.encoders import EncodersConf
from dune_rl.sensors.height_scan import HeightScanConf
from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.kinds import SENSOR_KINDS, SensorKind, SensorRequest, sensor_kind
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.lidar_3d import Lidar3dConf
from dune_rl.sensors.odometry import OdometryConf
from dune_rl.sensors.position import PositionConf
from dune_rl.sensors.realism.camera import CameraRealismConf
from dune_rl.sensors.realism.lidar import LidarRealismConf
from dune_rl.sensors.realism.pipeline import (
    EncoderRealismConf,
    ImuRealismConf,
    OdometryRealismConf,
    PositionRealismConf,
    ReadingRealismConf,
    RealismConf,
    SpeedRealismConf,
)
from dune_rl.settings import Settings

# What a robot can observe without further settings.
ROBOT_SENSORS = (
    "lidar",
    "lidar_past",
    "lidar_3d",
    "depth_strip",
    "height_scan",
    "camera",
    "imu",
    "goal",
    "velocity",
    "encoders",
    "odometry",
    "currents",
    "position",
)
_PAST = "_past"


class SensorRealismConf(Settings):
    """The faults of real parts, for the sensors that have any; null is a perfect one.

    A name alone (`imu: bno055`) is a part that is known, with all its figures.
    """

    imu: ImuRealismConf | None = None
    lidar: LidarRealismConf | None = None
    lidar_3d: LidarRealismConf | None = None
    depth_strip: ReadingRealismConf | None = None
    height_scan: ReadingRealismConf | None = None
    camera: CameraRealismConf | None = None
    velocity: SpeedRealismConf | None = None
    encoders: EncoderRealismConf | None = None
    odometry: OdometryRealismConf | None = None
    currents: ReadingRealismConf | None = None
    position: PositionRealismConf | None = None

    def check(self, step_s: float) -> None:
        """Raise ValueError where a rate or a latency does not fit control steps of `step_s`."""
        for name in type(self).model_fields:
            check_timing(f"sensors.realism.{name}", getattr(self, name), step_s)


def check_timing(path: str, conf: RealismConf | None, step_s: float) -> None:
    """Raise ValueError, opened by the setting's `path`, where a rate or a latency does not fit `step_s`."""
    if conf is not None:
        try:
            conf.steps(step_s)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None


class NamedSensorConf(Settings):
    """Settings of a sensor with a name of its own: `sensor` is its kind, and the rest that kind's settings.

    `realism` has the faults of a real part, where the kind has any.
    """

    sensor: str
    realism: Any = None

    def __reduce__(self) -> tuple[Any, ...]:
        # The classes of kinds are made at run time: another process makes them again.
        return _named_sensor, (self.model_dump(mode="json"),)


@lru_cache(maxsize=64)
def _named_class(name: str, kind: SensorKind) -> type[NamedSensorConf]:
    label = "".join(word.capitalize() for word in name.split("_"))
    realism: Any = (None, None) if kind.realism is None else (kind.realism | None, None)
    fields: dict[str, Any] = {"sensor": (Literal[name], name), "realism": realism}
    # The bases differ from kind to kind, which mypy's plugin cannot follow.
    bases: Any = (NamedSensorConf, kind.settings)
    made: Any = create_model(
        f"Named{label}Conf",
        __base__=bases,
        __doc__=kind.settings.__doc__,
        **fields,
    )
    return cast(type[NamedSensorConf], made)


def _named_sensor(value: Any) -> Any:
    """The settings that a mapping has for the kind that its `sensor` names; anything else as it is."""
    if not isinstance(value, Mapping):
        return value
    name = value.get("sensor")
    kind = sensor_kind(name) if isinstance(name, str) else None
    if kind is None:
        raise ValueError(f"sensor must name a kind: {', '.join(sorted(SENSOR_KINDS))} (got {name!r})")
    return _named_class(str(name), kind).model_validate(value)


class SensorsConf(Settings):
    """The sensors whose readings make the observation, in this order, and their settings.

    `lidar_past` is the scan of `past_s` ago, carried into the present sensor frame: where it differs from the
    present scan, something has moved. Mounts that are None are those of the robot.

    `named` has further sensors: `{rear: {sensor: camera, mount_b: [-0.3, 0.0, 0.2]}}`. They are enabled by
    their names, and their readings are named so ("rear_rgb"). One that is called as a kind takes its place.
    """

    named: dict[str, Annotated[SerializeAsAny[NamedSensorConf], BeforeValidator(_named_sensor)]] = Field(
        default_factory=dict
    )
    enabled: tuple[str, ...] = ("lidar", "lidar_past", "imu", "goal", "velocity")
    lidar: LidarConf = LidarConf()
    past_s: float = Field(0.5, gt=0.0, le=5.0)
    lidar_3d: Lidar3dConf = Lidar3dConf()
    depth_strip: DepthStripConf = DepthStripConf()
    height_scan: HeightScanConf = HeightScanConf()
    camera: CameraConf = CameraConf()
    imu: ImuConf = ImuConf()
    encoders: EncodersConf = EncodersConf()
    odometry: OdometryConf = OdometryConf()
    currents: CurrentsConf = CurrentsConf()
    position: PositionConf = PositionConf()
    realism: SensorRealismConf = SensorRealismConf()

    @field_validator("enabled")
    @classmethod
    def _enabled_sensors_exist(cls, enabled: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        named = info.data.get("named", {})
        for name in enabled:
            if _instrument(name, named) is None:
                known = [*named, *ROBOT_SENSORS]
                near = difflib.get_close_matches(name, known, 1)
                remedy = f"did you mean {near[0]}?" if near else f"choose from {', '.join(known)}"
                raise ValueError(f"there is no sensor {name!r}; {remedy}")
        return enabled

    def check_timing(self, step_s: float) -> None:
        """Raise ValueError where a rate or a latency does not fit control steps of `step_s`."""
        self.realism.check(step_s)
        for name, conf in self.named.items():
            check_timing(f"sensors.named.{name}.realism", conf.realism, step_s)

    def mounted_on(self, carrier: SensorCarrier) -> Self:
        """The same with the carrier's mounts, camera pitch and standing height where these are None."""
        changes: dict[str, Any] = {
            name: _mounted(getattr(self, name), kind, carrier)
            for name, kind in SENSOR_KINDS.items()
            if name in type(self).model_fields
        }
        changes["named"] = {
            name: _mounted(conf, SENSOR_KINDS[conf.sensor], carrier) for name, conf in self.named.items()
        }
        return self.model_copy(update=changes)

    def requests(self) -> list[SensorRequest]:
        """The enabled sensors, each once, in the order of their first readings."""
        readings: dict[str, list[str]] = {}
        for name in self.enabled:
            instrument = _instrument(name, self.named)
            assert instrument is not None
            readings.setdefault(instrument, []).append(name)
        return [self._request(name, names) for name, names in readings.items()]

    def readings(self) -> list[str]:
        """Names of the readings, in order: a camera and a 3D LiDAR have one for each output."""
        names: list[str] = []
        for name in self.enabled:
            instrument = _instrument(name, self.named)
            assert instrument is not None
            request = self._request(instrument, [name])
            outputs = SENSOR_KINDS[request.kind].has_outputs
            names += [f"{name}_{each}" for each in request.settings.outputs] if outputs else [name]
        return names

    def _request(self, name: str, readings: list[str]) -> SensorRequest:
        kind = _kind_of(name, self.named)
        assert kind is not None
        settings: Any
        if name in self.named:
            settings = self.named[name]
            realism = settings.realism
        else:
            own = name in type(self).model_fields
            settings = getattr(self, name) if own else SENSOR_KINDS[kind].settings()
            realism = getattr(self.realism, name, None)
        return SensorRequest(name, kind, settings, realism, tuple(readings), self.past_s, self.encoders)


def _instrument(reading: str, named: Mapping[str, NamedSensorConf]) -> str | None:
    """The sensor that gives what is enabled as `reading`; None where there is none."""
    if _kind_of(reading, named) is not None:
        return reading
    base = reading.removesuffix(_PAST)
    return base if base != reading and _kind_of(base, named) == "lidar" else None


def _kind_of(name: str, named: Mapping[str, NamedSensorConf]) -> str | None:
    """The kind of the sensor called `name`; None where there is none."""
    if name in named:
        return named[name].sensor
    return name if sensor_kind(name) is not None else None


def _mounted(conf: Any, kind: SensorKind, carrier: SensorCarrier) -> Any:
    values: dict[str, Any] = {"standing_height_m": carrier.standing_height_m}
    if kind.mount is not None:
        values["mount_b"] = getattr(carrier, f"{kind.mount}_b")
    if kind.mount == "camera":
        values["pitch_rad"] = carrier.camera_pitch_rad
    missing = {key: value for key, value in values.items() if getattr(conf, key, value) is None}
    return conf.model_copy(update=missing)
