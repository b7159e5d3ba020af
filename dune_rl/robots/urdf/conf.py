"""Settings of a robot from a URDF."""

from typing import Literal

from pydantic import Field

from dune_rl.core.settings import Settings
from dune_rl.robots.heading import HeadingConf
from dune_rl.robots.settings import BatteryConf, RobotSettings, Triple

DriveKind = Literal["skid_steer", "ackermann"]


class UrdfDriveConf(Settings):
    """As `SkidSteerConf` and `AckermannConf`; values that are None are derived from the URDF.

    `kind` "auto" is Ackermann steering where wheels hang on steering joints, and else skid-steer. Derived
    are: the radius, from the wheels' shapes; the track, from their positions, wider for more than one axle,
    whose wheels scrub; the top speed, from the joints' velocity limits, else 1 m/s; the torque, from their
    effort limits, else enough to turn on the spot and to climb; steering angles and rates, from the limits of
    the steering joints.

    The track and the loop on the yaw rate are for skid-steer, the settings of steering for Ackermann
    steering alone.
    """

    kind: Literal["auto", "skid_steer", "ackermann"] = "auto"
    wheel_radius_m: float | None = Field(None, gt=0.0)
    effective_track_m: float | None = Field(None, gt=0.0)
    yaw_rate_kp: float = Field(0.4, ge=0.0, le=1.0)
    yaw_rate_ki_per_s: float = Field(8.0, ge=0.0, le=20.0)
    max_speed_mps: float | None = Field(None, gt=0.0, le=10.0)
    max_yaw_rate_radps: float = Field(1.5, gt=0.0, le=10.0)
    max_acceleration_mps2: float = Field(2.5, gt=0.0)
    max_yaw_acceleration_radps2: float = Field(3.0, gt=0.0)
    max_torque_nm: float | None = Field(None, gt=0.0)
    full_torque_speed_radps: float = Field(0.0, ge=0.0)
    no_load_speed_radps: float | None = Field(None, gt=0.0)
    gear_friction_nm: float = Field(0.0, ge=0.0)
    rotor_inertia_kgm2: float = Field(0.0, ge=0.0)
    max_wheel_speed_radps: float | None = Field(None, gt=0.0)
    max_steering_deg: float | None = Field(None, gt=0.0, le=80.0)
    max_steering_rate_radps: float | None = Field(None, gt=0.0, le=20.0)
    max_steering_torque_nm: float | None = Field(None, gt=0.0)
    max_lateral_acceleration_mps2: float = Field(3.0, gt=0.0)
    arc_speed_mps: float | None = Field(None, gt=0.0, le=10.0)


class UrdfMountsConf(Settings):
    """As `MountsConf`; values that are None are derived: above the centre, at the front, at the centre."""

    scanner_b: Triple | None = None
    camera_b: Triple | None = None
    camera_pitch_deg: float = Field(0.0, ge=-90.0, le=90.0)
    imu_b: Triple | None = None


class UrdfConf(RobotSettings):
    """A URDF at `path`, and settings that it does not contain.

    `left_wheels` and `right_wheels` are names of the joints of wheels with motors; None selects them among
    all continuous joints about the robot's y whose link has a round collision shape and stands on the ground.
    `steering_joints` turn wheels about the vertical; None selects those that look like it, an empty list
    none. `free_joints` have no motor: None selects the rockers and bogies of a suspension. Continuous joints
    of no wheel have none either (casters), with the URDF's friction, damping, limits and `mimic`. All other
    joints are fixed at zero. `hull_friction` applies to all links but the wheels, ball casters included.
    """

    name: Literal["urdf"] = "urdf"
    path: str = Field(min_length=1)
    left_wheels: tuple[str, ...] | None = None
    right_wheels: tuple[str, ...] | None = None
    steering_joints: tuple[str, ...] | None = None
    free_joints: tuple[str, ...] | None = None
    heading: HeadingConf = HeadingConf()
    drive: UrdfDriveConf = UrdfDriveConf()
    wheel_friction: float = Field(1.0, gt=0.0, le=3.0)
    sideways_friction_share: float = Field(1.0, gt=0.0, le=1.0)
    hull_friction: float = Field(0.3, ge=0.0, le=3.0)
    mounts: UrdfMountsConf = UrdfMountsConf()
    battery: BatteryConf = BatteryConf(capacity_wh=100.0, idle_w=10.0, efficiency=0.7)
