"""Meshes of moving agents: one ray scene in the mesh's own frame serves all agents of a shape."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.rays import Hits
from dune_rl.rendering.baked_scenery import to_srgb_bytes
from dune_rl.rendering.light import Light
from dune_rl.rendering.posed_mesh import RayMesh
from dune_rl.rendering.scenery import ColouredMesh, Segment

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


class MovingMesh(RayMesh):
    """A closed mesh with four degrees of freedom: position and yaw. It is drawn upright.

    `radius_m` is that of a sphere around `centre` (3,), in the mesh's frame, that encloses it.
    """

    def __init__(self, shape: ColouredMesh, segment: Segment = Segment.ACTOR) -> None:
        super().__init__(shape)
        self.segment = segment
        # On the yaw axis, so that yaw does not move it.
        self.centre = np.array([0.0, 0.0, self.centre[2]])
        self.radius_m = float(np.linalg.norm(shape.vertices - self.centre, axis=1).max())

    def hits(self, origins: Array, directions: Floats, poses: Array, ranges: Floats) -> Hits:
        """First hits of world rays (R, 3) with meshes at `poses` (R, 4: x, y, z, yaw) within `ranges` (R,).

        Each ray has its own pose. Normals are unit vectors in the world frame.
        """
        cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
        offset = origins - poses[:, :3]
        local = np.stack(
            [cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0], offset[:, 2]],
            axis=1,
        )
        x, y = directions[:, 0], directions[:, 1]
        carried = np.stack([cos * x + sin * y, cos * y - sin * x, directions[:, 2]], axis=1)
        face, ranges, normal = self.rays.hits(
            local.astype(np.float32), carried.astype(np.float32), ranges.copy()
        )
        normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        world = np.stack(
            [cos * normal[:, 0] - sin * normal[:, 1], sin * normal[:, 0] + cos * normal[:, 1], normal[:, 2]],
            axis=1,
        )
        return Hits(face, ranges, world.astype(np.float32))

    def colours(self, light: Light, face: NDArray[np.int32], normal: Floats) -> NDArray[np.uint8]:
        """SRGB bytes (R, 3) of faces `face` (R,) with unit world `normal` (R, 3), unshadowed."""
        full = np.ones(len(face), np.float32)
        return to_srgb_bytes(light.shade(self.shape.albedo[face], normal, full, full))
