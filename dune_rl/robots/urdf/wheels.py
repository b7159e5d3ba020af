"""Wheels of a URDF: continuous joints about the robot's y with round links that stand on the ground."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.core.errors import RobotError
from dune_rl.geometry.arrays import Array
from dune_rl.robots.urdf.bodies import RigidBody
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.model import Joint, UrdfModel

# Least absolute component of a wheel's axis along the robot's y.
MIN_AXIS = 0.97
# A wheel's lowest point is at most this share of its radius, and this height, above that of the others.
_HIGHEST_SHARE, _HIGHEST_M = 0.3, 0.02


@dataclass(frozen=True, eq=False)
class Wheel:
    """A wheel; `backward` is whether a positive speed of its joint drives the robot backward."""

    joint: Joint
    body: RigidBody
    centre_b: Array
    radius_m: float
    backward: bool

    @property
    def on_left(self) -> bool:
        """Whether it is on the robot's left."""
        return bool(self.centre_b[1] > 0.0)

    @property
    def width_m(self) -> float:
        """Its extent along y."""
        return float(np.ptp(self.body.points_b()[:, 1]))


def find_wheels(bodies: Sequence[RigidBody], excluded: Collection[str], named: Sequence[str]) -> list[Wheel]:
    """All wheels that stand on the ground, with motors or without, and those in `named` wherever they are.

    Joints in `excluded` are none. A round link above the ground, such as a spinning scanner, is no wheel.
    """
    found: list[Wheel] = []
    for body in bodies:
        joint = body.joint
        if joint is None or not body.spins or joint.name in excluded:
            continue
        across = float(body.axis_b[1])
        if abs(across) > MIN_AXIS:
            points = body.points_b()
            centre = (points.min(axis=0) + points.max(axis=0)) / 2
            radius = float(np.hypot(*(points - centre)[:, [0, 2]].T).max())
            found.append(Wheel(joint, body, centre, radius, across < 0.0))
    low = [wheel.centre_b[2] - wheel.radius_m for wheel in found if not named or wheel.joint.name in named]
    bottom = min(low, default=0.0)

    def stands(wheel: Wheel) -> bool:
        height = float(wheel.centre_b[2]) - wheel.radius_m - bottom
        return height < max(_HIGHEST_M, _HIGHEST_SHARE * wheel.radius_m)

    return [wheel for wheel in found if wheel.joint.name in named or stands(wheel)]


def check_named_wheels(
    bodies: Sequence[RigidBody], conf: UrdfConf, named: Sequence[str], model: UrdfModel
) -> None:
    """Raise `RobotError` for a named wheel that cannot be one, or is on the other side."""
    places: dict[str, float] = {}
    for body in bodies:
        joint = body.joint
        if joint is None or joint.name not in named:
            continue
        x, y, z = body.axis_b
        if abs(y) <= MIN_AXIS:
            raise model.fault(
                f"joint {joint.name} turns about ({x:.2f}, {y:.2f}, {z:.2f}), and "
                "wheels turn about the robot's y (x is forward, z up); turn the root link's frame."
            )
        if not body.spins:
            raise model.fault(
                f"link {body.name!r} of wheel {joint.name} has no round <collision>; give it a "
                "cylinder or a sphere."
            )
        across = body.points_b()[:, 1]
        places[joint.name] = float(across.min() + across.max()) / 2
    for setting, names, left in (("left", conf.left_wheels, True), ("right", conf.right_wheels, False)):
        for name in names or ():
            if (places[name] > 0.0) != left:
                raise RobotError(
                    f"robot.{setting}_wheels: joint {name} of {model.path.name} is at y = "
                    f"{places[name]:.3f} m, and left is where y is above 0; change sides."
                )


def check_driven_wheels(
    driven: Sequence[Wheel], bodies: Sequence[RigidBody], conf: UrdfConf, model: UrdfModel, *, steers: bool
) -> None:
    """Raise `RobotError` if the wheels with motors cannot drive the robot."""
    if not driven or (not steers and len({wheel.on_left for wheel in driven}) < 2):
        about_x = sum(body.spins and abs(float(body.axis_b[0])) > MIN_AXIS for body in bodies)
        hint = ""
        if about_x > 1:
            hint = (
                f" {about_x} such joints turn about x: if y is its forward axis, turn the root link's frame."
            )
        raise model.fault(
            "no wheels are found on both sides; name them in robot.left_wheels and "
            f"robot.right_wheels: continuous joints about y with a round <collision>.{hint} "
            f"It has {model.list_moving_joints()}"
        )
    radii = [wheel.radius_m for wheel in driven]
    if max(radii) > 1.1 * min(radii) and conf.drive.wheel_radius_m is None:
        raise model.fault(
            f"its wheels have radii from {min(radii):.3f} to {max(radii):.3f} m; name those that "
            "drive in robot.left_wheels and robot.right_wheels."
        )


def named_wheels(conf: UrdfConf, model: UrdfModel) -> list[str]:
    """Joints of wheels in the settings; none if they are to be detected."""
    if conf.left_wheels is None and conf.right_wheels is None:
        return []
    if not conf.left_wheels or not conf.right_wheels:
        raise RobotError(
            "robot.left_wheels and robot.right_wheels must both name joints, or both be null; "
            f"{model.path.name} has {model.list_moving_joints()}"
        )
    check_joint_names("left_wheels", conf.left_wheels, model)
    check_joint_names("right_wheels", conf.right_wheels, model)
    both = sorted(set(conf.left_wheels) & set(conf.right_wheels))
    if both:
        raise RobotError(f"robot.left_wheels and robot.right_wheels both name {', '.join(both)}; choose one.")
    return [*conf.left_wheels, *conf.right_wheels]


def check_joint_names(setting: str, names: Sequence[str], model: UrdfModel) -> None:
    """Raise `RobotError` for names in a setting that are no joints, or joints of another kind."""
    wanted, kinds = _WANTED_JOINTS[setting]
    for name in names:
        if name not in model.joints:
            raise RobotError(
                f"robot.{setting}: {model.path.name} has no joint {name}; it has {model.list_moving_joints()}"
            )
        kind = model.joints[name].kind
        if kind not in kinds:
            raise RobotError(f"robot.{setting}: joint {name} of {model.path.name} is {kind}; name {wanted}.")


_WHEEL_JOINTS = ("continuous ones", ("continuous",))
_WANTED_JOINTS = {
    "left_wheels": _WHEEL_JOINTS,
    "right_wheels": _WHEEL_JOINTS,
    "steering_joints": ("revolute or continuous ones", ("revolute", "continuous")),
    "free_joints": ("one that moves", ("continuous", "revolute", "prismatic")),
}
