"""Differential and skid-steer robots from a URDF."""

import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.errors import RobotError
from dune_rl.physics.interface import Coupling, PassiveJoint, RobotBody
from dune_rl.robots.battery import BatteryConf
from dune_rl.robots.heading import HeadingConf
from dune_rl.robots.mounts import MountsConf, Triple
from dune_rl.robots.settings import RobotSettings
from dune_rl.robots.skid_steer import SkidSteerConf
from dune_rl.robots.urdf.bodies import RigidBody, merge_links, write_urdfs
from dune_rl.robots.urdf.meshes import UrdfMeshes
from dune_rl.robots.urdf.model import Joint, UrdfModel, read_urdf
from dune_rl.robots.wheeled import WheeledRobot, wheel_motor
from dune_rl.settings import Settings

Array = NDArray[np.float64]

# Effective over real track of wheels that scrub sideways: rover_zero's, measured.
_SCRUB_RATIO = 1.4
_ROUND = ("sphere", "cylinder", "mesh")
# Least absolute y component of a wheel's axis.
_MIN_AXIS_Y = 0.97
_GRAVITY_MPS2 = 9.81
_DEFAULT_SPEED_MPS = 1.0
_SCANNER_OVER_TOP_M = 0.05
# Casters may be a little lower than the wheels.
_MAX_DEPTH_M = 0.02


class UrdfDriveConf(Settings):
    """As `SkidSteerConf`; values that are None are derived from the URDF.

    These are: the radius, from the wheels' shapes; the track, from their positions, wider for more than one
    axle, whose wheels scrub; the top speed, from the joints' velocity limits, else 1 m/s; the torque, from
    their effort limits, else enough to climb a wall.
    """

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


class UrdfMountsConf(Settings):
    """As `MountsConf`; values that are None are derived: above the centre, at the front, at the centre."""

    scanner_b: Triple | None = None
    camera_b: Triple | None = None
    camera_pitch_deg: float = Field(0.0, ge=-90.0, le=90.0)
    imu_b: Triple | None = None


class UrdfConf(RobotSettings):
    """A URDF at `path`, and settings that it does not contain.

    `left_wheels` and `right_wheels` are names of joints; None selects all continuous joints about the
    robot's y whose link has a round collision shape. Continuous joints of no wheel, and `free_joints`, have
    no motor: casters and suspensions, with the URDF's friction, damping, limits and `mimic`. All other
    joints are fixed at zero. `hull_friction` applies to all links but the wheels, ball casters included.
    """

    name: Literal["urdf"] = "urdf"
    path: str = Field(min_length=1)
    left_wheels: tuple[str, ...] | None = None
    right_wheels: tuple[str, ...] | None = None
    free_joints: tuple[str, ...] = ()
    heading: HeadingConf = HeadingConf()
    drive: UrdfDriveConf = UrdfDriveConf()
    wheel_friction: float = Field(1.0, gt=0.0, le=3.0)
    sideways_friction_share: float = Field(1.0, gt=0.0, le=1.0)
    hull_friction: float = Field(0.3, ge=0.0, le=3.0)
    mounts: UrdfMountsConf = UrdfMountsConf()
    battery: BatteryConf = BatteryConf(capacity_wh=100.0, idle_w=10.0, efficiency=0.7)

    @property
    def standing_height_m(self) -> float | None:
        """None: unknown before the URDF is read."""
        return None


@dataclass(frozen=True, eq=False)
class _Wheel:
    joint: Joint
    body: RigidBody
    centre_b: Array
    radius_m: float
    # Whether a positive speed of the joint drives the robot backward.
    backward: bool

    @property
    def on_left(self) -> bool:
        return bool(self.centre_b[1] > 0.0)


