"""Rover Zero, four-wheel drive: the paper's test platform."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.robots.heading import HeadingConf
from dune_rl.robots.robot import RobotDescription
from dune_rl.robots.settings import BatteryConf, MountsConf, RobotSettings
from dune_rl.robots.wheeled import ROVER_WHEELS, SkidSteerConf, WheeledRobot, rover_body


class RoverZeroDriveConf(SkidSteerConf):
    """Geometry and limits of the drive, and its motors.

    The motors' figures are estimates, as the maker publishes none. 6 N m are what a tyre holds that
    carries nearly half the rover's weight, as it may on rough ground; controllers of brushless motors
    limit the current, so this torque is available up to the largest commanded speed, 1 m/s. The no-load
    speed is 2.5 m/s, the top speed that follows from ratio, motor speed and "wheel radius" (0.267 m) of
    the maker's driver; with the real radius the same figures give 1.2 m/s. Gear friction and rotor
    inertia are part of these figures.
    """

    full_torque_speed_radps: float = Field(8.0, ge=0.0)
    no_load_speed_radps: float | None = Field(20.0, gt=0.0)


class RoverZeroConf(RobotSettings):
    """Settings of the rover: heading controller, drive, tyres, mounts and battery.

    The battery's figures are estimates: none are published.
    """

    name: Literal["rover_zero"] = "rover_zero"
    heading: HeadingConf = HeadingConf()
    drive: RoverZeroDriveConf = RoverZeroDriveConf()
    wheel_friction: float = Field(1.0, gt=0.0, le=3.0)
    mounts: MountsConf = MountsConf()
    battery: BatteryConf = BatteryConf(capacity_wh=90.0, idle_w=15.0, efficiency=0.7)

    @property
    def standing_height_m(self) -> float:
        return RoverZero.description.standing_height_m


class RoverZero(WheeledRobot):
    """N rovers with (speed, heading) actions: a `Robot`.

    Frame: x forward, y left, z up; the origin is the chassis centre, `standing_height_m` above level ground.
    """

    description = RobotDescription(
        # Of the hull, and over the tyres.
        length_m=0.62,
        width_m=0.443,
        height_m=0.254,
        standing_height_m=0.125,
        mass_kg=11.0,
        contact_centres_b=np.array(
            [[0.1415, 0.18, 0.0], [0.1415, -0.18, 0.0], [-0.145, 0.18, 0.0], [-0.145, -0.18, 0.0]]
        ),
        contact_radius_m=0.125,
        contact_width_m=0.083,
    )

    def __init__(self, conf: RoverZeroConf, num_robots: int) -> None:
        self.conf = conf
        super().__init__(
            replace(RoverZero.description, mounts=conf.mounts, battery=conf.battery),
            rover_body("rover_zero", RoverZero.description, conf.drive, conf.wheel_friction),
            heading=conf.heading,
            drive=conf.drive,
            on_left=["left" in wheel for wheel in ROVER_WHEELS],
            num_robots=num_robots,
        )
