"""Motor models: servos with a torque-speed curve, gear friction and rotor inertia."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Motor:
    """Servo on a joint that holds a speed within its torque limit.

    In mode `velocity` a command is the speed [rad/s]. In mode `position` it is an angle [rad]: the set point
    moves to it in equal parts of a control step, and the speed is `position_gain_per_s` times the difference
    between set point and angle, as in the servos of walking robots. The absolute target speed is at most
    `max_speed_radps`.

    The available torque is `max_torque_nm` up to `full_torque_speed_radps`, where the motor's current is
    limited, and falls linearly from there to 0 at `no_load_speed_radps`, as in a DC motor, minus
    `gear_friction_nm`; a motor that brakes has the full torque plus the friction. `rotor_inertia_kgm2` is the
    rotor's inertia reflected to the joint (the gear ratio squared times its own); it limits how fast the
    speed changes, so that light wheels without grip do not spin up at once. `rest_rad` is the joint's angle
    after a reset.
    """

    joint: str
    max_torque_nm: float
    mode: Literal["velocity", "position"] = "velocity"
    position_gain_per_s: float = 20.0
    max_speed_radps: float = math.inf
    no_load_speed_radps: float = math.inf
    full_torque_speed_radps: float = 0.0
    gear_friction_nm: float = 0.0
    rotor_inertia_kgm2: float = 0.0
    rest_rad: float = 0.0

    @property
    def is_ideal(self) -> bool:
        """Whether a target speed and a torque limit hold for a whole control step; see `held_targets`."""
        return (
            self.mode == "velocity"
            and self.gear_friction_nm == 0.0
            and self.rotor_inertia_kgm2 == 0.0
            and math.isinf(self.max_speed_radps)
        )

    @property
    def rest_command(self) -> float:
        """Command that keeps the joint at its start angle."""
        return self.rest_rad if self.mode == "position" else 0.0

    def target_speed_radps(self, command: float, angle_rad: float) -> float:
        """Target speed for a command and the joint's present angle."""
        target = command if self.mode == "velocity" else self.position_gain_per_s * (command - angle_rad)
        return min(max(target, -self.max_speed_radps), self.max_speed_radps)

    def torque_limit_nm(self, target_radps: float, speed_radps: float) -> float:
        """Largest absolute torque on the joint while it changes from a speed to a target speed."""
        change = target_radps - speed_radps
        if change * speed_radps >= 0.0 and change != 0.0:
            full = self.full_torque_speed_radps
            share = 1.0 - max(abs(speed_radps) - full, 0.0) / (self.no_load_speed_radps - full)
            return max(0.0, self.max_torque_nm * share - self.gear_friction_nm)
        return self.max_torque_nm + self.gear_friction_nm


def servo_targets(
    motors: Sequence[Motor],
    commands: Sequence[float],
    angles: Sequence[float],
    speeds: Sequence[float],
    step_s: float,
) -> tuple[list[float], list[float]]:
    """Target speeds [rad/s] and torque limits [N m] of the motors in a physics step of `step_s`.

    `angles` [rad] and `speeds` [rad/s] are the joints' present ones.
    """
    targets: list[float] = []
    limits: list[float] = []
    for motor, command, angle, speed in zip(motors, commands, angles, speeds, strict=True):
        target = motor.target_speed_radps(command, angle)
        limit = motor.torque_limit_nm(target, speed)
        if motor.rotor_inertia_kgm2:
            reach = limit * step_s / motor.rotor_inertia_kgm2
            target = min(max(target, speed - reach), speed + reach)
        targets.append(target)
        limits.append(limit)
    return targets, limits


def held_targets(
    motors: Sequence[Motor], commands: Sequence[float], speeds: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Target speeds [rad/s] and torque limits [N m] of ideal motors for a control step.

    `speeds` [rad/s] are the joints' at its start. A target is at most the no-load speed, which
    a light joint could otherwise exceed within the step.
    """
    targets: list[float] = []
    limits: list[float] = []
    for motor, command, speed in zip(motors, commands, speeds, strict=True):
        target = min(max(command, -motor.no_load_speed_radps), motor.no_load_speed_radps)
        targets.append(target)
        limits.append(motor.torque_limit_nm(target, speed))
    return targets, limits


class Servos:
    """Controllers of the motors of one robot, run before each physics step of `step_s`."""

    def __init__(self, motors: Sequence[Motor], step_s: float) -> None:
        self._motors, self._step_s = motors, step_s
        self.reset()

    def reset(self) -> None:
        """Set the commands that keep the joints at their start angles."""
        self._set_points = [motor.rest_command for motor in self._motors]
        self._commands: Sequence[float] = self._set_points
        self._steps_left = 0

    def set_commands(self, commands: Sequence[float], count: int) -> None:
        """Set speeds at once, and angles in equal parts over the next `count` physics steps."""
        self._commands, self._steps_left = commands, count

    def targets(self, angles: Sequence[float], speeds: Sequence[float]) -> tuple[list[float], list[float]]:
        """Target speeds [rad/s] and torque limits [N m] in the next physics step, one per motor.

        `angles` [rad] and `speeds` [rad/s] are the joints' present ones.
        """
        if self._steps_left:
            share = 1.0 / self._steps_left
            self._set_points = [
                command if motor.mode == "velocity" else set_point + share * (command - set_point)
                for motor, set_point, command in zip(
                    self._motors, self._set_points, self._commands, strict=True
                )
            ]
            self._steps_left -= 1
        return servo_targets(self._motors, self._set_points, angles, speeds, self._step_s)


def motor_power_w(motors: Sequence[Motor], speeds: Sequence[float], torques: Sequence[float]) -> float:
    """Mechanical power [W] of motors at joint speeds [rad/s] and torques [N m], gear friction included.

    A motor that brakes counts as 0: nothing is recovered.
    """
    power = 0.0
    for motor, speed, torque in zip(motors, speeds, torques, strict=True):
        power += max(0.0, torque * speed + motor.gear_friction_nm * abs(speed))
    return power


class WorkMeter:
    """Adds up the work of motors, from rest, over physics steps of `step_s`."""

    def __init__(self, motors: Sequence[Motor], step_s: float) -> None:
        self._motors, self._step_s = motors, step_s
        self._speeds: Sequence[float] = (0.0,) * len(motors)
        self._work_j = 0.0

    def add(self, speeds: Sequence[float], torques: Sequence[float]) -> None:
        """Add the work of a physics step with joint `speeds` [rad/s] at its end and `torques` [N m]."""
        # The joint speed changes linearly over a step under a constant torque.
        means = [(before + after) / 2 for before, after in zip(self._speeds, speeds, strict=True)]
        self._speeds = speeds
        self._work_j += motor_power_w(self._motors, means, torques) * self._step_s

    def take_j(self) -> float:
        """The work [J] since the last call."""
        work, self._work_j = self._work_j, 0.0
        return work
