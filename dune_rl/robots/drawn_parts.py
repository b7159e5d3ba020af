"""Parts that robots' meshes are drawn of."""

from collections.abc import Iterable
from typing import cast

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import rotation_matrix

Array = NDArray[np.float64]
Mesh = trimesh.Trimesh
Triple = tuple[float, float, float]

_ACROSS = (0.0, 1.0, 0.0)


def joined(parts: Iterable[Mesh]) -> Mesh:
    """All of them as one mesh."""
    return cast(Mesh, trimesh.util.concatenate(list(parts)))


def box(centre: Triple, size: Triple, pitch: float = 0.0) -> Mesh:
    """A box [m], turned by `pitch` [rad] about y."""
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(rotation_matrix(pitch, _ACROSS))
    mesh.apply_translation(centre)
    return mesh


def cylinder(
    radius: float, length: float, centre: Triple, axis: Triple = _ACROSS, sections: int = 24
) -> Mesh:
    """A cylinder [m] about `centre` along `axis`."""
    mesh = trimesh.creation.cylinder(radius, length, sections=sections)
    mesh.apply_transform(
        trimesh.geometry.align_vectors((0.0, 0.0, 1.0), np.array(axis) / np.linalg.norm(axis))
    )
    mesh.apply_translation(centre)
    return mesh


def bevelled(centre: Triple, size: Triple, bevel: float) -> Mesh:
    """A box whose edges are cut off at 45 degrees."""
    half = np.array(size) / 2
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = np.concatenate([signs * (half - bevel * np.eye(3)[axis]) for axis in range(3)])
    return Mesh(corners + centre).convex_hull


def plate(start: Array, end: Array, radii: tuple[float, float], width: float, y: float = 0.0) -> Mesh:
    """A plate round two points (x, z), as wide as a disc at each."""
    angle = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points = [
        np.insert(middle + radius * circle, 1, y + side * width / 2, axis=1)
        for middle, radius in zip((start, end), radii, strict=True)
        for side in (-1, 1)
    ]
    return Mesh(np.concatenate(points)).convex_hull


