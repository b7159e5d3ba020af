"""Visual meshes of hyperdog, generated from its published dimensions.

`python -m dune_rl.robots.hyperdog.shapes` writes them. Low in polygons, in
metres, each in its link's frame (x forward, y left, z up); a file for each
colour. Legs are those of the left side: the URDF mirrors them for the right.
"""

from pathlib import Path

import numpy as np
import trimesh

from dune_rl.core.paths import assets_folder
from dune_rl.robots.drawing import Mesh, bevelled_box, box, cylinder, join_meshes, rounded_plate

_HIP_X, _HIP_Y = 0.175, 0.066
_HIP_OUT = 0.104
_UPPER, _LOWER, _FOOT_RADIUS = 0.150, 0.145, 0.02
_LENGTHWISE, _UP = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
_ENDS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def make_meshes() -> dict[str, Mesh]:
    """Each file's mesh, by the file's name without ending."""
    return {
        "body": join_meshes(_body()),
        "plates": join_meshes(_plates()),
        "body_servos": join_meshes(_body_servos()),
        "lenses": join_meshes(_lenses()),
        "hip": join_meshes(_hip()),
        "hip_servo": join_meshes(_hip_servo()),
        "upper": join_meshes(_upper()),
        "upper_plates": join_meshes(_upper_plates()),
        "knee_servo": join_meshes(_knee_servo()),
        "lower": join_meshes(_lower()),
        "lower_plates": join_meshes(_lower_plates()),
        "foot": _foot(),
    }


def write_meshes(folder: Path) -> None:
    """Write the meshes as STL files."""
    folder.mkdir(exist_ok=True)
    for name, mesh in make_meshes().items():
        mesh.export(folder / f"{name}.stl")


def _body() -> list[Mesh]:
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


def _plates() -> list[Mesh]:
    """Carbon: back, belly and flanks."""
    flat = [bevelled_box((0.0, 0.0, side * 0.034), (0.370, 0.120, 0.005), 0.002) for side in (-1, 1)]
    flanks = [box((0.0, side * 0.070, 0.0), (0.236, 0.004, 0.044)) for side in (-1, 1)]
    return [*flat, *flanks]


def _body_servos() -> list[Mesh]:
    """Black boxes: four servos at the hips, the computer on the back, the camera's face and the LiDAR."""
    servos = [bevelled_box((x * 0.152, y * 0.058, 0.0), (0.050, 0.040, 0.044), 0.003) for x, y in _ENDS]
    horns = [cylinder(0.013, 0.012, (x * 0.182, y * _HIP_Y, 0.0), _LENGTHWISE) for x, y in _ENDS]
    computer = bevelled_box((0.075, 0.0, 0.049), (0.100, 0.084, 0.024), 0.004)
    fins = [box((0.075, y, 0.064), (0.060, 0.004, 0.010)) for y in np.linspace(-0.030, 0.030, 6)]
    face = box((0.2325, 0.0, 0.028), (0.003, 0.076, 0.024))
    lidar = [
        cylinder(0.035, 0.020, (-0.04, 0.0, 0.080), _UP, 32),
        cylinder(0.031, 0.024, (-0.04, 0.0, 0.101), _UP, 32),
        cylinder(0.035, 0.006, (-0.04, 0.0, 0.115), _UP, 32),
    ]
    return [*servos, *horns, computer, *fins, face, *lidar]


def _lenses() -> list[Mesh]:
    return [cylinder(0.008, 0.006, (0.2345, y, 0.028), _LENGTHWISE) for y in (-0.024, 0.024)]


def _hip() -> list[Mesh]:
    """The bracket that turns about the body's servo, and carries the next one outward."""
    yoke = bevelled_box((0.0, 0.026, 0.0), (0.034, 0.050, 0.048), 0.006)
    cheeks = [bevelled_box((x, 0.062, 0.0), (0.007, 0.048, 0.050), 0.002) for x in (-0.0245, 0.0245)]
    return [yoke, *cheeks]


def _hip_servo() -> list[Mesh]:
    servo = bevelled_box((0.0, 0.064, -0.002), (0.041, 0.046, 0.044), 0.003)
    return [servo, cylinder(0.013, 0.010, (0.0, _HIP_OUT - 0.018, 0.0))]


def _upper() -> list[Mesh]:
    """Printed: a disc on the servo's horn, spacers, and the knee."""
    discs = [cylinder(0.024, 0.007, (0.0, y, 0.0)) for y in (-0.0145, 0.0145)]
    bolts = [
        cylinder(0.0035, 0.034, (0.014 * np.cos(a), 0.0, 0.014 * np.sin(a)), sections=8)
        for a in np.arange(4) * np.pi / 2
    ]
    return [*discs, *bolts, cylinder(0.015, 0.036, (0.0, 0.0, -_UPPER))]


def _upper_plates() -> list[Mesh]:
    ends = np.array([0.0, 0.0]), np.array([0.0, -_UPPER])
    return [rounded_plate(*ends, (0.021, 0.014), 0.004, y) for y in (-0.0145, 0.0145)]


def _knee_servo() -> list[Mesh]:
    return [bevelled_box((0.0, 0.0, -0.058), (0.034, 0.024, 0.052), 0.003)]


def _lower() -> list[Mesh]:
    """Printed: the knee's hub, and the socket of the foot."""
    socket = cylinder(0.0115, 0.034, (0.0, 0.0, -_LOWER + 0.024), _UP, 16)
    return [cylinder(0.012, 0.024, (0.0, 0.0, 0.0)), socket]


def _lower_plates() -> list[Mesh]:
    ends = np.array([0.0, 0.0]), np.array([0.0, -_LOWER + 0.035])
    return [rounded_plate(*ends, (0.014, 0.009), 0.014)]


def _foot() -> Mesh:
    foot = trimesh.creation.icosphere(subdivisions=2, radius=_FOOT_RADIUS)
    foot.apply_translation((0.0, 0.0, -_LOWER))
    return foot


if __name__ == "__main__":
    write_meshes(assets_folder() / "robots" / "hyperdog" / "meshes")
