"""What an engine must do: the narrow interface that everything above sees of physics."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dune_rl.settings import Settings

Engine = Literal["bullet", "dart"]
FrictionModel = Literal["pyramid", "cone"]
ENGINES: tuple[Engine, ...] = get_args(Engine)

BODY_STATE_SIZE = 13

# Friction of the robot's links that are no wheels, and of kinematic bodies.
HULL_FRICTION = 0.3
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
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    friction: float
    ground: bool


@dataclass(frozen=True)
class KinematicCapsule:
    """An upright capsule that is moved from outside; its origin is on the ground below it."""

    name: str
    radius_m: float
    height_m: float


@dataclass(frozen=True)
class RobotBody:
    """A URDF and what its joints are for.

    `drive_joints` take velocity commands, limited to `max_torque_nm` each.
    Links of drive joints roll on the ground and touch nothing else; all other
    links touch everything. The base link's inertial origin is its own origin.
    """

    urdf: Path
    drive_joints: tuple[str, ...]
    max_torque_nm: float
    wheel_friction: float


@dataclass(frozen=True)
class SceneSpec:
    """All that a scene holds. Bodies are numbered: statics first, then kinematics."""

    statics: tuple[StaticBody, ...]
    kinematics: tuple[KinematicCapsule, ...]
    robot: RobotBody
    timestep_s: float
    solver_iterations: int
    gravity_mps2: float = 9.81
    friction: FrictionModel = "pyramid"


class PhysicsScene(Protocol):
    """One simulated scene with one robot. Not thread-safe; scenes are independent of each other.

    Between two bodies the friction coefficient is the product of theirs:
    wheels have `RobotBody.wheel_friction`, other links `HULL_FRICTION`,
    statics their own, kinematic bodies `CAPSULE_FRICTION`. Nothing bounces,
    and nothing but contacts and drives slows a body down.
    """

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        """Put the robot down at rest, and the kinematic bodies (K, 4: x, y, z, yaw) at their poses.

        What was before leaves no trace: the same calls after it give the same bytes.
        """
        ...

    def step(
        self, count: int, drive_velocities: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        """Advance `count` physics steps with the drive joints' target speeds [rad/s].

        Kinematic bodies reach `kinematic_poses` (K, 4: x, y, z, yaw) at the
        end, and get there in `count` equal parts where the robot is near.
        """
        ...

    def push(self, force_w: Sequence[float]) -> None:
        """Set the force (3) [N], world frame, that acts on the base link's centre throughout the next `step`.

        Without a call before it, a step has none.
        """
        ...

    def coast(self, count: int) -> None:
        """Advance `count` physics steps with the last commands and nothing moved: bare physics."""
        ...

    def body_state(self) -> tuple[float, ...]:
        """Base position (3) [m], quaternion xyzw (4), linear (3) [m/s] and angular velocity (3) [rad/s].

        All in the world frame.
        """
        ...

    def drive_state(self) -> tuple[float, ...]:
        """Angles [rad], speeds [rad/s] and torques [N m] of the W drive joints, one after another (3 * W).

        Angles are 0 where the robot is put down and count whole turns. A
        torque is what the drive gave in the last physics step, positive where
        it pushes toward a positive speed.
        """
        ...

    def touched(self) -> Sequence[int]:
        """Numbers of the bodies, ground left out, that the robot touches now; may repeat."""
        ...

    def close(self) -> None:
        """Free the engine's memory; calling it twice is harmless."""
        ...
