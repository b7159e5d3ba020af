"""Templates of robots in DART: skeletons that are loaded once and cloned for each episode."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dune_rl.core.errors import PhysicsError
from dune_rl.physics.dart.differential import configure_differential, is_chained
from dune_rl.physics.dart.files import robot_urdf
from dune_rl.physics.dart.joints import SLIP, TYRE
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.softness import TYRE_STIFFNESS_NPM
from dune_rl.physics.robot_body import RobotBody, Tyre

# DART uses the smaller friction coefficient of the two shapes of a contact. The robot's is always larger,
# so that the other shape's, which is the product of both bodies', is used.
ROBOT_FRICTION = 1e3

# Of a capsule that stands for a sphere.
_BALL_LENGTH_M = 1e-5

# More than any joint that stands for compliance or slip of a tyre moves in a physics step.
_MAX_DEFLECTION_M = 0.05


def load_template(spec: RobotBody, text: str | None = None) -> Any:
    """Skeleton of a robot with all joints at their start angles; `text` replaces that of its URDF.

    Raises PhysicsError if DART cannot load it.
    """
    robot = parse_skeleton(robot_urdf(spec, text), spec.urdf.parent)
    if robot is None:
        raise PhysicsError(f"DART cannot load {spec.urdf}")
    for body in robot.getBodyNodes():
        for node in body.getShapeNodes():
            if node.hasDynamicsAspect():
                node.getDynamicsAspect().setFrictionCoeff(ROBOT_FRICTION)
    for links in split_by_role(robot, spec):
        if not has_only_spheres(links):
            _convert_spheres(links)
    joints = {joint.getName(): joint for joint in robot.getJoints()[1:]}
    for name, joint in joints.items():
        if joint.getNumDofs() == 1:
            joint.setDampingCoefficient(0, 0.0)
            joint.setCoulombFriction(0, 0.0)
            joint.setLimitEnforcement(True)
            # The motor model limits the speed.
            joint.setVelocityLowerLimit(0, -math.inf)
            joint.setVelocityUpperLimit(0, math.inf)
            if name.endswith(TYRE):
                joint.setSpringStiffness(0, TYRE_STIFFNESS_NPM)
    for passive in spec.passive:
        joints[passive.joint].setDampingCoefficient(0, passive.damping_nms_per_rad)
        joints[passive.joint].setCoulombFriction(0, passive.friction_nm)
    for motor in spec.motors:
        joint = joints[motor.joint]
        joint.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
        joint.setForceLowerLimit(0, -motor.max_torque_nm)
        joint.setForceUpperLimit(0, motor.max_torque_nm)
        joint.setPosition(0, motor.rest_rad)
    for coupling in spec.couplings:
        if is_chained(robot, coupling):
            configure_differential(robot, coupling)
    return robot


def parse_skeleton(urdf: str, folder: Path) -> Any:
    """Skeleton of the text of a URDF, whose paths are relative to `folder`; None if DART cannot parse it."""
    # DART does not decode percent signs in a path.
    return dartpy.utils.DartLoader().parseSkeletonString(urdf, f"file://{folder.resolve()}/")


def split_by_role(robot: Any, spec: RobotBody) -> tuple[list[Any], list[Any]]:
    """The bodies of a skeleton that are ground links, and the others: the hull."""
    feet, hull = list[Any](), list[Any]()
    for body in robot.getBodyNodes():
        (feet if body.getName() in spec.ground_links else hull).append(body)
    return feet, hull


def _convert_spheres(bodies: Iterable[Any]) -> None:
    """Replace the spheres of some bodies by capsules of as good as no length.

    The detector keeps all shapes but spheres a margin off the triangles of an open surface, which is lowered
    by as much for links with other shapes: see `statics`. There spheres, such as a caster's, would sink.
    """
    for body in bodies:
        for node in body.getShapeNodes():
            shape = node.getShape()
            if node.hasCollisionAspect() and isinstance(shape, dartpy.dynamics.SphereShape):
                node.setShape(dartpy.dynamics.CapsuleShape(shape.getRadius(), _BALL_LENGTH_M))


def has_only_spheres(bodies: Iterable[Any]) -> bool:
    """Whether all collision shapes of some bodies are spheres."""
    nodes = [node for body in bodies for node in body.getShapeNodes() if node.hasCollisionAspect()]
    return all(isinstance(node.getShape(), dartpy.dynamics.SphereShape) for node in nodes)


def measure_reach_m(robot: Any, tyres: Sequence[Tyre]) -> float:
    """Upper bound of the distance [m] of any point of the skeleton `robot` from the base link's origin.

    `tyres`, which the skeleton need not have, count too. Each link adds the distance of its joint from its
    parent's, whatever the angles of the joints are.
    """
    reach, distances = 0.0, dict[str, float]()
    for body in robot.getBodyNodes():
        joint, parent = body.getParentJoint(), body.getParentBodyNode()
        distance = 0.0
        if parent is not None:
            step = body.getTransform(parent).translation()
            distance = distances[parent.getName()] + float(np.linalg.norm(step))
            if joint.getName().endswith((TYRE, SLIP)):
                distance += _MAX_DEFLECTION_M
            elif joint.getType() == "PrismaticJoint":
                low, high = joint.getPositionLowerLimit(0), joint.getPositionUpperLimit(0)
                distance += max(abs(low), abs(high))
        distances[body.getName()] = distance
        for node in body.getShapeNodes():
            if node.hasCollisionAspect():
                box, pose = node.getShape().getBoundingBox(), node.getRelativeTransform()
                middle = pose.multiply(0.5 * (box.getMin() + box.getMax()))
                half = 0.5 * np.linalg.norm(box.getMax() - box.getMin())
                reach = max(reach, distance + float(np.linalg.norm(middle) + half))
    return max([reach, *(distances[tyre.link] + tyre.reach_m for tyre in tyres)])
