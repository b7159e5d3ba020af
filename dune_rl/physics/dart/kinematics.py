"""Kinematic bodies of a DART scene."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import wrap_angle
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.loading import add_shape, negligible_inertia, weld_massless_body
from dune_rl.physics.dart.robot import DartRobot
from dune_rl.physics.dart.statics import LinkMaterial, obstacle_materials, tyre_materials
from dune_rl.physics.interface import SceneSpec
from dune_rl.physics.shapes import KINEMATIC_FRICTION, KinematicBox

# A kinematic body hits a robot with so much mass: what it stands for is heavier, but soft.
_MASS_KG = 5.0
# Limit of the vertical force: nothing moves a kinematic body up or down.
_VERTICAL_N = 1e6
# Bodies that are farther than this from where they were to go were held back.
_TOLERANCE_M = 1e-6
# DART's Euler joint turns about x, then y, then z of its own frame. These axes of it in the body's frame make
# that yaw, pitch and minus roll.
_EULER_AXES = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
# The columns of poses that are the positions of this joint, and their signs.
_EULER_COLUMNS, _EULER_SIGNS = [3, 5, 4], np.array([1.0, 1.0, -1.0])


class DartKinematics:
    """The kinematic bodies, in one skeleton: they move at commanded speeds, and boxes turn and lean.

    Each is present once for each `LinkMaterial` that collides with it; for
    tyres, after `add_for_tyres`. While a robot can touch a body, servos move
    it, whose force is limited to what it may push with. Nothing holds back how boxes turn.

    `poses` (K, 6: x, y, z, yaw, roll, pitch) are those at the end of the last control step,
    and `any_held_back` whether robots held any of the bodies back in it.
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
        self._joints, turns = [], []
        boxes = [isinstance(shape, KinematicBox) for shape in spec.kinematics]
        heights = np.array([shape.centre_height_m for shape in spec.kinematics])
        # A capsule's body is at its centre; a box's at its origin, about which it leans.
        self._heights = np.where(boxes, 0.0, heights)
        self._shape_heights = (heights - self._heights).tolist()
        for index, shape in enumerate(spec.kinematics):
            joint, base = self.skeleton.createTranslationalJointAndBodyNodePair()
            joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
            for axis, limit in enumerate((shape.max_push_n, shape.max_push_n, _VERTICAL_N)):
                joint.setForceUpperLimit(axis, limit)
                joint.setForceLowerLimit(axis, -limit)
            self._joints.append(joint)
            if isinstance(shape, KinematicBox):
                turning, base = self._add_turning_body(base)
                turns.append(turning)
                self._shapes.append(dartpy.dynamics.BoxShape(shape.size_m))
            else:
                length_m = shape.height_m - 2 * shape.radius_m
                self._shapes.append(dartpy.dynamics.CapsuleShape(shape.radius_m, length_m))
            self._bases.append(base)
            for count, material in enumerate(materials):
                body = self.skeleton.createWeldJointAndBodyNodePair(base)[1] if count else base
                self._shape_numbers[self._add_shape(index, body, material)] = self._body_numbers[index]
                body.setMass(_MASS_KG / len(materials))
        self._boxes = np.flatnonzero(boxes)
        # Where the positions of the joints are among those of the skeleton.
        self._places = _indices_in_skeleton(self._joints)
        self._turns = _indices_in_skeleton(turns)
        self._near: Sequence[int] = ()
        self._held_back = np.zeros(len(spec.kinematics), bool)

    @property
    def numbers(self) -> dict[Any, int]:
        """Body numbers by shape."""
        return self._shape_numbers | self._tyre_shape_numbers

    def _add_turning_body(self, place: Any) -> tuple[Any, Any]:
        """Add a body that turns about the origin of the body `place`; returns its joint and itself."""
        # Only the turning body has mass, and its joint's speeds are prescribed.
        place.setInertia(negligible_inertia())
        place.setGravityMode(False)
        joint, body = self.skeleton.createEulerJointAndBodyNodePair(place)
        axes = dartpy.math.Isometry3(_EULER_AXES, np.zeros(3))
        joint.setTransformFromParentBodyNode(axes)
        joint.setTransformFromChildBodyNode(axes)
        joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
        return joint, body

    def _add_shape(self, index: int, body: Any, material: LinkMaterial) -> Any:
        body.setGravityMode(False)
        self.bodies[material].append(body)
        friction = KINEMATIC_FRICTION * material.friction
        return add_shape(body, self._shapes[index], friction, self._shape_heights[index])

    def collide_with_tyres(self, indices: Iterable[int]) -> bool:
        """Whether all of these bodies collide with tyres."""
        return self._for_tyres.issuperset(indices)

    def add_for_tyres(self, indices: Iterable[int]) -> None:
        """Make these bodies collide with tyres, too."""
        new = [index for index in indices if index not in self._for_tyres]
        for index in new:
            for material in self._tyre_materials:
                body = weld_massless_body(self._bases[index])
                number = self._body_numbers[index]
                self._tyre_shape_numbers[self._add_shape(index, body, material)] = number
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
        """Put the bodies at `poses` (K, 6), at rest."""
        self.poses: list[list[float]] = poses.tolist()
        self.any_held_back = False
        if self.poses:
            self._held_back[:] = False
            self._stop(poses)

    def place_one(self, index: int, pose: Array) -> None:
        """Put a body at a `pose` (6), at rest; the others keep their poses and speeds."""
        left = self.skeleton.getVelocities()[self._places]
        left[index] = 0.0
        self.poses[index] = pose.tolist()
        self._held_back[index] = False
        self._stop(np.array(self.poses))
        self.skeleton.setVelocities(self._of_joints(left, np.zeros((len(self._boxes), 3))))

    def begin_step(self, poses: Array, near: Sequence[int], duration_s: float) -> None:
        """Start the motion of the bodies `near` to `poses` (K, 6); put the others there at once."""
        self._near = near
        if not near:
            self.place(poses)
            return
        skeleton, old = self.skeleton, np.array(self.poses)
        self.poses = poses.tolist()
        self._targets = targets = poses.copy()
        start = targets.copy()
        start[near] = old[near]
        ways = targets - start
        ways[:, 3] = wrap_angle(ways[:, 3])
        places, turns = self._centres(start), self._angles(start)
        speeds = (self._centres(targets) - places) / duration_s
        rates = self._angles(ways) / duration_s
        # What was held back begins with the speed that it has left.
        left = skeleton.getVelocities()[self._places]
        skeleton.setPositions(self._of_joints(places, turns))
        skeleton.setVelocities(self._of_joints(np.where(self._held_back[:, None], left, speeds), rates))
        self._set_actuators(dartpy.dynamics.ActuatorType.SERVO)
        skeleton.setCommands(self._of_joints(speeds, rates))

    def end_step(self) -> None:
        """Read where the bodies near robots are."""
        if not self._near:
            return
        skeleton, targets = self.skeleton, self._targets
        reached = skeleton.getPositions()[self._places]
        apart = np.abs(reached - self._centres(targets))[:, :2]
        self._held_back = held_back = (apart > _TOLERANCE_M).any(axis=1)
        self.any_held_back = bool(held_back.any())
        self._set_actuators(dartpy.dynamics.ActuatorType.VELOCITY)
        if not self.any_held_back:
            self._stop(targets)
            return
        for index in np.flatnonzero(held_back).tolist():
            self.poses[index][:2] = reached[index, :2].tolist()
        left = np.where(held_back[:, None], skeleton.getVelocities()[self._places], 0.0)
        self._stop(np.array(self.poses))
        skeleton.setVelocities(self._of_joints(left, np.zeros((len(self._boxes), 3))))

    def _centres(self, poses: Array) -> Array:
        """Positions (K, 3) of the joints by which bodies at `poses` (K, 6) move."""
        centres = poses[:, :3].copy()
        centres[:, 2] += self._heights
        return centres

    def _angles(self, poses: Array) -> Array:
        """Positions (B, 3) of the joints by which boxes at `poses` (K, 6) turn and lean."""
        return poses[self._boxes][:, _EULER_COLUMNS] * _EULER_SIGNS

    def _of_joints(self, places: Array, turns: Array) -> Array:
        """One vector for the skeleton, of values (K, 3) of the moving and (B, 3) of the turning joints."""
        values = np.empty(places.size + turns.size)
        values[self._places], values[self._turns] = places, turns
        return values

    def _set_actuators(self, kind: Any) -> None:
        for index in self._near:
            self._joints[index].setActuatorType(kind)

    def _stop(self, poses: Array) -> None:
        """Have the bodies stand still at `poses` (K, 6)."""
        positions = self._of_joints(self._centres(poses), self._angles(poses))
        skeleton, zeros = self.skeleton, np.zeros(positions.size)
        skeleton.setPositions(positions)
        skeleton.setVelocities(zeros)
        skeleton.setCommands(zeros)


def _indices_in_skeleton(joints: Sequence[Any]) -> NDArray[np.int64]:
    """Indices (J, 3) of the positions of joints among those of their skeleton."""
    found = [[joint.getIndexInSkeleton(axis) for axis in range(3)] for joint in joints]
    return np.array(found, np.int64).reshape(-1, 3)
