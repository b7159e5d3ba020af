"""Simple solids for visual meshes of robots, in metres."""

from collections.abc import Iterable
from typing import cast

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix

from dune_rl.geometry.arrays import Array

Mesh = trimesh.Trimesh
Triple = tuple[float, float, float]

ACROSS = (0.0, 1.0, 0.0)


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


def rounded_plate(start: Array, end: Array, radii: tuple[float, float], width: float, y: float = 0.0) -> Mesh:
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
