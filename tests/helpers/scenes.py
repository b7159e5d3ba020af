"""Scenes to try physics in, made of the interface alone: a backend more is a line more in `BACKENDS`."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module

import numpy as np
import pytest

from dune_rl.geometry.frames import (
    multiply_quaternions,
    quaternion_on_slope,
    roll_pitch_yaw,
    rotation_matrices,
)
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.physics.dart.scene import DartScene
from dune_rl.physics.interface import PhysicsRobot, PhysicsScene, SceneSpec, step_scene
from dune_rl.physics.robot_body import BodyVariation, RobotBody
from dune_rl.physics.shapes import KinematicCapsule, KinematicShape, StaticBody
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.robots.wheeled import WheeledRobot
from dune_rl.worlds.props import upright_box

Backend = Callable[[SceneSpec], PhysicsScene]

BACKENDS: dict[str, Backend] = {
    "bullet": BulletScene,
    "dart": DartScene,
}
every_backend = pytest.mark.parametrize("backend", BACKENDS.values(), ids=BACKENDS.keys())


def allowed(backend: Backend, rigid: float, on_tyres: float) -> float:
    """What a test allows: `rigid` in PyBullet, whose wheels are, `on_tyres` in DART, whose wheels yield."""
    return rigid if backend is BACKENDS["bullet"] else on_tyres


GRAVITY_MPS2 = 9.81
TIMESTEP_S = 0.005
SUBSTEPS = 10
STEP_S = TIMESTEP_S * SUBSTEPS

WHEEL_RADIUS_M = 0.125
MASS_KG = 11.0
HULL_HALF_LENGTH_M = 0.31
HULL_HALF_WIDTH_M = 0.195
HULL_BOTTOM_M = 0.090
HULL_TOP_M = 0.254


def rover_body(conf: RoverZeroConf | None = None) -> RobotBody:
    return RoverZero(conf or RoverZeroConf(), 1).body


def rover_without_tyres(**changes: object) -> RobotBody:
    """A rover whose wheels are balls and no more, which collide with the ground alone or with everything."""
    return replace(rover_body(), tyres=(), **changes)


def plane(slope_rad: float = 0.0, friction: float = 1.0, toward_rad: float = 0.0) -> StaticBody:
    """Ground through the origin that rises by `slope_rad` toward the bearing `toward_rad`."""
    return ground(plane_field(slope_rad, toward_rad), friction)


def plane_field(
    slope_rad: float, toward_rad: float = 0.0, half: int = 20, spacing_m: float = 1.0
) -> HeightField:
    x, y = np.meshgrid(*[np.arange(-half, half + 0.5) * spacing_m] * 2)
    uphill = x * np.cos(toward_rad) + y * np.sin(toward_rad)
    return HeightField(np.tan(slope_rad) * uphill, spacing_m, (-half * spacing_m, -half * spacing_m))


def slope_stage(
    backend: Backend,
    slope_rad: float,
    friction: float,
    yaw: float = 0.0,
    robot: RobotBody | None = None,
    variation: BodyVariation | None = None,
    height_m: float = WHEEL_RADIUS_M + 0.001,
) -> "Stage":
    """A rover just above a slope, in the middle of one large triangle: edges catch wheels that slide."""
    terrain = plane_field(slope_rad, half=4, spacing_m=5.0)
    stage = Stage(backend, [ground(terrain, friction)], robot=robot or rover_body())
    if variation is not None:
        stage.engine.set_body(variation)
    quaternion = quaternion_of(yaw, slope_rad)
    foot = np.array([-1.5, -3.5, terrain.height([-1.5, -3.5])])
    stage.place(foot + rotation_matrices(quaternion)[:, 2] * height_m, quaternion)
    return stage


def ground(terrain: HeightField, friction: float = 1.0) -> StaticBody:
    vertices, faces = terrain.mesh()
    return StaticBody("terrain", vertices, faces, friction, ground=True)


def box(
    xy: tuple[float, float],
    length: float,
    width: float,
    top: float,
    *,
    drivable: bool = False,
    name: str = "box",
) -> StaticBody:
    return StaticBody(name, *upright_box(xy, 0.0, -0.2, top, length, width), 1.0, ground=drivable)


def walker(name: str = "walker") -> KinematicCapsule:
    return KinematicCapsule(name, radius_m=0.25, height_m=1.75)


def quaternion_of(yaw: float = 0.0, slope_rad: float = 0.0, toward_rad: float = 0.0) -> np.ndarray:
    """Attitude of a robot that heads `yaw` on `plane(slope_rad, toward_rad=toward_rad)`."""
    uphill = np.array([np.cos(toward_rad), np.sin(toward_rad), 0.0])
    normal = np.array([0.0, 0.0, np.cos(slope_rad)]) - np.sin(slope_rad) * uphill
    return quaternion_on_slope(normal, np.asarray(yaw))


def about(axis: Sequence[float], angle: float) -> np.ndarray:
    return np.array([*(np.sin(angle / 2) * np.asarray(axis)), np.cos(angle / 2)])


def poses_of(actors: Sequence[Sequence[float]]) -> np.ndarray:
    """Poses (K, 6) of kinematic bodies, whose roll and pitch are zero where they are left out."""
    poses = np.zeros((len(actors), 6))
    for pose, given in zip(poses, actors, strict=True):
        pose[: len(given)] = given
    return poses


@dataclass
class Stage:
    """A scene of any backend, put to use step by step; arrays instead of tuples."""

    backend: Backend
    statics: Sequence[StaticBody] = field(default_factory=lambda: [plane()])
    kinematics: Sequence[KinematicShape] = ()
    robot: RobotBody = field(default_factory=rover_body)
    gravity_mps2: float = GRAVITY_MPS2
    measures_work: bool = False

    def __post_init__(self) -> None:
        self.scene = self.backend(
            SceneSpec(
                tuple(self.statics),
                tuple(self.kinematics),
                (self.robot,),
                timestep_s=TIMESTEP_S,
                solver_iterations=10,
                gravity_mps2=self.gravity_mps2,
                measures_work=self.measures_work,
            )
        )
        self.engine: PhysicsRobot = self.scene.robots[0]
        self.actors = np.zeros((len(self.kinematics), 6))
        self.actors[:, 0] = 15.0 + np.arange(len(self.kinematics))

    def place(
        self,
        position_w: Sequence[float] = (0.0, 0.0, WHEEL_RADIUS_M),
        quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        actors: Sequence[Sequence[float]] | None = None,
    ) -> None:
        if actors is not None:
            self.actors = poses_of(actors)
        self.engine.set_start_pose([float(x) for x in position_w], [float(x) for x in quaternion])
        self.scene.reset(self.actors)

    def step(
        self,
        count: int = SUBSTEPS,
        wheels: float | Sequence[float] = 0.0,
        actors: Sequence[Sequence[float]] | None = None,
    ) -> None:
        if actors is not None:
            self.actors = poses_of(actors)
        joints = len(self.robot.drive_joints)
        self.engine.set_command(np.broadcast_to(np.asarray(wheels, float), joints).tolist())
        step_scene(self.scene, count, self.actors)

    def walk(self, velocity_w: Sequence[float], count: int = SUBSTEPS) -> None:
        """Move the one kinematic body at a velocity (2) [m/s] from where it is; wheels stand still."""
        x, y, *others = self.actors[0]
        duration = count * TIMESTEP_S
        self.step(count, 0.0, [[x + velocity_w[0] * duration, y + velocity_w[1] * duration, *others]])
        held_back = self.scene.held_back_poses()
        if held_back is not None:
            self.actors = held_back

    @property
    def state(self) -> np.ndarray:
        return np.array(self.engine.body_state())

    @property
    def position(self) -> np.ndarray:
        return self.state[:3]

    @property
    def velocity(self) -> np.ndarray:
        return self.state[7:10]

    @property
    def angular(self) -> np.ndarray:
        return self.state[10:13]

    @property
    def rotation(self) -> np.ndarray:
        return rotation_matrices(self.state[3:7])

    @property
    def yaw(self) -> float:
        return float(roll_pitch_yaw(self.rotation)[2])

    @property
    def wheels(self) -> np.ndarray:
        """Angles, speeds and torques of the drive joints, (3, W)."""
        return np.array(self.engine.drive_state()).reshape(3, -1)

    @property
    def wheel_angles(self) -> np.ndarray:
        return self.wheels[0]

    @property
    def wheel_speeds(self) -> np.ndarray:
        return self.wheels[1]

    @property
    def wheel_torques(self) -> np.ndarray:
        return self.wheels[2]

    def contacts(self) -> set[int]:
        """Numbers of the bodies that the robot touches."""
        return set(self.engine.contacts())


UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Company:
    """Several robots in one scene of any backend, whose joints stand still until they are commanded."""

    def __init__(
        self,
        backend: Backend,
        robots: Sequence[RobotBody],
        statics: Sequence[StaticBody] | None = None,
        kinematics: Sequence[KinematicShape] = (),
        gravity_mps2: float = GRAVITY_MPS2,
    ) -> None:
        self.scene = backend(
            SceneSpec(
                tuple([plane()] if statics is None else statics),
                tuple(kinematics),
                tuple(robots),
                timestep_s=TIMESTEP_S,
                solver_iterations=10,
                gravity_mps2=gravity_mps2,
            )
        )
        self.robots: Sequence[PhysicsRobot] = self.scene.robots

    def place(
        self,
        *places_w: Sequence[float],
        quaternion: Sequence[float] = UPRIGHT,
        actors: Sequence[Sequence[float]] = (),
    ) -> None:
        for robot, place in zip(self.robots, places_w, strict=True):
            robot.set_start_pose([float(part) for part in place], quaternion)
        self.actors = poses_of(actors)
        self.scene.reset(self.actors)

    def step(self, count: int = SUBSTEPS, actors: Sequence[Sequence[float]] | None = None) -> None:
        if actors is not None:
            self.actors = poses_of(actors)
        step_scene(self.scene, count, self.actors)

    @property
    def states(self) -> np.ndarray:
        return np.array([robot.body_state() for robot in self.robots])

    @property
    def positions(self) -> np.ndarray:
        return self.states[:, :3]

    @property
    def velocities(self) -> np.ndarray:
        return self.states[:, 7:10]

    def contacts(self) -> list[set[int]]:
        return [set(robot.contacts()) for robot in self.robots]


class Drive:
    """A rover under commands, as the environment drives it: controller, drive, physics."""

    def __init__(
        self,
        backend: Backend,
        conf: RoverZeroConf | None = None,
        statics: Sequence[StaticBody] | None = None,
        yaw: float = 0.0,
        quaternion: np.ndarray | None = None,
        position_w: Sequence[float] = (0.0, 0.0, WHEEL_RADIUS_M),
        rover: WheeledRobot | None = None,
    ) -> None:
        self.rover = rover or RoverZero(conf or RoverZeroConf(), 1)
        self.stage = Stage(backend, statics or [plane()], robot=self.rover.body)
        self.start(yaw, quaternion, position_w)

    def start(
        self,
        yaw: float,
        quaternion: np.ndarray | None = None,
        position_w: Sequence[float] = (0.0, 0.0, WHEEL_RADIUS_M),
    ) -> None:
        self.rover.reset(np.array([True]))
        self.stage.place(position_w, about([0, 0, 1], yaw) if quaternion is None else quaternion)
        self.stage.step(20)

    def step(self, speed: float, heading: float) -> None:
        """One control step at `speed` [m/s] toward `heading` relative to the present one [rad]."""
        gyro = self.stage.rotation[:, 2] @ self.stage.angular
        commands = self.rover.wheel_commands(np.array([[speed, heading]]), np.array([gyro]), STEP_S)
        self.stage.step(SUBSTEPS, commands[0])


def rollout(stage: Stage, after: Callable[[], None] = lambda: None) -> str:
    """Digest of a run that meets bumpy ground, a wall and a passing walker; `after` runs between its steps.

    `stage` is a `mixed_stage`. Every byte of what it reports goes in.
    """
    digest = hashlib.sha256()
    commands = np.random.default_rng(0).uniform(-2.0, 10.0, (40, 4))
    stage.place(
        [0.0, 0.0, 0.6],
        multiply_quaternions(about([0, 0, 1], 0.3), about([1, 0, 0], 0.1)),
        [[1.5, 1.0, 0, 0]],
    )
    touched: set[int] = set()
    for number, wheels in enumerate(commands, start=1):
        stage.step(SUBSTEPS, wheels, [[1.5 - 0.06 * number, 1.0 - 0.04 * number, 0.1, -2.5]])
        touched |= stage.contacts()
        digest.update(
            repr((stage.engine.body_state(), stage.engine.drive_state(), sorted(stage.contacts()))).encode()
        )
        after()
    assert touched == {1, 2}, "the run should have met both the wall and the walker"
    return digest.hexdigest()


def mixed_stage(backend: Backend) -> Stage:
    heights = np.random.default_rng(1).uniform(0.0, 0.15, (17, 17))
    return Stage(
        backend,
        [ground(HeightField(heights, 0.5, (-4.0, -4.0))), box((-1.0, 0.0), 0.2, 4.0, 1.0)],
        [walker()],
    )


def print_rollout(backend_module: str, backend_name: str) -> None:
    """What a fresh process runs to tell its `rollout`."""
    print(rollout(mixed_stage(getattr(import_module(backend_module), backend_name))))


def with_joints(body: RobotBody, *joints: str) -> RobotBody:
    motor = body.motors[0]
    return replace(body, motors=tuple(replace(motor, joint=joint) for joint in joints))
