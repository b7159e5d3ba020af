"""Simple solids with a colour each, and their union in one coloured mesh.

All have outward faces. Angles are in radians, lengths in metres, x forward, y left and z up.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.scenery import ColouredMesh, Segment, join_meshes

Colour = tuple[float, float, float]
# Centre (3,) of a tube's ring, and its half-axes across and upward.
Ring = tuple[ArrayLike, float, float]


def at(x: float, y: float, z: float) -> Array:
    """A point or an offset (3,)."""
    return np.array([x, y, z], np.float64)


def solid(vertices: ArrayLike, faces: ArrayLike, colour: Colour) -> ColouredMesh:
    """A mesh of one sRGB `colour`."""
    points, triangles = np.asarray(vertices, np.float64), np.asarray(faces, np.int32)
    albedo = np.tile(srgb_to_linear(np.array(colour)).astype(np.float32), (len(triangles), 1))
    return ColouredMesh(points, triangles, albedo, np.full(len(triangles), Segment.ACTOR, np.uint8))


def box(
    centre: ArrayLike, size: ArrayLike, colour: Colour, taper: tuple[float, float] = (1.0, 1.0)
) -> ColouredMesh:
    """A box of `size` (3,) round `centre`; its top is `taper` times as long and as wide as its bottom."""
    half = np.asarray(size, np.float64) / 2
    corners = np.array([[x, y, z] for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float)
    corners[4:, :2] *= taper
    return solid(np.asarray(centre) + corners * half, _BOX_FACES, colour)


def prism(
    outline_xz: ArrayLike, width: float, colour: Colour, y: float = 0.0, top_width: float | None = None
) -> ColouredMesh:
    """A shape of constant cross-section across: a convex outline (P, 2) in x and z, anticlockwise.

    With `top_width` it narrows to that at its highest points.
    """
    outline = np.asarray(outline_xz, np.float64)
    count = len(outline)
    share = (outline[:, 1] - outline[:, 1].min()) / np.ptp(outline[:, 1])
    half = (width + ((width if top_width is None else top_width) - width) * share) / 2
    right = np.column_stack([outline[:, 0], y - half, outline[:, 1]])
    left = np.column_stack([outline[:, 0], y + half, outline[:, 1]])
    fan = np.array([[0, i, i + 1] for i in range(1, count - 1)])
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    sides = np.concatenate(
        [np.column_stack([here, here + count, there + count]), np.column_stack([here, there + count, there])]
    )
    return solid(np.concatenate([right, left]), np.concatenate([fan, fan[:, ::-1] + count, sides]), colour)


def _loft(rings: Array, ends: ArrayLike, colour: Colour) -> ColouredMesh:
    """A closed surface through rings (R, S, 3), with a point (2, 3) in the middle of each end."""
    count, sides, _ = rings.shape
    here, there = np.arange(sides), np.roll(np.arange(sides), -1)
    faces = []
    for low in sides * np.arange(count - 1):
        high = low + sides
        faces += [
            np.column_stack([low + here, low + there, high + there]),
            np.column_stack([low + here, high + there, high + here]),
        ]
    first, last = np.full(sides, count * sides), (count - 1) * sides
    faces += [
        np.column_stack([first, there, here]),
        np.column_stack([first + 1, last + here, last + there]),
    ]
    mesh = solid(np.concatenate([*rings, ends]), np.concatenate(faces), colour)
    # Outward, as a whole.
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces] - mesh.vertices.mean(axis=0), 1, 0)
    inside_out = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() <= 0
    return replace(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1])) if inside_out else mesh


def tube(
    rings: Sequence[Ring],
    colour: Colour,
    sides: int = 8,
    refine: int = 1,
    wide: float = 1.0,
    high: float = 1.0,
) -> ColouredMesh:
    """A tube with closed ends through `rings`: centres (3,) and half-axes across and upward, in their planes.

    Each ring is at right angles to the way from the one before it to the one after it. `refine` is the
    number of parts that each piece between two rings is made of. Half-axes are in units of `wide` and `high`.
    """
    known = np.array(
        [[*np.asarray(centre, np.float64), across * wide, up * high] for centre, across, up in rings]
    )
    places = np.linspace(0.0, len(rings) - 1.0, refine * (len(rings) - 1) + 1)
    each = np.stack([np.interp(places, np.arange(len(rings)), column) for column in known.T], axis=1)
    centres = each[:, :3]
    ways = np.gradient(centres, axis=0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    angle = np.arange(sides) * 2 * np.pi / sides
    points = []
    for (across, up), centre, way in zip(each[:, 3:], centres, ways, strict=True):
        # Across is as level as it can be.
        reference = np.array([0.0, 1.0, 0.0]) if abs(way[1]) < 0.9 else np.array([-1.0, 0.0, 0.0])
        upward = np.cross(way, reference)
        upward /= np.linalg.norm(upward)
        aside = np.cross(upward, way)
        points.append(centre + across * np.cos(angle)[:, None] * aside + up * np.sin(angle)[:, None] * upward)
    return _loft(np.stack(points), [centres[0], centres[-1]], colour)


def rod(start: ArrayLike, end: ArrayLike, radius: float, colour: Colour, sides: int = 6) -> ColouredMesh:
    """A straight, round bar."""
    return tube([(start, radius, radius), (end, radius, radius)], colour, sides)


def ball(
    centre: ArrayLike, half_axes: ArrayLike, colour: Colour, sides: int = 8, rings: int = 5
) -> ColouredMesh:
    """An ellipsoid of half-axes (3,)."""
    heights = -np.cos(np.linspace(0.0, np.pi, rings + 2)[1:-1])
    angle = np.arange(sides) * 2 * np.pi / sides
    circles = [
        np.column_stack(
            [np.sqrt(1 - h * h) * np.cos(angle), np.sqrt(1 - h * h) * np.sin(angle), np.full(sides, h)]
        )
        for h in heights
    ]
    axes, poles = np.asarray(half_axes), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    return _loft(np.asarray(centre) + np.stack(circles) * axes, np.asarray(centre) + poles * axes, colour)


def disc(
    centre: ArrayLike, radius: float, width: float, colour: Colour, sides: int = 16, axis: int = 1
) -> ColouredMesh:
    """A flat cylinder with its axis along x, y or z (0, 1, 2): a wheel."""
    half = np.zeros(3)
    half[axis] = width / 2
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.zeros((sides, 3))
    ring[:, [each for each in range(3) if each != axis]] = radius * np.column_stack(
        [np.cos(angle), np.sin(angle)]
    )
    ends = np.array([np.asarray(centre, np.float64) - half, np.asarray(centre, np.float64) + half])
    return _loft(ends[:, None] + ring, ends, colour)


def wheel(centre: ArrayLike, radius: float, width: float, rim: Colour, sides: int = 14) -> ColouredMesh:
    """A wheel with a black tyre and a rim of another colour, its axis along y."""
    tyre = disc(centre, radius, width, (0.07, 0.07, 0.07), sides)
    return join_meshes([tyre, disc(centre, 0.58 * radius, 1.04 * width, rim, sides - 4)])


def recoloured(mesh: ColouredMesh, chosen: Flags, colour: Colour) -> ColouredMesh:
    """The mesh with its `chosen` faces (F,) in another sRGB colour."""
    albedo = mesh.albedo.copy()
    albedo[chosen] = srgb_to_linear(np.array(colour))
    return replace(mesh, albedo=albedo)


def middles(mesh: ColouredMesh) -> Array:
    """The middles (F, 3) of the faces."""
    found: Array = mesh.vertices[mesh.faces].mean(axis=1)
    return found


_BOX_FACES = np.array(
    [
        [0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7],
        [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5],
        [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7],
    ]
)  # fmt: skip
