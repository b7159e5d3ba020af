"""Motors of a robot in DART, couplings of its joints, and the motors' work."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.motors import Motor, Servos, held_targets
from dune_rl.physics.robot_body import Coupling, RobotBody

# The loads of four rigid wheels on rigid ground are not unique, and neither are the torques of servos on one
# body: a direct solver then puts a rover's weight on two of its wheels, and its yaw rate jumps. Tyres that
# yield by less than a millimetre and servos that yield by 0.5 % of a rover's speed make both unique.

# Stiffness of a tyre on rigid ground.
TYRE_STIFFNESS_NPM = 1e5

# The constraint force mixing of servos, which applies to every scene in the process.
SERVO_SOFTNESS = 0.07
dartpy.constraint.JointConstraint.setConstraintForceMixing(SERVO_SOFTNESS)


# Share of the position error that is corrected in a physics step.
_ERROR_REDUCTION = 0.2


def has_driven_coupling(spec: RobotBody) -> bool:
    """Whether any coupled joint has a motor."""
    coupled = {name for each in spec.couplings for name in (each.leader, each.follower)}
    return not coupled.isdisjoint(spec.drive_joints)


class Gears:
    """Keeps the angles of followers at their ratios to the leaders'.

    After each physics step the skeleton `robot` gets the impulses that were missing to keep the ratios, and
    the corresponding torques act in the steps to come: under a constant load the missing impulses soon
    vanish. Servos accept no external torque: for joints with a motor it has to be added to the torque limits,
    which is equivalent.
    """

    def __init__(
        self, robot: Any, couplings: Sequence[Coupling], drive_joints: Sequence[str], timestep_s: float
    ) -> None:
        self._robot, self._step_s = robot, timestep_s
        joints = {joint.getName(): joint.getIndexInSkeleton(0) for joint in robot.getJoints()[1:]}
        # One row per coupling: the constraint's Jacobian over all joints.
        self._jacobian = np.zeros((len(couplings), robot.getNumDofs()))
        for row, coupling in zip(self._jacobian, couplings, strict=True):
            row[joints[coupling.follower]] = 1.0
            row[joints[coupling.leader]] = -coupling.ratio
        self._drives = [joints[name] for name in drive_joints]
        coupled = np.flatnonzero(self._jacobian.any(axis=0)).tolist()
        self._undriven = [index for index in coupled if index not in self._drives]
        self._torques = np.zeros(len(couplings))
        # Torques [N m] of the gears on the motors' joints in the next physics step.
        self.drive_torques: Array = np.zeros(len(self._drives))

    def after(self) -> None:
        """Correct the error of the ratios that the last physics step has left."""
        robot, jacobian = self._robot, self._jacobian
        speeds = robot.getVelocities()
        error = jacobian @ speeds + _ERROR_REDUCTION / self._step_s * (jacobian @ robot.getPositions())
        response = robot.getInvMassMatrix() @ jacobian.T
        impulses = np.linalg.solve(jacobian @ response, -error)
        robot.setVelocities(speeds + response @ impulses)
        self._torques += impulses / self._step_s
        torques = self._torques @ jacobian
        self.drive_torques = torques[self._drives]
        robot.setForces(self._undriven, torques[self._undriven])


_TORQUE_NM = 1e4
# A larger error of the body's angle is corrected by setting the position.
_MAX_ERROR_RAD = 2.5e-4


class Differential:
    """Keeps the body of a skeleton at the mean angle of two arms; the second is a child of the first.

    See `loading.chain_differential`. DART couples joints in one direction: the follower reacts to the leader
    at once, and acts back on it a step later. That is stable only if the follower is light. Compared with
    arms that stand on the ground the body is: so the joint between the arms turns freely, and a servo turns
    the body by half of its angle. After an impact on an arm, which the servo cannot anticipate, the body lags
    by some milliradians; it is then rotated by that much after the step.
    """

    def __init__(self, robot: Any, coupling: Coupling, timestep_s: float) -> None:
        self._robot, self._step_s = robot, timestep_s
        joint = robot.getJoint(coupling.leader)
        self._base_joint = robot.getJoint(0)
        self.body = joint.getIndexInSkeleton(0)
        self.between = robot.getJoint(coupling.follower).getIndexInSkeleton(0)
        self._both = [self.body, self.between]
        self._hinge = joint.getTransformFromParentBodyNode()
        self._axis = joint.getAxis()

    def after(self, impulses: Sequence[float]) -> None:
        """Command the body's servo to follow the arms in the next physics step.

        `impulses` [N m s] are the constraint impulses of all joints in the last one.
        """
        robot, both, step = self._robot, self._both, self._step_s
        body, between = robot.getPositions(both).tolist()
        error = body + between / 2
        if abs(error) > _MAX_ERROR_RAD:
            self._rotate_body(error)
            robot.setPosition(self.body, -between / 2)
            error = 0.0
        speed = -error / step - robot.getVelocity(self.between) / 2
        robot.setCommands(both, [speed, impulses[self.body] / step / 2])

    def _rotate_body(self, angle: float) -> None:
        """Rotate the body, without its arms, about their axis."""
        turn = dartpy.math.Isometry3(dartpy.math.AngleAxis(angle, self._axis).to_rotation_matrix(), [0.0] * 3)
        pose = self._base_joint.getRelativeTransform()
        pose = pose.multiply(self._hinge).multiply(turn).multiply(self._hinge.inverse())
        self._base_joint.setTransform(pose)


def is_chained(robot: Any, coupling: Coupling) -> bool:
    """Whether the follower is a child of the leader's link in the skeleton `robot`."""
    parent = robot.getJoint(coupling.follower).getParentBodyNode()
    return bool(parent.getParentJoint().getName() == coupling.leader)


