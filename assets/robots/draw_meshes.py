"""Draws the visual meshes of our robots from published dimensions: `python assets/robots/draw_meshes.py`.

Low in polygons, in metres, each in its link's frame (x forward, y left, z up); a file for each colour.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import cast

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix

Mesh = trimesh.Trimesh
Triple = tuple[float, float, float]

ACROSS, _UP, _LENGTHWISE = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)


def join_meshes(parts: Iterable[Mesh]) -> Mesh:
    """All parts as one mesh."""
    return cast(Mesh, trimesh.util.concatenate(list(parts)))


def box(centre: Triple, size: Triple, pitch: float = 0.0) -> Mesh:
    """A box with its front turned down by `pitch` [rad]."""
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(rotation_matrix(pitch, ACROSS))
    mesh.apply_translation(centre)
    return mesh


def cylinder(radius: float, length: float, centre: Triple, axis: Triple = ACROSS, sections: int = 24) -> Mesh:
    """A cylinder about `axis`."""
    mesh = trimesh.creation.cylinder(radius, length, sections=sections)
    mesh.apply_transform(
        trimesh.geometry.align_vectors((0.0, 0.0, 1.0), np.array(axis) / np.linalg.norm(axis))
    )
    mesh.apply_translation(centre)
    return mesh


def bevelled_box(centre: Triple, size: Triple, bevel: float) -> Mesh:
    """A box with edges cut off at 45 degrees, by `bevel` [m]."""
    half = np.array(size) / 2
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = np.concatenate([signs * (half - bevel * np.eye(3)[axis]) for axis in range(3)])
    return Mesh(corners + centre).convex_hull


def rounded_plate(
    start: np.ndarray, end: np.ndarray, radii: tuple[float, float], width: float, y: float = 0.0
) -> Mesh:
    """Convex hull of two discs about y, at points (x, z), extruded by `width`."""
    angle = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points = [
        np.insert(middle + radius * circle, 1, y + side * width / 2, axis=1)
        for middle, radius in zip((start, end), radii, strict=True)
        for side in (-1, 1)
    ]
    return Mesh(np.concatenate(points)).convex_hull


def tyre(radius: float, width: float, rim: float, lugs: int, tread: float, y: float = 0.0) -> Mesh:
    """A tyre about the y axis, centred at `y`, with `lugs` chevrons of height `tread` up to `radius`."""
    half, ground = width / 2, radius - tread
    shoulder, side = 0.45 * (ground - rim), 0.07 * width
    profile = [
        (rim, -half + side),
        (rim + shoulder, -half),
        (ground - tread / 2, -half + side),
        (ground, -half + 3 * side),
        (ground, half - 3 * side),
        (ground - tread / 2, half - side),
        (rim + shoulder, half),
        (rim, half - side),
        (rim, -half + side),
    ]
    carcass = trimesh.creation.revolve(np.array(profile), sections=2 * lugs)
    carcass.apply_transform(rotation_matrix(-np.pi / 2, (1.0, 0.0, 0.0)))
    carcass.apply_translation((0.0, y, 0.0))
    parts = [carcass]
    for number in range(2 * lugs):
        # Lugs alternate between the sides and slant to the middle.
        end = 1 if number % 2 else -1
        lug = trimesh.creation.box((0.38 * 2 * np.pi * radius / (2 * lugs) * 1.9, 0.43 * width, 2 * tread))
        lug.apply_transform(rotation_matrix(end * 0.45, (0.0, 0.0, 1.0)))
        lug.apply_translation((0.0, end * 0.235 * width, radius - tread))
        lug.apply_transform(rotation_matrix(np.pi * number / lugs, ACROSS))
        lug.apply_translation((0.0, y, 0.0))
        parts.append(lug)
    return join_meshes(parts)


_ROVER_RADIUS, _ROVER_WIDTH, _ROVER_RIM = 0.125, 0.083, 0.070


def rover_zero() -> dict[str, Mesh]:
    return {
        "chassis": join_meshes(_rover_chassis()),
        "plate": join_meshes(_rover_plate()),
        "trim": join_meshes(_rover_trim()),
        "sensors": join_meshes(_rover_sensors()),
        "lens": cylinder(0.010, 0.008, (0.262, 0.0, 0.112), (1.0, 0.0, 0.0)),
        "tyre": tyre(_ROVER_RADIUS, _ROVER_WIDTH, _ROVER_RIM, 20, 0.007),
        "rim": join_meshes(_rover_rim()),
        "hub": join_meshes(_rover_hub()),
    }


def _rover_chassis() -> list[Mesh]:
    tub = bevelled_box((0.0, 0.0, 0.016), (0.520, 0.244, 0.112), 0.022)
    axles = [cylinder(0.022, 0.300, (x, 0.0, 0.0)) for x in (0.1415, -0.145)]
    return [tub, *axles]


def _rover_plate() -> list[Mesh]:
    lid = bevelled_box((0.0, 0.0, 0.086), (0.560, 0.250, 0.012), 0.004)
    stripes = [box((0.0, side * 0.1225, 0.030), (0.300, 0.004, 0.022)) for side in (-1, 1)]
    return [lid, *stripes]


def _rover_trim() -> list[Mesh]:
    posts = [cylinder(0.009, 0.012, (x, y, 0.076), _UP, 12) for x in (-0.22, 0.0, 0.22) for y in (-0.1, 0.1)]
    bumpers = [bevelled_box((end * 0.285, 0.0, 0.020), (0.050, 0.270, 0.044), 0.012) for end in (-1, 1)]
    slots = [box((x, 0.0, 0.0925), (0.016, 0.170, 0.002)) for x in (-0.23, -0.18, -0.13, -0.08, -0.03, 0.02)]
    camera = bevelled_box((0.250, 0.0, 0.112), (0.022, 0.090, 0.026), 0.005)
    spinning = cylinder(0.036, 0.034, (0.174, 0.0, 0.184), _UP)
    return [*posts, *bumpers, *slots, camera, spinning]


def _rover_sensors() -> list[Mesh]:
    foot = bevelled_box((0.174, 0.0, 0.112), (0.080, 0.080, 0.040), 0.010)
    neck = cylinder(0.030, 0.040, (0.174, 0.0, 0.150), _UP)
    cap = cylinder(0.036, 0.006, (0.174, 0.0, 0.204), _UP)
    return [foot, neck, cap]


def _rover_rim() -> list[Mesh]:
    ring = trimesh.creation.annulus(0.058, _ROVER_RIM + 0.002, 0.066, sections=40)
    ring.apply_transform(rotation_matrix(np.pi / 2, (1.0, 0.0, 0.0)))
    spokes = []
    for number in range(5):
        spoke = box((0.0, 0.022, 0.040), (0.020, 0.012, 0.048))
        spoke.apply_transform(rotation_matrix(2 * np.pi * number / 5, ACROSS))
        spokes.append(spoke)
    return [ring, *spokes]


def _rover_hub() -> list[Mesh]:
    back = cylinder(0.060, 0.020, (0.0, -0.006, 0.0), sections=32)
    cap = cylinder(0.020, 0.016, (0.0, 0.028, 0.0), sections=16)
    return [back, cap]


_LEO_TYRE_Y = -0.0449
_LEO_TREAD_RADIUS, _LEO_TYRE_WIDTH = 0.0625, 0.07
_LEO_HINGE_TO_HUB = np.array([0.1526, -0.088])


def leo_rover() -> dict[str, Mesh]:
    return {
        "body": join_meshes(_leo_body()),
        "trim": join_meshes(_leo_trim()),
        "lens": cylinder(0.011, 0.006, (0.1215, 0.0, -0.0485), (1.0, 0.0, -0.21)),
        "mast": join_meshes(_leo_mast()),
        "rocker": join_meshes(_leo_rocker()),
        "motors": join_meshes(_leo_motors()),
        "tyre": tyre(_LEO_TREAD_RADIUS, _LEO_TYRE_WIDTH, 0.0355, 18, 0.0055, _LEO_TYRE_Y),
        "hub": join_meshes(_leo_hub()),
        "hub_cap": join_meshes(_leo_hub_cap()),
    }


def _leo_body() -> list[Mesh]:
    shell = bevelled_box((-0.008, 0.0, -0.046), (0.236, 0.206, 0.080), 0.014)
    nose = bevelled_box((0.104, 0.0, -0.050), (0.030, 0.120, 0.056), 0.008)
    return [shell, nose]


def _leo_trim() -> list[Mesh]:
    deck = bevelled_box((-0.008, 0.0, -0.002), (0.246, 0.196, 0.009), 0.003)
    belly = bevelled_box((-0.008, 0.0, -0.087), (0.210, 0.180, 0.010), 0.004)
    rails = [box((-0.008, side * 0.086, 0.007), (0.230, 0.012, 0.009)) for side in (-1, 1)]
    battery = bevelled_box((-0.128, 0.0, -0.046), (0.026, 0.120, 0.058), 0.006)
    camera = box((0.1175, 0.0, -0.047), (0.010, 0.046, 0.034), 0.21)
    hinges = [cylinder(0.022, 0.014, (0.0026, side * 0.108, -0.0473)) for side in (-1, 1)]
    antenna = cylinder(0.0055, 0.056, (-0.0052, 0.056, 0.028), (0.0, 0.0, 1.0), 12)
    # The bar of the differential, over the back of the body.
    bar = box((-0.100, 0.0, 0.012), (0.014, 0.230, 0.010))
    return [deck, belly, *rails, battery, camera, *hinges, antenna, bar]


def _leo_mast() -> list[Mesh]:
    foot = cylinder(0.028, 0.010, (0.0, 0.0, 0.008), _UP)
    pole = cylinder(0.008, 0.560, (0.0, 0.0, 0.285), _UP, 12)
    shelf = cylinder(0.040, 0.006, (0.0, 0.0, 0.566), _UP)
    lidar = [cylinder(0.035, 0.024, (0.0, 0.0, 0.581), _UP), cylinder(0.031, 0.026, (0.0, 0.0, 0.606), _UP)]
    return [foot, pole, shelf, *lidar, cylinder(0.035, 0.006, (0.0, 0.0, 0.622), _UP)]


def _leo_rocker() -> list[Mesh]:
    x, z = _LEO_HINGE_TO_HUB
    parts = [rounded_plate(np.array([-0.045, 0.004]), np.array([0.045, 0.004]), (0.028, 0.028), 0.026)]
    for end in (-1, 1):
        knee = np.array([end * 0.118, -0.012])
        parts.append(rounded_plate(np.array([end * 0.045, 0.004]), knee, (0.026, 0.020), 0.026))
        parts.append(rounded_plate(knee, np.array([end * x, z]), (0.020, 0.023), 0.026))
    return parts


def _leo_motors() -> list[Mesh]:
    x, z = _LEO_HINGE_TO_HUB
    housings = [cylinder(0.019, 0.046, (end * x, 0.012, z)) for end in (-1, 1)]
    return [*housings, cylinder(0.020, 0.036, (0.0, 0.0, 0.0))]


def _leo_hub() -> list[Mesh]:
    rim = trimesh.creation.annulus(0.028, 0.0365, 0.062, sections=32)
    rim.apply_transform(rotation_matrix(np.pi / 2, (1.0, 0.0, 0.0)))
    rim.apply_translation((0.0, _LEO_TYRE_Y, 0.0))
    spokes = []
    for number in range(6):
        spoke = box((0.0, _LEO_TYRE_Y + 0.024, 0.018), (0.011, 0.010, 0.026))
        spoke.apply_transform(rotation_matrix(np.pi * number / 3, ACROSS))
        spokes.append(spoke)
    return [rim, *spokes]


def _leo_hub_cap() -> list[Mesh]:
    back = cylinder(0.030, 0.012, (0.0, _LEO_TYRE_Y + 0.012, 0.0))
    nut = cylinder(0.011, 0.014, (0.0, _LEO_TYRE_Y + 0.030, 0.0), sections=6)
    return [back, nut]


_DOG_HIP_X, _DOG_HIP_Y = 0.175, 0.066
_DOG_HIP_OUT = 0.104
_DOG_UPPER, _DOG_LOWER, _DOG_FOOT_RADIUS = 0.150, 0.145, 0.02
_DOG_ENDS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def hyperdog() -> dict[str, Mesh]:
    return {
        "body": join_meshes(_dog_body()),
        "plates": join_meshes(_dog_plates()),
        "body_servos": join_meshes(_dog_body_servos()),
        "lenses": join_meshes(_dog_lenses()),
        "hip": join_meshes(_dog_hip()),
        "hip_servo": join_meshes(_dog_hip_servo()),
        "upper": join_meshes(_dog_upper()),
        "upper_plates": join_meshes(_dog_upper_plates()),
        "knee_servo": join_meshes(_dog_knee_servo()),
        "lower": join_meshes(_dog_lower()),
        "lower_plates": join_meshes(_dog_lower_plates()),
        "foot": _dog_foot(),
    }


def _dog_body() -> list[Mesh]:
    """Printed parts: the frames that hold the hips' servos, the head, ribs, and the shelf of the LiDAR."""
    frames = [bevelled_box((end * 0.196, 0.0, 0.0), (0.016, 0.176, 0.062), 0.006) for end in (-1, 1)]
    inner = [bevelled_box((end * 0.118, 0.0, 0.0), (0.018, 0.160, 0.060), 0.005) for end in (-1, 1)]
    head = bevelled_box((0.216, 0.0, 0.026), (0.032, 0.096, 0.040), 0.010)
    ribs = [box((x, 0.0, 0.0), (0.010, 0.148, 0.056)) for x in (-0.05, 0.0, 0.05)]
    posts = [
        cylinder(0.005, 0.030, (-0.04 + x, y, 0.052), _UP, 10) for x in (-0.03, 0.03) for y in (-0.03, 0.03)
    ]
    shelf = cylinder(0.046, 0.005, (-0.04, 0.0, 0.068), _UP)
    return [*frames, *inner, head, *ribs, *posts, shelf]


