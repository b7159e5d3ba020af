"""Rockers and bogies of a URDF: levers with wheels at both ends, which turn freely."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.robots.urdf.model import Joint, UrdfModel
from dune_rl.robots.urdf.wheels import MIN_AXIS, Wheel

_MIN_RANGE_RAD = 1e-3


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
        pose = model.pose_b(joint.child)
        axis = np.abs(pose[:3, :3] @ joint.axis)
        places = np.array([wheel.centre_b for wheel in below]) - pose[:3, 3]
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
