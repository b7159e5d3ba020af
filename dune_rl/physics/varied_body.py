"""A robot's body other than its URDF has it: heavier, its weight elsewhere, its motors weaker."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from defusedxml.ElementTree import parse

from dune_rl.errors import PhysicsError
from dune_rl.physics.motors import Motor

# A base lighter than this beside the whole robot would have to move its own centre too far.
_LEAST_SHARE = 0.1


@dataclass(frozen=True)
class BodyVariation:
    """What differs from a robot as it is described.

    `mass_factor` multiplies the masses and inertias of all links, which leaves
    the robot's proportions and its centre of mass. `centre_shift_b` (3) [m]
    moves the centre of mass of the whole robot, in the base link's frame: the
    base's own moves by more, as the wheels' and legs' stay where they are; its
    inertia about its centre is kept. `motor_strength` is the motors' share of
    their voltage, see `motors_at`.
    """

    mass_factor: float = 1.0
    centre_shift_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motor_strength: float = 1.0

    @property
    def is_of_the_urdf(self) -> bool:
        """Whether masses are as they are described."""
        return self.mass_factor == 1.0 and not any(self.centre_shift_b)


AS_DESCRIBED = BodyVariation()


def motors_at(motors: Sequence[Motor], strength: float) -> tuple[Motor, ...]:
    """The motors at `strength` times their voltage.

    A DC motor's stall torque and its speed without load are both proportional
    to its voltage (T = k V / R, w = V / k), so both are scaled and the slope
    between them stays; a motor without such a speed gives less torque at any.
    Gears' friction and a controller's bound on speed are not of the voltage.
    """
    if strength == 1.0:
        return tuple(motors)
    return tuple(
        replace(
            motor,
            max_torque_nm=motor.max_torque_nm * strength,
            no_load_speed_radps=motor.no_load_speed_radps * strength,
        )
        for motor in motors
    )


def varied_urdf(urdf: Path, variation: BodyVariation) -> str:
    """The text of `urdf` with the masses of `variation`, without looks; meshes have absolute paths.

    Raises PhysicsError where the base is too light for the centre to be moved.
    """
    root = _parsed(urdf)
    base = _base(root, urdf)
    links = [link for link in root.findall("link") if link.find("inertial/mass") is not None]
    masses = [_mass(link) for link in links]
    if any(variation.centre_shift_b):
        own = _mass(base) if base.find("inertial/mass") is not None else 0.0
        if own < _LEAST_SHARE * sum(masses):
            raise PhysicsError(
                f"{urdf.name}: the base link holds {own:.3g} of {sum(masses):.3g} kg, too little to move the "
                "robot's centre of mass; leave randomisation.centre_x_m, centre_y_m and centre_z_m null"
            )
        _shift(base, [part * sum(masses) / own for part in variation.centre_shift_b])
    for link, mass in zip(links, masses, strict=True):
        _required(link, "inertial/mass").set("value", repr(mass * variation.mass_factor))
        inertia = link.find("inertial/inertia")
        if inertia is not None:
            for name, value in inertia.attrib.items():
                inertia.set(name, repr(float(value) * variation.mass_factor))
    return tostring(root, encoding="unicode")


def _parsed(urdf: Path) -> Element:
    return _copy(_bare(urdf, urdf.stat().st_mtime_ns))


@lru_cache(maxsize=16)
def _bare(urdf: Path, changed_ns: int) -> Element:
    root: Element = parse(urdf, forbid_dtd=True).getroot()
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for mesh in root.iterfind("link/collision/geometry/mesh"):
        name = mesh.get("filename", "")
        if "://" not in name:
            mesh.set("filename", str((urdf.parent / name).resolve()))
    return root


def _copy(element: Element) -> Element:
    made = Element(element.tag, dict(element.attrib))
    made.text = element.text
    made.extend([_copy(child) for child in element])
    return made


def _base(root: Element, urdf: Path) -> Element:
    children = {_required(joint, "child").get("link") for joint in root.findall("joint")}
    for link in root.findall("link"):
        if link.get("name") not in children:
            return link
    raise PhysicsError(f"{urdf.name} has no base link: each link is some joint's child")


def _shift(link: Element, by: Sequence[float]) -> None:
    inertial = _required(link, "inertial")
    origin = inertial.find("origin")
    if origin is None:
        origin = SubElement(inertial, "origin")
    at = [float(part) for part in origin.get("xyz", "0 0 0").split()]
    origin.set("xyz", " ".join(repr(a + b) for a, b in zip(at, by, strict=True)))


def _mass(link: Element) -> float:
    return float(_required(link, "inertial/mass").get("value", "0"))


def _required(element: Element, path: str) -> Element:
    found = element.find(path)
    if found is None:
        raise PhysicsError(f"<{element.tag} name={element.get('name')!r}> has no {path}")
    return found
