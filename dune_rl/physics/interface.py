"""Interface of a physics engine: the description of a scene, protocols of its objects, and the registry."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Literal, Protocol, Self

from pydantic import AfterValidator, Field, model_validator

from dune_rl.core.errors import PhysicsError
from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array
from dune_rl.physics.robot_body import BodyVariation, RobotBody
from dune_rl.physics.shapes import KinematicShape, StaticBody

FrictionModel = Literal["pyramid", "cone"]


def _check_engine(name: str) -> str:
    if name not in ENGINES.names():
        raise ValueError(ENGINES.unknown(name))
    return name


# The name of a registered engine.
Engine = Annotated[str, AfterValidator(_check_engine)]


class PhysicsConf(Settings):
    """Engine and rates. `control_hz` must divide `physics_hz`.

    `friction` is a pyramid in both engines: a body that slides diagonally to the world's axes feels up to
    sqrt(2) times the friction of Coulomb's law. DART also has the true cone, which makes its physics several
    times slower. `solver_iterations` applies to iterative contact solvers: Bullet's, and DART's for the cone;
    DART's solver for the pyramid is direct.
    """

    backend: Engine = "bullet"
    physics_hz: int = Field(200, ge=20, le=10_000)
    control_hz: int = Field(20, ge=1, le=1_000)
    action_repeat: int = Field(1, ge=1, le=1_000, description="control steps for which an action is held")
    solver_iterations: int = Field(10, ge=1, le=1_000)
    friction: FrictionModel = "pyramid"

    @model_validator(mode="after")
    def _whole_substeps(self) -> Self:
        if self.physics_hz % self.control_hz:
            raise ValueError(
                f"control_hz must divide physics_hz ({self.control_hz} does not divide {self.physics_hz}); "
                "take 10, 20, 25, 40 or 50 with 200"
            )
        return self

    @property
    def substeps(self) -> int:
        """Physics steps in one control step."""
        return self.physics_hz // self.control_hz

    @property
    def decision_hz(self) -> float:
        """Actions a second."""
        return self.control_hz / self.action_repeat

    @property
    def control_step_s(self) -> float:
        """Length of a control step [s]."""
        return 1.0 / self.control_hz


@dataclass(frozen=True)
class SceneSpec:
    """Everything in a scene. Bodies are numbered: first statics, then kinematics, then robots.

    `measures_work` makes `PhysicsRobot.work_j` available, at the cost of
    reading the motors' joints in every physics step.
    """

    statics: tuple[StaticBody, ...]
    kinematics: tuple[KinematicShape, ...]
    robots: tuple[RobotBody, ...]
    timestep_s: float
    solver_iterations: int
    gravity_mps2: float = 9.81
    friction: FrictionModel = "pyramid"
    measures_work: bool = False

    def kinematic_number(self, index: int) -> int:
        """Body number of `kinematics[index]`."""
        return len(self.statics) + index

    def robot_number(self, index: int) -> int:
        """Body number of `robots[index]`."""
        return len(self.statics) + len(self.kinematics) + index


class PhysicsRobot(Protocol):
    """A robot in a scene."""

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        """Set the pose of the base link, (3) [m] and xyzw (4), that the scene's next `reset` puts it at."""

    def set_command(self, commands: Sequence[float]) -> None:
        """Set the command of each motor, a speed [rad/s] or an angle [rad], from the scene's next `step` on.

        `reset` sets the commands to `RobotBody.rest_commands`.
        """

    def apply_force(self, force_w: Sequence[float]) -> None:
        """Set the force (3) [N], world frame, on the base link's centre of mass throughout the next `step`.

        It lasts for that step only.
        """

    def set_body(self, variation: BodyVariation) -> None:
        """Set masses and motor strength, from the next `reset` on, until they are set again.

        Raises PhysicsError if the engine cannot do it. `read_urdf_body` and `scale_motors` do most of it.
        """

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        """Set the contact parameters of the W ground links, in their order, until the next `reset`.

        `friction` replaces the robot's `ground_friction`; it and `restitution` are multiplied with the
        ground's. Contacts are springs of `stiffness` [N/m] with `damping` [N s/m]; if these are None they
        stay as they were, which after `reset` is as stiff as the engine can simulate.

        In DART, stiffness is at most 2e5 N/m and damping at most 4e3 N s/m, only wheels and legs with motors
        have compliant contacts, and rebounds are below `restitution` by up to 0.12.
        """

    def body_state(self) -> tuple[float, ...]:
        """Base position (3) [m], quaternion xyzw (4), linear (3) [m/s] and angular velocity (3) [rad/s].

        All in the world frame, and of the base link's own frame, wherever its centre of mass is.
        """

    def drive_state(self) -> tuple[float, ...]:
        """Angles [rad], speeds [rad/s] and torques [N m] of the W motors' joints, concatenated (3 * W).

        Angles of wheels are 0 after `reset` and count whole turns. A torque is what acted on the joint in the
        last physics step, gear friction subtracted, positive in the direction of positive speed.
        """

    def work_j(self) -> float:
        """Work [J] of the motors since the last call; see `motors.motor_power_w`."""

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        """Angles [rad] of any joints of the robot, by name; 0 before the first `reset` and after `close`."""

    def contacts(self) -> Sequence[int]:
        """Numbers of the bodies, without ground, that it touched in any physics step of the last `step`.

        In ascending order; none after `reset`.
        """