def _dog_plates() -> list[Mesh]:
    """Carbon: back, belly and flanks."""
    flat = [bevelled_box((0.0, 0.0, side * 0.034), (0.370, 0.120, 0.005), 0.002) for side in (-1, 1)]
    flanks = [box((0.0, side * 0.070, 0.0), (0.236, 0.004, 0.044)) for side in (-1, 1)]
    return [*flat, *flanks]


def _dog_body_servos() -> list[Mesh]:
    """Black boxes: four servos at the hips, the computer on the back, the camera's face and the LiDAR."""
    servos = [bevelled_box((x * 0.152, y * 0.058, 0.0), (0.050, 0.040, 0.044), 0.003) for x, y in _DOG_ENDS]
    horns = [cylinder(0.013, 0.012, (x * 0.182, y * _DOG_HIP_Y, 0.0), _LENGTHWISE) for x, y in _DOG_ENDS]
    computer = bevelled_box((0.075, 0.0, 0.049), (0.100, 0.084, 0.024), 0.004)
    fins = [box((0.075, y, 0.064), (0.060, 0.004, 0.010)) for y in np.linspace(-0.030, 0.030, 6)]
    face = box((0.2325, 0.0, 0.028), (0.003, 0.076, 0.024))
    lidar = [
        cylinder(0.035, 0.020, (-0.04, 0.0, 0.080), _UP, 32),
        cylinder(0.031, 0.024, (-0.04, 0.0, 0.101), _UP, 32),
        cylinder(0.035, 0.006, (-0.04, 0.0, 0.115), _UP, 32),
    ]
    return [*servos, *horns, computer, *fins, face, *lidar]


