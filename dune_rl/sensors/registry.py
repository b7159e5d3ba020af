"""The sensors there are: ours, those of installed packages, and those that a program registers."""

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import SerializeAsAny, field_validator

from dune_rl.core.errors import RegistryError
from dune_rl.core.registry import RegisteredPart, Registry
from dune_rl.core.settings import Settings
from dune_rl.core.signatures import PartSignature
from dune_rl.sensors.realism.pipeline import ReadingRealismConf, RealismConf
from dune_rl.sensors.sensor import Sensor

_KINDS = "dune_rl.sensors.kinds"
_OWN = (
    "camera",
    "currents",
    "depth_strip",
    "encoders",
    "goal",
    "height_scan",
    "imu",
    "lidar",
    "lidar_3d",
    "nearest_agent",
    "neighbours",
    "odometry",
    "planar_velocity",
    "position",
    "velocity",
)


@dataclass(frozen=True)
class ReadingBounds:
    """What `dune_rl.sensor_bounds` states: a reading's size, and the lowest and highest of its entries."""

    low: float | tuple[float, ...]
    high: float | tuple[float, ...]
    size: int = 1


class SensorSettings(Settings):
    """Settings of a sensor: `sensor` names its kind, `realism` has the faults of a real part."""

    sensor: str
    realism: SerializeAsAny[RealismConf] | None = None

    @field_validator("realism", mode="before")
    @classmethod
    def _of_its_kind(cls, value: Any) -> Any:
        if value is None or isinstance(value, RealismConf):
            return value
        known: Any = ReadingRealismConf
        name = cls.model_fields["sensor"].default
        if name in _OWN:
            known = importlib.import_module(_KINDS).SENSOR_KINDS[name].realism
        if known is None:
            raise ValueError(f"a sensor of the kind {name} has no realism: leave it out")
        return known.model_validate(value)


class SensorRegistry(Registry[Sensor]):
    """Sensors are functions `f(state, group, *, SETTINGS) -> (N, size)` with `sensor_bounds`, and classes.

    A class has `__init__(self, name, context, *, SETTINGS)` and the methods of the `Sensor` protocol; `name`
    is that of its readings, or what their names begin with, and `context` is a `SensorContext`.
    """

    def __init__(self) -> None:
        super().__init__(
            "sensor",
            "dune_rl.sensors.registry:SENSORS",
            own=dict.fromkeys(_OWN, f"{_KINDS}:SENSOR_KINDS"),
            base=SensorSettings,
            product=Sensor,
            returned=np.ndarray,
            form="a function of (state, group) that returns an array, or a class made with (name, context)",
            function_leading=("state", "group"),
            class_leading=("name", "context"),
            tag="sensor",
        )

    def _read_own(self, name: str) -> RegisteredPart:
        # Ours are built from a request, which has more than the settings: see `SensorKind`.
        kind = importlib.import_module(_KINDS).SENSOR_KINDS[name]
        signature = PartSignature(kind.build, False, {}, "conf", kind.settings)
        origin = f"the sensor {name!r} of dune_rl"
        return self._with_derived_settings(kind.build, name, signature, origin, is_own=True)

    def _signature_of(self, target: Any, name: str, origin: str) -> PartSignature:
        signature = super()._signature_of(target, name, origin)
        if not signature.is_class and not hasattr(target, "sensor_bounds"):
            raise RegistryError(
                f"{origin}, whose values have no bounds: write "
                "@dune_rl.sensor_bounds(low=..., high=..., size=...) over it."
            )
        return signature


SENSORS = SensorRegistry()
