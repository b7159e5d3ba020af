"""Leo Rover: four wheels on two rockers with a differential."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.physics.robot_body import Coupling, PassiveJoint
from dune_rl.robots.heading import HeadingConf
from dune_rl.robots.robot import RobotDescription
from dune_rl.robots.settings import BatteryConf, MountsConf, RobotSettings
from dune_rl.robots.wheeled import ROVER_WHEELS, SkidSteerConf, WheeledRobot, rover_body

# From a wheel's joint, at the outside of its hub, inward to the centre of its tyre [m].
_HUB_M = 0.0449


class LeoDriveConf(SkidSteerConf):
    """Geometry and limits of the drive, and its motors.

    The no-load speed is the battery voltage over the motors' torque constant, 11.1 V / 1.176 Nm/A, both the
    maker's figures, as are 0.4 m/s and 60 degrees per second. The rotor's inertia is an estimate: 9 g cm²
    behind gears of 73.2:1. The effective track gives the commanded yaw rates in this simulation.
    """

    wheel_radius_m: float = Field(0.0625, gt=0.0)
    effective_track_m: float = Field(0.45, gt=0.0)
    max_speed_mps: float = Field(0.4, gt=0.0, le=10.0)
    max_yaw_rate_radps: float = Field(1.047, gt=0.0, le=10.0)
    max_acceleration_mps2: float = Field(2.5, gt=0.0)
    max_yaw_acceleration_radps2: float = Field(3.0, gt=0.0)
    max_torque_nm: float = Field(2.0, gt=0.0)
    no_load_speed_radps: float | None = Field(9.4, gt=0.0)
    gear_friction_nm: float = Field(0.3125, ge=0.0)
    rotor_inertia_kgm2: float = Field(0.005, ge=0.0)


class LeoMountsConf(MountsConf):
    """LiDAR on a mast, as in the published simulation; camera and IMU at the maker's poses."""

    scanner_b: tuple[float, float, float] = (0.0, 0.0, 0.6)
    camera_b: tuple[float, float, float] = (0.097, 0.0, -0.043)
    camera_pitch_deg: float = Field(12.03, ge=-90.0, le=90.0)
    imu_b: tuple[float, float, float] = (0.063, -0.031, -0.039)


class LeoRoverConf(RobotSettings):
    """Settings of the rover: heading controller, drive, tyres, rockers, mounts and battery.

    The battery is the maker's, 11.1 V and 5 Ah. The power at rest makes it last the four hours that the
    maker states.
    """

    name: Literal["leo_rover"] = "leo_rover"
    heading: HeadingConf = HeadingConf()
    drive: LeoDriveConf = LeoDriveConf()
    wheel_friction: float = Field(1.0, gt=0.0, le=3.0)
    sideways_friction_share: float = Field(0.5, gt=0.0, le=1.0)
    rocker_friction_nm: float = Field(1.0, ge=0.0)
    rocker_damping_nms_per_rad: float = Field(0.1, ge=0.0)
    mounts: LeoMountsConf = LeoMountsConf()
    battery: BatteryConf = BatteryConf(capacity_wh=55.5, idle_w=13.9, efficiency=0.7)

    @property
    def standing_height_m(self) -> float:
        return LeoRover.description.standing_height_m


class LeoRover(WheeledRobot):
    """N rovers with (speed, heading) actions: a `Robot`.

    Frame: x forward, y left, z up; the origin is that of the maker's base link, `standing_height_m` above
    level ground. A differential turns the right rocker opposite to the left one: the body's pitch is the
    mean of theirs.
    """

    description = RobotDescription(
        # Over the tyres, and over the flanges of the hubs.
        length_m=0.436,
        width_m=0.45,
        height_m=0.25,
        standing_height_m=0.198,
        mass_kg=5.495,
        # With level rockers.
        contact_centres_b=np.array(
            [
                [0.1552, 0.1789, -0.1353],
                [0.1552, -0.1789, -0.1353],
                [-0.15, 0.1789, -0.1353],
                [-0.15, -0.1789, -0.1353],
            ]
        ),
        contact_radius_m=0.0625,
        contact_width_m=0.07,
    )

    def __init__(self, conf: LeoRoverConf, num_robots: int) -> None:
        self.conf = conf
        rockers = ("left_rocker_joint", "right_rocker_joint")
        body = rover_body("leo_rover", LeoRover.description, conf.drive, conf.wheel_friction, _HUB_M)
        super().__init__(
            replace(LeoRover.description, mounts=conf.mounts, battery=conf.battery),
            replace(
                body,
                sideways_friction_share=conf.sideways_friction_share,
                passive=tuple(
                    PassiveJoint(joint, conf.rocker_friction_nm, conf.rocker_damping_nms_per_rad)
                    for joint in rockers
                ),
                couplings=(Coupling(*rockers, ratio=-1.0),),
            ),
            heading=conf.heading,
            drive=conf.drive,
            on_left=["left" in wheel for wheel in ROVER_WHEELS],
            num_robots=num_robots,
        )
