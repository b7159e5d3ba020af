"""Interface of a physics engine: the description of a scene (`SceneSpec`), and protocols of its objects."""

import math
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

# Friction coefficient of kinematic bodies.
KINEMATIC_FRICTION = 0.5


class PhysicsConf(Settings):
    """Engine and rates. `control_hz` must divide `physics_hz`.

    `friction` is a pyramid in both engines: a body that slides diagonally to
    the world's axes feels up to sqrt(2) times the friction of Coulomb's law.
    DART also has the true cone, which makes its physics several times slower.
    `solver_iterations` applies to iterative contact solvers: Bullet's, and
    DART's for the cone; DART's solver for the pyramid is direct.
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
    """Triangle mesh that never moves: vertices (V, 3) [m] in the world frame, faces (F, 3).

    Contacts of robots with `ground` are not reported; a contact with any other
    body is a collision. Friction and restitution coefficients are multiplied
    with those of the other body of a contact.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    friction: float
    ground: bool
    restitution: float = 0.0


@dataclass(frozen=True)
class KinematicCapsule:
    """Upright capsule whose motion is prescribed; its origin is on the ground below its centre.

    It pushes robots with at most `max_push_n` [N], horizontally, and is held
    back or pushed away by larger resistance. The default is the largest initial
    force for men in ISO 11228-2.
    """

    name: str
    radius_m: float
    height_m: float
    max_push_n: float = 250.0

    @property
    def centre_height_m(self) -> float:
        """Height of the centre above the origin."""
        return self.height_m / 2

    def reach_m(self, lean_rad: float) -> float:
        """Upper bound of the horizontal distance [m] of its points from its origin; it does not lean."""
        return self.radius_m


@dataclass(frozen=True)
class KinematicBox:
    """Box whose motion is prescribed; its origin is on the ground below its centre, and it leans about it.

    It is from `clearance_m`, such as a truck's underside, to `height_m` above the ground, `length_m` along
    its x axis and `width_m` along y. It pushes robots as a `KinematicCapsule` does: robots can hold back or
    push away its origin, but not its turns.
    """

    name: str
    length_m: float
    width_m: float
    height_m: float
    clearance_m: float = 0.0
    max_push_n: float = 250.0

    def __post_init__(self) -> None:
        if self.height_m <= self.clearance_m:
            raise ValueError(
                f"the box {self.name!r} has no height: it is from clearance_m ({self.clearance_m}) to "
                f"height_m ({self.height_m}) above the ground"
            )

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height of the box itself [m]."""
        return self.length_m, self.width_m, self.height_m - self.clearance_m

    @property
    def centre_height_m(self) -> float:
        """Height of the centre above the origin."""
        return (self.clearance_m + self.height_m) / 2

    def reach_m(self, lean_rad: float) -> float:
        """Upper bound of the horizontal distance [m] of its points from its origin.

        It leans by at most `lean_rad`, the sum of the amounts of roll and pitch.
        """
        farthest = max(abs(self.clearance_m), abs(self.height_m))
        return math.hypot(self.length_m, self.width_m) / 2 + farthest * min(lean_rad, 1.0)


KinematicShape = KinematicCapsule | KinematicBox


@dataclass(frozen=True)
class PassiveJoint:
    """Joint without a motor, with dry friction and damping; its limits are the URDF's."""

    joint: str
    friction_nm: float = 0.0
    damping_nms_per_rad: float = 0.0


@dataclass(frozen=True)
class Coupling:
    """Gear without backlash: the angle of joint `follower` is `ratio` times that of joint `leader`."""

    leader: str
    follower: str
    ratio: float


