"""Reader of URDFs: a fault is a `RobotError` that names the file, the element and the remedy."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element

import numpy as np
from trimesh.transformations import euler_matrix

from dune_rl.core.errors import RobotError, WorldError
from dune_rl.core.untrusted_files import printable, read_bytes, read_xml
from dune_rl.geometry.arrays import Array
from dune_rl.robots.urdf.model import Geometry, Inertial, Joint, Link, UrdfHints, UrdfModel

_KINDS = ("fixed", "continuous", "revolute", "prismatic")
_XACRO = "xacro"
Part = TypeVar("Part", Link, Joint)
_MAX_BYTES = 16 * 2**20
_MOST_LINKS = 500
# PyBullet's room for a name is 1,024 bytes, which a longer one overflows; a letter has up to four.
_MOST_LETTERS = 255
# Elements of a plugin that name joints: <left_joint>, <front_left_steering_joint>, <joint_name> and so on.
_JOINT_TAG = re.compile(r"joint", re.IGNORECASE)
# Rollers at 45 degrees are modelled by friction along a diagonal.
_LEAST_DIAGONAL = 0.3


def read_urdf(path: str | Path) -> UrdfModel:
    """Read the URDF at `path`; a `RobotError` names the file, the element and the remedy for a fault."""
    file = Path(path).expanduser()
    if not file.exists():
        raise RobotError(f"there is no file {file}: robot.path must name a URDF that exists.")
    if file.suffix.lower() == f".{_XACRO}":
        raise RobotError(_xacro_message(file))
    try:
        root = read_xml(read_bytes(file, _MAX_BYTES), file.name)
    except WorldError as error:
        raise RobotError(str(error).replace("world.path", "robot.path")) from None
    if any(_XACRO in element.tag for element in root.iter() if isinstance(element.tag, str)):
        raise RobotError(_xacro_message(file))
    if root.tag != "robot":
        raise RobotError(f"{file.name} begins with <{printable(str(root.tag))}>, and a URDF with <robot>.")
    try:
        return _read_model(root, file)
    except _FaultError as fault:
        raise RobotError(f"{file.name}: {fault}") from None


def _xacro_message(file: Path) -> str:
    # Never the file itself: the shell empties it before xacro reads it.
    stem = file.name.split(".")[0]
    expanded = f"{stem}.urdf" if f"{stem}.urdf" != file.name else f"{stem}_expanded.urdf"
    return f"{file.name} is a xacro file; expand it first: xacro {file.name} > {expanded}"


class _FaultError(Exception):
    pass


def _read_model(root: Element, path: Path) -> UrdfModel:
    colours = {
        material.get("name", ""): _numbers(material.find("color"), "rgba", 4, None, "a <material>")[:3]
        for material in root.findall("material")
        if material.find("color") is not None
    }
    links = _by_name("links", (_link(element, colours) for element in root.findall("link")))
    if not links:
        raise _FaultError("it has no links; a robot has one at least.")
    if len(links) > _MOST_LINKS:
        raise _FaultError(f"it has {len(links)} links, more than {_MOST_LINKS}; leave some out.")
    joints = _by_name("joints", (_joint(element, links) for element in root.findall("joint")))
    base = _base_of(links, joints.values())
    return UrdfModel(path, _checked(root.get("name", "robot"), root), base, links, joints, _read_hints(root))


def _by_name(kind: str, parts: Iterable[Part]) -> dict[str, Part]:
    found: dict[str, Part] = {}
    for part in parts:
        if part.name in found:
            raise _FaultError(f"there are two {kind} {printable(part.name)!r}; rename one.")
        found[part.name] = part
    return found


def _link(element: Element, colours: Mapping[str, tuple[float, ...]]) -> Link:
    name = _name(element)
    where = f"link {printable(name)!r}"
    inertial = element.find("inertial")
    collisions, visuals = (
        tuple(_geometry(each, where, colours) for each in element.findall(tag))
        for tag in ("collision", "visual")
    )
    return Link(name, None if inertial is None else _inertial(inertial, where), collisions, visuals)


def _joint(element: Element, links: dict[str, Link]) -> Joint:
    name, kind = _name(element), element.get("type", "")
    where = f"joint {printable(name)!r}"
    if kind not in _KINDS:
        raise _FaultError(f"{where} has the type {printable(kind)!r}; types are {', '.join(_KINDS)}.")
    ends = []
    for end in ("parent", "child"):
        found = element.find(end)
        link = None if found is None else found.get("link")
        if link is None or link not in links:
            raise _FaultError(f"{where}: its {end} is {printable(str(link))!r}, and no link is called so.")
        ends.append(link)
    axis = _numbers(element.find("axis"), "xyz", 3, (1.0, 0.0, 0.0), where)
    length = float(np.linalg.norm(axis))
    if kind != "fixed" and length < 1e-9:
        raise _FaultError(f'{where}: its <axis> has no length; write xyz="0 1 0" or such.')
    limit, dynamics, mimic = (element.find(tag) for tag in ("limit", "dynamics", "mimic"))
    lower, upper = (_number(limit, name_, 0.0, where) for name_ in ("lower", "upper"))
    if kind in ("revolute", "prismatic") and lower > upper:
        raise _FaultError(f"{where}: its <limit> has lower {lower:g} above upper {upper:g}.")
    ratio = _number(mimic, "multiplier", 1.0, where)
    if ratio == 0.0:
        raise _FaultError(f"{where}: its <mimic> has the multiplier 0; make the joint fixed.")
    return Joint(
        name,
        kind,
        ends[0],
        ends[1],
        _pose(element, where),
        np.array(axis) / max(length, 1e-9),
        (lower, upper),
        _positive(limit, "effort", where),
        _positive(limit, "velocity", where),
        abs(_number(dynamics, "friction", 0.0, where)),
        abs(_number(dynamics, "damping", 0.0, where)),
        None if mimic is None else (mimic.get("joint", ""), ratio),
    )


def _base_of(links: Collection[str], joints: Iterable[Joint]) -> str:
    parents: dict[str, str] = {}
    for joint in joints:
        if joint.child in parents:
            raise _FaultError(
                f"link {printable(joint.child)!r} is the child of two joints; "
                "a URDF is a tree, so remove one."
            )
        parents[joint.child] = joint.parent
    bases = [name for name in links if name not in parents]
    if not bases:
        raise _FaultError("its joints run in a loop, so that no link is the base; remove one of them.")
    if len(bases) > 1:
        listed = ", ".join(printable(name) for name in bases[:6])
        raise _FaultError(f"{len(bases)} links have no parent ({listed}); join all but the base by joints.")
    for name in links:
        seen = {name}
        while name in parents:
            name = parents[name]
            if name in seen:
                raise _FaultError(f"its joints run in a loop by way of link {printable(name)!r}; remove one.")
            seen.add(name)
    return bases[0]


def _name(element: Element) -> str:
    name = element.get("name", "")
    if not name:
        raise _FaultError(f"a <{element.tag}> has no name; give it one.")
    return _checked(name, element)


def _checked(name: str, element: Element) -> str:
    if len(name) > _MOST_LETTERS:
        raise _FaultError(
            f"a <{element.tag}> has a name of {len(name):,} letters, more than {_MOST_LETTERS}; shorten it."
        )
    return name


def _inertial(element: Element, where: str) -> Inertial | None:
    mass = _number(element.find("mass"), "value", 0.0, where)
    if mass < 0.0:
        raise _FaultError(f"{where}: its <mass> is {mass:g} kg; a mass is above 0.")
    moments = element.find("inertia")
    xx, yy, zz, xy, xz, yz = (
        _number(moments, key, 0.0, where) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass == 0.0:
        return None
    least, middle, most = np.linalg.eigvalsh(inertia)
    # PyBullet silently replaces such an inertia.
    if least <= 0.0 or most > 1.0001 * (least + middle):
        raise _FaultError(
            f"{where}: its <inertia> is that of no body; its moments must be above 0, and none above the sum "
            "of the other two: a solid box has m (a² + b²) / 12 about each axis."
        )
    pose = _pose(element, where)
    return Inertial(mass, np.zeros(3), inertia).transform(pose)


def _colour(
    material: Element | None, colours: Mapping[str, tuple[float, ...]], where: str
) -> tuple[float, ...] | None:
    if material is None:
        return None
    own = material.find("color")
    default = None if own is None else _numbers(own, "rgba", 4, None, where)[:3]
    return colours.get(material.get("name", ""), default)


def _geometry(element: Element, where: str, colours: Mapping[str, tuple[float, ...]]) -> Geometry:
    holder = element.find("geometry")
    if holder is None or not len(holder):
        raise _FaultError(f"{where}: a <{element.tag}> has no <geometry>; give it one, or remove it.")
    shape = holder[0]
    pose, colour = _pose(element, where), _colour(element.find("material"), colours, where)
    if shape.tag == "box":
        size = _numbers(shape, "size", 3, None, where)
    elif shape.tag == "cylinder":
        size = (_number(shape, "radius", None, where), _number(shape, "length", None, where))
    elif shape.tag == "sphere":
        size = (_number(shape, "radius", None, where),)
    elif shape.tag == "mesh":
        size = _numbers(shape, "scale", 3, (1.0, 1.0, 1.0), where)
        if not shape.get("filename"):
            raise _FaultError(f"{where}: a <mesh> has no filename.")
        if not all(size):
            raise _FaultError(f"{where}: a <mesh> has a scale of 0.")
        return Geometry("mesh", size, pose, shape.get("filename"), colour)
    else:
        raise _FaultError(
            f"{where}: a <{printable(str(shape.tag))}> is no shape of a URDF; "
            "use box, cylinder, sphere or mesh."
        )
    if min(size) <= 0.0:
        raise _FaultError(f"{where}: a <{shape.tag}> has a size of {min(size):g} m; sizes are above 0.")
    return Geometry(shape.tag, size, pose, None, colour)


def _pose(element: Element, where: str) -> Array:
    origin = element.find("origin")
    roll, pitch, yaw = _numbers(origin, "rpy", 3, (0.0, 0.0, 0.0), where)
    pose = np.asarray(euler_matrix(roll, pitch, yaw, axes="sxyz"))
    pose[:3, 3] = _numbers(origin, "xyz", 3, (0.0, 0.0, 0.0), where)
    return pose


def _numbers(
    element: Element | None, key: str, count: int, default: tuple[float, ...] | None, where: str
) -> tuple[float, ...]:
    text = None if element is None else element.get(key)
    if text is None:
        if default is None:
            raise _FaultError(f"{where}: {key} is missing; write {count} numbers.")
        return default
    try:
        found = tuple(float(word) for word in text.split())
    except ValueError:
        found = ()
    # No robot has larger numbers, and squares of them overflow.
    if len(found) != count or not all(abs(value) < 1e9 for value in found):
        tag = "" if element is None else f"<{element.tag}> "
        raise _FaultError(f"{where}: {tag}{key}={printable(text)!r} must be {count} finite numbers.")
    return found


def _number(element: Element | None, key: str, default: float | None, where: str) -> float:
    fallback = None if default is None else (default,)
    return _numbers(element, key, 1, fallback, where)[0]


def _positive(element: Element | None, key: str, where: str) -> float | None:
    value = _number(element, key, 0.0, where)
    return value if value > 0.0 else None


def _read_hints(root: Element) -> UrdfHints:
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
    for gazebo in root.findall("gazebo"):
        link = gazebo.get("reference", "")
        if _is_diagonal(_words(gazebo, "fdir1")):
            diagonal.add(link)
        friction = [_words(gazebo, name) for name in ("mu1", "mu2")]
        if all(friction) and all(_parse_float(words[0]) == 0.0 for words in friction):
            slippery.add(link)
    return UrdfHints(frozenset(commanded), tuple(plugins), frozenset(diagonal), frozenset(slippery))


def _controlled_joints(root: Element) -> Iterator[str]:
    for transmission in root.findall("transmission"):
        yield from (joint.get("name", "") for joint in transmission.findall("joint"))
    for control in root.findall("ros2_control"):
        for joint in control.findall("joint"):
            if joint.find("command_interface") is not None:
                yield joint.get("name", "")


def _words(element: Element, name: str) -> list[str]:
    """The words of a child that has them as its text or as its attribute `value`."""
    child = element.find(name)
    return [] if child is None else (child.get("value") or child.text or "").split()


def _is_diagonal(words: list[str]) -> bool:
    numbers = [abs(_parse_float(word)) for word in words]
    return len(numbers) == 3 and min(numbers[:2]) > _LEAST_DIAGONAL


def _parse_float(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")
