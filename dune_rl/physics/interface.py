"""What an engine must do: the narrow interface that everything above sees of physics."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.physics.motors import Motor
from dune_rl.physics.varied_body import BodyVariation
from dune_rl.settings import Settings

Engine = Literal["bullet", "dart"]
FrictionModel = Literal["pyramid", "cone"]
ENGINES: tuple[Engine, ...] = get_args(Engine)

BODY_STATE_SIZE = 13

# Friction of kinematic bodies.
CAPSULE_FRICTION = 0.5


class PhysicsConf(Settings):
    """Engine and rates. `control_hz` must divide `physics_hz`.

    `friction` is a pyramid in both engines, so that what slides askew to the
    world's axes is held by up to sqrt(2) times as much; DART can have the
    true cone, which makes its physics several times slower.
    `solver_iterations` are those of iterative contact solvers: Bullet's, and
    DART's for the cone; DART's for the pyramid is direct.
    """

    backend: Engine = "bullet"
    physics_hz: int = Field(200, ge=20, le=10_000)
    control_hz: int = Field(20, ge=1, le=1_000)
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
    def control_step_s(self) -> float:
        """Length of a control step [s]."""
        return 1.0 / self.control_hz


@dataclass(frozen=True)
class StaticBody:
    """Triangles that never move: vertices (V, 3) [m] in the world frame, faces (F, 3).

    A robot may drive on `ground`; to touch any other body is a collision.
    Friction and restitution multiply with those of what touches it.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    friction: float
    ground: bool
    restitution: float = 0.0


@dataclass(frozen=True)
class KinematicCapsule:
    """An upright capsule that is moved from outside; its origin is on the ground below it."""

    name: str
    radius_m: float
    height_m: float


@dataclass(frozen=True)
class PassiveJoint:
    """A joint that turns as it is pushed, against dry friction and damping; its limits are the URDF's."""

    joint: str
    friction_nm: float = 0.0
    damping_nms_per_rad: float = 0.0


@dataclass(frozen=True)
class Coupling:
    """A gear without play: joint `follower` turns `ratio` times what joint `leader` does."""

    leader: str
    follower: str
    ratio: float


@dataclass(frozen=True)
class RobotBody:
    """A URDF and what its joints and links are for.

    `motors` take commands, in their order. The joints that are neither theirs
    nor `passive` turn freely. `ground_links`, which are wheels or feet, stand
    on the ground with `ground_friction`, along a wheel's axle with
    `sideways_friction_share` of it, and touch nothing else, unless
    `ground_links_meet_obstacles`; all other links touch everything, with
    `hull_friction`. Joints that are not motors start at 0. `look` is a URDF
    of the same links and joints that shows the robot, where `urdf` does not.
    """

    urdf: Path
    motors: tuple[Motor, ...]
    ground_links: tuple[str, ...]
    ground_friction: float
    hull_friction: float = 0.3
    sideways_friction_share: float = 1.0
    ground_links_meet_obstacles: bool = False
    look: Path | None = None
    passive: tuple[PassiveJoint, ...] = ()
    couplings: tuple[Coupling, ...] = ()

    @property
    def drive_joints(self) -> tuple[str, ...]:
        """The motors' joints, in the order of commands and of what is told of them."""
        return tuple(motor.joint for motor in self.motors)

    def rest_commands(self) -> list[float]:
        """Commands under which the robot stands as it is put down."""
        return [motor.rest_command for motor in self.motors]

    def missing_from(self, joints: Collection[str], links: Collection[str]) -> str | None:
        """What is wrong with the names, given those that the URDF has; None where all are there."""
        named = [*self.drive_joints, *(joint.joint for joint in self.passive)]
        for coupling in self.couplings:
            named += [coupling.leader, coupling.follower]
        for kind, wanted, known in (("joint", named, joints), ("link", self.ground_links, links)):
            absent = [name for name in dict.fromkeys(wanted) if name not in known]
            if absent:
                return f"{self.urdf.name} has no {kind} {', '.join(absent)}; it has {', '.join(known)}"
        return None


