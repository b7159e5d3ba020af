"""The sensors of one agent group, read once a control step; their readings make the observation."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import advise
from dune_rl.geometry.arrays import Flags
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.navigation import ControllerMotion, Navigation
from dune_rl.sensors.own_motion import LEG_SPEED, EstimatedVelocity
from dune_rl.sensors.realism.pipeline import realistic
from dune_rl.sensors.registry import SENSORS
from dune_rl.sensors.sensor import Bounds, Reading, Sensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, Motion, State

# Sensors of robots that know where they are by their receiver.
_NEED_POSITION = (
    *("command_costs", "goal", "goal_direction", "height_scan", "nearest_agent", "neighbours", "position"),
    "way_left",
)

# With realism of their own these are the truth with its faults, and not what follows from the instruments.
_TRUE_WITH_OWN_FAULTS = ("goal", "height_scan", "nearest_agent", "neighbours", "planar_velocity")


class SensorSuite:
    """The sensors of `conf` for the N agents of one group.

    `settings` are those of `conf` with the carrier's mounts, and realism for all sensors if any has it.
    `sensors` have those that are read, each after the sensors that it reads itself. `bounds` are the lowest
    and highest values of each reading, in the order of the observation; of those in `privileged` no policy
    knows. `needs_joints` tells whether a sensor
    reads the joints' state. `navigation` is what the robots know of their own motion where any sensor has the
    faults of a real device, else None.

    Raises ConfigError for a mount that lies in the ground and for a sensor that the body cannot have.
    """

    def __init__(self, conf: Mapping[str, SensorSettings], context: SensorContext) -> None:
        own_faults = {name: each.sensor for name, each in conf.items() if each.realism is not None}
        self._is_realistic = bool(own_faults)
        self._is_truthful = {name for name, kind in own_faults.items() if kind in _TRUE_WITH_OWN_FAULTS}
        self._context = replace(
            context, sensor_of=self._sensor, settings_of=self.settings_of, reading_of=self._reading_of
        )
        self.settings = {name: self._complete(each) for name, each in conf.items()}
        self.navigation: Navigation | None = None
        self._instruments_by_name = instruments = dict[str, Sensor]()
        if self._is_realistic:
            instruments |= self._instruments()
            self.navigation = Navigation(instruments, context.num_rows, context.step_s)
            self._context = replace(self._context, navigation=self.navigation)
        shared = {
            name: sensor for name, sensor in instruments.items() if name in conf and conf[name].sensor == name
        }
        self._exact: dict[str, Sensor] = {}
        self.sensors: dict[str, Sensor] = {}
        for name, each in self.settings.items():
            if each.observed:
                _check_mount(name, each, context.carrier.standing_height_m)
                if name in shared:
                    self.sensors[name] = shared[name]
                else:
                    self._sensor(name)
        # The navigation reads its instruments itself.
        self._measured = [sensor for name, sensor in self.sensors.items() if name not in shared]
        self.needs_joints = any(
            getattr(sensor, "needs_joints", False) for sensor in (*instruments.values(), *self._measured)
        )
        self._observed = [self.sensors[name] for name, each in self.settings.items() if each.observed]
        self.bounds: dict[str, Bounds] = {}
        for sensor in self._observed:
            self.bounds |= sensor.bounds()
        self.privileged = frozenset(
            reading
            for name, each in self.settings.items()
            if each.observed and each.privileged
            for reading in self.sensors[name].bounds()
        )

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Read at the start of the episodes in `mask` (N,), which have no past."""
        if self.navigation is not None:
            self.navigation.begin(mask, now, state)
        for sensor in self._measured:
            sensor.begin(mask, now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Read at the end of a control step, once, after the goals of the next have been set."""
        if self.navigation is not None:
            self.navigation.measure(now, state)
        for sensor in self._measured:
            sensor.measure(now, state)

    def controller_motion(self, now: GroupState) -> ControllerMotion | Motion:
        """What the robots' own controllers know of their motion: the truth of `now`, or faulty readings."""
        return now.motion if self.navigation is None else self.navigation.motion

    def observe(self) -> dict[str, Reading]:
        """The latest readings by name, each (N, ...); repeated calls return equal arrays."""
        readings: dict[str, Reading] = {}
        for sensor in self._observed:
            readings |= sensor.read()
        return readings

    def without_timing(self, name: str) -> Sensor:
        """The sensor `name` as it measures in every control step, before a device's rate and latency."""
        return self._sensor(name)

    def _sensor(self, name: str) -> Sensor:
        """The sensor `name` without rate, latency and noise, built when it is first asked for."""
        if name not in self._exact:
            conf = self.settings.get(name) or self.settings_of(name)
            self._exact[name], self.sensors[name] = self._build(name, conf)
        return self._exact[name]

    def _reading_of(self, name: str) -> Callable[[], Reading]:
        """A function that returns the latest reading of the sensor `name`, as the robot has it."""
        instrument = self._instruments_by_name.get(name)
        if instrument is None:
            self._sensor(name)
            instrument = self.sensors[name]
        return lambda: instrument.read()[name]

    def _build(self, name: str, conf: SensorSettings) -> tuple[Sensor, Sensor]:
        """A sensor without, and with, rate, latency and noise."""
        context = self._context
        if name in self._is_truthful:
            context = replace(context, navigation=None)
        exact = SENSORS.build_sensor(conf, name, context)
        return exact, realistic(exact, conf.realism, self._context.num_rows, self._context.step_s)

    def settings_of(self, kind: str) -> Any:
        """The settings of the sensor that is called after its kind, or the kind's defaults."""
        conf = self.settings.get(kind)
        if conf is not None and conf.sensor == kind:
            return conf
        known = SENSORS.settings_class(kind)
        if known is None:
            remedy = advise(kind, [*self.settings, *SENSORS.names()])
            raise ConfigError(f"sensors: there is no sensor {kind!r} to read; {remedy}")
        return self._complete(known())

    def _complete(self, conf: SensorSettings) -> SensorSettings:
        """Settings with the carrier's mounts, and a device for a sensor without one where another has one."""
        realism = conf.realism
        if realism is None and self._is_realistic and conf.default_realism is not None:
            realism = conf.default_realism.fit_to(self._context.step_s)
        return conf.mounted_on(self._context.carrier).model_copy(update={"realism": realism})

    def _instruments(self) -> dict[str, Sensor]:
        """The instruments that robots navigate by, whether they are observed or not.

        A velocity with realism of its own is measured with these faults; otherwise the speed is that of the
        odometry, on a body without wheels that of its legs, and the yaw rate the gyroscope's.
        """
        rows, step_s = self._context.num_rows, self._context.step_s
        imu = self._build("imu", self.settings_of("imu"))[1]
        instruments: dict[str, Sensor] = {"imu": imu}
        velocity = self.settings_of("velocity")
        if velocity.realism is not None:
            instruments["velocity"] = self._build("velocity", velocity)[1]
        elif self._context.carrier.drive is not None:
            odometry = self._build("odometry", self.settings_of("odometry"))[1]
            instruments |= {"odometry": odometry, "velocity": EstimatedVelocity(odometry, imu, rows)}
        else:
            exact = SENSORS.build_sensor(velocity, "velocity", self._context)
            legs = realistic(exact, LEG_SPEED, rows, step_s)
            instruments |= {"legs": legs, "velocity": EstimatedVelocity(legs, imu, rows)}
        if any(conf.sensor in _NEED_POSITION for conf in self.settings.values()):
            instruments["position"] = self._build("position", self.settings_of("position"))[1]
        return instruments


def _check_mount(name: str, conf: SensorSettings, height_m: float) -> None:
    mount = getattr(conf, "mount_b", None)
    if mount is not None and conf.sensor != "imu" and mount[2] <= -height_m:
        raise ConfigError(
            f"sensors.{name}.mount_b lies in the ground: its third value, up of the robot's origin, "
            f"must be above {-height_m:g} (got {mount[2]:g})"
        )
