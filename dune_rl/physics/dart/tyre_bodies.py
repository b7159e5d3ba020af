"""Tyres in DART: bodies with the wheels' true width, which are there only while they can touch anything."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.massless import weld_massless_body
from dune_rl.physics.dart.template import ROBOT_FRICTION
from dune_rl.physics.robot_body import Tyre

# The compliance of a wheel's contact has the ending `joints.TYRE`, on its joint.
_ENDING = "/tyre shape"
# With so many, the radius of a rover's tyre varies by 0.4 mm.
_SPHERES = 32


def tyre_name(tyre: Tyre) -> str:
    """Name of a tyre's body, whether it is there or not."""
    return f"{tyre.link}{_ENDING}"


class TyreBodies:
    """The tyres of the skeleton `robot`, which has none at first."""

    def __init__(self, robot: Any, tyres: Sequence[Tyre]) -> None:
        self._robot, self._tyres = robot, tyres
        self._active: frozenset[int] = frozenset()

    def set_active(self, active: frozenset[int]) -> None:
        """Have the tyres with these indices, and no others, as bodies that are welded to the wheels.

        Python must not refer to the shapes of those that are removed.
        """
        for index in sorted(self._active - active):
            self._robot.getBodyNode(tyre_name(self._tyres[index])).remove()
        for index in sorted(active - self._active):
            self._add(self._tyres[index])
        self._active = active

    def _add(self, tyre: Tyre) -> None:
        body = weld_massless_body(self._robot.getBodyNode(tyre.link))
        body.setName(tyre_name(tyre))
        node = body.createShapeNode(_shape(tyre))
        turn, _ = Rotation.align_vectors([tyre.axis], [[0.0, 0.0, 1.0]])
        node.setRelativeTransform(dartpy.math.Isometry3(turn.as_matrix(), tyre.centre))
        node.createCollisionAspect()
        node.createDynamicsAspect().setFrictionCoeff(ROBOT_FRICTION)


def _shape(tyre: Tyre) -> Any:
    """Collision shape of a tyre about z: the convex hull of a ring of spheres.

    A cylinder has a line of possible contacts with a plane; the detector returns another point of it in each
    step, so that the wheel sinks by a centimetre and loses a tenth of its speed.
    """
    edge = min(tyre.width_m / 2, tyre.radius_m)
    angles = np.arange(_SPHERES) * 2 * np.pi / _SPHERES
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    centres = (tyre.radius_m - edge) * circle
    return dartpy.dynamics.MultiSphereConvexHullShape([(edge, centre) for centre in centres])
