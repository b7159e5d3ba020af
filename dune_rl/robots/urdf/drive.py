"""Drive of a robot from a URDF: limits and torques from its joints, its mass and its geometry."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.geometry.arrays import Array
from dune_rl.robots.ackermann import AckermannConf, AckermannDrive, SteeringGeometry
from dune_rl.robots.urdf.conf import UrdfConf, UrdfDriveConf
from dune_rl.robots.urdf.layout import RobotLayout
from dune_rl.robots.urdf.model import Joint, UrdfModel
from dune_rl.robots.urdf.steering import steering_geometry
from dune_rl.robots.wheeled import SkidSteerConf

# Torque over what equally loaded wheels on level ground take: loads differ, and the ground's friction acts
# along both axes of the world, with up to sqrt(2) times its coefficient.
_MARGIN = 2.0
# A limit so many times as high as what is needed stands for none.
NO_LIMIT_RATIO = 50.0


def _turning_torque(
    mass_kg: float, friction: float, radius_m: float, driven_b: Array, wheels_b: Array
) -> float:
    """Torque [N m] of each driven wheel, at `driven_b` (D, 3) [m], with which a robot turns on the spot.

    All wheels, at `wheels_b` (W, 3) [m], carry the weight m g in equal parts. Turned about their middle, they
    scrub along their axles, which takes the moment M = mu m g mean|x|; wheels driven at the rim with F each
    make D F mean|y|. So F = mu m g mean|x| / (D mean|y|). It is limited to the grip, mu m g / D: a robot that
    is longer than wide turns with spinning wheels.
    """
    lever_x = float(np.abs(wheels_b[:, 0] - wheels_b[:, 0].mean()).mean())
    lever_y = float(np.abs(driven_b[:, 1] - driven_b[:, 1].mean()).mean())
    share = min(1.0, lever_x / lever_y) if lever_y > 0.0 else 1.0
    return _MARGIN * friction * mass_kg * GRAVITY_MPS2 / len(driven_b) * radius_m * share


# Effective over real track of wheels that scrub sideways: rover_zero's, measured.
_SCRUB_RATIO = 1.4
_DEFAULT_SPEED_MPS, _MAX_SPEED_MPS = 1.0, 10.0
_ARC_SPEED_SHARE = 0.25
_STEERING_RATE_RADPS = 2.0


@dataclass(frozen=True, eq=False)
class DerivedDrive:
    """Settings of the wheels' drive and, with steering, those of steering and its geometry.

    `assumptions` say where values come from, for people.
    """

    wheels: SkidSteerConf
    ackermann: AckermannConf | None
    geometry: SteeringGeometry | None
    steering_torque_nm: float
    assumptions: tuple[str, ...]

    def describe(self, drive: SkidSteerConf, steering: AckermannDrive | None) -> list[str]:
        """Lines of a robot's summary."""
        lines = [f"wheel radius: {drive.wheel_radius_m:.4f} m; top speed: {drive.max_speed_mps:.2f} m/s"]
        if steering is None:
            lines.append(f"track for turns: {drive.effective_track_m:.3f} m")
        else:
            geometry = steering.geometry
            lowest, highest = np.rad2deg([geometry.limits.min(), geometry.limits.max()])
            wheelbase = float(np.ptp([*geometry.pivots_b[:, 0], geometry.turning_x_m]))
            lines += [
                f"wheelbase: {wheelbase:.3f} m; steering: {lowest:.0f} to {highest:.0f} degrees",
                f"smallest circle: radius {steering.turning_radius_m:.2f} m about x = "
                f"{geometry.turning_x_m:.3f} m; it cannot turn on the spot",
            ]
        return [*lines, *self.assumptions]


def derive_drive(conf: UrdfConf, layout: RobotLayout, mass_kg: float, model: UrdfModel) -> DerivedDrive:
    """The drive of `layout`; values that `conf` leaves open are derived."""
    own, driven = conf.drive, layout.driven
    radius = own.wheel_radius_m or driven[0].radius_m
    centres = np.array([wheel.centre_b for wheel in driven])
    across = centres[:, 1]
    sides = [side for side in (across[across > 0], across[across <= 0]) if len(side)]
    track = float(np.ptp([side.mean() for side in sides])) or radius
    scrubs = np.ptp(centres[:, 0]) > radius / 2
    speeds = [wheel.joint.velocity for wheel in driven if wheel.joint.velocity is not None]
    # Some URDFs write a limit of thousands for none.
    top = min(_MAX_SPEED_MPS, min(speeds) * radius) if speeds else _DEFAULT_SPEED_MPS
    torque, text = _wheel_torque(conf, layout, mass_kg, radius)
    names = SkidSteerConf.model_fields
    wheels = SkidSteerConf(
        **{name: value for name, value in own.model_dump().items() if name in names}
        | {
            "wheel_radius_m": radius,
            "effective_track_m": own.effective_track_m or track * (_SCRUB_RATIO if scrubs else 1.0),
            "max_speed_mps": own.max_speed_mps or top,
            "max_torque_nm": torque,
        }
    )
    if layout.kind == "skid_steer":
        return DerivedDrive(wheels, None, None, 0.0, (text,))
    joints = [model.joints[name] for name in layout.pivots.joints]
    ackermann = AckermannConf(
        max_speed_mps=wheels.max_speed_mps,
        max_yaw_rate_radps=own.max_yaw_rate_radps,
        max_acceleration_mps2=own.max_acceleration_mps2,
        max_lateral_acceleration_mps2=own.max_lateral_acceleration_mps2,
        max_steering_rate_radps=_steering_rate(own, joints),
        arc_speed_mps=own.arc_speed_mps or _ARC_SPEED_SHARE * wheels.max_speed_mps,
    )
    geometry = steering_geometry(driven, layout.wheels, layout.pivots, own, radius, model)
    _check_steering(geometry, layout, model)
    turning, steering_text = _steering_torque(conf, layout, joints, mass_kg, model)
    return DerivedDrive(wheels, ackermann, geometry, turning, (text, steering_text))


