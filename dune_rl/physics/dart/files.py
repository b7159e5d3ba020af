"""Files that DART loads: a robot's URDF with additional joints, and the meshes of static bodies."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import ParseError, tostring

import numpy as np
from defusedxml.ElementTree import fromstring, parse

from dune_rl.core.errors import PhysicsError
from dune_rl.geometry.arrays import Array
from dune_rl.physics.dart.joints import (
    add_slip_joint,
    add_tyre_joint,
    chain_differential,
    differentials,
)
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.shapes import StaticBody

_FOLD_DEPTH_M = 10.0


def robot_urdf(spec: RobotBody, text: str | None = None) -> str:
    """Text of the robot's URDF with the additional joints of `dart.joints`.

    `text` is a URDF that replaces the robot's own.
    Raises PhysicsError if the file, or a joint or link of `spec`, does not exist.
    """
    try:
        root = parse(spec.urdf).getroot() if text is None else fromstring(text)
    except (OSError, ParseError) as error:
        raise PhysicsError(f"DART cannot load {spec.urdf}: {error}") from error
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
