"""Visual shapes of a robot, from its URDF."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from defusedxml.ElementTree import parse

from dune_rl.geometry.arrays import Array
from dune_rl.physics.robot_body import RobotBody
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.posed_mesh import PosedMesh, RayMesh
from dune_rl.rendering.scenery import ColouredMesh, Segment, join_meshes
from dune_rl.robots.urdf.meshes import UrdfMeshes

_SECTIONS = 28
_GREY = (0.6, 0.6, 0.6)


@dataclass(frozen=True)
class _Joint:
    name: str
    parent: str
    child: str
    origin: Array
    axis: Array


class RobotVisual:
    """Visual meshes of a URDF's links, posed by the base's pose and the joint angles.

    Shapes are boxes, cylinders, spheres and meshes (.stl, .obj, .dae, .glb, .ply). A mesh has the colour of
    the URDF's material, or its own if there is none.
    """

    def __init__(self, urdf: Path) -> None:
        root = parse(urdf).getroot()
        colours = {
            material.get("name", ""): _rgb(material)
            for material in root.findall("material")
            if material.find("color") is not None
        }
        links = {link.get("name", ""): link for link in root.findall("link")}
        self._joints = [_joint(element) for element in root.findall("joint")]
        children = {joint.child for joint in self._joints}
        self._base = next(name for name in links if name not in children)
        self._solids: dict[str, RayMesh] = {}
        meshes = UrdfMeshes(urdf)
        for name, link in links.items():
            shapes = [_visual(element, colours, meshes) for element in link.findall("visual")]
            if shapes:
                self._solids[name] = RayMesh(join_meshes(shapes))

    def posed_meshes(
        self, position_w: Array, rotation: Array, angles: Mapping[str, float] | None = None
    ) -> list[PosedMesh]:
        """Meshes of the links for a base at `position_w` (3,) [m] with `rotation` (3, 3), body to world.

        `angles` [rad] are those of joints, by name; other joints are at zero.
        """
        poses = {self._base: _transform(position_w, rotation)}
        remaining = list(self._joints)
        while remaining:
            joint = next((joint for joint in remaining if joint.parent in poses), None)
            if joint is None:
                break
            remaining.remove(joint)
            turn = trimesh.transformations.rotation_matrix((angles or {}).get(joint.name, 0.0), joint.axis)
            poses[joint.child] = poses[joint.parent] @ joint.origin @ turn
        return [
            PosedMesh(solid, poses[name][:3, 3], poses[name][:3, :3])
            for name, solid in self._solids.items()
            if name in poses
        ]


def _transform(position: Array, rotation: Array) -> Array:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


def _numbers(text: str | None, default: tuple[float, ...]) -> Array:
    return np.array(default if text is None else [float(word) for word in text.split()])


def _origin(element: Element) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = _numbers(origin.get("rpy"), (0.0, 0.0, 0.0))
    turn = trimesh.transformations.euler_matrix(roll, pitch, yaw, axes="sxyz")
    turn[:3, 3] = _numbers(origin.get("xyz"), (0.0, 0.0, 0.0))
    return np.asarray(turn)


def _joint(element: Element) -> _Joint:
    parent, child, axis = (element.find(tag) for tag in ("parent", "child", "axis"))
    assert parent is not None and child is not None
    return _Joint(
        element.get("name", ""),
        parent.get("link", ""),
        child.get("link", ""),
        _origin(element),
        _numbers(None if axis is None else axis.get("xyz"), (1.0, 0.0, 0.0)),
    )


def _rgb(material: Element | None) -> tuple[float, float, float]:
    colour = None if material is None else material.find("color")
    if colour is None:
        return _GREY
    red, green, blue = _numbers(colour.get("rgba"), (*_GREY, 1.0))[:3]
    return float(red), float(green), float(blue)


def _visual(
    element: Element, colours: Mapping[str, tuple[float, float, float]], meshes: UrdfMeshes
) -> ColouredMesh:
    geometry = element.find("geometry")
    assert geometry is not None and len(geometry), "a visual element has a geometry"
    own: Array | None = None
    if geometry[0].tag == "mesh":
        mesh, own = _from_file(geometry[0], meshes)
    else:
        mesh = _primitive(geometry[0])
    mesh.apply_transform(_origin(element))
    material = element.find("material")
    named = None if material is None else colours.get(material.get("name", ""))
    painted = material is not None and (named is not None or material.find("color") is not None)
    count = len(mesh.faces)
    if own is None or painted:
        own = np.tile(np.array(named if named is not None else _rgb(material)), (count, 1))
    return ColouredMesh(
        np.asarray(mesh.vertices),
        np.asarray(mesh.faces, np.int32),
        srgb_to_linear(own.astype(np.float32)),
        np.full(count, Segment.ROBOT, np.uint8),
    )


def _from_file(element: Element, meshes: UrdfMeshes) -> tuple[trimesh.Trimesh, Array]:
    """A mesh file of a URDF, scaled, and the colours (F, 3) of its faces in sRGB."""
    parts = meshes.parts(element.get("filename", ""))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    vertices = np.concatenate([part.vertices for part in parts])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    # trimesh reverses the faces if the scale mirrors them.
    mesh.apply_transform(np.diag([*_numbers(element.get("scale"), (1.0, 1.0, 1.0)), 1.0]))
    return mesh, np.concatenate([part.colours for part in parts]).astype(np.float64)


def _primitive(element: Element) -> trimesh.Trimesh:
    if element.tag == "box":
        return trimesh.creation.box(_numbers(element.get("size"), (1.0, 1.0, 1.0)))
    if element.tag == "cylinder":
        radius, length = float(element.get("radius", 0.5)), float(element.get("length", 1.0))
        return trimesh.creation.cylinder(radius, length, sections=_SECTIONS)
    if element.tag == "sphere":
        return trimesh.creation.icosphere(subdivisions=3, radius=float(element.get("radius", 0.5)))
    raise ValueError(f"a visual <{element.tag}> cannot be drawn; use box, cylinder, sphere or mesh")


@lru_cache(maxsize=8)
def robot_mesh(body: RobotBody) -> MovingMesh:
    """Mesh of a robot with its joints at zero, in the base link's frame; cached by robot description."""
    parts = RobotVisual(body.look or body.urdf).posed_meshes(np.zeros(3), np.eye(3))
    shapes = [
        ColouredMesh(
            part.shape.vertices @ part.rotation.T + part.position,
            part.shape.faces,
            part.shape.albedo,
            part.shape.segments,
            part.shape.texture,
        )
        for part in parts
    ]
    return MovingMesh(join_meshes(shapes), Segment.ROBOT)
