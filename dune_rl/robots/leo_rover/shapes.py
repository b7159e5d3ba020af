"""Visual meshes of leo_rover, generated from its published dimensions.

`python -m dune_rl.robots.leo_rover.shapes` writes them. Low in polygons, in metres,
each in its link's frame (x forward, y left, z up); a file for each colour.
"""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix

from dune_rl.core.paths import assets_folder
from dune_rl.robots.drawing import ACROSS, Mesh, bevelled_box, box, cylinder, join_meshes, rounded_plate, tyre

# From a left wheel's joint, at the outside of its hub, to the middle of its tyre.
_TYRE_Y = -0.0449
_TREAD_RADIUS, _TYRE_WIDTH = 0.0625, 0.07
_HINGE_TO_HUB = np.array([0.1526, -0.088])


def make_meshes() -> dict[str, Mesh]:
    """Each file's mesh, by the file's name without ending."""
    return {
        "body": join_meshes(_body()),
        "trim": join_meshes(_trim()),
        "lens": cylinder(0.011, 0.006, (0.1215, 0.0, -0.0485), (1.0, 0.0, -0.21)),
        "mast": join_meshes(_mast()),
        "rocker": join_meshes(_rocker()),
        "motors": join_meshes(_motors()),
        "tyre": tyre(_TREAD_RADIUS, _TYRE_WIDTH, 0.0355, 18, 0.0055, _TYRE_Y),
        "hub": join_meshes(_hub()),
        "hub_cap": join_meshes(_hub_cap()),
    }


def write_meshes(folder: Path) -> None:
    """Write the meshes as STL files."""
    for name, mesh in make_meshes().items():
        mesh.export(folder / f"{name}.stl")


def _body() -> list[Mesh]:
    shell = bevelled_box((-0.008, 0.0, -0.046), (0.236, 0.206, 0.080), 0.014)
    nose = bevelled_box((0.104, 0.0, -0.050), (0.030, 0.120, 0.056), 0.008)
    return [shell, nose]


def _trim() -> list[Mesh]:
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


def _mast() -> list[Mesh]:
    up = (0.0, 0.0, 1.0)
    foot = cylinder(0.028, 0.010, (0.0, 0.0, 0.008), up)
    pole = cylinder(0.008, 0.560, (0.0, 0.0, 0.285), up, 12)
    shelf = cylinder(0.040, 0.006, (0.0, 0.0, 0.566), up)
    lidar = [cylinder(0.035, 0.024, (0.0, 0.0, 0.581), up), cylinder(0.031, 0.026, (0.0, 0.0, 0.606), up)]
    return [foot, pole, shelf, *lidar, cylinder(0.035, 0.006, (0.0, 0.0, 0.622), up)]


def _rocker() -> list[Mesh]:
    x, z = _HINGE_TO_HUB
    parts = [rounded_plate(np.array([-0.045, 0.004]), np.array([0.045, 0.004]), (0.028, 0.028), 0.026)]
    for end in (-1, 1):
        knee = np.array([end * 0.118, -0.012])
        parts.append(rounded_plate(np.array([end * 0.045, 0.004]), knee, (0.026, 0.020), 0.026))
        parts.append(rounded_plate(knee, np.array([end * x, z]), (0.020, 0.023), 0.026))
    return parts


def _motors() -> list[Mesh]:
    x, z = _HINGE_TO_HUB
    housings = [cylinder(0.019, 0.046, (end * x, 0.012, z)) for end in (-1, 1)]
    return [*housings, cylinder(0.020, 0.036, (0.0, 0.0, 0.0))]


def _hub() -> list[Mesh]:
    rim = trimesh.creation.annulus(0.028, 0.0365, 0.062, sections=32)
    rim.apply_transform(rotation_matrix(np.pi / 2, (1.0, 0.0, 0.0)))
    rim.apply_translation((0.0, _TYRE_Y, 0.0))
    spokes = []
    for number in range(6):
        spoke = box((0.0, _TYRE_Y + 0.024, 0.018), (0.011, 0.010, 0.026))
        spoke.apply_transform(rotation_matrix(np.pi * number / 3, ACROSS))
        spokes.append(spoke)
    return [rim, *spokes]


def _hub_cap() -> list[Mesh]:
    back = cylinder(0.030, 0.012, (0.0, _TYRE_Y + 0.012, 0.0))
    nut = cylinder(0.011, 0.014, (0.0, _TYRE_Y + 0.030, 0.0), sections=6)
    return [back, nut]


if __name__ == "__main__":
    write_meshes(assets_folder() / "robots" / "leo_rover" / "meshes")
