"""Rigid bodies of a URDF: links merged over fixed joints, written as a URDF that all engines read alike."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement

import numpy as np
import trimesh

from dune_rl.core.errors import RobotError
from dune_rl.geometry.arrays import Array
from dune_rl.robots.urdf.elements import words, write_inertial, write_joint, write_shape
from dune_rl.robots.urdf.meshes import MeshError, UrdfMeshes, primitive_mesh
from dune_rl.robots.urdf.model import Geometry, Inertial, Joint, UrdfModel

_SECTIONS = 32
_ROUND = ("sphere", "cylinder", "mesh")


@dataclass(frozen=True, eq=False)
class ConvexShape:
    """Convex collision shape of a body; `points` (P, 3) [m] are its corners in the body's frame."""

    geometry: Geometry
    points: Array


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Links that are connected by fixed joints, in the frame of the first link.

    `joint` connects it to its parent, None for the base; its `pose` is relative to the parent body's frame,
    and `parent` is that body's name. `pose_b` (4, 4) is this body's pose in the base's frame with all joints
    at zero.
    """

    name: str
    joint: Joint | None
    pose_b: Array
    inertial: Inertial
    shapes: tuple[ConvexShape, ...]
    visuals: tuple[Geometry, ...]

    @property
    def axis_b(self) -> Array:
        """Axis (3,) of its joint in the base's frame."""
        assert self.joint is not None
        axis: Array = self.pose_b[:3, :3] @ self.joint.axis
        return axis

    @property
    def spins(self) -> bool:
        """Whether it turns without end, and has a collision shape that can roll."""
        turns = self.joint is not None and self.joint.kind == "continuous"
        return turns and any(shape.geometry.kind in _ROUND for shape in self.shapes)

    def points_b(self) -> Array:
        """Corners (P, 3) [m] of all its collision shapes, in the base's frame with all joints at zero."""
        points = np.concatenate([np.zeros((0, 3)), *(shape.points for shape in self.shapes)])
        return points @ self.pose_b[:3, :3].T + self.pose_b[:3, 3]


def merge_links(model: UrdfModel, moving: Collection[str], meshes: UrdfMeshes) -> list[RigidBody]:
    """The rigid bodies, the base first and parents before children; joints not in `moving` are fixed at zero.

    Raises `RobotError` if a moving body has no mass or a mesh cannot be read.
    """
    bodies: list[RigidBody] = []
    roots: list[tuple[str, Joint | None, Array]] = [(model.root, None, np.eye(4))]
    while roots:
        first, joint, pose_b = roots.pop(0)
        inertials: list[Inertial] = []
        shapes: list[ConvexShape] = []
        visuals: list[Geometry] = []
        links: list[tuple[str, Array]] = [(first, np.eye(4))]
        while links:
            name, pose = links.pop(0)
            link = model.links[name]
            if link.inertial is not None:
                inertials.append(link.inertial.transform(pose))
            for geometry in link.collisions:
                shapes.append(_convex_shape(_transformed(geometry, pose), name, meshes, model))
            visuals += [_transformed(geometry, pose) for geometry in link.visuals]
            for child in model.child_joints(name):
                child_pose = pose @ child.pose
                if child.name in moving:
                    own = replace(child, pose=child_pose, parent=first)
                    roots.append((child.child, own, pose_b @ child_pose))
                else:
                    links.append((child.child, child_pose @ child.motion(child.rest)))
        if not inertials:
            by = "it is the base" if joint is None else f"joint {joint.name!r} moves it"
            raise model.fault(
                f"link {first!r} has no mass, nor has what is fixed to it, and {by}; "
                "give it an <inertial> with <mass> and <inertia>."
            )
        inertial = _combined_inertial(inertials)
        bodies.append(RigidBody(first, joint, pose_b, inertial, tuple(shapes), tuple(visuals)))
    return bodies


def align_frames(bodies: Sequence[RigidBody], names: Collection[str]) -> list[RigidBody]:
    """The bodies, with the frames of those in `names` turned to the axes of the base's frame."""
    turns = {body.name: np.eye(4) for body in bodies}
    for body in bodies:
        if body.name in names:
            turns[body.name][:3, :3] = body.pose_b[:3, :3]
    aligned = []
    for body in bodies:
        own, joint = turns[body.name], body.joint
        if joint is not None:
            joint = replace(
                joint, pose=turns[joint.parent] @ joint.pose @ own.T, axis=own[:3, :3] @ joint.axis
            )
        shapes = [
            ConvexShape(_transformed(shape.geometry, own), shape.points @ own[:3, :3].T)
            for shape in body.shapes
        ]
        visuals = tuple(_transformed(visual, own) for visual in body.visuals)
        pose_b, inertial = body.pose_b @ own.T, body.inertial.transform(own)
        aligned.append(RigidBody(body.name, joint, pose_b, inertial, tuple(shapes), visuals))
    return aligned


