"""Simulations of one robot per scene in either engine, with the raw engine states of every step."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.config.build import build_world, group_setups
from dune_rl.config.compose import compose_environment
from dune_rl.env.simulation import SimulationStep, VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.interface import Engine, PhysicsRobot, PhysicsScene, SceneSpec, scene_maker
from dune_rl.robots.robot import Robot
from dune_rl.state.state import Motion
from dune_rl.worlds.world import World

Actions = NDArray[np.floating]

_SLOPE_RAD = np.deg2rad(15.0)


class RecordingRobot:
    """A robot that remembers whether it ever had a contact with anything but ground."""

    def __init__(self, robot: PhysicsRobot) -> None:
        self._robot = robot
        self.had_contact = False

    def contacts(self) -> Sequence[int]:
        numbers = self._robot.contacts()
        self.had_contact |= bool(numbers)
        return numbers

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)


class RecordingScene:
    """A scene of one robot that records the state after each step as the engine reports it.

    `state` (13,) is as `PhysicsRobot.body_state`, `wheel_speeds` (J,) of the motors' joints, the
    wheels' first, are in rad/s, and `work_done_j` is the work [J] of the motors in the last step.
    """

    def __init__(self, scene: PhysicsScene) -> None:
        self._scene = scene
        self.robots = [RecordingRobot(robot) for robot in scene.robots]
        self.work_done_j = 0.0
        self.state: Array = np.zeros(13)
        self.wheel_speeds: Array = np.zeros(0)

    def finish_step(self) -> None:
        self._scene.finish_step()
        (robot,) = self._scene.robots
        self.work_done_j = robot.work_j()
        self.state = np.array(robot.body_state())
        self.wheel_speeds = np.array(robot.drive_state()).reshape(3, -1)[1]

    @property
    def had_contact(self) -> bool:
        """Whether the robot ever had a contact with anything but ground."""
        return self.robots[0].had_contact

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)


class RecordedSimulation:
    """M scenes with one robot each, in a world or on the plane of 15 degrees named `slope`.

    `scenes` are the recording scenes, in the order of the batch.
    """

    def __init__(
        self,
        world: str,
        engine: Engine,
        robot: str,
        num_scenes: int,
        seed: int,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        on_slope = world == "slope"
        conf = compose_environment(
            "flat" if on_slope else world,
            (),
            {
                **{"physics": engine, "robot": robot, "actors": "none", "sensors": ["imu", "goal"]},
                **(settings or {}),
            },
        )
        make = scene_maker(conf.physics.backend)
        self.scenes: list[RecordingScene] = []

        def make_scene(spec: SceneSpec) -> Any:
            self.scenes.append(RecordingScene(make(replace(spec, measures_work=True))))
            return self.scenes[-1]

        self.simulation = VectorSimulation(
            world=_slope() if on_slope else build_world(conf.world),
            groups=group_setups(conf),
            make_scene=make_scene,
            physics=conf.physics,
            num_scenes=num_scenes,
            seed=seed,
        )
        self._group = self.simulation.group()
        body: Any = self._group.body
        self.robot: Robot = body.robot
        self.step_s = conf.physics.control_step_s
        self.world = self.simulation.worlds.worlds[0]

    @property
    def motion(self) -> Motion:
        """True motion of the robots, rows (M,)."""
        return self._group.body.motion

    def step(self, actions: Actions) -> SimulationStep:
        """Advance all scenes by one control step with `actions` (M, A)."""
        return self.simulation.step({self._group.name: actions[:, None]})


def _slope() -> World:
    positions = np.arange(-50.0, 50.1, 5.0)
    heights = np.tile(np.tan(_SLOPE_RAD) * positions, (len(positions), 1))
    return World("slope", HeightField(heights, 5.0, (-50.0, -50.0)), region=(-8.0, 8.0, -8.0, 8.0))
