"""Wheels of a URDF: continuous joints about the robot's y with round links that stand on the ground."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dune_rl.core.errors import RobotError
from dune_rl.geometry.arrays import Array
from dune_rl.robots.urdf.bodies import RigidBody
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.model import Joint, UrdfModel

_ROUND = ("sphere", "cylinder", "mesh")
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
        if joint is None or joint.kind != "continuous" or joint.name in excluded:
            continue
        axis = body.pose_b[:3, :3] @ joint.axis
        if abs(float(axis[1])) > MIN_AXIS and is_round(body):
            points = body.points_b()
            centre = (points.min(axis=0) + points.max(axis=0)) / 2
            radius = float(np.hypot(*(points - centre)[:, [0, 2]].T).max())
            found.append(Wheel(joint, body, centre, radius, bool(axis[1] < 0.0)))
    low = [wheel.centre_b[2] - wheel.radius_m for wheel in found if not named or wheel.joint.name in named]
    bottom = min(low, default=0.0)

    def stands(wheel: Wheel) -> bool:
        height = float(wheel.centre_b[2]) - wheel.radius_m - bottom
        return height < max(_HIGHEST_M, _HIGHEST_SHARE * wheel.radius_m)

    return [wheel for wheel in found if wheel.joint.name in named or stands(wheel)]


def is_round(body: RigidBody) -> bool:
    """Whether a body has a collision shape that can roll."""
    return any(shape.geometry.kind in _ROUND for shape in body.shapes)


def check_named_wheels(
    bodies: Sequence[RigidBody], conf: UrdfConf, named: Sequence[str], model: UrdfModel
) -> None:
    """Raise `RobotError` for a named wheel that cannot be one, or is on the other side."""
    file = model.path.name
    places: dict[str, float] = {}
    for body in bodies:
        joint = body.joint
        if joint is None or joint.name not in named:
            continue
        axis = body.pose_b[:3, :3] @ joint.axis
        if abs(float(axis[1])) <= MIN_AXIS:
            raise RobotError(
                f"{file}: joint {joint.name} turns about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}), and "
                "wheels turn about the robot's y (x is forward, z up); turn the root link's frame."
            )
        if not is_round(body):
            raise RobotError(
                f"{file}: link {body.name!r} of wheel {joint.name} has no round <collision>; give it a "
                "cylinder or a sphere."
            )
        across = body.points_b()[:, 1]
        places[joint.name] = float(across.min() + across.max()) / 2
    for setting, names, left in (("left", conf.left_wheels, True), ("right", conf.right_wheels, False)):
        for name in names or ():
            if (places[name] > 0.0) != left:
                raise RobotError(
                    f"robot.{setting}_wheels: joint {name} of {file} is at y = "
                    f"{places[name]:.3f} m, and left is where y is above 0; change sides."
                )


def check_driven_wheels(
    driven: Sequence[Wheel], bodies: Sequence[RigidBody], conf: UrdfConf, model: UrdfModel, *, steers: bool
) -> None:
    """Raise `RobotError` if the wheels with motors cannot drive the robot."""
    file = model.path.name
    if not driven or (not steers and len({wheel.on_left for wheel in driven}) < 2):
        raise RobotError(
            f"{file}: no wheels are found on both sides; name them in robot.left_wheels and "
            f"robot.right_wheels: continuous joints about y with a round <collision>.{_turned_frame(bodies)} "
            f"It has {list_moving_joints(model)}"
        )
    radii = [wheel.radius_m for wheel in driven]
    if max(radii) > 1.1 * min(radii) and conf.drive.wheel_radius_m is None:
        raise RobotError(
            f"{file}: its wheels have radii from {min(radii):.3f} to {max(radii):.3f} m; name those that "
            "drive in robot.left_wheels and robot.right_wheels."
        )


def _turned_frame(bodies: Sequence[RigidBody]) -> str:
    """A hint for a robot whose wheels turn about its x axis."""
    about_x = [
        body
        for body in bodies
        if body.joint is not None
        and body.joint.kind == "continuous"
        and is_round(body)
        and abs(float((body.pose_b[:3, :3] @ body.joint.axis)[0])) > MIN_AXIS
    ]
    if len(about_x) < 2:
        return ""
    return f" {len(about_x)} such joints turn about x: if y is its forward axis, turn the root link's frame."


def named_wheels(conf: UrdfConf, model: UrdfModel) -> list[str]:
    """Joints of wheels in the settings; none if they are to be detected."""
    if conf.left_wheels is None and conf.right_wheels is None:
        return []
    if not conf.left_wheels or not conf.right_wheels:
        raise RobotError(
            "robot.left_wheels and robot.right_wheels must both name joints, or both be null; "
            f"{model.path.name} has {list_moving_joints(model)}"
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
                f"robot.{setting}: {model.path.name} has no joint {name}; it has {list_moving_joints(model)}"
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


def list_moving_joints(model: UrdfModel) -> str:
    """The joints that are not fixed, for messages."""
    moving = [f"{joint.name} ({joint.kind})" for joint in model.joints.values() if joint.kind != "fixed"]
    return ", ".join(moving) or "no joints that move"


def turn_axes(bodies: Sequence[RigidBody], joints: Collection[str]) -> list[RigidBody]:
    """The bodies, with the axes of some joints reversed."""
    return [
        body
        if body.joint is None or body.joint.name not in joints
        else replace(
            body,
            joint=replace(
                body.joint,
                axis=-body.joint.axis,
                limits=(-body.joint.limits[1], -body.joint.limits[0]),
            ),
        )
        for body in bodies
    ]
