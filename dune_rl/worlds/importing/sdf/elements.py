"""Numbers, poses and primitive shapes of SDF files."""

from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from numpy.typing import NDArray

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport, printable
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.light import LightConf

Mesh = tuple[Array, NDArray[np.int32]]

_ROUND_SIDES = 24
_LARGEST_M = 1e5
Colour = tuple[float, float, float]


def parse_numbers(element: Element | None, count: int, default: tuple[float, ...]) -> Array:
    """The `count` finite numbers in an element; `default` without an element or text."""
    text = None if element is None else (element.text or "").strip()
    if not text or element is None:
        return np.array(default, np.float64)
    try:
        found = np.array([float(word) for word in text.split()], np.float64)
    except ValueError:
        found = np.zeros(0)
    if len(found) != count or not np.isfinite(found).all():
        raise WorldError(f"<{element.tag}> must hold {count} numbers (got {printable(text, 60)!r}).")
    return found


def parse_pose(element: Element) -> Array:
    """The transform (4, 4) of an element's <pose>: by default x y z [m] and roll pitch yaw [rad]."""
    pose = element.find("pose")
    if pose is None:
        return np.eye(4)
    matrix = np.eye(4)
    if pose.get("rotation_format") == "quat_xyzw":
        found = parse_numbers(pose, 7, (0, 0, 0, 0, 0, 0, 1))
        x, y, z, w = found[3:] / max(float(np.linalg.norm(found[3:])), 1e-12)
        matrix = trimesh.transformations.quaternion_matrix([w, x, y, z])
    else:
        found = parse_numbers(pose, 6, (0,) * 6)
        angles = np.deg2rad(found[3:]) if pose.get("degrees") in ("true", "1") else found[3:]
        matrix = trimesh.transformations.euler_matrix(angles[0], angles[1], angles[2], "sxyz")
    matrix = np.asarray(matrix, np.float64)
    matrix[:3, 3] = found[:3]
    return matrix


def build_primitive(element: Element) -> Mesh | None:
    """The closed surface of a <box>, <cylinder>, <cone>, <sphere>, <ellipsoid> or <capsule>; else None."""
    kind = element.tag
    if kind == "box":
        solid = trimesh.creation.box(_parse_lengths(element, "size", 3, (1, 1, 1)))
    elif kind == "cylinder":
        radius, length = _parse_round(element)
        solid = trimesh.creation.cylinder(radius, length, sections=_ROUND_SIDES)
    elif kind == "cone":
        radius, length = _parse_round(element)
        solid = trimesh.creation.cone(radius, length, sections=_ROUND_SIDES)
        solid.vertices[:, 2] -= length / 2
    elif kind == "capsule":
        radius, length = _parse_round(element)
        solid = trimesh.creation.capsule(length, radius, count=(_ROUND_SIDES, _ROUND_SIDES))
        solid.vertices[:, 2] -= solid.vertices[:, 2].min() + radius + length / 2
    elif kind == "sphere":
        radius = float(_parse_lengths(element, "radius", 1, (1,))[0])
        solid = trimesh.creation.icosphere(2, radius)
    elif kind == "ellipsoid":
        solid = trimesh.creation.icosphere(2, 1.0)
        solid.vertices *= _parse_lengths(element, "radii", 3, (1, 1, 1))
    else:
        return None
    return np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int32)


def build_plane(element: Element, least_m: Array) -> Mesh:
    """A <plane> as two triangles of its size, at least `least_m` (2,): Gazebo's planes are infinite."""
    normal = parse_numbers(element.find("normal"), 3, (0, 0, 1))
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        raise WorldError("<normal> of a <plane> must not be zero.")
    half = np.maximum(_parse_lengths(element, "size", 2, (1, 1)), least_m) / 2
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 1.0]
    turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], normal / length)[:3, :3]
    return corners @ np.asarray(turn).T, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def _parse_round(element: Element) -> tuple[float, float]:
    return float(_parse_lengths(element, "radius", 1, (0.5,))[0]), float(
        _parse_lengths(element, "length", 1, (1,))[0]
    )


def _parse_lengths(element: Element, name: str, count: int, default: tuple[float, ...]) -> Array:
    found = parse_numbers(element.find(name), count, default)
    if not ((found > 0) & (found <= _LARGEST_M)).all():
        raise WorldError(f"<{name}> of a <{element.tag}> must be above 0 and at most {_LARGEST_M:g} m.")
    return found


def parse_sun(element: Element, turn: Array, report: ImportReport) -> LightConf | None:
    """The sun of a <light> with orientation `turn` (3, 3); None, with a warning, if it shines upwards."""
    to_sun = -turn @ parse_numbers(element.find("direction"), 3, (0, 0, -1))
    length = float(np.linalg.norm(to_sun))
    if length < 1e-9 or to_sun[2] / length < 0.02:
        report.warn("its directional light does not come from above and is left out")
        return None
    return LightConf(
        sun_bearing_deg=float(np.rad2deg(np.arctan2(to_sun[1], to_sun[0]))),
        sun_elevation_deg=float(np.clip(np.rad2deg(np.arcsin(to_sun[2] / length)), 1.0, 90.0)),
        shadows=(element.findtext("cast_shadows") or "true").strip() in ("true", "1"),
        sun_colour=_colour(element, report),
    )


def _colour(element: Element, report: ImportReport) -> Colour:
    words = (element.findtext("diffuse") or "1 1 1").split()
    try:
        red, green, blue = (float(np.clip(float(word), 0.0, 1.0)) for word in words[:3])
        if np.isfinite([red, green, blue]).all() and max(red, green, blue) > 0.0:
            return red, green, blue
    except ValueError:
        pass
    report.warn(f"<diffuse> of its sun, {printable(' '.join(words), 40)!r}, is no colour of a light")
    return 1.0, 1.0, 1.0
