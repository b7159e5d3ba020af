"""Steering joints and suspension of a robot from a URDF, and the geometry of its steering."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.core.errors import RobotError
from dune_rl.robots.ackermann import SteeringGeometry
from dune_rl.robots.urdf.conf import UrdfConf, UrdfDriveConf
from dune_rl.robots.urdf.model import Joint, UrdfModel
from dune_rl.robots.urdf.wheels import MIN_AXIS, Wheel, check_joint_names


@dataclass(frozen=True)
class Suspension:
    """Joints of levers that turn freely, and the pair of them, left and right, that a differential connects.

    With all wheels on two rockers, the body would fall about their axis without a differential, which URDFs
    leave out because it closes a loop.
    """

    joints: tuple[str, ...] = ()
    differential: tuple[str, str] | None = None


def find_suspension(wheels: Sequence[Wheel], model: UrdfModel) -> Suspension:
    """The free levers: joints about y with wheels before and behind them, and one axle that pivots about x.

    An arm with one wheel, or with wheels on one side, would fall without the spring that a URDF cannot
    describe: such joints do not count.
    """
    above = {
        wheel.joint.name: {joint.name for joint in model.joints_above(model.joints[wheel.joint.name].parent)}
        for wheel in wheels
    }
    levers: dict[str, list[Wheel]] = {}
    axles: list[str] = []
    for joint in model.joints.values():
        below = [wheel for wheel in wheels if joint.name in above[wheel.joint.name]]
        if not 2 <= len(below) < len(wheels) or not _can_swing(joint):
            continue
        axis = np.abs(model.axis_b(joint))
        places = np.array([wheel.centre_b for wheel in below]) - model.pose_b(joint.child)[:3, 3]
        if axis[1] > MIN_AXIS and _straddles(places[:, 0]):
            levers[joint.name] = below
        elif axis[0] > MIN_AXIS and _straddles(places[:, 1]):
            axles.append(joint.name)
    # Two such axles would leave the body without any hold about x.
    joints = (*levers, *(axles if len(axles) == 1 else []))
    return Suspension(joints, _find_differential(levers, wheels, model))


def _can_swing(joint: Joint) -> bool:
    if joint.kind == "continuous":
        return True
    low, high = joint.limits
    return joint.kind == "revolute" and high - low > _MIN_RANGE_RAD and low <= 0.0 <= high


def _straddles(places: np.ndarray) -> bool:
    return bool(places.min() < 0.0 < places.max())


def _find_differential(
    levers: dict[str, list[Wheel]], wheels: Sequence[Wheel], model: UrdfModel
) -> tuple[str, str] | None:
    """The left and the right rocker, if they carry all wheels and no `mimic` couples them."""
    top = [
        name
        for name in levers
        if not any(joint.name in levers for joint in model.joints_above(model.joints[name].parent))
    ]
    if len(top) != 2 or any(model.joints[name].mimic is not None for name in top):
        return None
    sides = [{wheel.on_left for wheel in levers[name]} for name in top]
    carried = sum(len(levers[name]) for name in top)
    if carried < len(wheels) or sorted(map(sorted, sides)) != [[False], [True]]:
        return None
    left, right = top if sides[0] == {True} else reversed(top)
    return left, right


# Least absolute vertical component of a pivot's axis: kingpins are inclined by up to some 20 degrees.
_MIN_VERTICAL = 0.85
# A revolute joint of a smaller range does not steer.
_MIN_RANGE_RAD = 0.1
_MAX_ANGLE_RAD = float(np.deg2rad(60.0))
_DEFAULT_ANGLE_RAD = float(np.deg2rad(30.0))
# Distance of a wheel behind its pivot, over its radius, from which on it trails like a caster's.
_TRAIL = 0.4
_STEERING_NAME = re.compile(r"steer|stear|knuckle|kingpin|hinge|corner|swivel_motor", re.IGNORECASE)
_CASTER_NAME = re.compile(r"cast[eo]r|swivel", re.IGNORECASE)
_STEERING_PLUGIN = re.compile(r"ackermann|steering|car_?demo|prius", re.IGNORECASE)
_SKID_PLUGIN = re.compile(r"diff_?drive|skid_?steer", re.IGNORECASE)
_LEAST_SCORE = 2


@dataclass(frozen=True)
class Pivots:
    """Joints about the vertical that have wheels below: those that steer, and those of casters, by wheel.

    `steering` and `casters` map the joint of a wheel to that of its pivot.
    """

    steering: dict[str, str]
    casters: dict[str, str]

    @property
    def joints(self) -> tuple[str, ...]:
        """The steering joints, without repetitions."""
        return tuple(dict.fromkeys(self.steering.values()))


def find_pivots(wheels: Sequence[Wheel], conf: UrdfConf, model: UrdfModel) -> Pivots:
    """The pivots above `wheels`, from the settings or by their looks.

    Raises `RobotError` for settings that do not fit.
    """
    above = {wheel.joint.name: _pivots_above(wheel, model) for wheel in wheels}
    above_names = {wheel: {joint.name for joint in joints} for wheel, joints in above.items()}
    steering: dict[str, str] = {}
    casters: dict[str, str] = {}
    if conf.steering_joints is not None:
        check_joint_names("steering_joints", conf.steering_joints, model)
    for wheel in wheels:
        for joint in above[wheel.joint.name]:
            below = [name for name, names in above_names.items() if joint.name in names]
            if conf.steering_joints is not None:
                if joint.name in conf.steering_joints:
                    steering[wheel.joint.name] = joint.name
            elif len(below) < len(wheels) and _steering_score(joint, wheel, model) >= _LEAST_SCORE:
                steering[wheel.joint.name] = joint.name
            if wheel.joint.name not in steering and joint.kind == "continuous":
                casters[wheel.joint.name] = joint.name
    for name in conf.steering_joints or ():
        if name not in steering.values():
            raise RobotError(
                f"robot.steering_joints: joint {name} of {model.path.name} has no wheel below it, or is not "
                f"about the vertical (z up); it has {model.list_moving_joints()}"
            )
    return Pivots(steering, {wheel: joint for wheel, joint in casters.items() if wheel not in steering})


def _pivots_above(wheel: Wheel, model: UrdfModel) -> list[Joint]:
    """Joints about the vertical between the root and a wheel, the root's first."""
    return [
        joint
        for joint in model.joints_above(model.joints[wheel.joint.name].parent)
        if joint.kind in ("revolute", "continuous") and abs(float(model.axis_b(joint)[2])) > _MIN_VERTICAL
    ]


