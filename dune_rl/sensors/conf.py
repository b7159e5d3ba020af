"""Settings of a group's sensors: which are observed, how each works, and what faults they have."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, SerializeAsAny, ValidationInfo, field_validator

from dune_rl.core.errors import DuneError
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import closest, one_of
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.currents import CurrentsConf
from dune_rl.sensors.depth_strip import DepthStripConf
from dune_rl.sensors.encoders import EncodersConf
from dune_rl.sensors.height_scan import HeightScanConf
from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.kinds import SENSOR_KINDS, SensorKind, SensorRequest
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.lidar_3d import Lidar3dConf
from dune_rl.sensors.odometry import OdometryConf
from dune_rl.sensors.position import PositionConf
from dune_rl.sensors.realism.camera import CameraRealismConf
from dune_rl.sensors.realism.defaults import default_realism
from dune_rl.sensors.realism.lidar import LidarRealismConf
from dune_rl.sensors.realism.pipeline import (
    EncoderRealismConf,
    GoalRealismConf,
    ImuRealismConf,
    OdometryRealismConf,
    PositionRealismConf,
    ReadingRealismConf,
    RealismConf,
    SpeedRealismConf,
)
from dune_rl.sensors.registry import SENSORS, SensorSettings
from dune_rl.state.sensor_carrier import SensorCarrier

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
    """The faults of real parts.

    Where all are null, every reading is exact. Once one is set, those that are null have the default part of
    their kind (`realism/defaults.py`), and goal, velocity, the past scan's motion and what the robot's
    controller knows are computed from faulty readings. A name alone (`imu: bno055`) is a part that is known,
    with all its figures; `perfect` has no faults.
    """

    imu: ImuRealismConf | None = None
    lidar: LidarRealismConf | None = None
    lidar_3d: LidarRealismConf | None = None
    depth_strip: ReadingRealismConf | None = None
    height_scan: ReadingRealismConf | None = None
    camera: CameraRealismConf | None = None
    goal: GoalRealismConf | None = None
    velocity: SpeedRealismConf | None = None
    encoders: EncoderRealismConf | None = None
    odometry: OdometryRealismConf | None = None
    currents: ReadingRealismConf | None = None
    position: PositionRealismConf | None = None

    @property
    def is_set(self) -> bool:
        """Whether any sensor has faults."""
        return any(getattr(self, name) is not None for name in type(self).model_fields)

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


NamedSensor = Annotated[SerializeAsAny[SensorSettings], BeforeValidator(SENSORS.parse_settings)]


class SensorsConf(Settings):
    """The sensors whose readings make the observation, in this order, and their settings.

    `lidar_past` is the scan of `past_s` ago, carried into the present sensor frame: where it differs from the
    present scan, something has moved. Mounts that are None are those of the robot.

    `named` has further sensors: `{rear: {sensor: camera, mount_b: [-0.3, 0.0, 0.2]}}`. They are enabled by
    their names, and their readings are named so ("rear_rgb"). Without `sensor`, the name is the kind; one
    that has the name of another kind takes its place.
    """

    named: Annotated[dict[str, NamedSensor], BeforeValidator(SENSORS.tag_entries)] = Field(
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
            instrument = _instrument(name, named)
            if instrument is None:
                known = [*named, *ROBOT_SENSORS, *SENSORS.user_names()]
                near = closest(name, known)
                remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}"
                raise ValueError(f"there is no sensor {name!r}; {remedy}")
            if instrument not in named and instrument not in SENSOR_KINDS:
                # A user's sensor: its settings take it to worker processes, and are saved with a run.
                named[instrument] = _default_settings(instrument)
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
            name: _mounted(conf, SENSOR_KINDS.get(conf.sensor), carrier) for name, conf in self.named.items()
        }
        return self.model_copy(update=changes)

    @property
    def is_realistic(self) -> bool:
        """Whether any sensor has the faults of a real part: then none is perfect unless it is set so."""
        return self.realism.is_set or any(conf.realism is not None for conf in self.named.values())

    def requests(self, step_s: float) -> list[SensorRequest]:
        """The enabled sensors, each once, in the order of their first readings."""
        readings: dict[str, list[str]] = {}
        for name in self.enabled:
            instrument = _instrument(name, self.named)
            assert instrument is not None
            readings.setdefault(instrument, []).append(name)
        realistic = self.is_realistic
        return [self._request(name, names, step_s, realistic) for name, names in readings.items()]

    def navigation_requests(self, step_s: float) -> dict[str, SensorRequest]:
        """The instruments that a robot navigates by, whether they are observed or not."""
        names = ["imu", "odometry", "velocity"]
        kinds = {_kind_of(name, self.named) for name in [*self.enabled, *self.named]}
        if kinds & {"goal", "position"}:
            names.append("position")
        # One of another kind that has the name of such an instrument leaves that as it is.
        named = {key: conf for key, conf in self.named.items() if key not in names or conf.sensor == key}
        plain = self.model_copy(update={"named": named})
        return {name: plain._request(name, [name], step_s, self.is_realistic) for name in names}

    def readings(self) -> list[str]:
        """Names of the readings, in order: a camera and a 3D LiDAR have one for each output."""
        names: list[str] = []
        for name in self.enabled:
            instrument = _instrument(name, self.named)
            assert instrument is not None
            kind = SENSOR_KINDS.get(_kind_of(instrument, self.named) or "")
            outputs = self._settings(instrument).outputs if kind is not None and kind.has_outputs else ()
            names += [f"{name}_{output}" for output in outputs] or [name]
        return names

    def sensed_groups(self) -> dict[str, tuple[str, ...]]:
        """The agent groups that sensors in `enabled` are limited to, by the sensor's name."""
        instruments = dict.fromkeys(_instrument(reading, self.named) for reading in self.enabled)
        settings = {name: self._settings(name) for name in instruments if name is not None}
        return {name: groups for name, conf in settings.items() if (groups := getattr(conf, "groups", ()))}

    def _settings(self, name: str) -> Any:
        """The settings of the sensor called `name`."""
        if name in self.named:
            return self.named[name]
        return getattr(self, name) if name in type(self).model_fields else _default_settings(name)

    def _request(self, name: str, readings: list[str], step_s: float, realistic: bool) -> SensorRequest:
        kind = _kind_of(name, self.named)
        assert kind is not None
        realism = self.named[name].realism if name in self.named else getattr(self.realism, name, None)
        if realism is None and realistic:
            realism = default_realism(kind, step_s)
        return SensorRequest(
            name, kind, self._settings(name), realism, tuple(readings), self.past_s, self.encoders
        )