class UrdfRobot(WheeledRobot):
    """N robots with (speed, heading) actions: a `Robot`.

    Frame: that of the URDF's root link, which must have x forward, y left and z up. Raises `RobotError` for
    faults in the file or the settings.
    """

    def __init__(self, conf: UrdfConf, num_robots: int) -> None:
        self.conf = conf
        model = read_urdf(conf.path)
        meshes = UrdfMeshes(model.path)
        named = _named_wheels(conf, model)
        moving = [joint.name for joint in model.joints.values() if joint.kind == "continuous"]
        _check_joints("free_joints", conf.free_joints, model)
        bodies = merge_links(model, {*moving, *conf.free_joints}, meshes)
        wheels = _find_wheels(bodies, conf, named, model)
        driven = {wheel.joint.name for wheel in wheels}
        self._bodies = _with_forward_axes(bodies, wheels)
        self._model = model
        self._measure(bodies, wheels)
        self.mass_kg = sum(body.inertial.mass for body in bodies)
        drive = self._derive_drive(conf.drive, wheels, self.mass_kg)
        folder = Path(tempfile.mkdtemp(prefix="dune_rl_robot_"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        physics, look = write_urdfs(self._bodies, model, meshes, folder)
        passive = [body.joint for body in bodies if body.joint is not None and body.joint.name not in driven]
        super().__init__(
            heading=conf.heading,
            drive=drive,
            body=RobotBody(
                urdf=physics,
                look=look,
                motors=tuple(wheel_motor(wheel.joint.name, drive) for wheel in wheels),
                ground_links=tuple(wheel.body.name for wheel in wheels),
                ground_friction=conf.wheel_friction,
                hull_friction=conf.hull_friction,
                sideways_friction_share=conf.sideways_friction_share,
                ground_links_meet_obstacles=True,
                passive=tuple(PassiveJoint(joint.name, joint.friction, joint.damping) for joint in passive),
                couplings=_couplings(passive),
            ),
            on_left=[wheel.on_left for wheel in wheels],
            mounts=self._derive_mounts(conf.mounts),
            battery=conf.battery,
            num_robots=num_robots,
        )
        self.drive = drive

    def summary(self) -> str:
        """Derived values, one per line, for people."""
        drive, wheels = self.drive, self.body.drive_joints
        left = [wheel for wheel, side in zip(wheels, self._on_left, strict=True) if side]
        right = [wheel for wheel in wheels if wheel not in left]
        lines = [
            f"{self._model.name}: {self.mass_kg:.2f} kg in {len(self._bodies)} moving parts",
            f"left wheels: {', '.join(left)}",
            f"right wheels: {', '.join(right)}",
            f"joints without motor: {', '.join(joint.joint for joint in self.body.passive) or '-'}",
            f"size: {self.length_m:.3f} x {self.width_m:.3f} x {self.height_m:.3f} m, origin "
            f"{self.standing_height_m:.3f} m over the ground",
            f"wheel radius: {drive.wheel_radius_m:.4f} m; track for turns: {drive.effective_track_m:.3f} m",
            f"top speed: {drive.max_speed_mps:.2f} m/s; torque of a wheel: {drive.max_torque_nm:.2f} Nm",
            f"scanner at {self.mounts.scanner_b}, camera at {self.mounts.camera_b}, "
            f"inertial unit at {self.mounts.imu_b}",
        ]
        return "\n".join(lines)

    def _measure(self, bodies: Sequence[RigidBody], wheels: Sequence[_Wheel]) -> None:
        points = np.concatenate([body.points_b() for body in bodies])
        low, high = points.min(axis=0), points.max(axis=0)
        reach = np.maximum(np.abs(low), np.abs(high))
        self.length_m, self.width_m = 2 * float(reach[0]), 2 * float(reach[1])
        self.height_m = float(high[2] - low[2])
        self._top_m, self._front_m = round(float(high[2]), 4), round(float(high[0]), 4)
        self.wheel_positions_b = np.array([wheel.centre_b for wheel in wheels])
        self.contact_radius_m = wheels[0].radius_m
        self.contact_width_m = float(np.ptp(wheels[0].body.points_b()[:, 1]))
        self.standing_height_m = float(self.contact_radius_m - self.wheel_positions_b[:, 2].min())
        hull = np.concatenate(
            [np.zeros((0, 3)), *(body.points_b() for body in bodies if body not in [w.body for w in wheels])]
        )
        deeper = -self.standing_height_m - float(hull[:, 2].min(initial=np.inf))
        if deeper > _MAX_DEPTH_M:
            raise RobotError(
                f"{self._model.path.name}: its hull reaches {deeper:.3f} m "
                "below its wheels, which would hang in the air; mend a <collision>, or name the wheels in "
                "robot.left_wheels and robot.right_wheels."
            )

    def _derive_drive(self, conf: UrdfDriveConf, wheels: Sequence[_Wheel], mass: float) -> SkidSteerConf:
        radius = conf.wheel_radius_m or self.contact_radius_m
        across = self.wheel_positions_b[:, 1]
        track = float(across[across > 0].mean() - across[across <= 0].mean())
        scrubs = np.ptp(self.wheel_positions_b[:, 0]) > radius / 2
        speeds = [wheel.joint.velocity for wheel in wheels if wheel.joint.velocity is not None]
        efforts = [wheel.joint.effort for wheel in wheels if wheel.joint.effort is not None]
        # Some URDFs write a limit of thousands for none.
        top = min(10.0, min(speeds) * radius) if speeds else _DEFAULT_SPEED_MPS
        climbing = mass * _GRAVITY_MPS2 * radius / len(wheels)
        values = conf.model_dump()
        return SkidSteerConf(
            **values
            | {
                "wheel_radius_m": radius,
                "effective_track_m": conf.effective_track_m or track * (_SCRUB_RATIO if scrubs else 1.0),
                "max_speed_mps": conf.max_speed_mps or top,
                "max_torque_nm": conf.max_torque_nm or (min(efforts) if efforts else climbing),
            }
        )

    def _derive_mounts(self, conf: UrdfMountsConf) -> MountsConf:
        middle = round(self._top_m - self.height_m / 2, 4)
        return MountsConf(
            scanner_b=conf.scanner_b or (0.0, 0.0, round(self._top_m + _SCANNER_OVER_TOP_M, 4)),
            camera_b=conf.camera_b or (self._front_m, 0.0, round(self._top_m - self.height_m / 4, 4)),
            camera_pitch_deg=conf.camera_pitch_deg,
            imu_b=conf.imu_b or (0.0, 0.0, middle),
        )


def _named_wheels(conf: UrdfConf, model: UrdfModel) -> list[str]:
    """Joints of wheels in the settings; none if they are to be detected."""
    if conf.left_wheels is None and conf.right_wheels is None:
        return []
    if not conf.left_wheels or not conf.right_wheels:
        raise RobotError(
            "robot.left_wheels and robot.right_wheels must both name joints, or both be null; "
            f"{model.path.name} has {_listed(model)}"
        )
    _check_joints("left_wheels", conf.left_wheels, model)
    _check_joints("right_wheels", conf.right_wheels, model)
    both = sorted(set(conf.left_wheels) & set(conf.right_wheels))
    if both:
        raise RobotError(f"robot.left_wheels and robot.right_wheels both name {', '.join(both)}; choose one.")
    return [*conf.left_wheels, *conf.right_wheels]


def _check_joints(setting: str, names: Sequence[str], model: UrdfModel) -> None:
    for name in names:
        if name not in model.joints:
            raise RobotError(
                f"robot.{setting}: {model.path.name} has no joint {name}; it has {_listed(model)}"
            )
        kind = model.joints[name].kind
        if kind == "fixed" or (setting != "free_joints" and kind != "continuous"):
            wanted = "one that moves" if setting == "free_joints" else "continuous ones"
            raise RobotError(f"robot.{setting}: joint {name} of {model.path.name} is {kind}; name {wanted}.")


def _listed(model: UrdfModel) -> str:
    moving = [f"{joint.name} ({joint.kind})" for joint in model.joints.values() if joint.kind != "fixed"]
    return ", ".join(moving) or "no joints that move"


def _find_wheels(
    bodies: Sequence[RigidBody], conf: UrdfConf, named: Sequence[str], model: UrdfModel
) -> list[_Wheel]:
    file = model.path.name
    found: list[_Wheel] = []
    for body in bodies:
        joint = body.joint
        if joint is None or joint.kind != "continuous" or joint.name in conf.free_joints:
            continue
        if named and joint.name not in named:
            continue
        axis = body.pose_b[:3, :3] @ joint.axis
        across = abs(float(axis[1])) > _MIN_AXIS_Y
        rounds = [shape for shape in body.shapes if shape.geometry.kind in _ROUND]
        if named and not across:
            raise RobotError(
                f"{file}: joint {joint.name} turns about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}), and "
                "wheels turn about the robot's y (x is forward, z up); turn the root link's frame."
            )
        if named and not rounds:
            raise RobotError(
                f"{file}: link {body.name!r} of wheel {joint.name} has no round <collision>; give it a "
                "cylinder or a sphere."
            )
        if not across or not rounds:
            continue
        points = body.points_b()
        centre = (points.min(axis=0) + points.max(axis=0)) / 2
        radius = float(np.hypot(*(points - centre)[:, [0, 2]].T).max())
        found.append(_Wheel(joint, body, centre, radius, bool(axis[1] < 0.0)))
    if not named:
        # A round link above the ground, such as a spinning scanner, is no wheel.
        bottom = min((wheel.centre_b[2] - wheel.radius_m for wheel in found), default=0.0)
        found = [wheel for wheel in found if wheel.centre_b[2] - wheel.radius_m < bottom + 0.02]
    sides = {wheel.on_left for wheel in found}
    if len(sides) < 2:
        raise RobotError(
            f"{file}: no wheels are found on both sides; name them in robot.left_wheels and "
            f"robot.right_wheels: continuous joints about y with a round <collision>. It has {_listed(model)}"
        )
    for setting, names, left in (("left", conf.left_wheels, True), ("right", conf.right_wheels, False)):
        for wheel in found:
            if names is not None and wheel.joint.name in names and wheel.on_left != left:
                raise RobotError(
                    f"robot.{setting}_wheels: joint {wheel.joint.name} of {file} is at y = "
                    f"{wheel.centre_b[1]:.3f} m, and left is where y is above 0; change sides."
                )
    radii = [wheel.radius_m for wheel in found]
    if max(radii) > 1.1 * min(radii) and conf.drive.wheel_radius_m is None:
        raise RobotError(
            f"{file}: its wheels have radii from {min(radii):.3f} to {max(radii):.3f} m; name those that "
            "drive in robot.left_wheels and robot.right_wheels."
        )
    if named:
        order = {name: index for index, name in enumerate(named)}
        found.sort(key=lambda wheel: order[wheel.joint.name])
    return found


def _with_forward_axes(bodies: Sequence[RigidBody], wheels: Sequence[_Wheel]) -> list[RigidBody]:
    """The bodies, with the axes of wheels oriented so that positive speeds drive the robot forward."""
    reversed_bodies = {id(wheel.body) for wheel in wheels if wheel.backward}
    oriented = []
    for body in bodies:
        joint = body.joint
        if id(body) in reversed_bodies and joint is not None:
            body = RigidBody(
                body.name,
                Joint(**{**vars(joint), "axis": -joint.axis}),
                body.pose_b,
                body.inertial,
                body.shapes,
                body.visuals,
            )
        oriented.append(body)
    return oriented


def _couplings(passive: Sequence[Joint]) -> tuple[Coupling, ...]:
    names = {joint.name for joint in passive}
    return tuple(
        Coupling(joint.mimic[0], joint.name, joint.mimic[1])
        for joint in passive
        if joint.mimic is not None and joint.mimic[0] in names and joint.mimic[0] != joint.name
    )
