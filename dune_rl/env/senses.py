"""What rovers sense: their instruments read once a control step, and the observation made of the readings."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from dune_rl.actors.actor import Actors
from dune_rl.actors.shapes import figures
from dune_rl.errors import ConfigError
from dune_rl.geometry.rays import RayScene
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.air import Air
from dune_rl.rendering.weather import Haze, WeatherConf
from dune_rl.robots.robot import Robot
from dune_rl.sensors.imu import Imu
from dune_rl.sensors.odometry import DriveGeometry
from dune_rl.sensors.sensor import PI32, Bounds, Moment, Reading
from dune_rl.sensors.suite import SensorsConf, Surroundings, make_sensors
from dune_rl.worlds.appearance import in_weather
from dune_rl.worlds.solid_look import solid_look
from dune_rl.worlds.world import World

Array = NDArray[np.float64]

_GOAL = "goal"
# Over the highest and under the lowest thing, where a rover can still be.
_ROOM_M = 1.0


class Senses:
    """The instruments of M rovers, and the goal, which the task tells; the unwanted is not measured.

    `needs_wheels` tells whether one of them reads a moment's `wheels`.
    """

    def __init__(
        self,
        conf: SensorsConf,
        world: World,
        robot: Robot,
        actors: Actors,
        physics: PhysicsConf,
        num_scenes: int,
        weather: WeatherConf,
    ) -> None:
        self.conf = conf = carried_by(robot, conf)
        solid = world.solid_mesh()
        low, high = float(solid.vertices[:, 2].min()), float(solid.vertices[:, 2].max())
        around = Surroundings(
            solid=RayScene(solid.vertices, solid.faces),
            figures=figures(actors.confs),
            terrain=world.terrain,
            extent=world.extent,
            heights=(low - _ROOM_M, high + _ROOM_M),
            num_wheels=len(robot.body.drive_joints),
            wheels=_drive_geometry(robot),
            appearance=partial(in_weather, world, weather),
            surface=partial(solid_look, world),
            air=air_of(world, weather),
        )
        self._imu = Imu(conf.imu, num_scenes)
        self._sensors = make_sensors(conf, around, self._imu, num_scenes, physics.control_step_s)
        xmin, xmax, ymin, ymax = world.extent
        self.farthest_goal_m = float(np.hypot(xmax - xmin, ymax - ymin))
        known = {_GOAL: self._goal_bounds()}
        for sensor in self._sensors:
            known |= sensor.bounds()
        # A wheel's state costs a call of physics for every scene: it is asked for where it is read.
        self.needs_wheels = any(getattr(sensor, "needs_wheels", False) for sensor in self._sensors)
        self._order = conf.readings()
        self.bounds: dict[str, Bounds] = {name: known[name] for name in self._order}

    def _goal_bounds(self) -> Bounds:
        low, high = [0.0, -PI32], [self.farthest_goal_m, PI32]
        return np.array(low, np.float32), np.array(high, np.float32)

    @property
    def acceleration_b(self) -> Array:
        """Acceleration without gravity in the body frame [m/s²], (M, 3), over the last control step."""
        return self._imu.acceleration_b

    def begin(self, mask: NDArray[np.bool_], now: Moment) -> None:
        """Read the instruments at the start of the episodes in `mask` (M,), which have no past."""
        for sensor in self._sensors:
            sensor.begin(mask, now)

    def measure(self, now: Moment) -> None:
        """Read the instruments at the end of a control step, once."""
        for sensor in self._sensors:
            sensor.measure(now)

    def observe(self, distance: Array, bearing: Array) -> dict[str, Reading]:
        """The observation, each part (M, ...), for goals at `distance` [m] and `bearing` [rad], (M,).

        Asking twice gives the same.
        """
        goal = np.stack([np.minimum(distance, self.farthest_goal_m), bearing], axis=1)
        readings: dict[str, Reading] = {_GOAL: goal.astype(np.float32)}
        for sensor in self._sensors:
            readings |= sensor.read()
        return {name: readings[name] for name in self._order}


def air_of(world: World, weather: WeatherConf) -> Air:
    """What lies between sensors or pictures and what they show."""
    return Air(Haze.of(weather), None if world.grass is None else world.grass.foliage)


def carried_by(robot: Robot, conf: SensorsConf) -> SensorsConf:
    """The sensors at their places on `robot`; `ConfigError` where one would lie in the ground."""
    mounts, height = robot.mounts, robot.standing_height_m
    placed = conf.on(
        scanner_b=mounts.scanner_b,
        camera_b=mounts.camera_b,
        camera_pitch_rad=mounts.camera_pitch_rad,
        imu_b=mounts.imu_b,
        standing_height_m=height,
    )
    for name in placed.enabled:
        mount = getattr(getattr(placed, name, None), "mount_b", None)
        if mount is not None and name != "imu" and mount[2] <= -height:
            raise ConfigError(
                f"sensors.{name}.mount_b lies in the ground: its third value, up of the robot's origin, "
                f"must be above {-height:g} (got {mount[2]:g})"
            )
    return placed


def _drive_geometry(robot: Robot) -> DriveGeometry | None:
    wheels = robot.wheels
    if wheels is None:
        return None
    return DriveGeometry(wheels.radius_m, wheels.track_m, wheels.left, wheels.right)
