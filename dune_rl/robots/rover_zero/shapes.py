"""Visual meshes of rover_zero, generated from its published dimensions.

`python -m dune_rl.robots.rover_zero.shapes` writes them. Low in polygons, in
metres, each in its link's frame (x forward, y left, z up); a file for each colour.
"""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix

from dune_rl.core.paths import assets_folder
from dune_rl.robots.drawing import ACROSS, Mesh, bevelled_box, box, cylinder, join_meshes, tyre

_RADIUS, _WIDTH, _RIM = 0.125, 0.083, 0.070
_UP = (0.0, 0.0, 1.0)


def make_meshes() -> dict[str, Mesh]:
    """Each file's mesh, by the file's name without ending."""
    return {
        "chassis": join_meshes(_chassis()),
        "plate": join_meshes(_plate()),
        "trim": join_meshes(_trim()),
        "sensors": join_meshes(_sensors()),
        "lens": cylinder(0.010, 0.008, (0.262, 0.0, 0.112), (1.0, 0.0, 0.0)),
        "tyre": tyre(_RADIUS, _WIDTH, _RIM, 20, 0.007),
        "rim": join_meshes(_rim()),
        "hub": join_meshes(_hub()),
    }


def write_meshes(folder: Path) -> None:
    """Write the meshes as STL files."""
    for name, mesh in make_meshes().items():
        mesh.export(folder / f"{name}.stl")


def _chassis() -> list[Mesh]:
    tub = bevelled_box((0.0, 0.0, 0.016), (0.520, 0.244, 0.112), 0.022)
    axles = [cylinder(0.022, 0.300, (x, 0.0, 0.0)) for x in (0.1415, -0.145)]
    return [tub, *axles]


def _plate() -> list[Mesh]:
    lid = bevelled_box((0.0, 0.0, 0.086), (0.560, 0.250, 0.012), 0.004)
    stripes = [box((0.0, side * 0.1225, 0.030), (0.300, 0.004, 0.022)) for side in (-1, 1)]
    return [lid, *stripes]


def _trim() -> list[Mesh]:
    posts = [cylinder(0.009, 0.012, (x, y, 0.076), _UP, 12) for x in (-0.22, 0.0, 0.22) for y in (-0.1, 0.1)]
    bumpers = [bevelled_box((end * 0.285, 0.0, 0.020), (0.050, 0.270, 0.044), 0.012) for end in (-1, 1)]
    slots = [box((x, 0.0, 0.0925), (0.016, 0.170, 0.002)) for x in (-0.23, -0.18, -0.13, -0.08, -0.03, 0.02)]
    camera = bevelled_box((0.250, 0.0, 0.112), (0.022, 0.090, 0.026), 0.005)
    spinning = cylinder(0.036, 0.034, (0.174, 0.0, 0.184), _UP)
    return [*posts, *bumpers, *slots, camera, spinning]


def _sensors() -> list[Mesh]:
    foot = bevelled_box((0.174, 0.0, 0.112), (0.080, 0.080, 0.040), 0.010)
    neck = cylinder(0.030, 0.040, (0.174, 0.0, 0.150), _UP)
    cap = cylinder(0.036, 0.006, (0.174, 0.0, 0.204), _UP)
    return [foot, neck, cap]


def _rim() -> list[Mesh]:
    ring = trimesh.creation.annulus(0.058, _RIM + 0.002, 0.066, sections=40)
    ring.apply_transform(rotation_matrix(np.pi / 2, (1.0, 0.0, 0.0)))
    spokes = []
    for number in range(5):
        spoke = box((0.0, 0.022, 0.040), (0.020, 0.012, 0.048))
        spoke.apply_transform(rotation_matrix(2 * np.pi * number / 5, ACROSS))
        spokes.append(spoke)
    return [ring, *spokes]


def _hub() -> list[Mesh]:
    back = cylinder(0.060, 0.020, (0.0, -0.006, 0.0), sections=32)
    cap = cylinder(0.020, 0.016, (0.0, 0.028, 0.0), sections=16)
    return [back, cap]


if __name__ == "__main__":
    write_meshes(assets_folder() / "robots" / "rover_zero" / "meshes")
