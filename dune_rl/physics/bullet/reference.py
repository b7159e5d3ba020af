"""PyBullet's own ray tests and camera images of a scene: the reference that our sensors are timed against."""

from collections.abc import Sequence

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.physics.bullet.client import pybullet
from dune_rl.physics.shapes import StaticBody


class BulletReference:
    """Static bodies in a PyBullet client of their own, for ray tests and camera images.

    A grid of `heights` (rows, columns) [m] at `spacing_m` becomes PyBullet's heightfield shape.
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
            visual = pybullet.createVisualShape(pybullet.GEOM_MESH, **mesh, physicsClientId=self._client)
            collision = pybullet.createCollisionShape(
                pybullet.GEOM_MESH,
                **mesh,
                flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=self._client,
            )
            pybullet.createMultiBody(0.0, collision, visual, physicsClientId=self._client)
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
            # PyBullet puts the middle of the range of heights at the body's origin.
            middle = (float(heights.min()) + float(heights.max())) / 2
            pybullet.createMultiBody(
                0.0, field, basePosition=[0.0, 0.0, middle], physicsClientId=self._client
            )

    def cast(self, origins: list[list[float]], ends: list[list[float]]) -> None:
        """Cast rays from `origins` to `ends`, at most 16,383."""
        pybullet.rayTestBatch(origins, ends, physicsClientId=self._client)

    def look(self, eye: Array, ahead: Array, width: int, height: int, fov_deg: float) -> None:
        """Render an image with PyBullet's software renderer, without shadows."""
        target = np.asarray(eye) + np.asarray(ahead)
        view = pybullet.computeViewMatrix(list(eye), target.tolist(), [0.0, 0.0, 1.0])
        lens = pybullet.computeProjectionMatrixFOV(fov_deg, width / height, 0.05, 100.0)
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
        """Free the client's memory."""
        pybullet.disconnect(physicsClientId=self._client)