@dataclass(frozen=True)
class Tyre:
    """Cylinder by which a wheel collides with everything but the ground: the tyre in its true width.

    An engine may round its edges by up to half of `width_m`. It is fixed to the wheel's `link`, with its
    `centre` (3) [m] and its unit `axis` (3) in that link's frame; `position_b` (3) [m] is its centre in the
    base link's frame with all joints at zero.
    """

    link: str
    radius_m: float
    width_m: float
    position_b: tuple[float, float, float]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @property
    def reach_m(self) -> float:
        """Upper bound of the distance [m] of any of its points from the origin of its link."""
        return math.hypot(*self.centre) + math.hypot(self.radius_m, self.width_m / 2)


@dataclass(frozen=True)
class RobotBody:
    """URDF of a robot, and the roles of its joints and links.

    `motors` take commands, in their order. Joints that are neither theirs nor
    `passive` turn freely. Joints without a motor start at 0.

    `ground_links` are wheels or feet. They collide with the ground, with
    `ground_friction` (along a wheel's axle with `sideways_friction_share` of
    it), and with nothing else, unless `ground_links_meet_obstacles`. Wheels
    whose collision shapes are wider than they are, such as spheres, have
    `tyres` instead: these collide, with the same friction, with everything but
    the ground. All other links collide with everything, with `hull_friction`.

    `look` is a URDF with the same links and joints that is drawn in place of `urdf`.
    """

    urdf: Path
    motors: tuple[Motor, ...]
    ground_links: tuple[str, ...]
    ground_friction: float
    hull_friction: float = 0.3
    sideways_friction_share: float = 1.0
    ground_links_meet_obstacles: bool = False
    tyres: tuple[Tyre, ...] = ()
    look: Path | None = None
    passive: tuple[PassiveJoint, ...] = ()
    couplings: tuple[Coupling, ...] = ()

    @property
    def drive_joints(self) -> tuple[str, ...]:
        """Joints of the motors, in the order of commands and of `PhysicsRobot.drive_state`."""
        return tuple(motor.joint for motor in self.motors)

    def rest_commands(self) -> list[float]:
        """Commands that keep all joints at their start angles."""
        return [motor.rest_command for motor in self.motors]

    def describe_missing_names(self, joints: Collection[str], links: Collection[str]) -> str | None:
        """Error message for names that are not in the URDF; None if all are.

        `joints` and `links` are the names in the URDF.
        """
        used_joints = [*self.drive_joints, *(joint.joint for joint in self.passive)]
        for coupling in self.couplings:
            used_joints += [coupling.leader, coupling.follower]
        used_links = [*self.ground_links, *(tyre.link for tyre in self.tyres)]
        for kind, used, known in (("joint", used_joints, joints), ("link", used_links, links)):
            missing = [name for name in dict.fromkeys(used) if name not in known]
            if missing:
                return f"{self.urdf.name} has no {kind} {', '.join(missing)}; it has {', '.join(known)}"
        return None


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

    @property
    def num_bodies(self) -> int:
        """Number of bodies in the scene; body numbers are below it."""
        return self.robot_number(len(self.robots))