def _dog_lenses() -> list[Mesh]:
    return [cylinder(0.008, 0.006, (0.2345, y, 0.028), _LENGTHWISE) for y in (-0.024, 0.024)]


def _dog_hip() -> list[Mesh]:
    """The bracket that turns about the body's servo, and carries the next one outward."""
    yoke = bevelled_box((0.0, 0.026, 0.0), (0.034, 0.050, 0.048), 0.006)
    cheeks = [bevelled_box((x, 0.062, 0.0), (0.007, 0.048, 0.050), 0.002) for x in (-0.0245, 0.0245)]
    return [yoke, *cheeks]


def _dog_hip_servo() -> list[Mesh]:
    servo = bevelled_box((0.0, 0.064, -0.002), (0.041, 0.046, 0.044), 0.003)
    return [servo, cylinder(0.013, 0.010, (0.0, _DOG_HIP_OUT - 0.018, 0.0))]


def _dog_upper() -> list[Mesh]:
    """Printed: a disc on the servo's horn, spacers, and the knee."""
    discs = [cylinder(0.024, 0.007, (0.0, y, 0.0)) for y in (-0.0145, 0.0145)]
    bolts = [
        cylinder(0.0035, 0.034, (0.014 * np.cos(a), 0.0, 0.014 * np.sin(a)), sections=8)
        for a in np.arange(4) * np.pi / 2
    ]
    return [*discs, *bolts, cylinder(0.015, 0.036, (0.0, 0.0, -_DOG_UPPER))]


