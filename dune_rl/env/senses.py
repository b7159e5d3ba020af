"""What rovers sense: their instruments read once a control step, and the observation made of the readings."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dune_rl.actors.actor import Actors
from dune_rl.actors.shapes import actor_moving_meshes
from dune_rl.errors import ConfigError
from dune_rl.geometry.batched import BatchedHeightFields, BatchedRayScenes
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.beam_surface import BatchedBeamSurfaces
from dune_rl.rendering.foliage import BatchedFoliage, Foliage
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.participating_media import BeamMedia
from dune_rl.rendering.weather import Haze, WeatherConf
from dune_rl.robots.robot import Robot
from dune_rl.sensors.camera import Camera, CameraConf, Cameras
from dune_rl.sensors.imu import Imu
from dune_rl.sensors.odometry import DriveGeometry
from dune_rl.sensors.sensor import PI32, Bounds, Moment, Reading
from dune_rl.sensors.suite import SensorsConf, Surroundings, make_sensors
from dune_rl.worlds.appearance import bake_in_weather, with_own_sun
from dune_rl.worlds.batched_worlds import BatchedWorlds, WorldAppearance
from dune_rl.worlds.beam_surface import beam_surface
from dune_rl.worlds.world import World

Array = NDArray[np.float64]

_GOAL = "goal"
# Over the highest and under the lowest thing, where a rover can still be.
_ROOM_M = 1.0


class Senses:
    """The instruments of M rovers, and the goal, which the task tells; the unwanted is not measured.

    Where `worlds_differ`, from episode to episode, bounds are those of any world
    as large as the first: spaces never change. `others` are the figures of other
    robots, whose poses follow those of the actors in a `Moment`. `needs_wheels` tells whether an
    instrument reads a moment's `wheels`.
    """

    def __init__(
        self,
        conf: SensorsConf,
        sites: BatchedWorlds,
        robot: Robot,
        actors: Actors,
        physics: PhysicsConf,
        *,
        worlds_differ: bool = False,
        others: Sequence[MovingMesh] = (),
    ) -> None:
        self.conf = conf = carried_by(robot, conf)
        num_scenes = len(sites)
        # The first world stands for all: they have the same extent.
        world, weather = sites.appearances[0].world, sites.appearances[0].weather
        shapes = [*actor_moving_meshes(actors.confs), *others]
        around = Surroundings(
            solid=BatchedRayScenes(sites.worlds.map(_rays)),
            surfaces=BatchedBeamSurfaces(sites.worlds.map(beam_surface)),
            figures=shapes,
            terrain=BatchedHeightFields(sites.worlds.map(_terrain)),
            extent=world.extent,
            heights=_any_heights(world) if worlds_differ else _heights(world),
            num_wheels=len(robot.body.drive_joints),
            wheels=_drive_geometry(robot),
            cameras=partial(_cameras, sites, shapes),
            air=_beam_air(sites, weather, worlds_differ),
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


def _cameras(sites: BatchedWorlds, shapes: Sequence[MovingMesh], conf: CameraConf) -> Cameras:
    def camera(look: WorldAppearance) -> Camera:
        return Camera(conf, bake_in_weather(look.world, look.weather), shapes, look.air)

    return Cameras(conf, sites.appearances.map(camera))


def _beam_air(sites: BatchedWorlds, weather: WeatherConf, worlds_differ: bool) -> BeamMedia:
    grassy = worlds_differ or any(world.grass is not None for world, _ in sites.worlds.groups)
    return BeamMedia(
        Haze.of(with_own_sun(sites.worlds[0], weather)),
        BatchedFoliage(sites.worlds.map(_foliage)) if grassy else None,
    )


def _heights(world: World) -> tuple[float, float]:
    """Heights [m] between which a rover can be in `world`."""
    heights = world.solid_mesh().vertices[:, 2]
    return float(heights.min()) - _ROOM_M, float(heights.max()) + _ROOM_M


def _any_heights(world: World) -> tuple[float, float]:
    """Heights [m] between which a rover can be in any world as large as `world`, by its size alone."""
    xmin, xmax, ymin, ymax = world.extent
    reach = float(np.hypot(xmax - xmin, ymax - ymin)) / 2
    return -reach, reach


def _rays(world: World) -> RayScene:
    return world.rays


def _terrain(world: World) -> HeightField:
    return world.terrain


def _foliage(world: World) -> Foliage | None:
    return None if world.grass is None else world.grass.foliage


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
