"""Kinematic bodies of a DART scene."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.massless import weld_massless_body
from dune_rl.physics.dart.robot import DartRobot
from dune_rl.physics.dart.statics import LinkMaterial, add_shape, obstacle_materials, tyre_materials
from dune_rl.physics.interface import KINEMATIC_FRICTION, SceneSpec

Array = NDArray[np.float64]

# A capsule hits a robot with so much mass: what it stands for is heavier, but soft.
_MASS_KG = 5.0
# Limit of the vertical force: nothing moves a capsule up or down.
_VERTICAL_N = 1e6
# Capsules that are farther than this from where they were to go were held back.
_TOLERANCE_M = 1e-6


class KinematicCapsules:
    """The kinematic capsules, in one skeleton: they move at commanded speeds and do not turn.

    Each is present once for each `LinkMaterial` that collides with it; for
    tyres, after `add_for_tyres`. While a robot can touch a capsule, servos move
    it, whose force is limited to what it may push with.

    `poses` (K, 4: x, y, z, yaw) are those at the end of the last control step,
    and `any_held_back` whether robots held any of the capsules back in it.
    """

    def __init__(self, spec: SceneSpec, robots: Sequence[DartRobot]) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("kinematics")
        materials = obstacle_materials(robots)
        self._tyre_materials = tyre_materials(robots)
        self.bodies: dict[LinkMaterial, list[Any]] = {
            material: [] for material in (*materials, *self._tyre_materials)
        }
        self._shape_numbers: dict[Any, int] = {}
        self._tyre_shape_numbers: dict[Any, int] = {}
        self._body_numbers = [spec.kinematic_number(index) for index in range(len(spec.kinematics))]
        self._bases, self._shapes = [], []
        self._for_tyres: set[int] = set()
        self._joints = []
        for index, capsule in enumerate(spec.kinematics):
            joint, base = self.skeleton.createTranslationalJointAndBodyNodePair()
            joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
            for axis, limit in enumerate((capsule.max_push_n, capsule.max_push_n, _VERTICAL_N)):
                joint.setForceUpperLimit(axis, limit)
                joint.setForceLowerLimit(axis, -limit)
            self._joints.append(joint)
            shape = dartpy.dynamics.CapsuleShape(capsule.radius_m, capsule.height_m - 2 * capsule.radius_m)
            self._bases.append(base)
            self._shapes.append(shape)
            for count, material in enumerate(materials):
                body = self.skeleton.createWeldJointAndBodyNodePair(base)[1] if count else base
                self._shape_numbers[self._add_capsule(index, body, material)] = self._body_numbers[index]
                body.setMass(_MASS_KG / len(materials))
        self._centre_heights = np.array([body.height_m / 2 for body in spec.kinematics])
        self._near: Sequence[int] = ()
        self._held_back = np.zeros(len(spec.kinematics), bool)

    @property
    def numbers(self) -> dict[Any, int]:
        """Body numbers by shape."""
        return self._shape_numbers | self._tyre_shape_numbers

    def _add_capsule(self, index: int, body: Any, material: LinkMaterial) -> Any:
        body.setGravityMode(False)
        self.bodies[material].append(body)
        return add_shape(body, self._shapes[index], KINEMATIC_FRICTION * material.friction)

    def collide_with_tyres(self, indices: Iterable[int]) -> bool:
        """Whether all of these capsules collide with tyres."""
        return self._for_tyres.issuperset(indices)

    def add_for_tyres(self, indices: Iterable[int]) -> None:
        """Make these capsules collide with tyres, too."""
        new = [index for index in indices if index not in self._for_tyres]
        for index in new:
            for material in self._tyre_materials:
                body = weld_massless_body(self._bases[index])
                number = self._body_numbers[index]
                self._tyre_shape_numbers[self._add_capsule(index, body, material)] = number
        self._for_tyres.update(new)

    def remove_for_tyres(self) -> None:
        """Undo `add_for_tyres`. Python must not refer to the shapes any more."""
        self._tyre_shape_numbers.clear()
        for material in self._tyre_materials:
            for body in self.bodies[material]:
                body.remove()
            self.bodies[material].clear()
        self._for_tyres.clear()

    def place(self, poses: Array) -> None:
        """Put the capsules at `poses` (K, 4), at rest."""
        self.poses: list[list[float]] = poses.tolist()
        self.any_held_back = False
        if self.poses:
            self._held_back[:] = False
            self._stop(self._centres(poses))

    def _centres(self, poses: Array) -> Array:
        centres = poses[:, :3].copy()
        centres[:, 2] += self._centre_heights
        return centres

    def begin_step(self, poses: Array, near: Sequence[int], duration_s: float) -> None:
        """Start the motion of the capsules `near` to `poses` (K, 4); put the others there at once."""
        self._near = near
        if not near:
            self.place(poses)
            return
        skeleton, old = self.skeleton, self._centres(np.array(self.poses))
        self.poses = poses.tolist()
        self._targets = targets = self._centres(poses)
        start = targets.copy()
        start[near] = old[near]
        speeds = (targets - start) / duration_s
        # What was held back begins with the speed that it has left.
        left = skeleton.getVelocities().reshape(-1, 3)
        skeleton.setPositions(start.ravel())
        skeleton.setVelocities(np.where(self._held_back[:, None], left, speeds).ravel())
        self._set_actuators(dartpy.dynamics.ActuatorType.SERVO)
        skeleton.setCommands(speeds.ravel())

    def end_step(self) -> None:
        """Read where the capsules near robots are."""
        if not self._near:
            return
        skeleton, targets = self.skeleton, self._targets
        reached = skeleton.getPositions().reshape(-1, 3)
        self._held_back = held_back = (np.abs(reached - targets)[:, :2] > _TOLERANCE_M).any(axis=1)
        self.any_held_back = bool(held_back.any())
        self._set_actuators(dartpy.dynamics.ActuatorType.VELOCITY)
        if not self.any_held_back:
            self._stop(targets)
            return
        for index in np.flatnonzero(held_back).tolist():
            self.poses[index][:2] = reached[index, :2].tolist()
        left = np.where(held_back[:, None], skeleton.getVelocities().reshape(-1, 3), 0.0)
        self._stop(self._centres(np.array(self.poses)))
        skeleton.setVelocities(left.ravel())

    def _set_actuators(self, kind: Any) -> None:
        for index in self._near:
            self._joints[index].setActuatorType(kind)

    def _stop(self, centres: Array) -> None:
        """Have the capsules stand still at `centres` (K, 3) [m]."""
        skeleton, zeros = self.skeleton, np.zeros(centres.size)
        skeleton.setPositions(centres.ravel())
        skeleton.setVelocities(zeros)
        skeleton.setCommands(zeros)
