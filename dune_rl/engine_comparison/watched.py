"""A batch in either engine that can be watched closer than an environment lets one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.config.build import build_robot, build_world, scene_class
from dune_rl.config.compose import compose_environment
from dune_rl.env.batch import Batch
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.interface import Engine, PhysicsRobot, PhysicsScene, SceneSpec
from dune_rl.worlds.world import World

_SLOPE_RAD = np.deg2rad(15.0)


class WatchedRobot:
    """A robot that remembers whether it ever touched anything but ground."""

    def __init__(self, robot: PhysicsRobot) -> None:
        self._robot = robot
        self.has_touched = False

    def contacts(self) -> Sequence[int]:
        """As `PhysicsRobot.contacts`."""
        found = self._robot.contacts()
        self.has_touched |= bool(found)
        return found

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)


class WatchedScene:
    """A scene that keeps its robot's state after the last step, as the engine reported it.

    `work_done_j` is the work of the robot's motors in that step [J].
    """

    def __init__(self, scene: PhysicsScene) -> None:
        self._scene = scene
        self.robots = [WatchedRobot(robot) for robot in scene.robots]
        self.work_done_j = 0.0
        self.state: NDArray[np.float64] = np.zeros(13)
        self.wheel_speeds: NDArray[np.float64] = np.zeros(0)

    def step(self, count: int, kinematic_poses: NDArray[np.float64]) -> None:
        """As `PhysicsScene.step`."""
        self._scene.step(count, kinematic_poses)
        (robot,) = self._scene.robots
        self.work_done_j = robot.work_j()
        self.state = np.array(robot.body_state())
        self.wheel_speeds = np.array(robot.drive_state()).reshape(3, -1)[1]

    @property
    def has_touched(self) -> bool:
        """Whether the robot ever touched anything but ground."""
        return self.robots[0].has_touched

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)


def watched_batch(
    place: str, engine: Engine, robot: str, scenes: int, seed: int, settings: Mapping[str, Any]
) -> tuple[Batch, list[WatchedScene]]:
    """A batch in a world, or on the plane of 15 degrees that is called `slope`, and its scenes."""
    slope = place == "slope"
    conf = compose_environment(
        "flat" if slope else place,
        (),
        {"physics": engine, "robot": robot, "actors": "none", "sensors": ["imu", "goal"], **settings},
    )
    make = scene_class(conf.physics.backend)
    watched: list[WatchedScene] = []

    def make_scene(spec: SceneSpec) -> Any:
        watched.append(WatchedScene(make(replace(spec, measures_work=True))))
        return watched[-1]

    batch = Batch(
        world=_slope() if slope else build_world(conf.world),
        make_robot=lambda number: build_robot(conf.robot, number),
        make_scene=make_scene,
        actors=conf.actors,
        sensors=conf.sensors,
        physics=conf.physics,
        task=conf.task,
        metrics=conf.metrics,
        num_scenes=scenes,
        seed=seed,
    )
    return batch, watched


def _slope() -> World:
    places = np.arange(-50.0, 50.1, 5.0)
    heights = np.tile(np.tan(_SLOPE_RAD) * places, (len(places), 1))
    return World("slope", HeightField(heights, 5.0, (-50.0, -50.0)), region=(-8.0, 8.0, -8.0, 8.0))