def _check_steering(geometry: SteeringGeometry, layout: RobotLayout, model: UrdfModel) -> None:
    """Raise `RobotError` if the steering joints cannot turn the robot to both sides."""
    left, right = geometry.max_curvatures()
    joints = ", ".join(layout.pivots.joints)
    if np.isinf([left, right]).any():
        raise model.fault(
            f"{joints} steer, but none is before or behind the axle that it would turn "
            "the robot about; robot.drive.kind=skid_steer drives it without steering."
        )
    if min(left, right) <= 0.0:
        raise model.fault(
            f"{joints} cannot steer to both sides; give them a <limit> with lower below 0 and "
            "upper above it, or name others in robot.steering_joints."
        )


def _choose_torque(
    about: str, own: float | None, joints: Sequence[Joint], needed: float, use: str
) -> tuple[float, str]:
    """Torque of each of some joints [N m], and where it comes from."""
    if own is not None:
        return own, f"torque of {about}: {own:.2f} Nm, as set"
    efforts = [joint.effort for joint in joints if joint.effort is not None]
    limits = [effort for effort in efforts if effort < NO_LIMIT_RATIO * needed]
    if limits:
        return min(limits), f"torque of {about}: {min(limits):.2f} Nm, the URDF's effort limit"
    why = "the URDF has no effort limit" if not efforts else f"its effort limit, {min(efforts):g}, is none"
    return needed, f"torque of {about}: {needed:.2f} Nm, assumed ({why}): enough to {use}"


def _wheel_torque(conf: UrdfConf, layout: RobotLayout, mass_kg: float, radius_m: float) -> tuple[float, str]:
    driven = np.array([wheel.centre_b for wheel in layout.driven])
    every = np.array([wheel.centre_b for wheel in layout.wheels])
    friction, own = conf.wheel_friction, conf.drive.max_torque_nm
    # The grip of the driven wheels if they carry the whole weight.
    climb = max(friction, 1.0) * mass_kg * GRAVITY_MPS2 * radius_m / len(driven)
    turn = 0.0
    if layout.kind == "skid_steer":
        turn = _turning_torque(mass_kg, friction * conf.sideways_friction_share, radius_m, driven, every)
    use = "turn on the spot" if turn > climb else "hold the tyres' grip on a slope"
    use += f" with {mass_kg:.1f} kg at friction {friction:g}"
    joints = [wheel.joint for wheel in layout.driven]
    torque, text = _choose_torque("a wheel", own, joints, max(climb, turn), use)
    if own is None and torque < turn / 2:
        text += (
            f"; too little to turn on the spot at friction {friction:g}, which takes {turn / 2:.2f} Nm: "
            "see robot.drive.max_torque_nm"
        )
    return torque, text


def _steering_rate(conf: UrdfDriveConf, joints: Sequence[Joint]) -> float:
    """Rate of steering [rad/s], from the settings or the joints' velocity limits."""
    if conf.max_steering_rate_radps is not None:
        return conf.max_steering_rate_radps
    limits = [joint.velocity for joint in joints if joint.velocity is not None]
    return min([*limits, 2 * _STEERING_RATE_RADPS]) if limits else _STEERING_RATE_RADPS


def _steering_torque(
    conf: UrdfConf, layout: RobotLayout, joints: Sequence[Joint], mass_kg: float, model: UrdfModel
) -> tuple[float, str]:
    # From pivots to the farthest points of contact of their wheels, which carry the weight in equal parts.
    levers = []
    for wheel in layout.wheels:
        name = layout.pivots.steering.get(wheel.joint.name)
        if name is not None:
            pivot = model.pose_b(model.joints[name].child)[:2, 3]
            along, aside = np.abs(wheel.centre_b[:2] - pivot)
            levers.append(float(np.hypot(along, aside + wheel.width_m / 2)))
    needed = _MARGIN * conf.wheel_friction * mass_kg * GRAVITY_MPS2 / len(layout.wheels) * max(levers)
    own = conf.drive.max_steering_torque_nm
    return _choose_torque("steering", own, joints, needed, "turn a standing wheel")
