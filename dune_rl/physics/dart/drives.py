"""Motors of a robot in DART: commands to the engine's servos, and the torques that these give."""

import math
from collections.abc import Sequence
from typing import Any

from dune_rl.physics.dart.gears import Gears
from dune_rl.physics.dart.softness import SERVO_SOFTNESS
from dune_rl.physics.motors import Motor, Servos, held_targets


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
        self._robot, self.motors, self._gears, self._timestep_s = robot, motors, gears, timestep_s
        # Indices of the motors' joints in the skeleton.
        self.indices = [robot.getJoint(motor.joint).getIndexInSkeleton(0) for motor in motors]
        self.hold_commands = hold_commands
        self._have_curves = any(math.isfinite(motor.no_load_speed_radps) for motor in motors)
        self._servos = Servos(motors, timestep_s)
        # Commands compensate for the softness of servos, which matters if rotors outweigh wheels.
        self.compensates_load = not hold_commands and all(
            motor.mode == "velocity" and motor.rotor_inertia_kgm2 > 0.0 for motor in motors
        )
        self._servo_compliances = self._compute_servo_compliances() if self.compensates_load else []
        self._impulses: Sequence[float] = [0.0] * robot.getNumDofs()
        self._gear_torques: Sequence[float] = (0.0,) * len(motors)

    def _compute_servo_compliances(self) -> list[float]:
        """Speed [rad/s] at which each motor's servo yields under an impulse of 1 N m s."""
        inverse_inertias = self._robot.getInvMassMatrix().diagonal()[self.indices]
        compliances: list[float] = (SERVO_SOFTNESS * inverse_inertias).tolist()
        return compliances

    def begin_step(self, commands: Sequence[float], count: int) -> None:
        """Take the commands (M) [rad/s, rad] for the next `count` physics steps."""
        if not self.hold_commands:
            self._servos.set_commands(commands, count)
            return
        robot, indices = self._robot, self.indices
        if self._have_curves:
            speeds = robot.getVelocities(indices).tolist()
            commands, torques = held_targets(self.motors, commands, speeds)
            robot.setForceUpperLimits(indices, torques)
            robot.setForceLowerLimits(indices, [-torque for torque in torques])
        robot.setCommands(indices, commands)

    def command_servos(self) -> None:
        """Set target speeds and torque limits of the servos for the next physics step."""
        robot, indices = self._robot, self.indices
        angles, speeds = robot.getPositions(indices).tolist(), robot.getVelocities(indices).tolist()
        targets, torques = self._servos.targets(angles, speeds)
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
        if self._gears is None:
            robot.setForceUpperLimits(indices, torques)
            robot.setForceLowerLimits(indices, [-torque for torque in torques])
            return
        self._gear_torques = gear_torques = self._gears.drive_torques.tolist()
        upper = [gear + torque for gear, torque in zip(gear_torques, torques, strict=True)]
        lower = [gear - torque for gear, torque in zip(gear_torques, torques, strict=True)]
        robot.setForceUpperLimits(indices, upper)
        robot.setForceLowerLimits(indices, lower)

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

    def state(self) -> tuple[float, ...]:
        """Angles, speeds and torques (3 * M), as in `PhysicsRobot.drive_state`."""
        robot, indices = self._robot, self.indices
        return (
            *robot.getPositions(indices).tolist(),
            *robot.getVelocities(indices).tolist(),
            *self.torques(),
        )
