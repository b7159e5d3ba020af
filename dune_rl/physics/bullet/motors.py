"""The motors of a robot in PyBullet: commands, and work."""

import math
from collections.abc import Sequence

from dune_rl.physics.bullet.loading import LoadedBody
from dune_rl.physics.motors import Servos, held_targets, motor_power_w
from dune_rl.physics.process import suppress_stderr
from dune_rl.physics.robot_body import RobotBody
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
        has_curves = any(math.isfinite(motor.no_load_speed_radps) for motor in spec.motors)
        self._holds_curves = self.are_ideal and has_curves
        self._present_speeds: Sequence[float] | None = None
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
        self.mark_moved()
        self._work, self._speeds = 0.0, (0.0,) * len(self._motors)

    def begin_step(self, count: int) -> None:
        """Pass the commands to the motors for the next `count` physics steps."""
        if self.are_ideal:
            if self._holds_curves:
                self._set_targets(*held_targets(self._motors, self.commands, self.read_speeds()))
            else:
                self._set_targets(self.commands, self._torques)
        else:
            self._servos.set_commands(self.commands, count)

    def mark_moved(self) -> None:
        """Drop the speeds that were read before a physics step."""
        self._present_speeds = None

    def read_speeds(self) -> Sequence[float]:
        """Speeds [rad/s] of the joints of motors with curves that are commanded once a control step.

        They are read once between physics steps. Empty for all other motors, which do not need them.
        """
        if self._present_speeds is None:
            self._present_speeds = [state[1] for state in self._read()] if self._holds_curves else []
        return self._present_speeds

    def _read(self) -> Sequence[tuple[float, float, tuple[float, ...], float]]:
        """Angle, speed, reaction forces and torque of each motor's joint."""
        states: Sequence[tuple[float, float, tuple[float, ...], float]] = pybullet.getJointStates(
            self._body.handle, self._body.drive_joints, self._body.client
        )
        return states

    def command_step(self) -> None:
        """Set target speeds and torque limits of the motors for the next physics step."""
        angles, speeds, _, _ = zip(*self._read(), strict=True)
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
        _, speeds, _, torques = zip(*self._read(), strict=True)
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
        angles, speeds, _, torques = zip(*self._read(), strict=True)
        return (*angles, *speeds, *torques)
