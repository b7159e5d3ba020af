"""Meshes of robots, for the sensors of other agents."""

from functools import lru_cache

import numpy as np

from dune_rl.physics.robot_body import RobotBody
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.scenery import ColouredMesh, Segment, join_meshes
from dune_rl.robots.visual import RobotVisual


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
