"""Robots as physics engines load them: the URDF, and the roles of its joints and links."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from dune_rl.physics.motors import Motor


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
