"""Rover Zero, four-wheel drive: the paper's test platform."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.paths import assets_folder
from dune_rl.physics.robot_body import RobotBody, Tyre
from dune_rl.robots.heading import HeadingConf
from dune_rl.robots.robot import RobotDescription
from dune_rl.robots.settings import BatteryConf, MountsConf, RobotSettings
from dune_rl.robots.wheeled import SkidSteerConf, WheeledRobot, wheel_motor


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
        """Height of the origin over level ground."""
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
        wheels = [f"{end}_{side}_wheel" for end in ("front", "rear") for side in ("left", "right")]
        size = RoverZero.description
        super().__init__(
            replace(size, mounts=conf.mounts, battery=conf.battery),
            RobotBody(
                urdf=assets_folder() / "robots" / "rover_zero" / "rover_zero.urdf",
                motors=tuple(wheel_motor(f"{wheel}_joint", conf.drive) for wheel in wheels),
                ground_links=tuple(wheels),
                ground_friction=conf.wheel_friction,
                tyres=tuple(
                    Tyre(wheel, size.contact_radius_m, size.contact_width_m, (x, y, z))
                    for wheel, (x, y, z) in zip(wheels, size.contact_centres_b.tolist(), strict=True)
                ),
            ),
            heading=conf.heading,
            drive=conf.drive,
            on_left=["left" in wheel for wheel in wheels],
            num_robots=num_robots,
        )
