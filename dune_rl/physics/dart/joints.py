"""Joints that a robot has in DART beside those of its URDF, for what the engine has no setting for."""

from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dune_rl.physics.interface import Coupling, RobotBody

Array = NDArray[np.float64]

# Ends the names of joints and links that stand for the give of a tyre, and for its slip along the axle.
TYRE, GRIP = "/tyre", "/grip"

_HARDLY_ANY_KG = "1e-3"
_UP = np.array([0.0, 0.0, 1.0])


def hang(wheel_joint: Element, root: Element) -> None:
    """Let a wheel move up and down on its mount."""
    _insert(wheel_joint, TYRE, root, "prismatic", np.zeros(3), _UP)


def let_slip(wheel_joint: Element, root: Element) -> None:
    """Let a wheel whose contact sticks move along its axle.

    A ball rolls sideways about an axis through its middle, so that only what
    rubs on it along the axle turns it, and not what presses it from any side.
    Other shapes do not roll so: they slide along the axle. Either way the wheel
    leaves its weight to what it hangs on, which moves as the whole does.
    """
    turn, place = _pose(wheel_joint)
    axle = turn.apply(_axis(wheel_joint))
    wheel, mount = (_link(root, name) for name in (_child(wheel_joint), _mount(wheel_joint).get("link", "")))
    mass = wheel.find("inertial/mass")
    if mass is not None:
        centre = place + turn.apply(_numbers(wheel.find("inertial/origin"), "xyz"))
        for inertial in mount.findall("inertial"):
            SubElement(inertial, "origin", {"xyz": _told(centre)})
            for light in inertial.findall("mass"):
                light.set("value", mass.get("value", "0"))
        mass.set("value", _HARDLY_ANY_KG)
    shapes = wheel.findall("collision")
    if len(shapes) == 1 and shapes[0].find("geometry/sphere") is not None:
        middle = place + turn.apply(_numbers(shapes[0].find("origin"), "xyz"))
        _insert(wheel_joint, GRIP, root, "continuous", middle, np.cross(axle, _UP))
    else:
        _insert(wheel_joint, GRIP, root, "prismatic", np.zeros(3), axle)


def differentials(spec: RobotBody, joints: dict[str, Element]) -> list[Coupling]:
    """The couplings of two joints of one body, on one axis and without motors, that turn opposite."""
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
    if _mount(leader).get("link") != _mount(follower).get("link"):
        return False
    (turn, place), (other_turn, other_place) = _pose(leader), _pose(follower)
    axis, other_axis = turn.apply(_axis(leader)), other_turn.apply(_axis(follower))
    return bool(np.allclose(axis, other_axis) and np.allclose(np.cross(other_place - place, axis), 0.0))


def chain(leader: Element, follower: Element) -> None:
    """Have the follower's joint of a differential turn on the leader's link, and no more on the body's."""
    (turn, place), (other_turn, other_place) = _pose(leader), _pose(follower)
    _mount(follower).set("link", _child(leader))
    _place(follower, turn.inv().apply(other_place - place))
    _origin(follower).set("rpy", _told((turn.inv() * other_turn).as_euler("xyz")))


def _insert(wheel_joint: Element, ending: str, root: Element, kind: str, place: Array, axis: Array) -> None:
    """Put a joint, and a link of hardly any mass, between a wheel and what it hangs on."""
    mount = _mount(wheel_joint)
    name = f"{wheel_joint.get('name')}{ending}"
    joint = SubElement(root, "joint", {"name": name, "type": kind})
    SubElement(joint, "parent", {"link": mount.get("link", "")})
    SubElement(joint, "child", {"link": name})
    SubElement(joint, "axis", {"xyz": _told(axis)})
    SubElement(joint, "limit", {"effort": "1e9", "velocity": "1e9", "lower": "-1", "upper": "1"})
    # Light beside any wheel; nothing at all would be a mass that DART replaces by 1 kg.
    inertial = SubElement(SubElement(root, "link", {"name": name}), "inertial")
    SubElement(inertial, "mass", {"value": _HARDLY_ANY_KG})
    moments = {"ixx": "1e-6", "iyy": "1e-6", "izz": "1e-6", "ixy": "0", "ixz": "0", "iyz": "0"}
    SubElement(inertial, "inertia", moments)
    mount.set("link", name)
    if place.any():
        _place(joint, place)
        _place(wheel_joint, _pose(wheel_joint)[1] - place)


def _link(root: Element, name: str) -> Element:
    return next(link for link in root.findall("link") if link.get("name") == name)


def _mount(joint: Element) -> Element:
    mount = joint.find("parent")
    assert mount is not None, "a joint has a parent"
    return mount


def _child(joint: Element) -> str:
    child = joint.find("child")
    return "" if child is None else child.get("link", "")


def _origin(joint: Element) -> Element:
    origin = joint.find("origin")
    return SubElement(joint, "origin") if origin is None else origin


def _place(joint: Element, place: Array) -> None:
    _origin(joint).set("xyz", _told(place))


def _pose(joint: Element) -> tuple[Rotation, Array]:
    origin = joint.find("origin")
    return Rotation.from_euler("xyz", _numbers(origin, "rpy")), _numbers(origin, "xyz")


def _axis(joint: Element) -> Array:
    return _numbers(joint.find("axis"), "xyz", "1 0 0")


def _numbers(element: Element | None, name: str, otherwise: str = "0 0 0") -> Array:
    return np.array((otherwise if element is None else element.get(name, otherwise)).split(), float)


def _told(numbers: Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)
