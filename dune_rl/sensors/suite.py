"""The sensors of one agent group, read once a control step; their readings make the observation."""

from dataclasses import replace

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Flags
from dune_rl.sensors.conf import SensorsConf
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.kinds import SensorRequest, build_navigation, build_sensor
from dune_rl.sensors.navigation import ControllerMotion, Navigation
from dune_rl.sensors.sensor import Bounds, Reading, Sensor
from dune_rl.state.state import GroupState, Motion, State


class SensorSuite:
    """The sensors that `conf` enables, for the N agents of one group.

    `conf` has mounts where the carrier has them. `bounds` are the lowest and highest values of each reading,
    in the order of the observation. `needs_joints` tells whether a sensor reads the joints' state.
    `navigation` is what the robots know of their own motion where any sensor has the faults of a real part,
    else None.

    Raises ConfigError for a mount that lies in the ground and for a sensor that the body cannot have.
    """

    def __init__(self, conf: SensorsConf, context: SensorContext) -> None:
        self.conf = conf = conf.mounted_on(context.carrier)
        self.navigation: Navigation | None = None
        instruments: dict[str, Sensor] = {}
        if conf.is_realistic:
            self.navigation = build_navigation(conf.navigation_requests(context.step_s), context)
            instruments = self.navigation.instruments
        self.sensors: dict[str, Sensor] = {}
        for request in conf.requests(context.step_s):
            _check_mount(request, context.carrier.standing_height_m)
            shared = instruments.get(request.name) if request.kind == request.name else None
            own = replace(request, navigation=self.navigation)
            self.sensors[request.name] = build_sensor(own, context) if shared is None else shared
        # The navigation reads its instruments itself.
        read = {id(sensor) for sensor in instruments.values()}
        self._others = [sensor for sensor in self.sensors.values() if id(sensor) not in read]
        every = [*instruments.values(), *self._others]
        self.needs_joints = any(getattr(sensor, "needs_joints", False) for sensor in every)
        known: dict[str, Bounds] = {}
        for sensor in self.sensors.values():
            known |= sensor.bounds()
        self._order = [name for reading in conf.readings() for name in _parts(reading, known)]
        self.bounds: dict[str, Bounds] = {name: known[name] for name in self._order}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Read at the start of the episodes in `mask` (N,), which have no past."""
        if self.navigation is not None:
            self.navigation.begin(mask, now, state)
        for sensor in self._others:
            sensor.begin(mask, now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Read at the end of a control step, once, after the goals of the next have been set."""
        if self.navigation is not None:
            self.navigation.measure(now, state)
        for sensor in self._others:
            sensor.measure(now, state)

    def controller_motion(self, now: GroupState) -> ControllerMotion | Motion:
        """What the robots' own controllers know of their motion: the truth of `now`, or faulty readings."""
        return now.motion if self.navigation is None else self.navigation.motion

    def observe(self) -> dict[str, Reading]:
        """The latest readings by name, each (N, ...); repeated calls return equal arrays."""
        readings: dict[str, Reading] = {}
        for sensor in self.sensors.values():
            readings |= sensor.read()
        return {name: readings[name] for name in self._order}


def _parts(reading: str, known: dict[str, Bounds]) -> list[str]:
    """Names of the arrays of a reading: itself, or all that begin with it where a sensor has several."""
    return [reading] if reading in known else [name for name in known if name.startswith(f"{reading}_")]


def _check_mount(request: SensorRequest, height_m: float) -> None:
    mount = getattr(request.settings, "mount_b", None)
    if mount is not None and request.kind != "imu" and mount[2] <= -height_m:
        raise ConfigError(
            f"sensors.{request.name}.mount_b lies in the ground: its third value, up of the robot's origin, "
            f"must be above {-height_m:g} (got {mount[2]:g})"
        )
