"""Loading of robots and meshes into DART: URDFs with additional joints, and skeletons that are cloned."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from dune_rl.core.errors import PhysicsError
from dune_rl.geometry.arrays import Array
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.motors import TYRE_STIFFNESS_NPM, configure_differential, is_chained
from dune_rl.physics.robot_body import AS_DESCRIBED, BodyVariation, Coupling, RobotBody, Tyre, read_urdf_body
from dune_rl.physics.shapes import StaticBody

# Suffixes of the names of joints and links for the compliance of a tyre, and for its slip along the axle.
TYRE, SLIP = "/tyre", "/grip"

_NEGLIGIBLE_KG = "1e-3"
_UP = np.array([0.0, 0.0, 1.0])


def add_tyre_joint(wheel_joint: Element, root: Element) -> None:
    """Insert a vertical sliding joint between a wheel and the link that it is mounted on."""
    _insert_joint(wheel_joint, TYRE, root, "prismatic", np.zeros(3), _UP)


def add_slip_joint(wheel_joint: Element, root: Element) -> None:
    """Insert a joint that lets a wheel whose contact sticks move along its axle.

    A sphere rolls sideways about an axis through its centre, so that only friction along the axle turns it,
    and no normal force. Other shapes cannot roll sideways: they slide along the axle. Either way the wheel's
    mass is moved to the link that it is mounted on, which moves with the robot.
    """
    rotation, position = _pose(wheel_joint)
    axle = rotation.apply(_axis(wheel_joint))
    wheel, mount = (_link(root, name) for name in (_child(wheel_joint), _parent(wheel_joint).get("link", "")))
    mass = wheel.find("inertial/mass")
    if mass is not None:
        centre = position + rotation.apply(_numbers(wheel.find("inertial/origin"), "xyz"))
        for inertial in mount.findall("inertial"):
            SubElement(inertial, "origin", {"xyz": _format(centre)})
            for mount_mass in inertial.findall("mass"):
                mount_mass.set("value", mass.get("value", "0"))
        mass.set("value", _NEGLIGIBLE_KG)
    shapes = wheel.findall("collision")
    if len(shapes) == 1 and shapes[0].find("geometry/sphere") is not None:
        centre = position + rotation.apply(_numbers(shapes[0].find("origin"), "xyz"))
        _insert_joint(wheel_joint, SLIP, root, "continuous", centre, np.cross(axle, _UP))
    else:
        _insert_joint(wheel_joint, SLIP, root, "prismatic", np.zeros(3), axle)


def differentials(spec: RobotBody, joints: dict[str, Element]) -> list[Coupling]:
    """Couplings with ratio -1 of two joints of one link, on one axis and without motors."""
    coupled = [name for coupling in spec.couplings for name in (coupling.leader, coupling.follower)]
    return [
        coupling
        for coupling in spec.couplings
        if all(
            coupled.count(name) == 1 and name not in spec.drive_joints
            for name in (coupling.leader, coupling.follower)
        )
        and coupling.ratio == -1.0
        and _on_one_axis(joints[coupling.leader], joints[coupling.follower])
    ]


def _on_one_axis(leader: Element, follower: Element) -> bool:
    if _parent(leader).get("link") != _parent(follower).get("link"):
        return False
    (rotation, position), (other_rotation, other_position) = _pose(leader), _pose(follower)
    axis, other_axis = rotation.apply(_axis(leader)), other_rotation.apply(_axis(follower))
    return bool(np.allclose(axis, other_axis) and np.allclose(np.cross(other_position - position, axis), 0.0))


def chain_differential(leader: Element, follower: Element) -> None:
    """Make the follower's joint of a differential a child of the leader's link instead of the body's."""
    (rotation, position), (other_rotation, other_position) = _pose(leader), _pose(follower)
    _parent(follower).set("link", _child(leader))
    _set_position(follower, rotation.inv().apply(other_position - position))
    _origin(follower).set("rpy", _format((rotation.inv() * other_rotation).as_euler("xyz")))


def _insert_joint(
    wheel_joint: Element, suffix: str, root: Element, kind: str, position: Array, axis: Array
) -> None:
    """Insert a joint, and a link of negligible mass, between a wheel and the link that it is mounted on."""
    parent = _parent(wheel_joint)
    name = f"{wheel_joint.get('name')}{suffix}"
    joint = SubElement(root, "joint", {"name": name, "type": kind})
    SubElement(joint, "parent", {"link": parent.get("link", "")})
    SubElement(joint, "child", {"link": name})
    SubElement(joint, "axis", {"xyz": _format(axis)})
    SubElement(joint, "limit", {"effort": "1e9", "velocity": "1e9", "lower": "-1", "upper": "1"})
    # Small compared with any wheel; DART replaces a mass of 0 by 1 kg.
    inertial = SubElement(SubElement(root, "link", {"name": name}), "inertial")
    SubElement(inertial, "mass", {"value": _NEGLIGIBLE_KG})
    moments = {"ixx": "1e-6", "iyy": "1e-6", "izz": "1e-6", "ixy": "0", "ixz": "0", "iyz": "0"}
    SubElement(inertial, "inertia", moments)
    parent.set("link", name)
    if position.any():
        _set_position(joint, position)
        _set_position(wheel_joint, _pose(wheel_joint)[1] - position)


