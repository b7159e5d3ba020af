"""Corners that a robot's boxes have in DART, so that they lie still on their faces."""

from itertools import product
from typing import Any

import numpy as np

from dune_rl.physics.dart_library import dartpy

_CORNER_M = 0.02


def add_corners(body: Any, friction: float) -> None:
    """Put small cubes of a `friction` coefficient into the corners of a body's boxes.

    DART's detector finds one point between a box and a triangle, another one
    in each step, and keeps none: a box on one face rocks on points that come
    and go, and sinks into the ground by some millimetres a second, in the end
    through it. A cube in each corner gives it four that stay.
    """
    boxes = [node for node in body.getShapeNodes() if node.hasCollisionAspect() and _is_box(node)]
    for box in boxes:
        size = np.array(box.getShape().getSize())
        edge = min(_CORNER_M, float(size.min()) / 2)
        cube = dartpy.dynamics.BoxShape([edge] * 3)
        for signs in product((-1.0, 1.0), repeat=3):
            corner = body.createShapeNode(cube)
            to_corner = dartpy.math.Isometry3(np.eye(3), np.array(signs) * (size - edge) / 2)
            corner.setRelativeTransform(box.getRelativeTransform().multiply(to_corner))
            corner.createCollisionAspect()
            corner.createDynamicsAspect().setFrictionCoeff(friction)


def _is_box(node: Any) -> bool:
    return isinstance(node.getShape(), dartpy.dynamics.BoxShape)
