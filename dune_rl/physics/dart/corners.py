"""Additional collision shapes in the corners of robots' boxes, which let them rest on ground in DART."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.robot import DartRobot
from dune_rl.physics.dart.template import ROBOT_FRICTION

_CORNER_M = 0.02


class CornerContacts:
    """Adds small cubes to the corners of boxes that touch one of the bodies `grounds`.

    DART's detector finds one contact point between a box and a triangle of a
    mesh, another one in each step, and keeps none: on large triangles a box
    rocks on points that appear and vanish, and sinks by centimetres a second,
    in the end through the ground. A cube in each corner has contact points
    that persist. As each costs a microsecond a step, boxes get them only when
    they touch ground.
    """

    def __init__(self, robots: Sequence[DartRobot], grounds: Sequence[Any]) -> None:
        self._grounds = list(dict.fromkeys(grounds))
        self._ground_nodes = {node for body in self._grounds for node in body.getShapeNodes()}
        self._boxes = {
            node: body
            for robot in robots
            for body in robot.skeleton.getBodyNodes()
            for node in body.getShapeNodes()
            if node.hasCollisionAspect() and isinstance(node.getShape(), dartpy.dynamics.BoxShape)
        }

    @property
    def has_boxes_left(self) -> bool:
        """Whether there are boxes without corner cubes."""
        return bool(self._boxes)

    def find_touching(self, result: Any) -> list[Any]:
        """The boxes without corner cubes that touch ground in a collision result."""
        if not any(map(result.inCollision, self._grounds)):
            return []
        touching = set()
        for contact in result.getContacts():
            frames = {contact.collisionObject1.getShapeFrame(), contact.collisionObject2.getShapeFrame()}
            if not frames.isdisjoint(self._ground_nodes):
                touching |= frames & self._boxes.keys()
        # In the order of the dict: the order of a set differs between processes.
        return [box for box in self._boxes if box in touching]

    def add_to(self, boxes: Sequence[Any]) -> None:
        """Add cubes to boxes."""
        for box in boxes:
            _add_corner_cubes(self._boxes.pop(box), box)


def _add_corner_cubes(body: Any, box: Any) -> None:
    size = np.array(box.getShape().getSize())
    edge = min(_CORNER_M, float(size.min()) / 2)
    cube = dartpy.dynamics.BoxShape([edge] * 3)
    for signs in product((-1.0, 1.0), repeat=3):
        corner = body.createShapeNode(cube)
        to_corner = dartpy.math.Isometry3(np.eye(3), np.array(signs) * (size - edge) / 2)
        corner.setRelativeTransform(box.getRelativeTransform().multiply(to_corner))
        corner.createCollisionAspect()
        corner.createDynamicsAspect().setFrictionCoeff(ROBOT_FRICTION)
