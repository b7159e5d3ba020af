"""Physics without an engine: robots that are where a test puts them, and touch what it says."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from simulations import environment_conf

from dune_rl.config.build import build_world, group_setups
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.simulation import VectorSimulation
from dune_rl.physics.interface import SceneSpec
from dune_rl.physics.robot_body import AS_DESCRIBED, BodyVariation, RobotBody
from dune_rl.worlds.world import World


class ScriptedRobot:
    """A `PhysicsRobot` that never moves by itself; a test sets its `state` (13,) and contacts `touching`.

    `drive` are the angles, speeds and torques of its J joints, (3 * J). It keeps the forces that are applied
    to it in `pushes`, its commands in `commands` and what varies of its body in `variation`.
    """

    def __init__(self, body: RobotBody) -> None:
        self._start = np.array([0.0] * 6 + [1.0] + [0.0] * 6)
        self.state = self._start.copy()
        self.drive = np.zeros(3 * len(body.drive_joints))
        self.touching: list[int] = []
        self.pushes: list[list[float]] = []
        self.commands: list[list[float]] = []
        self.variation = AS_DESCRIBED

    def put(self, x: float, y: float, yaw: float = 0.0, z: float = 0.125) -> None:
        """Stand upright and still at (x, y, z) [m] with `yaw` [rad]."""
        self.state = np.array([x, y, z, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2), *[0.0] * 6])

    def reset(self) -> None:
        self.state, self.touching = self._start.copy(), []

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self._start = np.array([*position_w, *quaternion, *[0.0] * 6])

    def set_command(self, commands: Sequence[float]) -> None:
        self.commands.append(list(commands))

    def apply_force(self, force_w: Sequence[float]) -> None:
        self.pushes.append(list(force_w))

    def set_body(self, variation: BodyVariation) -> None:
        self.variation = variation

    def set_wheel_contacts(self, *settings: Any) -> None:
        pass

    def body_state(self) -> tuple[float, ...]:
        return tuple(self.state.tolist())

    def drive_state(self) -> tuple[float, ...]:
        return tuple(self.drive.tolist())

    def work_j(self) -> float:
        return 0.0

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        return (0.0,) * len(joints)

    def contacts(self) -> Sequence[int]:
        return self.touching


class ScriptedScene:
    """A `PhysicsScene` of scripted robots."""

    def __init__(self, spec: SceneSpec) -> None:
        self.robots = [ScriptedRobot(body) for body in spec.robots]

    def reset(self, kinematic_poses: NDArray[np.float64]) -> None:
        for robot in self.robots:
            robot.reset()

    def begin_step(self, count: int, kinematic_poses: NDArray[np.float64]) -> None:
        pass

    def finish_step(self) -> None:
        pass

    def held_back_poses(self) -> None:
        return None

    def step_passive(self, count: int) -> None:
        pass

    def close(self) -> None:
        pass


def scripted_simulation(
    world: Any = "flat", num_scenes: int = 1, seed: int = 0, **settings: Any
) -> tuple[VectorSimulation, list[ScriptedRobot]]:
    """A simulation of `environment_conf` that has been reset, and its robots, scene after scene.

    `world` may be a `World` that a test has built.
    """
    conf = environment_conf("flat" if isinstance(world, World) else world, **settings)
    scenes: list[ScriptedScene] = []

    def make_scene(spec: SceneSpec) -> ScriptedScene:
        scenes.append(ScriptedScene(spec))
        return scenes[-1]

    simulation = VectorSimulation(
        world=world if isinstance(world, World) else build_world(conf.world),
        groups=group_setups(conf),
        make_scene=make_scene,
        physics=conf.physics,
        weather=conf.weather,
        randomizer=DomainRandomizer(
            conf.world, conf.weather, conf.randomisation, build_world, num_scenes=num_scenes
        ),
        num_scenes=num_scenes,
        seed=seed,
    )
    simulation.reset()
    return simulation, [robot for scene in scenes for robot in scene.robots]
