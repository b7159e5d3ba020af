"""Robots as physics engines load them: the URDF, roles of its joints and links, and variations of it."""

import math
from collections.abc import Collection, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, SubElement

from defusedxml.ElementTree import parse

from dune_rl.core.errors import PhysicsError
from dune_rl.physics.motors import Motor


@dataclass(frozen=True)
class PassiveJoint:
    """Joint without a motor, with dry friction and damping; its limits are the URDF's."""

    joint: str
    friction_nm: float = 0.0
    damping_nms_per_rad: float = 0.0


@dataclass(frozen=True)
class Coupling:
    """Gear without backlash: the angle of joint `follower` is `ratio` times that of joint `leader`."""

    leader: str
    follower: str
    ratio: float


@dataclass(frozen=True)
class Tyre:
    """Cylinder by which a wheel collides with everything but the ground: the tyre in its true width.

    An engine may round its edges by up to half of `width_m`. It is fixed to the wheel's `link`, with its
    `centre` (3) [m] and its unit `axis` (3) in that link's frame; `position_b` (3) [m] is its centre in the
    base link's frame with all joints at zero.
    """

    link: str
    radius_m: float
    width_m: float
    position_b: tuple[float, float, float]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)

    @property
    def reach_m(self) -> float:
        """Upper bound of the distance [m] of any of its points from the origin of its link."""
        return math.hypot(*self.centre) + math.hypot(self.radius_m, self.width_m / 2)


@dataclass(frozen=True)
class RobotBody:
    """URDF of a robot, and the roles of its joints and links.

    `motors` take commands, in their order. Joints that are neither theirs nor
    `passive` turn freely. Joints without a motor start at 0.

    `ground_links` are wheels or feet. They collide with the ground, with `ground_friction` (along a wheel's
    axle with `sideways_friction_share` of it), and with nothing else, unless `ground_links_meet_obstacles`.
    Wheels whose collision shapes are wider than they are, such as spheres, have `tyres` instead: these
    collide, with the same friction, with everything but the ground. All other links collide with everything,
    with `hull_friction`.

    `look` is a URDF with the same links and joints that is drawn in place of `urdf`.
    """

    urdf: Path
    motors: tuple[Motor, ...]
    ground_links: tuple[str, ...]
    ground_friction: float
    hull_friction: float = 0.3
    sideways_friction_share: float = 1.0
    ground_links_meet_obstacles: bool = False
    tyres: tuple[Tyre, ...] = ()
    look: Path | None = None
    passive: tuple[PassiveJoint, ...] = ()
    couplings: tuple[Coupling, ...] = ()

    @property
    def drive_joints(self) -> tuple[str, ...]:
        """Joints of the motors, in the order of commands and of `PhysicsRobot.drive_state`."""
        return tuple(motor.joint for motor in self.motors)

    def rest_commands(self) -> list[float]:
        """Commands that keep all joints at their start angles."""
        return [motor.rest_command for motor in self.motors]

    def describe_missing_names(self, joints: Collection[str], links: Collection[str]) -> str | None:
        """Error message for names that are not in the URDF; None if all are.

        `joints` and `links` are the names in the URDF.
        """
        used_joints = [*self.drive_joints, *(joint.joint for joint in self.passive)]
        for coupling in self.couplings:
            used_joints += [coupling.leader, coupling.follower]
        used_links = [*self.ground_links, *(tyre.link for tyre in self.tyres)]
        for kind, used, known in (("joint", used_joints, joints), ("link", used_links, links)):
            missing = [name for name in dict.fromkeys(used) if name not in known]
            if missing:
                return f"{self.urdf.name} has no {kind} {', '.join(missing)}; it has {', '.join(known)}"
        return None


# Below this share of the robot's mass, the base's own centre would have to move too far.
_MIN_BASE_SHARE = 0.1


@dataclass(frozen=True)
class BodyVariation:
    """Differences from a robot's URDF and motors.

    `mass_factor` multiplies the masses and inertias of all links; the centre of mass stays. `centre_shift_b`
    (3) [m] moves the centre of mass of the whole robot, in the base link's frame: only the base's own centre
    moves, by more than that, and the base's inertia about its centre stays. `motor_strength` is the share of
    their voltage that the motors get, see `scale_motors`.
    """

    mass_factor: float = 1.0
    centre_shift_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motor_strength: float = 1.0

    @property
    def keeps_masses(self) -> bool:
        """Whether the masses are the URDF's."""
        return self.mass_factor == 1.0 and not any(self.centre_shift_b)