class PhysicsScene(Protocol):
    """One simulated scene. Not thread-safe; scenes are independent of each other.

    The friction coefficient of a contact is the product of its bodies': a robot's links have those of
    `RobotBody`, statics their own, kinematic bodies `KINEMATIC_FRICTION`. Contacts are inelastic, and only
    contacts, joints and motors slow a body down. In DART wheels are mounted on springs, which return part of
    the energy of a hard landing.
    """

    @property
    def robots(self) -> Sequence[PhysicsRobot]:
        """The robots, in the order of `SceneSpec.robots`. They stay the same objects over `reset`."""

    def reset(self, kinematic_poses: Array) -> None:
        """Put robots at their start poses, at rest, and kinematic bodies at theirs (K, 6).

        Poses are x, y, z [m], yaw, roll and pitch [rad]; capsules stand upright at any.
        The result does not depend on anything before: the same calls after it give the same bytes.
        """

    def move_kinematic(self, index: int, pose: Array) -> None:
        """Put a kinematic body at a pose (6), as for `reset`, between control steps.

        The next step moves it from there. No robot may touch it before or after.
        """

    def begin_step(self, count: int, kinematic_poses: Array) -> None:
        """Prepare the `count` physics steps of a control step, under the robots' present commands and forces.

        Kinematic bodies reach `kinematic_poses` (K, 6), as for `reset`, at the
        end; those near a robot move there, boxes turn and lean too, in `count` equal parts. Bodies that
        a robot holds back do not get there: see `held_back_poses`.
        """

    def finish_step(self) -> None:
        """Advance by the control step that `begin_step` prepared."""

    def held_back_poses(self) -> Array | None:
        """Where the kinematic bodies are after a step in which a robot held any of them back, else None.

        Poses (K, 6) as for `reset`, of which x and y alone differ from those commanded. The next step
        moves the bodies from there.
        """

    def step_passive(self, count: int) -> None:
        """Advance `count` physics steps with the last commands and without moving kinematic bodies."""

    def close(self) -> None:
        """Free the engine's memory; a second call does nothing."""


def step_scene(scene: PhysicsScene, count: int, kinematic_poses: Array) -> None:
    """Advance a scene by `count` physics steps: see `PhysicsScene.begin_step`."""
    scene.begin_step(count, kinematic_poses)
    scene.finish_step()


class EngineSettings(Settings):
    """Base of an engine's settings: its name."""

    backend: str


# An engine is what makes its scenes.
ENGINES: Registry[PhysicsScene] = Registry(
    "engine",
    "dune_rl.physics.interface:ENGINES",
    own={
        "bullet": "dune_rl.physics.bullet.scene:BulletScene",
        "dart": "dune_rl.physics.dart.scene:DartScene",
    },
    base=EngineSettings,
    product=PhysicsScene,
    form="a class of scenes, made with (spec), or a function of (spec) that returns a PhysicsScene",
    function_leading=("spec",),
    class_leading=("spec",),
    tag="backend",
    error=PhysicsError,
)
OWN_ENGINES: tuple[str, ...] = tuple(ENGINES.own)


def scene_maker(engine: str) -> Callable[[SceneSpec], PhysicsScene]:
    """The function that makes an engine's scenes; raises `PhysicsError` if the engine is not installed."""
    settings = ENGINES.settings_class(engine)
    if settings is None:
        raise PhysicsError(ENGINES.unknown(engine))
    return partial(ENGINES.build, settings(backend=engine))
