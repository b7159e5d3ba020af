"""Drives that are not supported, recognised by several signs: mecanum and omnidirectional wheels, tracks."""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from dune_rl.core.untrusted_files import printable
from dune_rl.robots.urdf.bodies import RigidBody
from dune_rl.robots.urdf.model import UrdfModel
from dune_rl.robots.urdf.wheels import MIN_AXIS, Wheel

# Words in names are separated by anything but letters, or by case: "omni_wheel", "wheelMecanumFL".
_MECANUM = re.compile(r"me[ck]h?anum|swedish", re.IGNORECASE)
_OMNI = re.compile(r"(?<![a-z])omni(?=[^a-z]|wheel|$)", re.IGNORECASE)
_SIDEWAYS_PLUGIN = re.compile(
    r"mecanum|planar_?move|force_based_move|omni_?(drive|directional|base)", re.IGNORECASE
)
_TRACK = re.compile(r"(?<![a-z])(tracks?|treads?|crawlers?|caterpillar)(?![a-z]|_?width)", re.IGNORECASE)
_TRACK_PLUGIN = re.compile(r"tracked_?vehicle|track_?controller", re.IGNORECASE)
_LEAST_ROLLERS = 4
_LEAST_SCORE = 2


def refuse_unsupported_drives(bodies: Sequence[RigidBody], wheels: Sequence[Wheel], model: UrdfModel) -> None:
    """Raise `RobotError` if at least two signs say that the robot moves sideways, or that it has tracks.

    One name is one sign, and rollers or a controller that moves it sideways are two. Tracks that are modelled
    by wheels count as wheels.
    """
    for signs, text in (
        (
            _sideways_signs(bodies, wheels, model),
            "mecanum or omnidirectional wheels ({}), which are not supported; robot.drive.kind=skid_steer "
            "drives it as if they were plain ones.",
        ),
        (
            _track_signs(wheels, model),
            "tracks ({}), which are not supported; give each track a row of wheels (continuous joints about "
            "y, cylinders), or, where it has them, set robot.drive.kind=skid_steer.",
        ),
    ):
        if sum(weight for weight, _ in signs) >= _LEAST_SCORE:
            listed = printable("; ".join(sign for _, sign in signs))
            raise model.fault(f"the robot has {text.format(listed)}")


def _sideways_signs(
    bodies: Sequence[RigidBody], wheels: Sequence[Wheel], model: UrdfModel
) -> list[tuple[int, str]]:
    signs: list[tuple[int, str]] = []
    plugins = [name for name in model.hints.plugins if _SIDEWAYS_PLUGIN.search(name)]
    if plugins:
        signs.append((2, f"plugin {plugins[0]}"))
    links = {wheel.body.name for wheel in wheels}
    # A hub need not have a shape of its own: its rollers stand on the ground.
    turning = [joint for joint in model.joints.values() if joint.kind == "continuous"]
    rollers = Counter(joint.parent for joint in turning)
    hubs = [joint.child for joint in turning if rollers[joint.child] >= _LEAST_ROLLERS]
    if hubs:
        signs.append((2, f"rollers on link {hubs[0]}"))
    named = [wheel for wheel in wheels if _names_sideways(f"{wheel.joint.name} {wheel.body.name}")]
    if named:
        weight = 2 if len(named) == len(wheels) > 2 else 1
        signs.append((weight, f"wheels called {named[0].body.name}"))
    meshes = sorted({mesh for name in links for mesh in _meshes(name, model) if _names_sideways(mesh)})
    if meshes:
        signs.append((1, f"mesh {meshes[0].rpartition('/')[2]}"))
    if _names_sideways(model.name):
        signs.append((1, f"name {model.name}"))
    diagonal = sorted(links & model.hints.diagonal_grip)
    if diagonal:
        signs.append((2, f"fdir1 along a diagonal on link {diagonal[0]}"))
    if links and links <= model.hints.no_grip:
        signs.append((1, "wheels without friction (mu1 and mu2 are 0)"))
    return signs + _star_signs(bodies)


def _star_signs(bodies: Sequence[RigidBody]) -> list[tuple[int, str]]:
    """Three or more wheels whose horizontal axes point in different directions, as on kiwi drives."""
    angles = []
    for body in bodies:
        if not body.spins:
            continue
        axis = body.axis_b
        centre = body.points_b().mean(axis=0)
        outward = centre[:2] / max(float(np.linalg.norm(centre[:2])), 1e-9)
        # Axes that point outward, most of them askew to y.
        if abs(float(axis[:2] @ outward)) > MIN_AXIS:
            angles.append(float(np.arctan2(axis[1], axis[0]) % np.pi))
    askew = [angle for angle in angles if abs(np.sin(angle)) < MIN_AXIS]
    if len(angles) >= 3 and len({round(angle, 1) for angle in angles}) >= 3 and len(askew) >= 2:
        return [(2, f"{len(angles)} wheels about axes in different directions")]
    return []


def _meshes(link: str, model: UrdfModel) -> list[str]:
    shapes = (*model.links[link].collisions, *model.links[link].visuals)
    return [shape.mesh for shape in shapes if shape.mesh is not None]


def _names_sideways(text: str) -> bool:
    return bool(_MECANUM.search(text) or _OMNI.search(text))


def _track_signs(wheels: Sequence[Wheel], model: UrdfModel) -> list[tuple[int, str]]:
    signs: list[tuple[int, str]] = []
    plugins = [name for name in model.hints.plugins if _TRACK_PLUGIN.search(name)]
    if plugins:
        signs.append((2, f"plugin {plugins[0]}"))
    links = [name for name, link in model.links.items() if link.collisions and _TRACK.search(name)]
    if links and len({wheel.on_left for wheel in wheels}) < 2:
        signs.append((2, f"link {links[0]}, and no wheels on both sides"))
    return signs
