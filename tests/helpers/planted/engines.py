"""Real scenes with planted faults that a fault counter must see, and with a fall, which is not a fault."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import PhysicsRobot, PhysicsScene, SceneSpec

_PERIOD_STEPS = 20
_TELEPORT_M = 0.15
_KICK_MPS2 = 50.0


class UnchangedRobot:
    """The robot as it is; `raised_m` is added to the height of its start poses."""

    raised_m = 0.0

    def __init__(self, robot: PhysicsRobot, mass_kg: float) -> None:
        self.robot, self.mass_kg = robot, mass_kg
        self.steps = 0

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        x, y, z = position_w
        self.robot.set_start_pose([x, y, z + self.raised_m], quaternion)

    def before_step(self) -> None:
        """Change something before a control step; `steps` counts those before it in the episode."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.robot, name)


class RaisedRobot(UnchangedRobot):
    """The robot starts high in the air, and falls."""

    raised_m = 3.0


class KickedRobot(UnchangedRobot):
    """Once a second a force without a cause gives the robot 2.5 m/s in one control step."""

    def before_step(self) -> None:
        if self.steps % _PERIOD_STEPS == _PERIOD_STEPS - 1:
            push = _KICK_MPS2 * self.mass_kg
            self.robot.apply_force([0.6 * push, 0.0, 0.8 * push])


class TeleportedRobot(UnchangedRobot):
    """Once a second the robot is reported at another position, without ever having moved fast."""

    def body_state(self) -> tuple[float, ...]:
        x, *others = self.robot.body_state()
        return (x + _TELEPORT_M * (self.steps // _PERIOD_STEPS), *others)


class TamperedScene:
    """A scene whose robots are wrapped in `kind`."""

    def __init__(self, scene: PhysicsScene, kind: type[UnchangedRobot], mass_kg: float) -> None:
        self._scene = scene
        self.robots = [kind(robot, mass_kg) for robot in scene.robots]

    def reset(self, kinematic_poses: NDArray[np.float64]) -> None:
        self._scene.reset(kinematic_poses)
        for robot in self.robots:
            robot.steps = 0

    def begin_step(self, count: int, kinematic_poses: NDArray[np.float64]) -> None:
        for robot in self.robots:
            robot.before_step()
            robot.steps += 1
        self._scene.begin_step(count, kinematic_poses)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)


Maker = Callable[[str], Any]


def tampered(kind: type[UnchangedRobot], scene_maker: Maker, mass_kg: float) -> Maker:
    """`scene_maker`, with every robot of every scene wrapped in `kind`."""

    def make_of(backend: str) -> Any:
        make = scene_maker(backend)

        def make_scene(spec: SceneSpec) -> TamperedScene:
            return TamperedScene(make(spec), kind, mass_kg)

        return make_scene

    return make_of