def _dog_upper_plates() -> list[Mesh]:
    ends = np.array([0.0, 0.0]), np.array([0.0, -_DOG_UPPER])
    return [rounded_plate(*ends, (0.021, 0.014), 0.004, y) for y in (-0.0145, 0.0145)]


def _dog_knee_servo() -> list[Mesh]:
    return [bevelled_box((0.0, 0.0, -0.058), (0.034, 0.024, 0.052), 0.003)]


def _dog_lower() -> list[Mesh]:
    """Printed: the knee's hub, and the socket of the foot."""
    socket = cylinder(0.0115, 0.034, (0.0, 0.0, -_DOG_LOWER + 0.024), _UP, 16)
    return [cylinder(0.012, 0.024, (0.0, 0.0, 0.0)), socket]


def _dog_lower_plates() -> list[Mesh]:
    ends = np.array([0.0, 0.0]), np.array([0.0, -_DOG_LOWER + 0.035])
    return [rounded_plate(*ends, (0.014, 0.009), 0.014)]


def _dog_foot() -> Mesh:
    foot = trimesh.creation.icosphere(subdivisions=2, radius=_DOG_FOOT_RADIUS)
    foot.apply_translation((0.0, 0.0, -_DOG_LOWER))
    return foot


ROBOTS: dict[str, Callable[[], dict[str, Mesh]]] = {
    "hyperdog": hyperdog,
    "leo_rover": leo_rover,
    "rover_zero": rover_zero,
}

if __name__ == "__main__":
    for name, draw in ROBOTS.items():
        for part, mesh in draw().items():
            mesh.export(Path(__file__).parent / name / "meshes" / f"{part}.stl")