def _link(root: Element, name: str) -> Element:
    return next(link for link in root.findall("link") if link.get("name") == name)


def _parent(joint: Element) -> Element:
    parent = joint.find("parent")
    assert parent is not None, "a joint has a parent"
    return parent


def _child(joint: Element) -> str:
    child = joint.find("child")
    return "" if child is None else child.get("link", "")


def _origin(joint: Element) -> Element:
    origin = joint.find("origin")
    return SubElement(joint, "origin") if origin is None else origin


def _set_position(joint: Element, position: Array) -> None:
    _origin(joint).set("xyz", _format(position))


def _pose(joint: Element) -> tuple[Rotation, Array]:
    origin = joint.find("origin")
    return Rotation.from_euler("xyz", _numbers(origin, "rpy")), _numbers(origin, "xyz")


def _axis(joint: Element) -> Array:
    return _numbers(joint.find("axis"), "xyz", "1 0 0")


def _numbers(element: Element | None, name: str, default: str = "0 0 0") -> Array:
    return np.array((default if element is None else element.get(name, default)).split(), float)


def _format(numbers: Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)


_FOLD_DEPTH_M = 10.0


def robot_urdf(spec: RobotBody, variation: BodyVariation) -> str:
    """Text of the robot's URDF with the additional joints for tyres, slip and differentials.

    Raises PhysicsError if the file, or a joint or link of `spec`, does not exist.
    """
    root = read_urdf_body(spec.urdf, variation)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    error_text = spec.describe_missing_names(joints, [link.get("name", "") for link in root.findall("link")])
    if error_text:
        raise PhysicsError(error_text)
    for coupling in differentials(spec, joints):
        chain_differential(joints[coupling.leader], joints[coupling.follower])
    for motor in spec.motors:
        joint = joints[motor.joint]
        child = joint.find("child")
        # Legs with position motors are compliant already, and would sink on a sliding joint.
        if motor.mode == "velocity" and child is not None and child.get("link") in spec.ground_links:
            add_tyre_joint(joint, root)
            if spec.sideways_friction_share != 1.0:
                add_slip_joint(joint, root)
    return tostring(root, encoding="unicode")


def mesh_corners(body: StaticBody, is_open: bool) -> Array:
    """The corners (F, 3, 3) [m] of a body's triangles, as DART gets them.

    Open surfaces get a fold far below: the engine would otherwise treat flat
    ground as a convex solid, and search all its vertices at every contact.
    """
    corners = body.vertices[body.faces]
    return np.concatenate([corners, _fold(body)]) if is_open else corners


def write_meshes(meshes: Sequence[Array], folder: Path) -> str:
    """Text of a URDF with one link, whose collision shapes are `meshes` (F, 3, 3), written to `folder`."""
    elements = []
    for number, corners in enumerate(meshes):
        path = folder.resolve() / f"{number}.stl"
        path.write_bytes(_stl(corners))
        elements.append(f'<collision><geometry><mesh filename="file://{path}"/></geometry></collision>')
    return f'<robot name="statics"><link name="statics">{"".join(elements)}</link></robot>'


def is_open_surface(body: StaticBody) -> bool:
    """Whether the mesh has a border, that is, it is not a closed solid."""
    edges = np.sort(body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 1).any())


def _fold(body: StaticBody) -> Array:
    """Two triangles (2, 3, 3) that make any mesh non-convex."""
    x, y = body.vertices[:, :2].mean(axis=0)
    below = [x, y, body.vertices[:, 2].min() - _FOLD_DEPTH_M]
    return np.array([[[0, 0, 0], [1, 0, 1], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [-1, 0, 1]]]) + below


def _stl(corners: Array) -> bytes:
    """Binary STL file of triangles (F, 3, 3)."""
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = corners
    return bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes()


# DART refuses bodies without mass; this is as good as none.
_MASS_KG, _MOMENT_KGM2 = 1e-9, 1e-12


def negligible_inertia() -> Any:
    """Inertia of a body of as good as no mass."""
    return dartpy.dynamics.Inertia(_MASS_KG, np.zeros(3), _MOMENT_KGM2 * np.eye(3))


def weld_massless_body(link: Any) -> Any:
    """Weld a new body, of as good as no mass, to a link."""
    _, body = link.createWeldJointAndBodyNodePair()
    body.setInertia(negligible_inertia())
    return body


def add_shape(body: Any, shape: Any, friction: float, height_m: float = 0.0) -> Any:
    """Add a collision shape with a friction coefficient to a body; returns its shape node."""
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    node.setRelativeTranslation([0.0, 0.0, height_m])
    return node


# DART uses the smaller friction coefficient of the two shapes of a contact. The robot's is always larger,
# so that the other shape's, which is the product of both bodies', is used.
ROBOT_FRICTION = 1e3

# Of a capsule that stands for a sphere.
_BALL_LENGTH_M = 1e-5

# More than any joint that stands for compliance or slip of a tyre moves in a physics step.
_MAX_DEFLECTION_M = 0.05


def load_template(spec: RobotBody, variation: BodyVariation = AS_DESCRIBED) -> Any:
    """Skeleton of a robot with all joints at their start angles, with the masses of `variation`.

    Raises PhysicsError if DART cannot load it.
    """
    robot = parse_skeleton(robot_urdf(spec, variation), spec.urdf.parent)
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