AS_DESCRIBED = BodyVariation()


def scale_motors(motors: Sequence[Motor], strength: float) -> tuple[Motor, ...]:
    """The motors at `strength` times their voltage and current.

    A DC motor's stall torque and no-load speed are both proportional to its voltage (T = k V / R, w = V / k),
    so both are scaled and the slope between them stays, and so are a limit of the current and the speed up to
    which it acts; a motor without a no-load speed only loses torque. Gear friction and a controller's speed
    limit are not scaled.
    """
    if strength == 1.0:
        return tuple(motors)
    return tuple(
        replace(
            motor,
            max_torque_nm=motor.max_torque_nm * strength,
            no_load_speed_radps=motor.no_load_speed_radps * strength,
            full_torque_speed_radps=motor.full_torque_speed_radps * strength,
        )
        for motor in motors
    )


def read_urdf_body(urdf: Path, variation: BodyVariation = AS_DESCRIBED) -> Element:
    """The root of `urdf` with the masses of `variation`, without visual shapes; mesh paths are absolute.

    Raises PhysicsError if the file cannot be read, or the base is too light to move the centre of mass.
    """
    try:
        root = deepcopy(_parse_cached(urdf, urdf.stat().st_mtime_ns))
    except (OSError, ParseError) as error:
        raise PhysicsError(f"cannot read {urdf}: {error}") from error
    if variation.keeps_masses:
        return root
    base = _base_link(root, urdf)
    links = [link for link in root.findall("link") if link.find("inertial/mass") is not None]
    masses = [_mass(link) for link in links]
    if any(variation.centre_shift_b):
        base_mass = _mass(base) if base.find("inertial/mass") is not None else 0.0
        if base_mass < _MIN_BASE_SHARE * sum(masses):
            raise PhysicsError(
                f"{urdf.name}: the base link holds {base_mass:.3g} of {sum(masses):.3g} kg, too little to "
                "move the robot's centre of mass; "
                "leave randomisation.centre_x_m, centre_y_m and centre_z_m null"
            )
        _shift_centre(base, [part * sum(masses) / base_mass for part in variation.centre_shift_b])
    for link, mass in zip(links, masses, strict=True):
        _find_required(link, "inertial/mass").set("value", repr(mass * variation.mass_factor))
        inertia = link.find("inertial/inertia")
        if inertia is not None:
            for name, value in inertia.attrib.items():
                inertia.set(name, repr(float(value) * variation.mass_factor))
    return root


@lru_cache(maxsize=16)
def _parse_cached(urdf: Path, modified_ns: int) -> Element:
    root: Element = parse(urdf, forbid_dtd=True).getroot()
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for mesh in root.iterfind("link/collision/geometry/mesh"):
        name = mesh.get("filename", "")
        if "://" not in name:
            mesh.set("filename", str((urdf.parent / name).resolve()))
    return root


def _base_link(root: Element, urdf: Path) -> Element:
    children = {_find_required(joint, "child").get("link") for joint in root.findall("joint")}
    for link in root.findall("link"):
        if link.get("name") not in children:
            return link
    raise PhysicsError(f"{urdf.name} has no base link: each link is some joint's child")


def _shift_centre(link: Element, offset: Sequence[float]) -> None:
    inertial = _find_required(link, "inertial")
    origin = inertial.find("origin")
    if origin is None:
        origin = SubElement(inertial, "origin")
    centre = [float(part) for part in origin.get("xyz", "0 0 0").split()]
    origin.set("xyz", " ".join(repr(a + b) for a, b in zip(centre, offset, strict=True)))


def _mass(link: Element) -> float:
    return float(_find_required(link, "inertial/mass").get("value", "0"))


def _find_required(element: Element, path: str) -> Element:
    found = element.find(path)
    if found is None:
        raise PhysicsError(f"<{element.tag} name={element.get('name')!r}> has no {path}")
    return found
