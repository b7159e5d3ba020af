"""A URDF's links joined to the bodies that move apart, and these as a URDF that every engine reads alike."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import euler_from_matrix

from dune_rl.errors import RobotError
from dune_rl.robots.urdf.meshes import UrdfMeshes
from dune_rl.robots.urdf.model import Geometry, Inertial, Joint, UrdfModel

Array = NDArray[np.float64]

_SECTIONS = 32


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex shape of a body, at its place in the body's frame: `points` (N, 3) [m] are its corners."""

    geometry: Geometry
    points: Array


@dataclass(frozen=True, eq=False)
class RigidBody:
    """What moves as one: the links that fixed joints hold together, in the frame of the first.

    `joint` is what moves it, None for the base; its `pose` is that in the parent body's frame, and `parent`
    names that body. `pose_b` (4, 4) is this body's in the base's frame with all joints at zero.
    """

    name: str
    joint: Joint | None
    pose_b: Array
    inertial: Inertial
    solids: tuple[Solid, ...]
    visuals: tuple[Geometry, ...]

    def points_b(self) -> Array:
        """Corners (N, 3) of all its shapes in the base's frame [m]."""
        points = np.concatenate([np.zeros((0, 3)), *(solid.points for solid in self.solids)])
        return points @ self.pose_b[:3, :3].T + self.pose_b[:3, 3]


def rigid_bodies(model: UrdfModel, moving: Collection[str], meshes: UrdfMeshes) -> list[RigidBody]:
    """The bodies, the base first and parents before children; joints not in `moving` are held at zero.

    Raises `RobotError` where what moves has no mass or a mesh cannot be read.
    """
    found: list[RigidBody] = []
    waiting: list[tuple[str, Joint | None, Array]] = [(model.root, None, np.eye(4))]
    while waiting:
        first, joint, pose_b = waiting.pop(0)
        inertials: list[Inertial] = []
        solids: list[Solid] = []
        visuals: list[Geometry] = []
        inside: list[tuple[str, Array]] = [(first, np.eye(4))]
        while inside:
            name, pose = inside.pop(0)
            link = model.links[name]
            if link.inertial is not None:
                inertials.append(link.inertial.transform(pose))
            for geometry in link.collisions:
                solids.append(_solid(_placed(geometry, pose), name, meshes, model))
            visuals += [_placed(geometry, pose) for geometry in link.visuals]
            for below in model.joints_below(name):
                there = pose @ below.pose
                if below.name in moving:
                    own = replace(below, pose=there, parent=first)
                    waiting.append((below.child, own, pose_b @ there))
                else:
                    inside.append((below.child, there @ _held(below)))
        if not inertials:
            by = "it is the base" if joint is None else f"joint {joint.name!r} moves it"
            raise RobotError(
                f"{model.path.name}: link {first!r} has no mass, nor has what is fixed to it, and {by}; "
                "give it an <inertial> with <mass> and <inertia>."
            )
        found.append(RigidBody(first, joint, pose_b, _sum(inertials), tuple(solids), tuple(visuals)))
    return found


def write_urdfs(
    bodies: Sequence[RigidBody], model: UrdfModel, meshes: UrdfMeshes, folder: Path
) -> tuple[Path, Path]:
    """Write the bodies into `folder` as two URDFs, for physics and for the eye, with the meshes they need.

    Physics gets convex hulls; engines refuse a file for looks that they cannot read.
    """
    physics, look = (Element("robot", name=model.name) for _ in range(2))
    look.extend(model.materials)
    for number, body in enumerate(bodies):
        link = SubElement(physics, "link", name=body.name)
        _write_inertial(link, body.inertial)
        for index, solid in enumerate(body.solids):
            geometry = _write_shape(link, "collision", solid.geometry)
            if solid.geometry.kind == "mesh":
                # In the body's own frame and size already.
                file = f"hull_{number}_{index}.stl"
                trimesh.Trimesh(solid.points, process=False).convex_hull.export(folder / file)
                SubElement(geometry, "mesh", filename=file)
        link = SubElement(look, "link", name=body.name)
        for index, visual in enumerate(body.visuals):
            geometry = _write_shape(link, "visual", visual)
            if visual.mesh is not None:
                file = f"look_{number}_{index}.ply"
                _look(visual.mesh, meshes).export(folder / file)
                SubElement(geometry, "mesh", filename=file, scale=" ".join(map(repr, visual.size)))
    for root in (physics, look):
        for body in bodies:
            if body.joint is not None:
                _write_joint(root, body.joint)
    paths = folder / "robot.urdf", folder / "look.urdf"
    for path, root in zip(paths, (physics, look), strict=True):
        ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return paths


