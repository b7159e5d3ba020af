"""Wheeled robots from a URDF: differential, skid-steer and Ackermann steering."""

import shutil
import tempfile
import warnings
import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import PassiveJoint, RobotBody
from dune_rl.robots.ackermann import AckermannDrive
from dune_rl.robots.robot import RobotDescription
from dune_rl.robots.settings import MountsConf
from dune_rl.robots.urdf.bodies import RigidBody, write_urdfs
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.drive import DerivedDrive, derive_drive
from dune_rl.robots.urdf.layout import RobotLayout, find_layout
from dune_rl.robots.urdf.meshes import RobotWarning, UrdfMeshes
from dune_rl.robots.urdf.model import UrdfModel
from dune_rl.robots.urdf.reader import read_urdf
from dune_rl.robots.wheeled import WheeledRobot, wheel_motor

_SCANNER_OVER_TOP_M = 0.05
# Casters may be a little lower than the wheels.
_MAX_DEPTH_M = 0.02


class UrdfRobot(WheeledRobot):
    """N robots with (speed, heading) actions: a `Robot`.

    Frame: that of the URDF's root link, which must have x forward, y left and z up. Raises `RobotError` for
    faults in the file or the settings.
    """

    def __init__(self, conf: UrdfConf, num_robots: int) -> None:
        self.conf = conf
        model = read_urdf(conf.path)
        meshes = UrdfMeshes(model.path)
        layout = find_layout(conf, model, meshes)
        self._layout, self._model = layout, model
        description = _describe(conf, layout, model)
        derived = derive_drive(conf, layout, description.mass_kg, model)
        self._derived = derived
        folder = Path(tempfile.mkdtemp(prefix="dune_rl_robot_"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        physics, look = write_urdfs(layout.bodies, model, meshes, folder)
        super().__init__(
            description,
            RobotBody(
                urdf=physics,
                look=look,
                motors=_motors(layout, derived),
                ground_links=tuple(wheel.body.name for wheel in layout.wheels),
                ground_friction=conf.wheel_friction,
                hull_friction=conf.hull_friction,
                sideways_friction_share=conf.sideways_friction_share,
                ground_links_meet_obstacles=True,
                passive=tuple(
                    PassiveJoint(joint.name, joint.friction, joint.damping) for joint in layout.passive
                ),
                couplings=layout.couplings,
            ),
            heading=conf.heading,
            drive=derived.wheels,
            on_left=[wheel.on_left for wheel in layout.driven],
            num_robots=num_robots,
        )
        self.drive = derived.wheels
        self.steering: AckermannDrive | None = None
        if derived.ackermann is not None and derived.geometry is not None:
            self.steering = AckermannDrive(derived.ackermann, conf.heading, derived.geometry, num_robots)
            wheels = self.description.wheels
            assert wheels is not None
            steered = replace(wheels, steering=derived.geometry)
            self.description = replace(self.description, wheels=steered)
        for text in meshes.report.texts:
            warnings.warn(f"{model.path.name}: {text}", RobotWarning, stacklevel=2)

    def reset(self, mask: Flags) -> None:
        """Reset the controllers of the robots in `mask` (N,)."""
        super().reset(mask)
        if self.steering is not None:
            self.steering.reset(mask)

    def wheel_commands(self, action: Array, measured_yaw_rate: Array, step_s: float) -> Array:
        """Target speeds of the driven wheels [rad/s], then angles of the steering joints [rad], (N, J).

        See `WheeledRobot.wheel_commands`. Ackermann steering does without the yaw rate.
        """
        if self.steering is None:
            return super().wheel_commands(action, measured_yaw_rate, step_s)
        return self.steering.commands(action[:, 0], action[:, 1], step_s)

    def summary(self) -> str:
        """What was derived and assumed, one statement per line, for people."""
        drive, layout, size = self.drive, self._layout, self.description
        left, right = (
            ", ".join(wheel.joint.name for wheel in layout.driven if wheel.on_left == side)
            for side in (True, False)
        )
        rolling = ", ".join(wheel.joint.name for wheel in layout.rolling)
        lines = [
            f"{self._model.name}: {size.mass_kg:.2f} kg in {len(layout.bodies)} moving parts",
            f"drive: {layout.reasons[0]}",
            *layout.reasons[1:],
            f"left wheels: {left}",
            f"right wheels: {right}",
            *([f"wheels without motor: {rolling}"] if rolling else []),
            f"joints without motor: {', '.join(joint.joint for joint in self.body.passive) or '-'}",
            f"size: {size.length_m:.3f} x {size.width_m:.3f} x {size.height_m:.3f} m, origin "
            f"{size.standing_height_m:.3f} m over the ground",
            *self._derived.describe(drive, self.steering),
            f"scanner at {size.mounts.scanner_b}, camera at {size.mounts.camera_b}, "
            f"inertial unit at {size.mounts.imu_b}",
        ]
        return "\n".join(lines)


def _describe(conf: UrdfConf, layout: RobotLayout, model: UrdfModel) -> RobotDescription:
    """Sizes, mass and mounts of the robot, without the limits of its drive."""
    bodies, wheels = layout.bodies, layout.wheels
    points = np.concatenate([body.points_b() for body in bodies])
    low, high = points.min(axis=0), points.max(axis=0)
    reach = np.maximum(np.abs(low), np.abs(high))
    bottom = min(float(wheel.centre_b[2]) - wheel.radius_m for wheel in wheels)
    rolling = [wheel.body for wheel in wheels]
    hull = _lowest_point([body for body in bodies if body not in rolling])
    deeper = bottom - hull
    if deeper > _MAX_DEPTH_M:
        raise model.fault(
            f"its hull reaches {deeper:.3f} m "
            "below its wheels, which would hang in the air; mend a <collision>, or name the wheels in "
            "robot.left_wheels and robot.right_wheels."
        )
    height, top, front = float(high[2] - low[2]), round(float(high[2]), 4), round(float(high[0]), 4)
    own = conf.mounts
    return RobotDescription(
        length_m=2 * float(reach[0]),
        width_m=2 * float(reach[1]),
        height_m=height,
        # A body that starts in the ground is thrown out of it, or a small one through it.
        standing_height_m=-min(bottom, hull),
        mass_kg=sum(body.inertial.mass for body in bodies),
        contact_centres_b=np.array([wheel.centre_b for wheel in wheels]),
        contact_radius_m=wheels[0].radius_m,
        contact_width_m=wheels[0].width_m,
        mounts=MountsConf(
            scanner_b=own.scanner_b or (0.0, 0.0, round(top + _SCANNER_OVER_TOP_M, 4)),
            camera_b=own.camera_b or (front, 0.0, round(top - height / 4, 4)),
            camera_pitch_deg=own.camera_pitch_deg,
            imu_b=own.imu_b or (0.0, 0.0, round(top - height / 2, 4)),
        ),
        battery=conf.battery,
    )


def _lowest_point(bodies: Sequence[RigidBody]) -> float:
    """Height [m] of the lowest point in the base's frame; infinite without shapes."""
    points = np.concatenate([np.zeros((0, 3)), *(body.points_b() for body in bodies)])
    return float(points[:, 2].min(initial=np.inf))


def _motors(layout: RobotLayout, derived: DerivedDrive) -> tuple[Motor, ...]:
    """Motors of the driven wheels, then of the steering joints."""
    wheels = [wheel_motor(wheel.joint.name, derived.wheels) for wheel in layout.driven]
    if derived.ackermann is None:
        return tuple(wheels)
    rate = derived.ackermann.max_steering_rate_radps
    steering = [
        Motor(name, derived.steering_torque_nm, mode="position", max_speed_radps=rate)
        for name in layout.pivots.joints
    ]
    return (*wheels, *steering)
