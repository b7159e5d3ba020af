"""The motors of a robot in PyBullet: commands, and work."""

import math
from collections.abc import Sequence

from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.interface import RobotBody
from dune_rl.physics.motors import Servos, held_targets, motor_power_w
from dune_rl.physics.stderr import suppress_stderr
from dune_rl.physics.varied_body import scale_motors

with suppress_stderr():
    import pybullet


class BulletMotors:
    """Drives the motors' joints of `body` after `commands`, and adds up the motors' work.

    `commands` has one speed [rad/s] or angle [rad] for each motor. If `are_ideal`,
    the motors take them once a control step in `begin_step`; if not, they need
    the joint states in every physics step: `command_step`. `measures_work`
    tells whether `add_work` is due after every physics step.
    """

    def __init__(self, body: LoadedBody, spec: RobotBody, timestep_s: float, *, measures_work: bool) -> None:
        self._body, self._spec, self._timestep_s = body, spec, timestep_s
        self.are_ideal = all(motor.is_ideal for motor in spec.motors)
        self.measures_work = measures_work and bool(spec.motors)
        self._has_curves = any(math.isfinite(motor.no_load_speed_radps) for motor in spec.motors)
        self.set_strength(1.0)
        self.commands: Sequence[float] = spec.rest_commands()
        self._work = 0.0
        self._speeds: Sequence[float] = ()

    def set_strength(self, strength: float) -> None:
        """Scale the motors of the `RobotBody`; see `scale_motors`."""
        self._motors = scale_motors(self._spec.motors, strength)
        self._servos = Servos(self._motors, self._timestep_s)
        self._torques = [motor.max_torque_nm for motor in self._motors]

    def reset(self) -> None:
        """Set the commands that keep the joints at their start angles, and the work to 0."""
        self.commands = self._spec.rest_commands()
        self._servos.reset()
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)

    def begin_step(self, count: int) -> None:
        """Pass the commands to the motors for the next `count` physics steps."""
        if self.are_ideal:
            if self._has_curves:
                body = self._body
                states = pybullet.getJointStates(body.handle, body.drive_joints, physicsClientId=body.client)
                speeds = [state[1] for state in states]
                self._set_targets(*held_targets(self._motors, self.commands, speeds))
            else:
                self._set_targets(self.commands, self._torques)
        else:
            self._servos.set_commands(self.commands, count)

    def command_step(self) -> None:
        """Set target speeds and torque limits of the motors for the next physics step."""
        body = self._body
        states = pybullet.getJointStates(body.handle, body.drive_joints, physicsClientId=body.client)
        angles, speeds, _, _ = zip(*states, strict=True)
        self._set_targets(*self._servos.targets(angles, speeds))

    def _set_targets(self, speeds: Sequence[float], torques: Sequence[float]) -> None:
        body = self._body
        pybullet.setJointMotorControlArray(
            body.handle,
            body.drive_joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=speeds,
            forces=torques,
            physicsClientId=body.client,
        )

    def add_work(self) -> None:
        """Add the motors' work in the last physics step to what `take_work_j` returns."""
        body = self._body
        states = pybullet.getJointStates(body.handle, body.drive_joints, physicsClientId=body.client)
        _, speeds, _, torques = zip(*states, strict=True)
        # The joint speed changes linearly over a step under a constant torque.
        means = [(before + after) / 2 for before, after in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work += motor_power_w(self._motors, means, torques) * self._timestep_s

    def take_work_j(self) -> float:
        """Work [J] of the motors since the last call."""
        work, self._work = self._work, 0.0
        return work

    def joint_states(self) -> tuple[float, ...]:
        """See `PhysicsRobot.drive_state`."""
        body = self._body
        states = pybullet.getJointStates(body.handle, body.drive_joints, physicsClientId=body.client)
        angles, speeds, _, torques = zip(*states, strict=True)
        return (*angles, *speeds, *torques)