def _look(name: str, meshes: UrdfMeshes) -> trimesh.Trimesh:
    """A mesh file with the colours of its faces, textures and all, as one that needs no other file."""
    parts = meshes.parts(name)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    colours = np.concatenate([part.colours for part in parts])
    return trimesh.Trimesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        face_colors=np.column_stack([np.round(colours * 255), np.full(len(colours), 255)]).astype(np.uint8),
        process=False,
    )


def _placed(geometry: Geometry, pose: Array) -> Geometry:
    return replace(geometry, pose=pose @ geometry.pose)


def _held(joint: Joint) -> Array:
    """Where a joint that is held leaves its child: at zero, or at the limit nearest to it."""
    if joint.kind not in ("revolute", "prismatic"):
        return np.eye(4)
    at = min(max(0.0, joint.lower), joint.upper)
    if joint.kind == "revolute":
        return np.asarray(trimesh.transformations.rotation_matrix(at, joint.axis))
    return np.asarray(trimesh.transformations.translation_matrix(at * joint.axis))


def _sum(parts: list[Inertial]) -> Inertial:
    if len(parts) == 1:
        return parts[0]
    mass = sum(part.mass for part in parts)
    centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        away = part.centre - centre
        inertia += part.inertia + part.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return Inertial(mass, centre, inertia)


def _solid(geometry: Geometry, link: str, meshes: UrdfMeshes, model: UrdfModel) -> Solid:
    if geometry.kind == "mesh":
        assert geometry.mesh is not None
        try:
            points = np.concatenate([part.vertices for part in meshes.parts(geometry.mesh)])
            points = points * np.array(geometry.size)
            hull = trimesh.Trimesh(points, process=False).convex_hull
            corners = np.asarray(hull.vertices)
        except RobotError as error:
            raise RobotError(f"{model.path.name}: link {link!r}: {error}") from None
        except Exception:
            raise RobotError(
                f"{model.path.name}: link {link!r}: the mesh {geometry.mesh!r} is flat or empty, so that "
                "nothing can collide with it; take a box for its <collision>."
            ) from None
        moved = corners @ geometry.pose[:3, :3].T + geometry.pose[:3, 3]
        return Solid(replace(geometry, pose=np.eye(4)), moved)
    if geometry.kind == "box":
        half = np.array(geometry.size) / 2
        corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T * half
    elif geometry.kind == "cylinder":
        radius, length = geometry.size
        corners = np.asarray(trimesh.creation.cylinder(radius, length, sections=_SECTIONS).vertices)
    else:
        corners = np.asarray(trimesh.creation.icosphere(subdivisions=3, radius=geometry.size[0]).vertices)
    return Solid(geometry, corners @ geometry.pose[:3, :3].T + geometry.pose[:3, 3])


def _write_origin(element: Element, pose: Array) -> None:
    xyz, rpy = (
        " ".join(repr(float(number)) for number in numbers)
        for numbers in (pose[:3, 3], euler_from_matrix(pose, axes="sxyz"))
    )
    SubElement(element, "origin", xyz=xyz, rpy=rpy)


def _write_inertial(link: Element, inertial: Inertial) -> None:
    element = SubElement(link, "inertial")
    pose = np.eye(4)
    pose[:3, 3] = inertial.centre
    _write_origin(element, pose)
    SubElement(element, "mass", value=repr(float(inertial.mass)))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertial.inertia.tolist()
    values = {"ixx": xx, "iyy": yy, "izz": zz, "ixy": xy, "ixz": xz, "iyz": yz}
    SubElement(element, "inertia", {name: repr(value) for name, value in values.items()})


def _write_shape(link: Element, tag: str, geometry: Geometry) -> Element:
    """The shape's element; a mesh is left for the caller to name."""
    element = SubElement(link, tag)
    _write_origin(element, geometry.pose)
    material = geometry.element.find("material")
    if tag == "visual" and material is not None:
        element.append(material)
    holder = SubElement(element, "geometry")
    size = [repr(float(value)) for value in geometry.size]
    if geometry.kind == "box":
        SubElement(holder, "box", size=" ".join(size))
    elif geometry.kind == "cylinder":
        SubElement(holder, "cylinder", radius=size[0], length=size[1])
    elif geometry.kind == "sphere":
        SubElement(holder, "sphere", radius=size[0])
    return holder


def _write_joint(root: Element, joint: Joint) -> None:
    element = SubElement(root, "joint", name=joint.name, type=joint.kind)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    _write_origin(element, joint.pose)
    SubElement(element, "axis", xyz=" ".join(repr(float(x)) for x in joint.axis))
    if joint.kind in ("revolute", "prismatic"):
        SubElement(
            element, "limit", lower=repr(joint.lower), upper=repr(joint.upper), effort="1e6", velocity="1e6"
        )
