"""What moves on a robot from a URDF: wheels with and without motors, steering joints and suspension."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dune_rl.core.errors import RobotError
from dune_rl.physics.robot_body import Coupling
from dune_rl.robots.urdf.bodies import RigidBody, align_frames, merge_links, reverse_axes
from dune_rl.robots.urdf.conf import DriveKind, UrdfConf
from dune_rl.robots.urdf.meshes import UrdfMeshes
from dune_rl.robots.urdf.model import Joint, UrdfModel
from dune_rl.robots.urdf.steering import Pivots, Suspension, find_pivots, find_suspension
from dune_rl.robots.urdf.unsupported import refuse_unsupported_drives
from dune_rl.robots.urdf.wheels import (
    Wheel,
    check_driven_wheels,
    check_joint_names,
    check_named_wheels,
    find_wheels,
    named_wheels,
)

_MOST_CAR_WHEELS = 4


@dataclass(frozen=True, eq=False)
class RobotLayout:
    """The rigid bodies of a robot and what they are for.

    `driven` wheels have motors, `rolling` ones have none. `passive` are the joints without a motor, and
    `couplings` connect some of them. `reasons` say, for people, why the drive is what it is.
    """

    kind: DriveKind
    bodies: list[RigidBody]
    driven: list[Wheel]
    rolling: list[Wheel]
    pivots: Pivots
    passive: list[Joint]
    couplings: tuple[Coupling, ...]
    reasons: tuple[str, ...]

    @property
    def wheels(self) -> list[Wheel]:
        """All wheels on the ground, those with motors first."""
        return [*self.driven, *self.rolling]


def find_layout(conf: UrdfConf, model: UrdfModel, meshes: UrdfMeshes) -> RobotLayout:
    """The layout of a robot; raises `RobotError` for faults of the file or the settings."""
    named = named_wheels(conf, model)
    free = () if conf.free_joints is None else conf.free_joints
    check_joint_names("free_joints", free, model)
    moving = {joint.name for joint in model.joints.values() if joint.kind == "continuous"} | set(free)
    # Steering joints and levers are found by the wheels, which the links must be merged for.
    bodies = merge_links(model, moving, meshes)
    check_named_wheels(bodies, conf, named, model)
    wheels = find_wheels(bodies, free, named)
    if conf.drive.kind == "auto":
        refuse_unsupported_drives(bodies, wheels, model)
    kind, pivots, reason = _choose_drive(wheels, conf, model)
    wheels = [wheel for wheel in wheels if wheel.joint.name not in pivots.casters]
    driven, why_driven = _driven_wheels(wheels, named, pivots, model)
    check_driven_wheels(driven, bodies, conf, model, steers=kind == "ackermann")
    suspension = find_suspension(wheels, model) if conf.free_joints is None else Suspension()
    moving |= {*pivots.joints, *suspension.joints}
    bodies = _orient(merge_links(model, moving, meshes), wheels, suspension, model)
    by_name = {body.name: body for body in bodies}
    wheels = [replace(wheel, body=by_name[wheel.body.name]) for wheel in wheels]
    driven_names = [wheel.joint.name for wheel in driven]
    motors = {*driven_names, *pivots.joints}
    passive = [body.joint for body in bodies if body.joint is not None and body.joint.name not in motors]
    return RobotLayout(
        kind,
        bodies,
        _in_order(wheels, driven_names),
        [wheel for wheel in wheels if wheel.joint.name not in driven_names],
        pivots,
        passive,
        _couplings(passive, suspension),
        (reason, why_driven, *_describe_suspension(suspension)),
    )


def _choose_drive(wheels: Sequence[Wheel], conf: UrdfConf, model: UrdfModel) -> tuple[DriveKind, Pivots, str]:
    pivots = find_pivots(wheels, conf, model)
    wanted = conf.drive.kind
    steering = ", ".join(pivots.joints)
    if wanted == "skid_steer":
        note = f"; the steering joints {steering} are fixed at zero" if steering else ""
        return "skid_steer", Pivots({}, pivots.casters), f"skid-steer, by robot.drive.kind{note}"
    if steering:
        by = "robot.steering_joints" if conf.steering_joints is not None else "their place and limits"
        return "ackermann", pivots, f"Ackermann steering: {steering} steer, by {by}"
    if wanted == "ackermann":
        raise RobotError(
            f"robot.drive.kind=ackermann: {model.path.name} has no joint that looks like steering (about z, "
            "with a wheel below it); name it in robot.steering_joints. "
            f"It has {model.list_moving_joints()}"
        )
    return "skid_steer", pivots, "skid-steer: no wheel hangs on a joint that steers"


def _driven_wheels(
    wheels: Sequence[Wheel], named: Sequence[str], pivots: Pivots, model: UrdfModel
) -> tuple[list[Wheel], str]:
    """The wheels with motors, in their order, and why these."""
    if named:
        return _in_order(wheels, named), "driven wheels: by robot.left_wheels and robot.right_wheels"
    commanded = [wheel for wheel in wheels if wheel.joint.name in model.hints.commanded]
    enough = bool(commanded) if pivots.steering else len({wheel.on_left for wheel in commanded}) == 2
    if enough and len(commanded) < len(wheels):
        return commanded, "driven wheels: those that the URDF's controllers command"
    straight = [wheel for wheel in wheels if wheel.joint.name not in pivots.steering]
    if pivots.steering and not enough and straight and len(wheels) <= _MOST_CAR_WHEELS:
        note = "driven wheels: those that do not steer (others: robot.left_wheels and right_wheels)"
        return straight, note
    return list(wheels), "driven wheels: all"


def _in_order(wheels: Sequence[Wheel], names: Sequence[str]) -> list[Wheel]:
    """The wheels whose joints are in `names`, in that order."""
    by_name = {wheel.joint.name: wheel for wheel in wheels}
    return [by_name[name] for name in names if name in by_name]


def _orient(
    bodies: Sequence[RigidBody], wheels: Sequence[Wheel], suspension: Suspension, model: UrdfModel
) -> list[RigidBody]:
    """The bodies, with wheels that roll forward at positive speeds, and upright mounts of wheels."""
    turned = {wheel.joint.name for wheel in wheels if wheel.backward}
    if suspension.differential is not None:
        # Both rockers about the same direction, as engines expect of a differential.
        turned |= {name for name in suspension.differential if model.axis_b(model.joints[name])[1] < 0.0}
    oriented = reverse_axes(bodies, turned)
    # Engines put compliance along the vertical of the body that a wheel is mounted on.
    names = {wheel.joint.name for wheel in wheels}
    mounts = {body.joint.parent for body in oriented if body.joint is not None and body.joint.name in names}
    return align_frames(oriented, mounts)


def _couplings(passive: Sequence[Joint], suspension: Suspension) -> tuple[Coupling, ...]:
    names = {joint.name for joint in passive}
    couplings = [
        Coupling(joint.mimic[0], joint.name, joint.mimic[1])
        for joint in passive
        if joint.mimic is not None and joint.mimic[0] in names - {joint.name}
    ]
    if suspension.differential is not None:
        couplings.append(Coupling(*suspension.differential, ratio=-1.0))
    return tuple(couplings)


def _describe_suspension(suspension: Suspension) -> list[str]:
    if not suspension.joints:
        return []
    lines = [f"suspension: {', '.join(suspension.joints)} turn freely"]
    if suspension.differential is not None:
        left, right = suspension.differential
        lines.append(f"suspension: a differential between {left} and {right} is assumed (the URDF has none)")
    return lines
