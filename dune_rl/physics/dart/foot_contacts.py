"""Contacts of a robot's ground links in DART: friction, restitution, lateral slip and compliance."""

from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart.grip import LateralSlip
from dune_rl.physics.dart.softness import SERVO_SOFTNESS
from dune_rl.physics.dart.tyres import CompliantGround
from dune_rl.physics.robot_body import RobotBody


class FootContacts:
    """Contact parameters of the W ground links of the skeleton `robot`, which `spec` describes.

    `friction` is the coefficient of all of them, multiplied with the ground's, until `set` is called.
    `slip` is None if tyres grip equally in all directions, `ground` if contacts are rigid.
    """

    def __init__(self, robot: Any, spec: RobotBody, friction: float, timestep_s: float) -> None:
        self._robot, self._timestep_s = robot, timestep_s
        self._feet = [robot.getBodyNode(name) for name in spec.ground_links]
        self.ground: CompliantGround | None = None
        self.slip: LateralSlip | None = None
        if spec.sideways_friction_share != 1.0:
            self.slip = LateralSlip(robot, self._feet, spec.sideways_friction_share, timestep_s)
            self.slip.set_friction([friction] * len(self._feet))

    def set(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> None:
        """Set the parameters (W each) as `PhysicsRobot.set_wheel_contacts`; both friction coefficients
        of a contact are multiplied in `friction`.
        """
        for foot, foot_friction, foot_restitution in zip(self._feet, friction, restitution, strict=True):
            for node in foot.getShapeNodes():
                if node.hasDynamicsAspect():
                    node.getDynamicsAspect().setFrictionCoeff(foot_friction)
                    node.getDynamicsAspect().setRestitutionCoeff(foot_restitution)
        if self.slip is not None:
            self.slip.set_friction(friction)
        if stiffness is None or damping is None:
            return
        if self.ground is None:
            self.ground = CompliantGround(self._robot, self._feet, self._timestep_s, SERVO_SOFTNESS)
        self.ground.set(stiffness, damping)
