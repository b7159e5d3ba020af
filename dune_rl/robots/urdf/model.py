"""Reader of URDFs: links with masses and shapes, and the tree of joints, as checked data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal, cast
from xml.etree.ElementTree import Element

import numpy as np
from trimesh.transformations import euler_matrix, rotation_matrix, translation_matrix

from dune_rl.core.errors import RobotError, WorldError
from dune_rl.core.untrusted_files import printable, read_bytes, read_xml
from dune_rl.geometry.arrays import Array
from dune_rl.robots.urdf.hints import UrdfHints, read_hints

JointKind = Literal["fixed", "continuous", "revolute", "prismatic"]

_KINDS = ("fixed", "continuous", "revolute", "prismatic")
_XACRO = "xacro"
_MAX_BYTES = 16 * 2**20
_MOST_LINKS = 500


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²], in the axes of a frame."""

    mass: float
    centre: Array
    inertia: Array

    def transform(self, pose: Array) -> "Inertial":
        """The same in the frame in which this one's frame has `pose` (4, 4)."""
        turn = pose[:3, :3]
        return Inertial(self.mass, turn @ self.centre + pose[:3, 3], turn @ self.inertia @ turn.T)


@dataclass(frozen=True, eq=False)
class Geometry:
    """A box, cylinder (along z), sphere or mesh, at `pose` (4, 4) in its link.

    `size` is (3,) lengths, (radius, length), (radius,), or a mesh's (3,) scale. `colour` (sRGB) is its
    material's, None without one.
    """

    kind: str
    size: tuple[float, ...]
    pose: Array
    mesh: str | None
    colour: tuple[float, ...] | None


@dataclass(frozen=True, eq=False)
class Link:
    """A link; `inertial` is None without mass."""

    name: str
    inertial: Inertial | None
    collisions: tuple[Geometry, ...]
    visuals: tuple[Geometry, ...]


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint; `pose` (4, 4) is the child's in the parent's frame with the joint at zero.

    `axis` (3,) is a unit vector in the child's frame. `limits` are the lowest and the highest position [m or
    rad]. `effort` and `velocity` are None if the URDF has no limit; `mimic` is the name of the joint that
    this one follows, and the ratio of their angles.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    pose: Array
    axis: Array
    limits: tuple[float, float]
    effort: float | None
    velocity: float | None
    friction: float
    damping: float
    mimic: tuple[str, float] | None

    @property
    def rest(self) -> float:
        """Position at rest [m or rad]: zero, or the limit nearest to zero."""
        return min(max(0.0, self.limits[0]), self.limits[1]) if self.is_limited else 0.0

    @property
    def is_limited(self) -> bool:
        """Whether `limits` apply."""
        return self.kind in ("revolute", "prismatic")

    def motion(self, position: float) -> Array:
        """Motion (4, 4) of the child at a position [m or rad]."""
        if self.kind == "fixed":
            return np.eye(4)
        slides = self.kind == "prismatic"
        return np.asarray(
            translation_matrix(position * self.axis) if slides else rotation_matrix(position, self.axis)
        )


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """Links and joints of a robot by name; `root` is the base link's, and `hints` what other elements say."""

    path: Path
    name: str
    root: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    hints: UrdfHints = field(default_factory=UrdfHints)

    def joints_above(self, link: str) -> list[Joint]:
        """The joints between the root and `link`, the root's first."""
        found: list[Joint] = []
        while link in self._by_child:
            found.append(self._by_child[link])
            link = found[-1].parent
        return found[::-1]

    @cached_property
    def _by_child(self) -> dict[str, Joint]:
        return {joint.child: joint for joint in self.joints.values()}

    def fault(self, text: str) -> RobotError:
        """An error about the file."""
        return RobotError(f"{self.path.name}: {text}")

    def axis_b(self, joint: Joint) -> Array:
        """Axis (3,) of a joint in the root's frame with all joints at rest."""
        axis: Array = self.pose_b(joint.child)[:3, :3] @ joint.axis
        return axis

    def list_moving_joints(self) -> str:
        """The joints that are not fixed, for messages."""
        moving = [f"{joint.name} ({joint.kind})" for joint in self.joints.values() if joint.kind != "fixed"]
        return ", ".join(moving) or "no joints that move"

    def pose_b(self, link: str) -> Array:
        """Pose (4, 4) of `link` in the root's frame with all joints at rest."""
        return self._poses_b[link]

    @cached_property
    def _poses_b(self) -> dict[str, Array]:
        return self.link_poses(np.eye(4), {joint.name: joint.rest for joint in self.joints.values()})

    def link_poses(self, base: Array, positions: Mapping[str, float]) -> dict[str, Array]:
        """Poses (4, 4) of the links, by name, with the root at `base` and joints at `positions` [m or rad].

        Joints that are not named are at zero.
        """
        poses, parents = {self.root: base}, [self.root]
        while parents:
            parent = parents.pop()
            for joint in self.child_joints(parent):
                poses[joint.child] = poses[parent] @ joint.pose @ joint.motion(positions.get(joint.name, 0.0))
                parents.append(joint.child)
        return poses

    def child_joints(self, link: str) -> Sequence[Joint]:
        """The joints whose parent is `link`, in the file's order."""
        return self._by_parent.get(link, ())

    @cached_property
    def _by_parent(self) -> dict[str, list[Joint]]:
        children: dict[str, list[Joint]] = {}
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)
        return children


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
    links: dict[str, Link] = {}
    for element in root.findall("link"):
        link = _link(element, colours)
        if link.name in links:
            raise _FaultError(f"there are two links {printable(link.name)!r}; rename one.")
        links[link.name] = link
    if not links:
        raise _FaultError("it has no links; a robot has one at least.")
    if len(links) > _MOST_LINKS:
        raise _FaultError(f"it has {len(links)} links, more than {_MOST_LINKS}; leave some out.")
    joints: dict[str, Joint] = {}
    for element in root.findall("joint"):
        joint = _joint(element, links)
        if joint.name in joints:
            raise _FaultError(f"there are two joints {printable(joint.name)!r}; rename one.")
        joints[joint.name] = joint
    base = _base_of(links, list(joints.values()))
    return UrdfModel(path, root.get("name", "robot"), base, links, joints, read_hints(root))


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
        cast(JointKind, kind),
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


def _base_of(links: dict[str, Link], joints: Sequence[Joint]) -> str:
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
