"""Joints added to a robot's URDF for DART: tyre compliance, lateral slip, and differentials."""

from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from dune_rl.geometry.arrays import Array
from dune_rl.physics.robot_body import Coupling, RobotBody

# Suffixes of the names of joints and links for the compliance of a tyre, and for its slip along the axle.
TYRE, SLIP = "/tyre", "/grip"

_NEGLIGIBLE_KG = "1e-3"
_UP = np.array([0.0, 0.0, 1.0])


def add_tyre_joint(wheel_joint: Element, root: Element) -> None:
    """Insert a vertical sliding joint between a wheel and the link that it is mounted on."""
    _insert_joint(wheel_joint, TYRE, root, "prismatic", np.zeros(3), _UP)


def add_slip_joint(wheel_joint: Element, root: Element) -> None:
    """Insert a joint that lets a wheel whose contact sticks move along its axle.

    A sphere rolls sideways about an axis through its centre, so that only
    friction along the axle turns it, and no normal force. Other shapes cannot
    roll sideways: they slide along the axle. Either way the wheel's mass is
    moved to the link that it is mounted on, which moves with the robot.
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
