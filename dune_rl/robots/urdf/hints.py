"""Hints in a URDF beyond links and joints: which joints simulators and controllers command, and how."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

_TRANSMISSION, _CONTROL, _GAZEBO = "transmission", "ros2_control", "gazebo"
# Elements of a plugin that name joints: <left_joint>, <front_left_steering_joint>, <joint_name> and so on.
_JOINT_TAG = re.compile(r"joint", re.IGNORECASE)
# Rollers at 45 degrees are modelled by friction along a diagonal.
_LEAST_DIAGONAL = 0.3


@dataclass(frozen=True)
class UrdfHints:
    """What <transmission>, <ros2_control> and <gazebo> elements say.

    `commanded` are joints that some controller commands; `plugins` are names and file names of plugins.
    `diagonal_grip` are links whose friction acts along a diagonal (`fdir1`), `no_grip` those without any.
    """

    commanded: frozenset[str] = frozenset()
    plugins: tuple[str, ...] = ()
    diagonal_grip: frozenset[str] = frozenset()
    no_grip: frozenset[str] = frozenset()


def read_hints(root: Element) -> UrdfHints:
    """The hints of a URDF's root element; what is malformed is ignored."""
    joints = {joint.get("name", "") for joint in root.findall("joint")}
    commanded = {name for name in _controlled_joints(root) if name in joints}
    plugins: list[str] = []
    for plugin in root.iter("plugin"):
        plugins += [word for word in (plugin.get("name"), plugin.get("filename")) if word]
        for element in plugin.iter():
            if isinstance(element.tag, str) and _JOINT_TAG.search(element.tag):
                commanded |= joints.intersection((element.text or "").replace(",", " ").split())
    diagonal, slippery = set[str](), set[str]()
    for gazebo in root.findall(_GAZEBO):
        link = gazebo.get("reference", "")
        if _is_diagonal(_words(gazebo, "fdir1")):
            diagonal.add(link)
        friction = [_words(gazebo, name) for name in ("mu1", "mu2")]
        if all(friction) and all(_number(words[0]) == 0.0 for words in friction):
            slippery.add(link)
    return UrdfHints(frozenset(commanded), tuple(plugins), frozenset(diagonal), frozenset(slippery))


def _controlled_joints(root: Element) -> Iterator[str]:
    for transmission in root.findall(_TRANSMISSION):
        yield from (joint.get("name", "") for joint in transmission.findall("joint"))
    for control in root.findall(_CONTROL):
        for joint in control.findall("joint"):
            if joint.find("command_interface") is not None:
                yield joint.get("name", "")


def _words(element: Element, name: str) -> list[str]:
    """The words of a child that has them as its text or as its attribute `value`."""
    child = element.find(name)
    return [] if child is None else (child.get("value") or child.text or "").split()


def _is_diagonal(words: list[str]) -> bool:
    numbers = [abs(_number(word)) for word in words]
    return len(numbers) == 3 and min(numbers[:2]) > _LEAST_DIAGONAL


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")