@dataclass(frozen=True)
class SceneSpec:
    """All that a scene holds. Bodies are numbered: statics first, then kinematics, `robot` and the `others`.

    `others` are further robots beside `robot`; hulls of different robots meet.
    `measures_work` has the motors' work summed up, which costs a look at their joints in every physics step.
    """

    statics: tuple[StaticBody, ...]
    kinematics: tuple[KinematicCapsule, ...]
    robot: RobotBody
    timestep_s: float
    solver_iterations: int
    gravity_mps2: float = 9.81
    friction: FrictionModel = "pyramid"
    measures_work: bool = False
    others: tuple[RobotBody, ...] = ()

    @property
    def robots(self) -> tuple[RobotBody, ...]:
        """All robots, in the order of their numbers."""
        return (self.robot, *self.others)

    @property
    def first_robot(self) -> int:
        """Number of `robot` among the bodies; those of the others follow."""
        return len(self.statics) + len(self.kinematics)


class PhysicsRobot(Protocol):
    """A robot in a scene."""

    def set_body(self, variation: BodyVariation) -> None:
        """Set what the robot is like from the next `place` on, until it is set again.

        It is called only where a body differs; an engine that cannot do it
        raises PhysicsError. `varied_urdf` and `motors_at` do most of it.
        """
        ...

    def push(self, force_w: Sequence[float]) -> None:
        """Set the force (3) [N], world frame, that acts on the base link's centre throughout the next `step`.

        Without a call before it, a step has none.
        """
        ...

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        """Set how the W wheels, in the order of the drive joints, meet the ground from now until `place`.

        `friction` takes the place of the robot's `ground_friction`; it and
        `restitution` multiply with the ground's. Contacts yield as springs of
        `stiffness` [N/m] with `damping` [N s/m]; without these they yield as
        they did before, which after `place` is as little as the engine can.

        DART's ground is never harder than 2e5 N/m with 4e3 N s/m, it gives way
        under wheels and legs that motors turn, and bounces fall short of
        `restitution` by up to 0.12.
        """
        ...

    def body_state(self) -> tuple[float, ...]:
        """Base position (3) [m], quaternion xyzw (4), linear (3) [m/s] and angular velocity (3) [rad/s].

        All in the world frame, and of the base link's own frame, wherever its centre of mass is.
        """
        ...

    def drive_state(self) -> tuple[float, ...]:
        """Angles [rad], speeds [rad/s] and torques [N m] of the W motors' joints, one after another (3 * W).

        The angles of wheels are 0 where the robot is put down and count whole
        turns. A torque is what turned the joint in the last physics step, gear
        friction taken off, positive where it pushes toward a positive speed.
        """
        ...

    def work_j(self) -> float:
        """Work [J] that the motors have done since this was asked last; see `motors.work_w`."""
        ...

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        """Angles [rad] of any joints of the robot, by name; 0 before it is placed and after `close`."""
        ...

    def touched(self) -> Sequence[int]:
        """Numbers of the bodies, ground left out, that the robot touches now; may repeat."""
        ...


class OtherRobot(PhysicsRobot, Protocol):
    """A robot beside the first of a scene."""

    def stand(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        """Say where the scene's next `place` puts it down at rest."""
        ...

    def drive(self, commands: Sequence[float]) -> None:
        """Set the command of each motor for the scene's next `step`, and for those after it."""
        ...


class PhysicsScene(PhysicsRobot, Protocol):
    """One simulated scene; as its first robot it answers itself. Not thread-safe; scenes are independent.

    Between two bodies the friction coefficient is the product of theirs:
    a robot's links have those of `RobotBody`, statics their own, kinematic
    bodies `CAPSULE_FRICTION`. Contacts give nothing back, and nothing but
    contacts, joints and motors slows a body down. DART's wheels hang on
    springs, which give back what a hard landing puts in.
    """

    @property
    def others(self) -> Sequence[OtherRobot]:
        """The further robots, in the order of `SceneSpec.others`."""
        ...

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        """Put the robot down at rest, and the kinematic bodies (K, 4: x, y, z, yaw) at their poses.

        What was before leaves no trace: the same calls after it give the same bytes.
        """
        ...

    def step(self, count: int, commands: Sequence[float], kinematic_poses: NDArray[np.float64]) -> None:
        """Advance `count` physics steps with a command for each motor, a speed [rad/s] or an angle [rad].

        Kinematic bodies reach `kinematic_poses` (K, 4: x, y, z, yaw) at the
        end, and get there in `count` equal parts where the robot is near.
        """
        ...

    def coast(self, count: int) -> None:
        """Advance `count` physics steps with the last commands and nothing moved: bare physics."""
        ...

    def close(self) -> None:
        """Free the engine's memory; calling it twice is harmless."""
        ...