def _instrument(reading: str, named: Mapping[str, SensorSettings]) -> str | None:
    """The sensor that gives what is enabled as `reading`; None where there is none."""
    if _kind_of(reading, named) is not None:
        return reading
    base = reading.removesuffix(_PAST)
    return base if base != reading and _kind_of(base, named) == "lidar" else None


def _kind_of(name: str, named: Mapping[str, SensorSettings]) -> str | None:
    """The kind of the sensor called `name`; None where there is none."""
    if name in named:
        return named[name].sensor
    try:
        return name if name in SENSOR_KINDS or SENSORS.settings_class(name) is not None else None
    except DuneError as error:
        raise ValueError(str(error)) from None


def _default_settings(kind: str) -> Any:
    """The settings of a kind without any given; ValueError where it needs some."""
    own = SENSOR_KINDS.get(kind)
    settings = SENSORS.settings_class(kind) if own is None else own.settings
    assert settings is not None
    missing = [name for name, field in settings.model_fields.items() if field.is_required()]
    if missing:
        example = ", ".join(f"{name}: ..." for name in missing)
        raise ValueError(f"the sensor {kind} needs settings: write named: {{{kind}: {{{example}}}}} too")
    return settings()


def _mounted(conf: Any, kind: SensorKind | None, carrier: SensorCarrier) -> Any:
    values: dict[str, Any] = {"standing_height_m": carrier.standing_height_m}
    if kind is not None and kind.mount is not None:
        values["mount_b"] = getattr(carrier, f"{kind.mount}_b")
    if kind is not None and kind.mount == "camera":
        values["pitch_deg"] = carrier.camera_pitch_deg
    missing = {key: value for key, value in values.items() if getattr(conf, key, value) is None}
    return conf.model_copy(update=missing)
