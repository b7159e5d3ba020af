"""Settings that sensors of all kinds have."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self

from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.core.settings import Settings
from dune_rl.sensors.realism.pipeline import ReadingRealismConf, RealismConf
from dune_rl.state.sensor_carrier import SensorCarrier


def _reading_realism(value: Any) -> Any:
    return value if isinstance(value, RealismConf) else ReadingRealismConf.model_validate(value)


class SensorSettings(Settings):
    """Settings of a sensor: its kind, the faults of a real device, and whether it is observed.

    `from_carrier` names the settings that follow from the body where they are None, with the attribute of
    `SensorCarrier` that they take. `default_realism` is the device that a sensor of the kind has where it has
    none of its own and another sensor of the robot has.
    """

    from_carrier: ClassVar[Mapping[str, str]] = {}
    default_realism: ClassVar[RealismConf | None] = None

    sensor: str = Field(description="kind of the sensor; by default its name")
    realism: Annotated[SerializeAsAny[RealismConf], BeforeValidator(_reading_realism)] | None = Field(
        None, description="faults of a real device; null: exact, or the default device"
    )
    privileged: bool = Field(
        False, description="whether critics alone read it in training, so that policies do without it"
    )
    observed: bool = Field(True, description="whether it is observed; false: robots only navigate by it")

    def steps(self, step_s: float) -> tuple[int, int]:
        """Control steps of `step_s` between two readings, and until a reading arrives."""
        return (1, 0) if self.realism is None else self.realism.steps(step_s)

    def mounted_on(self, carrier: SensorCarrier) -> Self:
        """The same with the carrier's values where `from_carrier` has None."""
        values = {
            name: getattr(carrier, value)
            for name, value in self.from_carrier.items()
            if getattr(self, name) is None
        }
        return self.model_copy(update=values)
