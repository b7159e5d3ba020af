"""Visual shapes of a robot, from its URDF."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from dune_rl.geometry.arrays import Array
from dune_rl.physics.robot_body import RobotBody
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.moving_mesh import MovingMesh, PosedMesh, RayMesh
from dune_rl.rendering.scenery import ColouredMesh, Segment, join_meshes
from dune_rl.robots.urdf.meshes import UrdfMeshes, primitive_mesh
from dune_rl.robots.urdf.model import Geometry
from dune_rl.robots.urdf.reader import read_urdf

_SECTIONS = 28
_GREY = (0.6, 0.6, 0.6)


class RobotVisual:
    """Visual meshes of a URDF's links, posed by the base's pose and the joint angles.

    Shapes are boxes, cylinders, spheres and meshes (.stl, .obj, .dae, .glb, .ply). A mesh has the colour of
    the URDF's material, or its own if there is none.
    """

    def __init__(self, urdf: Path) -> None:
        self._model, meshes = read_urdf(urdf), UrdfMeshes(urdf)
        self._solids = {
            name: RayMesh(join_meshes([_coloured_mesh(shape, meshes) for shape in link.visuals]))
            for name, link in self._model.links.items()
            if link.visuals
        }

    def posed_meshes(
        self, position_w: Array, rotation: Array, angles: Mapping[str, float] | None = None
    ) -> list[PosedMesh]:
        """Meshes of the links for a base at `position_w` (3,) [m] with `rotation` (3, 3), body to world.

        `angles` [rad] are those of joints, by name; other joints are at zero.
        """
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = rotation, position_w
        poses = self._model.link_poses(base, angles or {})
        return [
            PosedMesh(solid, poses[name][:3, 3], poses[name][:3, :3]) for name, solid in self._solids.items()
        ]


def _coloured_mesh(geometry: Geometry, meshes: UrdfMeshes) -> ColouredMesh:
    colours = np.array([_GREY])
    if geometry.mesh is None:
        mesh = primitive_mesh(geometry.kind, geometry.size, _SECTIONS)
    else:
        vertices, faces, colours = meshes.load(geometry.mesh)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        # trimesh reverses the faces if the scale mirrors them.
        mesh.apply_transform(np.diag([*geometry.size, 1.0]))
    mesh.apply_transform(geometry.pose)
    if geometry.colour is not None:
        colours = np.array([geometry.colour])
    count = len(mesh.faces)
    return ColouredMesh(
        np.asarray(mesh.vertices),
        np.asarray(mesh.faces, np.int32),
        srgb_to_linear(np.broadcast_to(colours, (count, 3)).astype(np.float32)),
        np.full(count, Segment.ROBOT, np.uint8),
    )


@lru_cache(maxsize=8)
def robot_mesh(body: RobotBody) -> MovingMesh:
    """Mesh of a robot with its joints at zero, in the base link's frame; cached by robot description."""
    parts = RobotVisual(body.look or body.urdf).posed_meshes(np.zeros(3), np.eye(3))
    shapes = [
        replace(part.shape, vertices=part.shape.vertices @ part.rotation.T + part.position) for part in parts
    ]
    return MovingMesh(join_meshes(shapes), Segment.ROBOT)