def reverse_axes(bodies: Sequence[RigidBody], joints: Collection[str]) -> list[RigidBody]:
    """The bodies, with the axes of some joints reversed."""
    reversed_axes = []
    for body in bodies:
        joint = body.joint
        if joint is not None and joint.name in joints:
            low, high = joint.limits
            body = replace(body, joint=replace(joint, axis=-joint.axis, limits=(-high, -low)))
        reversed_axes.append(body)
    return reversed_axes


def write_urdfs(
    bodies: Sequence[RigidBody], model: UrdfModel, meshes: UrdfMeshes, folder: Path
) -> tuple[Path, Path]:
    """Write the bodies into `folder` as two URDFs, for physics and for rendering, with their meshes.

    Physics has convex hulls only, and a file without visual shapes: engines refuse formats that they cannot
    read. A visual mesh that cannot be read is left out, with a warning in the meshes' report; a body that has
    no visual shape for it shows its collision shapes.
    """
    physics, look = (Element("robot", name=model.name) for _ in range(2))
    for number, body in enumerate(bodies):
        link = SubElement(physics, "link", name=body.name)
        write_inertial(link, body.inertial)
        for index, shape in enumerate(body.shapes):
            geometry = write_shape(link, "collision", shape.geometry)
            if shape.geometry.kind == "mesh":
                # The points are in the body's frame and scaled.
                file = f"hull_{number}_{index}.stl"
                trimesh.Trimesh(shape.points, process=False).convex_hull.export(folder / file)
                SubElement(geometry, "mesh", filename=file)
        link = SubElement(look, "link", name=body.name)
        for index, visual in enumerate(body.visuals):
            if visual.mesh is None:
                write_shape(link, "visual", visual)
                continue
            try:
                mesh = _coloured_mesh(visual.mesh, meshes)
            except MeshError as error:
                meshes.report.warn(f"link {body.name!r} is drawn without a visual mesh: {error}")
                continue
            file = f"look_{number}_{index}.ply"
            mesh.export(folder / file)
            geometry = write_shape(link, "visual", visual)
            SubElement(geometry, "mesh", filename=file, scale=words(visual.size))
        if body.visuals and not len(link):
            for index, shape in enumerate(body.shapes):
                geometry = write_shape(link, "visual", shape.geometry)
                if shape.geometry.kind == "mesh":
                    SubElement(geometry, "mesh", filename=f"hull_{number}_{index}.stl")
    for root in (physics, look):
        for body in bodies:
            if body.joint is not None:
                write_joint(root, body.joint)
    paths = folder / "robot.urdf", folder / "look.urdf"
    for path, root in zip(paths, (physics, look), strict=True):
        ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return paths


def _coloured_mesh(name: str, meshes: UrdfMeshes) -> trimesh.Trimesh:
    """A mesh file as one mesh with face colours, those of textures included, that needs no other file."""
    vertices, faces, colours = meshes.load(name)
    rgba = np.column_stack([np.round(colours * 255), np.full(len(colours), 255)]).astype(np.uint8)
    return trimesh.Trimesh(vertices, faces, face_colors=rgba, process=False)


def _transformed(geometry: Geometry, pose: Array) -> Geometry:
    return replace(geometry, pose=pose @ geometry.pose)


def _combined_inertial(parts: list[Inertial]) -> Inertial:
    if len(parts) == 1:
        return parts[0]
    mass = sum(part.mass for part in parts)
    centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        offset = part.centre - centre
        inertia += part.inertia + part.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return Inertial(mass, centre, inertia)


def _convex_shape(geometry: Geometry, link: str, meshes: UrdfMeshes, model: UrdfModel) -> ConvexShape:
    turn, place = geometry.pose[:3, :3], geometry.pose[:3, 3]
    if geometry.mesh is None:
        corners = np.asarray(primitive_mesh(geometry.kind, geometry.size, _SECTIONS).vertices)
        return ConvexShape(geometry, corners @ turn.T + place)
    try:
        corners = meshes.hull_corners(geometry.mesh, geometry.size)
    except RobotError as error:
        raise model.fault(f"link {link!r}: {error}") from None
    except Exception:
        raise model.fault(
            f"link {link!r}: the mesh {geometry.mesh!r} is flat or empty, so that "
            "nothing can collide with it; take a box for its <collision>."
        ) from None
    return ConvexShape(replace(geometry, pose=np.eye(4)), corners @ turn.T + place)
