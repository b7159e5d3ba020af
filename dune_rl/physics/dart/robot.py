"""A robot in a DART scene, and the contacts of its boxes' corners."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.loading import (
    ROBOT_FRICTION,
    add_shape,
    has_only_spheres,
    load_template,
    measure_reach_m,
    split_by_role,
)
from dune_rl.physics.dart.motors import Differential, Drives, Gears, has_driven_coupling, is_chained
from dune_rl.physics.dart.tyres import FootContacts, TyreBodies
from dune_rl.physics.engine_robot import EngineRobot
from dune_rl.physics.motors import WorkMeter
from dune_rl.physics.robot_body import BodyVariation, RobotBody, scale_motors

# No robot drives down a slope faster than this.
_FALL_MPS = 0.5


class DartRobot(EngineRobot):
    """A `PhysicsRobot`: a skeleton that `load` creates anew, with its tyres, motors, couplings and feet.

    `terrain_friction` is the ground's coefficient. `has_spherical_feet` is whether all collision shapes of
    ground links are spheres, `has_spherical_hull` whether all others are. For `reach_m` see `GatedRobot`. The
    scene sets `use_own_friction`, which makes the coefficients of the ground links decide their friction.
    """

    skeleton: Any
    tyres: TyreBodies
    use_own_friction: Callable[[], None]

    def __init__(
        self, spec: RobotBody, timestep_s: float, *, measures_work: bool, terrain_friction: float = 1.0
    ) -> None:
        super().__init__(spec)
        self._timestep_s, self._terrain_friction = timestep_s, terrain_friction
        self._measures_work = measures_work and bool(spec.motors)
        # Ideal motors take a command once a control step; others need the joint states in every physics step.
        self._has_ideal_motors = all(motor.is_ideal for motor in spec.motors) and not has_driven_coupling(
            spec
        )
        self._motors = spec.motors
        self._template = load_template(spec)
        feet, hull = split_by_role(self._template, spec)
        self.has_spherical_feet, self.has_spherical_hull = has_only_spheres(feet), has_only_spheres(hull)
        self.reach_m = measure_reach_m(self._template, spec.tyres)
        self._work: WorkMeter | None = None
        # Positions and velocities (6 each) of the base's joint, read once between physics steps.
        self._state: tuple[list[float], list[float]] | None = None
        self.skeleton = None

    def set_body(self, variation: BodyVariation) -> None:
        self._motors = scale_motors(self.spec.motors, variation.motor_strength)
        self._template = load_template(replace(self.spec, motors=self._motors), variation)

    def load(self) -> Any:
        """Create the skeleton at the start pose, at rest and without tyres, and return it."""
        spec, step_s = self.spec, self._timestep_s
        self.skeleton = robot = self._template.clone()
        self._base, self._base_joint = robot.getBodyNode(0), robot.getJoint(0)
        position, (x, y, z, w) = self.start_pose
        turn = dartpy.math.Quaternion(w, x, y, z)
        self._base_joint.setTransform(dartpy.math.Isometry3(turn, list(position)))
        self._state = None
        self.tyres = TyreBodies(robot, spec.tyres)
        chained = [coupling for coupling in spec.couplings if is_chained(robot, coupling)]
        geared = [coupling for coupling in spec.couplings if coupling not in chained]
        self._differentials = [Differential(robot, coupling, step_s) for coupling in chained]
        self._feet = FootContacts(robot, spec, spec.ground_friction * self._terrain_friction, step_s)
        self._gears = Gears(robot, geared, spec.drive_joints, step_s) if geared else None
        self._drives = Drives(robot, self._motors, self._gears, step_s, hold_commands=self._has_ideal_motors)
        self._work = WorkMeter(self._motors, step_s) if self._measures_work else None
        # What takes the constraint impulses of all joints after each physics step.
        self._impulse_users = [differential.after for differential in self._differentials]
        if self._feet.slip is not None:
            self._impulse_users.append(self._feet.slip.after)
        if self._drives.compensates_load:
            self._impulse_users.append(self._drives.note_impulses)
        self.forget_episode()
        return robot

    def release(self) -> None:
        """Drop the skeleton; the objects that act on it go with the next `load`."""
        self.skeleton = None

    def begin_step(self, count: int) -> None:
        """Forget what was touched, and pass the commands to the motors for `count` physics steps."""
        self.touched.clear()
        self._drives.begin_step(self.commands, count)

    def before_physics_steps(self) -> list[Callable[[], None]]:
        """What is to be called, in this order, before each physics step of the next control step."""
        calls: list[Callable[[], None]] = []
        if self._feet.ground is not None:
            calls.append(self._feet.ground.command_servos)
        if not self._drives.hold_commands:
            calls.append(self._drives.command_servos)
        return calls

    def after_physics_steps(self) -> list[Callable[[], None]]:
        """What is to be called, in this order, after each physics step of the next control step."""
        calls: list[Callable[[], None]] = []
        if self._gears is not None:
            calls.append(self._gears.after)
        if self._impulse_users:
            calls.append(self._pass_impulses)
        if self._work is not None:
            calls.append(self._add_work)
        return calls

    def _pass_impulses(self) -> None:
        impulses = self.skeleton.getJointConstraintImpulses().tolist()
        for use in self._impulse_users:
            use(impulses)

    def _add_work(self) -> None:
        if self._work is not None:
            self._work.add(self._drives.speeds(), self._drives.torques())

    def mark_moved(self) -> None:
        """Drop the state that was read before a physics step."""
        self._state = None

    def _read(self) -> tuple[list[float], list[float]]:
        state = self._state
        if state is None:
            # The joint's getters cost a tenth of the body's, which derives its state from the joint.
            joint = self._base_joint
            self._state = state = joint.getPositions().tolist(), joint.getVelocities().tolist()
        return state

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] of the base link's origin, and its speed [m/s] in all three directions."""
        (_, _, _, x, y, _), (_, _, _, vx, vy, vz) = self._read()
        return x, y, math.hypot(vx, vy, vz)

    def is_falling(self) -> bool:
        """Whether the base moves down faster than in any drive down a slope."""
        return self._read()[1][5] < -_FALL_MPS

    def body_state(self) -> tuple[float, ...]:
        (rx, ry, rz, px, py, pz), (ax, ay, az, vx, vy, vz) = self._read()
        angle = math.sqrt(rx * rx + ry * ry + rz * rz)
        scale = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
        return (px, py, pz, scale * rx, scale * ry, scale * rz, math.cos(angle / 2), vx, vy, vz, ax, ay, az)

    @property
    def base_mass_kg(self) -> float:
        """Mass of the base link."""
        return float(self._base.getMass())

    def act_force(self, force_w: Sequence[float]) -> None:
        """Apply a force (3) [N], world frame, on the base's centre of mass in the next physics step."""
        # Set again in each step, because the engine keeps a force in the body's frame, which may turn.
        self._base.setExtForce(force_w, self._base.getLocalCOM(), False, True)

    def clear_force(self) -> None:
        """Remove the force of `act_force`."""
        self._base.clearExternalForces()

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        self.use_own_friction()
        coefficients = [coefficient * self._terrain_friction for coefficient in friction]
        self._feet.set(coefficients, restitution, stiffness, damping)

    def drive_state(self) -> tuple[float, ...]:
        return self._drives.state()

    def work_j(self) -> float:
        return 0.0 if self._work is None else self._work.take_j()

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        robot = self.skeleton
        if robot is None:
            return (0.0,) * len(joints)
        positions = robot.getPositions().tolist()
        # The second arm of a differential is a child of the first.
        for differential in self._differentials:
            positions[differential.between] += positions[differential.body]
        return tuple(positions[robot.getJoint(joint).getIndexInSkeleton(0)] for joint in joints)


_CORNER_M = 0.02


class CornerContacts:
    """Adds small cubes to the corners of boxes that touch one of the bodies `grounds`.

    DART's detector finds one contact point between a box and a triangle of a mesh, another one in each step,
    and keeps none: on large triangles a box rocks on points that appear and vanish, and sinks by centimetres
    a second, in the end through the ground. A cube in each corner has contact points that persist. As each
    costs a microsecond a step, boxes get them only when they touch ground.
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
        to_corner = dartpy.math.Isometry3(np.eye(3), np.array(signs) * (size - edge) / 2)
        corner = add_shape(body, cube, ROBOT_FRICTION)
        corner.setRelativeTransform(box.getRelativeTransform().multiply(to_corner))
