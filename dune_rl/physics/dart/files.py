"""What DART reads, which are files: a robot's URDF with what it lacks, and meshes of static bodies."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import ParseError, tostring

import numpy as np
from defusedxml.ElementTree import fromstring, parse
from numpy.typing import NDArray

from dune_rl.errors import PhysicsError
from dune_rl.physics.dart.joints import chain, differentials, hang, let_slip
from dune_rl.physics.interface import RobotBody, StaticBody

Array = NDArray[np.float64]

_FOLD_DEPTH_M = 10.0


def robot_urdf(spec: RobotBody, text: str | None = None) -> str:
    """The robot's URDF with its couplings, and the joints of `dart_joints`.

    `text` is a URDF to take instead of the robot's own.
    Raises `PhysicsError` where there is no such file, or no such joint or link in it.
    """
    try:
        root = parse(spec.urdf).getroot() if text is None else fromstring(text)
    except (OSError, ParseError) as error:
        raise PhysicsError(f"DART cannot load {spec.urdf}: {error}") from error
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    fault = spec.missing_from(joints, [link.get("name", "") for link in root.findall("link")])
    if fault:
        raise PhysicsError(fault)
    for coupling in differentials(spec, joints):
        chain(joints[coupling.leader], joints[coupling.follower])
    for motor in spec.motors:
        joint = joints[motor.joint]
        child = joint.find("child")
        # A leg that is led to angles has give enough, and a slider in its knee would sink under it.
        if motor.mode == "velocity" and child is not None and child.get("link") in spec.ground_links:
            hang(joint, root)
            if spec.sideways_friction_share != 1.0:
                let_slip(joint, root)
    return tostring(root, encoding="unicode")


def write_meshes(statics: Sequence[StaticBody], hollow: Sequence[bool], folder: Path) -> str:
    """A URDF of one link that has each body's mesh, as files in `folder`, for a collision shape.

    Those that are `hollow` get a fold far below: flat ground would otherwise be
    taken for a convex solid, whose vertices are all searched at every contact.
    """
    elements = []
    for number, body in enumerate(statics):
        path = folder.resolve() / f"{number}.stl"
        corners = body.vertices[body.faces]
        path.write_bytes(_stl(np.concatenate([corners, _fold(body)]) if hollow[number] else corners))
        elements.append(f'<collision><geometry><mesh filename="file://{path}"/></geometry></collision>')
    return f'<robot name="statics"><link name="statics">{"".join(elements)}</link></robot>'


def is_open(body: StaticBody) -> bool:
    """Whether it is a surface with a border, and not a closed solid."""
    edges = np.sort(body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 1).any())


def _fold(body: StaticBody) -> Array:
    x, y = body.vertices[:, :2].mean(axis=0)
    below = [x, y, body.vertices[:, 2].min() - _FOLD_DEPTH_M]
    return np.array([[[0, 0, 0], [1, 0, 1], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [-1, 0, 1]]]) + below


def _stl(corners: Array) -> bytes:
    """Triangles (F, 3, 3) as a binary STL file."""
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = corners
    return bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes()
