"""Corners that robots' boxes get in DART when they come down on the ground, so that they lie still there."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.robot import NEVER_THE_LESSER, DartRobot

_CORNER_M = 0.02


class Corners:
    """Puts small cubes into the corners of boxes that touch one of the bodies `grounds`.

    DART's detector finds one point between a box and a triangle of a mesh,
    another one in each step, and keeps none: on large triangles a box rocks on
    points that come and go, and sinks by centimetres a second, in the end
    through the ground. A cube in each corner gives it points that stay. As
    each costs a microsecond a step, a box has none before it needs them.
    """

    def __init__(self, robots: Sequence[DartRobot], grounds: Sequence[Any]) -> None:
        self._grounds = list(dict.fromkeys(grounds))
        self._surfaces = {node for body in self._grounds for node in body.getShapeNodes()}
        self._boxes = {
            node: body
            for robot in robots
            for body in robot.skeleton.getBodyNodes()
            for node in body.getShapeNodes()
            if node.hasCollisionAspect() and isinstance(node.getShape(), dartpy.dynamics.BoxShape)
        }

    @property
    def are_wanted(self) -> bool:
        """Whether there are boxes without them."""
        return bool(self._boxes)

    def grow(self, result: Any) -> bool:
        """Do so by the engine's last `result`; whether any did."""
        if not any(map(result.inCollision, self._grounds)):
            return False
        lying = set()
        for contact in result.getContacts():
            frames = {contact.collisionObject1.getShapeFrame(), contact.collisionObject2.getShapeFrame()}
            if not frames.isdisjoint(self._surfaces):
                lying |= frames & self._boxes.keys()
        # In their own order, as sets have none that lasts.
        for box in [box for box in self._boxes if box in lying]:
            _add_corners(self._boxes.pop(box), box)
        return bool(lying)


def _add_corners(body: Any, box: Any) -> None:
    size = np.array(box.getShape().getSize())
    edge = min(_CORNER_M, float(size.min()) / 2)
    cube = dartpy.dynamics.BoxShape([edge] * 3)
    for signs in product((-1.0, 1.0), repeat=3):
        corner = body.createShapeNode(cube)
        to_corner = dartpy.math.Isometry3(np.eye(3), np.array(signs) * (size - edge) / 2)
        corner.setRelativeTransform(box.getRelativeTransform().multiply(to_corner))
        corner.createCollisionAspect()
        corner.createDynamicsAspect().setFrictionCoeff(NEVER_THE_LESSER)
