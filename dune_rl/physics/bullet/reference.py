"""PyBullet's own ray tests and pictures of a scene: what our sensors are compared with."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import StaticBody
from dune_rl.physics.quiet import silent_stderr

with silent_stderr():
    import pybullet

Array = NDArray[np.float64]


class BulletReference:
    """Still bodies in a client of their own, to cast rays at and to look at.

    A grid of `heights` (256, 256, say) [m] at `spacing_m` may be given instead
    of bodies: PyBullet has a shape of its own for that.
    """

    def __init__(
        self,
        statics: Sequence[StaticBody] = (),
        heights: Array | None = None,
        spacing_m: float = 1.0,
    ) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        for body in statics:
            mesh = {"vertices": body.vertices.tolist(), "indices": body.faces.ravel().tolist()}
            seen = pybullet.createVisualShape(pybullet.GEOM_MESH, **mesh, physicsClientId=self._client)
            solid = pybullet.createCollisionShape(
                pybullet.GEOM_MESH,
                **mesh,
                flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=self._client,
            )
            pybullet.createMultiBody(0.0, solid, seen, physicsClientId=self._client)
        if heights is not None:
            rows, columns = heights.shape
            field = pybullet.createCollisionShape(
                pybullet.GEOM_HEIGHTFIELD,
                meshScale=[spacing_m, spacing_m, 1.0],
                heightfieldData=heights.ravel().tolist(),
                numHeightfieldRows=columns,
                numHeightfieldColumns=rows,
                physicsClientId=self._client,
            )
            # PyBullet puts the middle of the heights' range at the body's origin.
            middle = (float(heights.min()) + float(heights.max())) / 2
            pybullet.createMultiBody(
                0.0, field, basePosition=[0.0, 0.0, middle], physicsClientId=self._client
            )

    def cast(self, origins: list[list[float]], ends: list[list[float]]) -> None:
        """Rays from `origins` to `ends`, at most 16,383, as its LiDARs are made of."""
        pybullet.rayTestBatch(origins, ends, physicsClientId=self._client)

    def look(self, eye: Array, ahead: Array, width: int, height: int, fov_rad: float) -> None:
        """A picture by its software renderer, without shadows."""
        target = np.asarray(eye) + np.asarray(ahead)
        view = pybullet.computeViewMatrix(list(eye), target.tolist(), [0.0, 0.0, 1.0])
        lens = pybullet.computeProjectionMatrixFOV(np.rad2deg(fov_rad), width / height, 0.05, 100.0)
        pybullet.getCameraImage(
            width,
            height,
            view,
            lens,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )

    def close(self) -> None:
        """Free its memory."""
        pybullet.disconnect(physicsClientId=self._client)
