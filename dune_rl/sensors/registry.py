"""The sensors there are: ours, those of installed packages, and those that a program registers."""

from dune_rl.registry import Registry
from dune_rl.sensors.sensor import Sensor
from dune_rl.settings import Settings


class SensorSettings(Settings):
    """Settings of a sensor; `sensor` says of which, so that settings read from a file find their class."""

    sensor: str


SENSORS: Registry[Sensor] = Registry(
    "sensor",
    "dune_rl.sensors.registry:SENSORS",
    own={},
    base=SensorSettings,
    product=Sensor,
    form="a function of (context) that returns a Sensor, or a class of sensors",
    function_leading=("context",),
    class_leading=("context",),
    tag="sensor",
)