class PhysicsRobot(Protocol):
    """A robot in a scene."""

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        """Set the pose of the base link, (3) [m] and xyzw (4), that the scene's next `reset` puts it at."""
        ...

    def set_command(self, commands: Sequence[float]) -> None:
        """Set the command of each motor, a speed [rad/s] or an angle [rad], from the scene's next `step` on.

        `reset` sets the commands to `RobotBody.rest_commands`.
        """
        ...

    def apply_force(self, force_w: Sequence[float]) -> None:
        """Set the force (3) [N], world frame, on the base link's centre of mass throughout the next `step`.

        It lasts for that step only.
        """
        ...

    def set_body(self, variation: BodyVariation) -> None:
        """Set masses and motor strength, from the next `reset` on, until they are set again.

        Raises PhysicsError if the engine cannot do it. `varied_urdf` and `scale_motors` do most of it.
        """
        ...

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        """Set the contact parameters of the W ground links, in their order, until the next `reset`.

        `friction` replaces the robot's `ground_friction`; it and `restitution`
        are multiplied with the ground's. Contacts are springs of `stiffness`
        [N/m] with `damping` [N s/m]; if these are None they stay as they were,
        which after `reset` is as stiff as the engine can simulate.

        In DART, stiffness is at most 2e5 N/m and damping at most 4e3 N s/m,
        only wheels and legs with motors have compliant contacts, and rebounds
        are below `restitution` by up to 0.12.
        """
        ...

    def body_state(self) -> tuple[float, ...]:
        """Base position (3) [m], quaternion xyzw (4), linear (3) [m/s] and angular velocity (3) [rad/s].

        All in the world frame, and of the base link's own frame, wherever its centre of mass is.
        """
        ...

    def drive_state(self) -> tuple[float, ...]:
        """Angles [rad], speeds [rad/s] and torques [N m] of the W motors' joints, concatenated (3 * W).

        Angles of wheels are 0 after `reset` and count whole turns. A torque is
        what acted on the joint in the last physics step, gear friction
        subtracted, positive in the direction of positive speed.
        """
        ...

    def work_j(self) -> float:
        """Work [J] of the motors since the last call; see `motors.motor_power_w`."""
        ...

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        """Angles [rad] of any joints of the robot, by name; 0 before the first `reset` and after `close`."""
        ...

    def contacts(self) -> Sequence[int]:
        """Numbers of the bodies, without ground, that it touched in any physics step of the last `step`.

        In ascending order; none after `reset`.
        """
        ...


class PhysicsScene(Protocol):
    """One simulated scene. Not thread-safe; scenes are independent of each other.

    The friction coefficient of a contact is the product of its bodies':
    a robot's links have those of `RobotBody`, statics their own, kinematic
    bodies `KINEMATIC_FRICTION`. Contacts are inelastic, and only contacts,
    joints and motors slow a body down. In DART wheels are mounted on springs,
    which return part of the energy of a hard landing.
    """

    @property
    def robots(self) -> Sequence[PhysicsRobot]:
        """The robots, in the order of `SceneSpec.robots`. They stay the same objects over `reset`."""
        ...

    def reset(self, kinematic_poses: NDArray[np.float64]) -> None:
        """Put robots at their start poses, at rest, and kinematic bodies at theirs (K, 6).

        Poses are x, y, z [m], yaw, roll and pitch [rad]; capsules stand upright at any.
        The result does not depend on anything before: the same calls after it give the same bytes.
        """
        ...

    def move_kinematic(self, index: int, pose: NDArray[np.float64]) -> None:
        """Put a kinematic body at a pose (6), as for `reset`, between control steps.

        The next step moves it from there. No robot may touch it before or after.
        """
        ...

    def begin_step(self, count: int, kinematic_poses: NDArray[np.float64]) -> None:
        """Prepare the `count` physics steps of a control step, under the robots' present commands and forces.

        Kinematic bodies reach `kinematic_poses` (K, 6), as for `reset`, at the
        end; those near a robot move there, boxes turn and lean too, in `count` equal parts. Bodies that
        a robot holds back do not get there: see `held_back_poses`.
        """
        ...

    def finish_step(self) -> None:
        """Advance by the control step that `begin_step` prepared."""
        ...

    def held_back_poses(self) -> NDArray[np.float64] | None:
        """Where the kinematic bodies are after a step in which a robot held any of them back, else None.

        Poses (K, 6) as for `reset`, of which x and y alone differ from those commanded. The next step
        moves the bodies from there.
        """
        ...

    def step_passive(self, count: int) -> None:
        """Advance `count` physics steps with the last commands and without moving kinematic bodies."""
        ...

    def close(self) -> None:
        """Free the engine's memory; a second call does nothing."""
        ...


def step_scene(scene: PhysicsScene, count: int, kinematic_poses: NDArray[np.float64]) -> None:
    """Advance a scene by `count` physics steps: see `PhysicsScene.begin_step`."""
    scene.begin_step(count, kinematic_poses)
    scene.finish_step()
