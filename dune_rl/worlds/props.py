"""Closed primitive meshes to build props from, and the areas that props occupy in a layout.

Faces run counter-clockwise seen from outside.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.arrays import Array

Indices = NDArray[np.signedinteger[Any]]
Mesh = tuple[Array, NDArray[np.int32]]

_BOX_CORNERS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) / 2
_BOX_FACES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ],
    dtype=np.int32,
)  # fmt: skip


def merge_meshes(meshes: Iterable[Mesh]) -> Mesh:
    """Several meshes as one, in their order."""
    parts = list(meshes)
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=True)])
    return vertices, faces.astype(np.int32)


def slab(centre: ArrayLike, axes: ArrayLike, size: ArrayLike) -> Mesh:
    """A box of `size` (3,) [m] along the orthonormal, right-handed rows of `axes` (3, 3)."""
    vertices = np.asarray(centre) + (_BOX_CORNERS * np.asarray(size)) @ np.asarray(axes)
    return vertices, _BOX_FACES


def upright_box(xy: ArrayLike, yaw: float, bottom: float, top: float, length: float, width: float) -> Mesh:
    """A vertical box between two heights, `length` along `yaw` and `width` across."""
    x, y = np.asarray(xy, dtype=np.float64)
    ahead, left = axes_of(yaw)
    axes = [[*ahead, 0.0], [*left, 0.0], [0.0, 0.0, 1.0]]
    return slab([x, y, (bottom + top) / 2], axes, [length, width, top - bottom])


def beam(start: ArrayLike, end: ArrayLike, width: float, height: float) -> Mesh:
    """A box from `start` to `end` (3,), its `width` horizontal; not for a vertical beam."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    axes = np.stack(level_axes(last - first))
    return slab((first + last) / 2, axes, [float(np.linalg.norm(last - first)), width, height])


def tube(start: ArrayLike, end: ArrayLike, radius: float, bore: float = 0.0, sides: int = 12) -> Mesh:
    """A cylinder from `start` to `end` (3,); with `bore` > 0, a pipe of that inner radius."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    if bore == 0.0:
        return limb(np.stack([first, last]), (radius, radius), sides)
    _, side, up = level_axes(last - first)
    angle = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up
    here, there = np.arange(sides), np.roll(np.arange(sides), -1)
    rings = [first + radius * circle, last + radius * circle, first + bore * circle, last + bore * circle]
    faces = [
        _strip(here, there, here + sides, there + sides),
        _strip(there, here, there + sides, here + sides) + 2 * sides,
        _strip(there, here, there + 2 * sides, here + 2 * sides),
        _strip(here + sides, there + sides, here + 3 * sides, there + 3 * sides),
    ]
    return np.concatenate(rings), np.concatenate(faces)


def limb(nodes: Array, radii: ArrayLike, sides: int = 7) -> Mesh:
    """A closed tube through `nodes` (N, 3) with radii (N,) at them."""
    angle = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    # All rings have the same axes, so that the tube is not twisted.
    _, side, up = level_axes(nodes[-1] - nodes[0])
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up
    rings = [node + radius * circle for node, radius in zip(nodes, np.asarray(radii), strict=True)]
    here, there = np.arange(sides), np.roll(np.arange(sides), -1)
    starts = sides * np.arange(len(nodes))
    mantle = [_strip(here + a, there + a, here + b, there + b) for a, b in pairwise(starts.tolist())]
    near = np.stack([np.full(sides, len(nodes) * sides), there, here], axis=-1)
    far = np.stack([np.full(sides, len(nodes) * sides + 1), here + starts[-1], there + starts[-1]], axis=-1)
    faces = np.concatenate([*mantle, near, far]).astype(np.int32)
    return np.concatenate([*rings, nodes[:1], nodes[-1:]]), faces


def unit_vector(yaw: float) -> Array:
    """Horizontal unit vector (2,) along `yaw` [rad]."""
    return np.array([np.cos(yaw), np.sin(yaw)])


def axes_of(yaw: float) -> Array:
    """Horizontal unit vectors, the rows (2, 2), along `yaw` [rad] and to its left."""
    return np.stack([unit_vector(yaw), unit_vector(yaw + np.pi / 2)])


def level_axes(direction: Array) -> tuple[Array, Array, Array]:
    """Right-handed unit axes (ahead, side, up), `ahead` along `direction` (3,) and `side` horizontal."""
    ahead = direction / np.linalg.norm(direction)
    side = np.array([-ahead[1], ahead[0], 0.0])
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-9 else np.array([0.0, 1.0, 0.0])
    return ahead, side, np.cross(ahead, side)


def _strip(a: Indices, b: Indices, c: Indices, d: Indices) -> NDArray[np.int32]:
    # Quads a-b-d-c as two triangles each.
    return np.concatenate([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]).astype(np.int32)


def bisect_triangles(corners: Array, side: NDArray[np.intp]) -> Array:
    """Both halves of triangles (N, 3, 3), cut at the middle of the `side` (N,) that follows that corner."""
    row = np.arange(len(corners))
    first, second, third = (corners[row, (side + k) % 3] for k in range(3))
    middle = (first + second) / 2
    halves = [np.stack([first, middle, third], axis=1), np.stack([middle, second, third], axis=1)]
    return np.concatenate(halves)


class Placement(NamedTuple):
    """Middle (2,) [m] and yaw [rad] of a prop."""

    xy: Array
    yaw: float


class OccupiedRectangles:
    """Occupied rectangles, sampled by points `spacing_m` [m] apart."""

    def __init__(self, spacing_m: float = 0.2) -> None:
        self._spacing_m = spacing_m
        self._points: Array = np.empty((0, 2))

    def gap(self, xy: ArrayLike, yaw: float, length: float, width: float) -> float:
        """Distance [m] from a rectangle, `length` along `yaw`, to the nearest occupied point; 0 on one."""
        if not len(self._points):
            return np.inf
        offset = (self._points - np.asarray(xy)) @ axes_of(yaw).T
        beyond = np.maximum(np.abs(offset) - [length / 2, width / 2], 0.0)
        return float(np.hypot(beyond[:, 0], beyond[:, 1]).min())

    def add(self, xy: ArrayLike, yaw: float, length: float, width: float) -> None:
        """Mark a rectangle as occupied."""
        u, v = (
            np.linspace(-side / 2, side / 2, 1 + int(np.ceil(side / self._spacing_m)))
            for side in (length, width)
        )
        local = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        self.add_points(np.asarray(xy) + local @ axes_of(yaw))

    def add_points(self, points: Array) -> None:
        """Mark points (N, 2) [m] as occupied."""
        self._points = np.concatenate([self._points, points])


class OccupiedDiscs:
    """Occupied discs."""

    def __init__(self) -> None:
        self._centres: Array = np.empty((0, 2))
        self._radii: Array = np.empty(0)

    def gap(self, xy: ArrayLike, radius: float) -> float:
        """Distance [m] between a disc and the nearest occupied one; negative where they overlap."""
        if not len(self._radii):
            return np.inf
        away = np.hypot(*(self._centres - np.asarray(xy)).T)
        return float((away - self._radii).min()) - radius

    def add(self, xy: ArrayLike, radius: float) -> None:
        """Mark a disc as occupied."""
        self._centres = np.concatenate([self._centres, np.asarray(xy, dtype=np.float64)[None]])
        self._radii = np.append(self._radii, radius)
