"""Meshes of moving agents: one ray scene in the mesh's own frame serves all agents of a shape."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.baked_scenery import to_srgb_bytes
from dune_rl.rendering.light import Light
from dune_rl.rendering.posed_mesh import RayMesh
from dune_rl.rendering.scenery import ColouredMesh, Segment

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


class MeshHits(NamedTuple):
    """What H rays hit: their numbers (H,) among N * P, faces (H,), and unit normals (H, 3), world frame."""

    ray: NDArray[np.int64]
    face: NDArray[np.int32]
    normal: Floats


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

    @property
    def sphere(self) -> tuple[float, float]:
        """Height of the centre of the enclosing sphere, and its radius [m]."""
        return float(self.centre[2]), self.radius_m

    def first_hits(
        self,
        origins: Array,
        directions: Floats,
        order: NDArray[np.int64],
        poses: Array,
        farthest: float,
        view: tuple[Array, float],
        ranges: Floats,
    ) -> MeshHits:
        """What the rays of N views hit of meshes at `poses` (N, K, 4: x, y, z, yaw), nearer than `ranges`.

        `origins` (N, 3) and unit `directions` (N, P, 3) are in the world frame; `ranges` (N, P), at most
        `farthest`, are shortened in place. `view` and `order` are as for `TriangleScene.hit_posed`.
        """
        hit = self.rays.hit_posed(origins, directions, order, poses, self.sphere, farthest, view, ranges)
        normal = hit.normal / np.maximum(np.linalg.norm(hit.normal, axis=1, keepdims=True), 1e-12)
        yaw = poses.reshape(-1, 4)[hit.copy, 3]
        cos, sin = np.cos(yaw), np.sin(yaw)
        world = np.empty((len(yaw), 3), np.float32)
        world[:, 0] = cos * normal[:, 0] - sin * normal[:, 1]
        world[:, 1] = sin * normal[:, 0] + cos * normal[:, 1]
        world[:, 2] = normal[:, 2]
        return MeshHits(hit.ray, hit.face, world)

    def colours(self, light: Light, face: NDArray[np.int32], normal: Floats) -> NDArray[np.uint8]:
        """SRGB bytes (R, 3) of faces `face` (R,) with unit world `normal` (R, 3), unshadowed."""
        full = np.ones(len(face), np.float32)
        return to_srgb_bytes(light.shade(self.shape.albedo[face], normal, full, full))