def configure_differential(robot: Any, coupling: Coupling) -> None:
    """Give the joint between the arms the friction, damping and limits of both arms, and the body a servo."""
    body, between = robot.getJoint(coupling.leader), robot.getJoint(coupling.follower)
    # The angle between the arms is twice that of either: a torque there does twice the work, damping
    # four times.
    between.setCoulombFriction(0, (body.getCoulombFriction(0) + between.getCoulombFriction(0)) / 2)
    damping = body.getDampingCoefficient(0) + between.getDampingCoefficient(0)
    between.setDampingCoefficient(0, damping / 4)
    low = max(between.getPositionLowerLimit(0), -body.getPositionUpperLimit(0))
    high = min(between.getPositionUpperLimit(0), -body.getPositionLowerLimit(0))
    between.setPositionLowerLimit(0, 2 * low)
    between.setPositionUpperLimit(0, 2 * high)
    body.setCoulombFriction(0, 0.0)
    body.setDampingCoefficient(0, 0.0)
    body.setLimitEnforcement(False)
    body.setActuatorType(dartpy.dynamics.ActuatorType.SERVO)
    body.setForceLowerLimit(0, -_TORQUE_NM)
    body.setForceUpperLimit(0, _TORQUE_NM)


class Drives:
    """The M motors of the skeleton `robot`, as servos of the engine.

    `gears` couple their joints, None if there are none. `hold_commands` says whether the engine keeps a
    command for a whole control step. If not, `command_servos` is to be called before each physics step,
    and, if `compensates_load`, `note_impulses` after each.
    """

    def __init__(
        self,
        robot: Any,
        motors: Sequence[Motor],
        gears: Gears | None,
        timestep_s: float,
        *,
        hold_commands: bool,
    ) -> None:
        self._robot, self._motors, self._gears, self._timestep_s = robot, motors, gears, timestep_s
        # Indices of the motors' joints in the skeleton.
        self.indices = [robot.getJoint(motor.joint).getIndexInSkeleton(0) for motor in motors]
        self.hold_commands = hold_commands
        self._have_curves = any(math.isfinite(motor.no_load_speed_radps) for motor in motors)
        self._servos = Servos(motors, timestep_s)
        # Commands compensate for the softness of servos, which matters if rotors outweigh wheels.
        self.compensates_load = not hold_commands and all(
            motor.mode == "velocity" and motor.rotor_inertia_kgm2 > 0.0 for motor in motors
        )
        # Speed [rad/s] at which each motor's servo yields under an impulse of 1 N m s.
        self._servo_compliances: list[float] = []
        if self.compensates_load:
            inverse_inertias = robot.getInvMassMatrix().diagonal()[self.indices]
            self._servo_compliances = (SERVO_SOFTNESS * inverse_inertias).tolist()
        self._impulses: Sequence[float] = [0.0] * robot.getNumDofs()
        self._gear_torques: Sequence[float] = (0.0,) * len(motors)

    def begin_step(self, commands: Sequence[float], count: int) -> None:
        """Take the commands (M) [rad/s, rad] for the next `count` physics steps."""
        if not self.hold_commands:
            self._servos.set_commands(commands, count)
            return
        robot, indices = self._robot, self.indices
        if self._have_curves:
            commands, torques = held_targets(self._motors, commands, self.speeds())
            robot.setForceUpperLimits(indices, torques)
            robot.setForceLowerLimits(indices, [-torque for torque in torques])
        robot.setCommands(indices, commands)

    def command_servos(self) -> None:
        """Set target speeds and torque limits of the servos for the next physics step."""
        robot, indices = self._robot, self.indices
        targets, torques = self._servos.targets(robot.getPositions(indices).tolist(), self.speeds())
        if self._servo_compliances:
            # Compensates for the mean load, as on a slope. Compensation for each motor's own load would make
            # the motors work against each other.
            impulses = self._impulses
            mean = sum([impulses[index] for index in indices]) / len(indices)
            targets = [
                target + compliance * mean
                for target, compliance in zip(targets, self._servo_compliances, strict=True)
            ]
        robot.setCommands(indices, targets)
        if self._gears is not None:
            self._gear_torques = self._gears.drive_torques.tolist()
        gears = self._gear_torques
        robot.setForceUpperLimits(indices, [gear + own for gear, own in zip(gears, torques, strict=True)])
        robot.setForceLowerLimits(indices, [gear - own for gear, own in zip(gears, torques, strict=True)])

    def note_impulses(self, impulses: Sequence[float]) -> None:
        """Take the constraint impulses [N s, N m s] of all joints in the last physics step."""
        self._impulses = impulses

    def torques(self) -> list[float]:
        """Torques (M) [N m] of the motors in the last physics step, without those of gears."""
        impulses: list[float] = self._robot.getJointConstraintImpulses()[self.indices].tolist()
        # Python floats, which overflow without a warning if the state diverges.
        step_s = self._timestep_s
        return [
            impulse / step_s - gear_torque
            for impulse, gear_torque in zip(impulses, self._gear_torques, strict=True)
        ]

    def speeds(self) -> list[float]:
        """Speeds (M) [rad/s] of the motors' joints."""
        speeds: list[float] = self._robot.getVelocities(self.indices).tolist()
        return speeds

    def state(self) -> tuple[float, ...]:
        """Angles, speeds and torques (3 * M), as in `PhysicsRobot.drive_state`."""
        return (*self._robot.getPositions(self.indices).tolist(), *self.speeds(), *self.torques())
