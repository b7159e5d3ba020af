"""Every engine, and a stub, passes the conformance check; planted faults do not."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenes import every_backend
from user_packages import registries_restored

import dune_rl
from dune_rl.core.errors import PhysicsError
from dune_rl.physics.conformance import check_engine
from dune_rl.physics.interface import SceneSpec, scene_maker

RADIUS_M = 0.1


class StubRobot:
    """A robot whose wheels turn as commanded and roll along its x axis, on whatever ground."""

    def __init__(self, num_motors: int) -> None:
        self._start = [0.0] * 6 + [1.0]
        self.reset(num_motors)

    def reset(self, num_motors: int) -> None:
        self.commands, self.angles = [0.0] * num_motors, [0.0] * num_motors
        self.position = self._start[:3]
        self.speed, self.touched = 0.0, []

    def set_start_pose(self, position_w, quaternion):
        self._start = [*position_w, *quaternion]

    def set_command(self, commands):
        self.commands = list(commands)

    def apply_force(self, force_w): ...

    def set_body(self, variation): ...

    def set_wheel_contacts(self, friction, restitution, stiffness=None, damping=None): ...

    def advance(self, time_s):
        self.angles = [a + c * time_s for a, c in zip(self.angles, self.commands, strict=True)]
        self.speed = RADIUS_M * float(np.mean(self.commands))
        self.position = [self.position[0] + self.speed * time_s, *self.position[1:]]

    def body_state(self):
        return (*self.position, *self._start[3:], self.speed, 0.0, 0.0, 0.0, 0.0, 0.0)

    def drive_state(self):
        speeds = self.commands if self.speed else [0.0] * len(self.commands)
        return (*self.angles, *speeds, *[0.0] * len(self.commands))

    def work_j(self):
        return 0.0

    def joint_angles(self, joints):
        return (0.0,) * len(joints)

    def contacts(self):
        return self.touched


class StubScene:
    """A scene without forces: robots stop, and report a contact, where other bodies are ahead of them."""

    def __init__(self, spec: SceneSpec) -> None:
        self._spec, self._count = spec, 0
        self.robots = [StubRobot(len(robot.motors)) for robot in spec.robots]

    def reset(self, kinematic_poses):
        self._walkers = kinematic_poses
        for robot, body in zip(self.robots, self._spec.robots, strict=True):
            robot.reset(len(body.motors))

    def obstacles(self):
        """Numbers and x, y of all bodies but ground."""
        statics = [(n, body.vertices[:, :2].mean(axis=0)) for n, body in enumerate(self._spec.statics)]
        yield from (each for each in statics if not self._spec.statics[each[0]].ground)
        yield from ((self._spec.kinematic_number(n), pose[:2]) for n, pose in enumerate(self._walkers))
        yield from ((self._spec.robot_number(n), robot.position[:2]) for n, robot in enumerate(self.robots))

    def move_kinematic(self, index, pose): ...

    def begin_step(self, count, kinematic_poses):
        self._count = count

    def finish_step(self):
        self.step_passive(self._count)

    def held_back_poses(self):
        return None

    def step_passive(self, count):
        for robot in self.robots:
            robot.touched = [
                number for number, xy in self.obstacles() if 0.0 < math.dist(xy, robot.position[:2]) < 0.5
            ]
            if not robot.touched:
                robot.advance(count * self._spec.timestep_s)

    def close(self): ...


@every_backend
def test_our_engines_conform(backend: Callable[[SceneSpec], Any]) -> None:
    check_engine(backend)


def test_a_stub_conforms_and_runs_by_its_name() -> None:
    check_engine(StubScene)
    with registries_restored():
        dune_rl.register_engine("stub")(StubScene)
        env = dune_rl.parallel_env("flat", physics="stub", actors="none")
        env.reset(seed=0)
        for _ in range(20):
            _, _, ended, _, _ = env.step({"rover_0": np.array([1.0, 0.0], np.float32)})
        assert ended == {"rover_0": False}
        env.close()


def test_an_unknown_engine_is_named() -> None:
    with pytest.raises(PhysicsError, match=r"there is no engine 'bulet'.*did you mean bullet"):
        scene_maker("bulet")


class Restless(StubScene):
    def reset(self, kinematic_poses):
        super().reset(kinematic_poses)
        for robot in self.robots:
            robot.speed = 0.1


class Remembering(StubScene):
    def reset(self, kinematic_poses):
        self.resets = getattr(self, "resets", 0) + 1
        super().reset(kinematic_poses)

    def step_passive(self, count):
        super().step_passive(count + self.resets)


class Replacing(StubScene):
    def reset(self, kinematic_poses):
        self.robots = [StubRobot(len(robot.motors)) for robot in self._spec.robots]
        for robot in self.robots:
            robot.set_start_pose([0.0, 0.0, 0.102], [0.0, 0.0, 0.0, 1.0])
        super().reset(kinematic_poses)


class Frozen(StubScene):
    def step_passive(self, count): ...


class Misnumbering(StubScene):
    def obstacles(self):
        yield from ((number - 1, xy) for number, xy in super().obstacles())


class Closeless:
    def __init__(self, spec: SceneSpec) -> None:
        self.robots = StubScene(spec).robots


@pytest.mark.parametrize(
    ("engine", "rule"),
    [
        (Restless, "at rest"),
        (Remembering, "the same bytes"),
        (Replacing, "start pose|move the robot|same objects"),
        (Frozen, "move the robot"),
        (Misnumbering, "number of a static body"),
        (Closeless, "a PhysicsScene has .*close"),
    ],
)
def test_planted_faults_are_found(engine: type, rule: str) -> None:
    with pytest.raises(PhysicsError, match=rule):
        check_engine(engine)
