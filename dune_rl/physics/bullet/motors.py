"""The motors of a robot in PyBullet: commands, and work."""

import math
from collections.abc import Sequence

from dune_rl.physics.bullet.client import pybullet
from dune_rl.physics.bullet.loading import LoadedBody
from dune_rl.physics.motors import Servos, WorkMeter, held_targets
from dune_rl.physics.robot_body import RobotBody, scale_motors


class BulletMotors:
    """Drives the motors' joints of `body`, and adds up the motors' work.

    If `are_ideal`, motors take a command once a control step in `begin_step`; if not, they need the joint
    states in every physics step: `command_step`. `measures_work` tells whether `add_work` is due after every
    physics step.
    """

    def __init__(self, body: LoadedBody, spec: RobotBody, timestep_s: float, *, measures_work: bool) -> None:
        self._body, self._spec, self._timestep_s = body, spec, timestep_s
        self.are_ideal = all(motor.is_ideal for motor in spec.motors)
        self.measures_work = measures_work and bool(spec.motors)
        has_curves = any(math.isfinite(motor.no_load_speed_radps) for motor in spec.motors)
        self._holds_curves = self.are_ideal and has_curves
        self.set_strength(1.0)
        self.reset()

    def set_strength(self, strength: float) -> None:
        """Scale the motors of the `RobotBody`; see `scale_motors`."""
        self._motors = scale_motors(self._spec.motors, strength)
        self._servos = Servos(self._motors, self._timestep_s)
        self._torques = [motor.max_torque_nm for motor in self._motors]

    def reset(self) -> None:
        """Set the commands that keep the joints at their start angles, and the work to 0."""
        self._servos.reset()
        self._present_speeds: Sequence[float] | None = None
        self.work = WorkMeter(self._motors, self._timestep_s)

    def begin_step(self, commands: Sequence[float], count: int) -> None:
        """Pass speeds [rad/s] or angles [rad], one for each motor, for the next `count` physics steps."""
        if not self.are_ideal:
            self._servos.set_commands(commands, count)
        elif self._holds_curves:
            self._set_targets(*held_targets(self._motors, commands, self.read_speeds()))
        else:
            self._set_targets(commands, self._torques)

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
        """Add the motors' work in the last physics step to `work`."""
        _, speeds, _, torques = zip(*self._read(), strict=True)
        self.work.add(speeds, torques)

    def joint_states(self) -> tuple[float, ...]:
        """See `PhysicsRobot.drive_state`."""
        angles, speeds, _, torques = zip(*self._read(), strict=True)
        return (*angles, *speeds, *torques)
