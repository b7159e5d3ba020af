"""Motors on joints: what they are told, and what they can give at the speed they turn at."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Motor:
    """What turns a joint: a servo that holds a speed as far as its torque lets it.

    In mode `velocity` a command is the speed [rad/s]. In mode `position` it is
    the angle [rad] that the servo is led to in equal parts of a control step,
    and the speed held is `position_gain_per_s` times what is missing of the
    angle led to, as in the servos of walking robots. Either way the speed held
    is at most `max_speed_radps`.

    Torque falls in a straight line from `max_torque_nm` at rest to nothing at
    `no_load_speed_radps`, as a DC motor's does, and `gear_friction_nm` comes
    off it; against its motion a motor brakes with all of it, friction
    included. `rotor_inertia_kgm2` is the rotor's as felt at the joint, the
    square of the gears' ratio times its own: no speed changes faster than it
    lets it, which keeps light wheels that lose their grip from racing.
    `rest_rad` is the joint's angle where the robot is put down.
    """

    joint: str
    max_torque_nm: float
    mode: Literal["velocity", "position"] = "velocity"
    position_gain_per_s: float = 20.0
    max_speed_radps: float = math.inf
    no_load_speed_radps: float = math.inf
    gear_friction_nm: float = 0.0
    rotor_inertia_kgm2: float = 0.0
    rest_rad: float = 0.0

    @property
    def is_plain(self) -> bool:
        """Whether it takes its command as a speed and gives the same torque at any."""
        return (
            self.mode == "velocity"
            and self.gear_friction_nm == 0.0
            and self.rotor_inertia_kgm2 == 0.0
            and math.isinf(self.no_load_speed_radps)
            and math.isinf(self.max_speed_radps)
        )

    @property
    def rest_command(self) -> float:
        """The command that keeps the joint where the robot is put down."""
        return self.rest_rad if self.mode == "position" else 0.0

    def target_speed_radps(self, command: float, angle_rad: float) -> float:
        """The speed to hold, for a command and the joint's present angle."""
        wanted = command if self.mode == "velocity" else self.position_gain_per_s * (command - angle_rad)
        return min(max(wanted, -self.max_speed_radps), self.max_speed_radps)

    def torque_limit_nm(self, target_radps: float, speed_radps: float) -> float:
        """The most that it can turn the joint by, either way, on its way from a speed to a target."""
        push = target_radps - speed_radps
        if push * speed_radps >= 0.0 and push != 0.0:
            share = 1.0 - abs(speed_radps) / self.no_load_speed_radps
            return max(0.0, self.max_torque_nm * share - self.gear_friction_nm)
        return self.max_torque_nm + self.gear_friction_nm


def servo(
    motors: Sequence[Motor],
    commands: Sequence[float],
    angles: Sequence[float],
    speeds: Sequence[float],
    step_s: float,
) -> tuple[list[float], list[float]]:
    """Speeds to hold [rad/s] and the most torque for it [N m], by motor, in a physics step of `step_s`.

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


class Servos:
    """The motors of one robot, and what they are told: asked before each physics step of `step_s`."""

    def __init__(self, motors: Sequence[Motor], step_s: float) -> None:
        self._motors, self._step_s = motors, step_s
        self.rest()

    def rest(self) -> None:
        """Keep the joints where the robot is put down."""
        self._held = [motor.rest_command for motor in self._motors]
        self._commands: Sequence[float] = self._held
        self._left = 0

    def command(self, commands: Sequence[float], count: int) -> None:
        """Take speeds at once, and angles in equal parts over the next `count` physics steps."""
        self._commands, self._left = commands, count

    def next(self, angles: Sequence[float], speeds: Sequence[float]) -> tuple[list[float], list[float]]:
        """Speeds to hold [rad/s] and torques to do it with [N m] in the next physics step, a number a motor.

        `angles` [rad] and `speeds` [rad/s] are the joints' present ones.
        """
        if self._left:
            part = 1.0 / self._left
            self._held = [
                command if motor.mode == "velocity" else held + part * (command - held)
                for motor, held, command in zip(self._motors, self._held, self._commands, strict=True)
            ]
            self._left -= 1
        return servo(self._motors, self._held, angles, speeds, self._step_s)


def work_w(motors: Sequence[Motor], speeds: Sequence[float], torques: Sequence[float]) -> float:
    """Power [W] that motors give at joints' speeds [rad/s] and torques [N m], gear friction included.

    One that brakes gives nothing back.
    """
    power = 0.0
    for motor, speed, torque in zip(motors, speeds, torques, strict=True):
        power += max(0.0, torque * speed + motor.gear_friction_nm * abs(speed))
    return power