def _steering_score(joint: Joint, wheel: Wheel, model: UrdfModel) -> int:
    """How many signs more say that a joint steers a wheel than that it is a caster's or none."""
    low, high = joint.limits
    limited = joint.kind == "revolute"
    if limited and (high - low < _MIN_RANGE_RAD or not low < 0.0 < high):
        return 0
    trail = abs(float(wheel.centre_b[0] - model.pose_b(joint.child)[0, 3]))
    trails = trail > _TRAIL * wheel.radius_m
    names = f"{joint.name} {joint.child}"
    hints, plugins = model.hints, " ".join(model.hints.plugins)
    return (
        (2 if limited else 0)
        + (2 if joint.name in hints.commanded else 0)
        + (1 if _STEERING_NAME.search(names) else 0)
        + (2 if _STEERING_PLUGIN.search(plugins) else 0)
        + (-2 if trails else 1)
        - (3 if _CASTER_NAME.search(names) and joint.name not in hints.commanded else 0)
        - (2 if _SKID_PLUGIN.search(plugins) and joint.name not in hints.commanded else 0)
    )


def steering_geometry(
    driven: Sequence[Wheel],
    wheels: Sequence[Wheel],
    pivots: Pivots,
    conf: UrdfDriveConf,
    radius_m: float,
    model: UrdfModel,
) -> SteeringGeometry:
    """Geometry of `wheels`, of which `driven` have motors, with `pivots`."""
    joints = [model.joints[name] for name in pivots.joints]
    straight = [wheel for wheel in wheels if wheel.joint.name not in pivots.steering]
    if straight:
        turning_x = float(np.mean([wheel.centre_b[0] for wheel in straight]))
    else:
        across = [wheel.centre_b[0] for wheel in wheels]
        turning_x = float(min(across) + max(across)) / 2
    places = {name: model.pose_b(model.joints[name].child)[:2, 3] for name in pivots.joints}
    own = [pivots.steering.get(wheel.joint.name) for wheel in driven]
    pivots_b = [
        wheel.centre_b[:2] if name is None else places[name] for wheel, name in zip(driven, own, strict=True)
    ]
    return SteeringGeometry(
        turning_x_m=turning_x,
        pivots_b=np.array(list(places.values())),
        signs=np.array([np.sign(model.axis_b(joint)[2]) for joint in joints]),
        limits=np.array([_limits(joint, conf, model) for joint in joints]),
        wheel_pivots_b=np.array(pivots_b),
        wheel_offsets_m=np.array(
            [wheel.centre_b[1] - pivot[1] for wheel, pivot in zip(driven, pivots_b, strict=True)]
        ),
        steered=np.array([name is not None for name in own]),
        wheel_radius_m=radius_m,
    )


def _limits(joint: Joint, conf: UrdfDriveConf, model: UrdfModel) -> tuple[float, float]:
    """Lowest and highest steering angle [rad], positive to the left."""
    low, high = joint.limits if joint.kind == "revolute" else (-_DEFAULT_ANGLE_RAD, _DEFAULT_ANGLE_RAD)
    if model.axis_b(joint)[2] < 0.0:
        low, high = -high, -low
    most = _MAX_ANGLE_RAD if conf.max_steering_deg is None else float(np.deg2rad(conf.max_steering_deg))
    if joint.kind == "continuous" and conf.max_steering_deg is not None:
        low, high = -most, most
    return max(low, -most), min(high, most)
