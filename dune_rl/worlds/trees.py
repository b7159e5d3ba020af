"""Trees and bushes: solid trunks, and leaves that are only visible."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.props import Mesh, limb, merge_meshes, unit_vector
from dune_rl.worlds.world import Colour, Prop

_BARK: tuple[Colour, ...] = ((0.34, 0.26, 0.19), (0.40, 0.33, 0.26), (0.30, 0.24, 0.18))
# Dark inside the crown, light outside.
_LEAVES: tuple[Colour, ...] = ((0.22, 0.33, 0.13), (0.31, 0.43, 0.16), (0.42, 0.52, 0.21))
_NEEDLES: tuple[Colour, ...] = ((0.15, 0.26, 0.16), (0.20, 0.33, 0.19))
_BUSH: tuple[Colour, ...] = ((0.25, 0.34, 0.14), (0.36, 0.43, 0.18), (0.47, 0.49, 0.24))

# Depth of trunks below the lowest ground around them.
_SUNK_M = 0.35


@dataclass(frozen=True)
class TreeSize:
    """Trunk radius at the ground, height, and width of the crown [m]."""

    radius_m: float
    height_m: float
    crown_m: float


def sample_tree_size(rng: np.random.Generator) -> TreeSize:
    """A random tree size: trunk radii of 0.07 to 0.25 m, heights of 3 to 9 m."""
    radius = float(rng.uniform(0.07, 0.25))
    height = float(np.clip(3.0 + 26.0 * (radius - 0.05) + rng.uniform(-0.8, 0.8), 3.0, 9.0))
    return TreeSize(radius, height, float(rng.uniform(0.38, 0.52)) * height)


def broadleaf(
    terrain: HeightField, name: str, xy: ArrayLike, size: TreeSize, rng: np.random.Generator
) -> list[Prop]:
    """A trunk with three boughs and clumps of leaves round their ends."""
    foot = _foot(terrain, xy, size.radius_m)
    ground = foot[2] + _SUNK_M
    fork = np.array([*(foot[:2] + rng.normal(0.0, 0.03 * size.height_m, 2)), ground + 0.45 * size.height_m])
    flare = np.array([*foot[:2], ground + 0.35])
    radii = size.radius_m * np.array([1.25, 1.0, 0.7])
    wood = [limb(np.array([foot, flare, fork]), radii)]
    turn = rng.uniform(-np.pi, np.pi)
    up = np.array([0.0, 0.0, size.height_m])
    ends = [fork + 0.28 * up]
    for bough in range(3):
        yaw = turn + 2 * np.pi / 3 * bough + float(rng.uniform(-0.4, 0.4))
        reach = 0.30 * size.crown_m
        end = fork + float(rng.uniform(0.14, 0.26)) * up
        end[:2] += reach * unit_vector(yaw)
        wood.append(limb(np.array([fork - [0.0, 0.0, 0.1], end]), size.radius_m * np.array([0.5, 0.2])))
        ends.append(end)
    leaves: list[list[Mesh]] = [[], [], []]
    for number, end in enumerate(ends):
        clump = size.crown_m * np.array([0.36, 0.36, 0.30]) * (1.15 if number == 0 else 1.0)
        for shade, mesh in zip(leaves, _clump(rng, end, clump, 36, 0.16 * size.crown_m), strict=True):
            shade.append(mesh)
    bark = _BARK[int(rng.integers(len(_BARK)))]
    return [
        Prop(f"{name} trunk", "tree", *merge_meshes(wood), colour=bark),
        *_foliage(f"{name} leaves", "leaves", leaves, _LEAVES),
    ]


def conifer(
    terrain: HeightField, name: str, xy: ArrayLike, size: TreeSize, rng: np.random.Generator
) -> list[Prop]:
    """A straight trunk with tiers of drooping branches."""
    foot = _foot(terrain, xy, size.radius_m)
    ground = foot[2] + _SUNK_M
    top = np.array([*foot[:2], ground + 1.1 * size.height_m])
    flare = np.array([*foot[:2], ground + 0.3])
    wood = limb(np.array([foot, flare, top]), size.radius_m * np.array([1.2, 0.95, 0.1]))
    tiers: list[list[Mesh]] = [[], []]
    count = 5 + int(size.height_m > 5.0) + int(size.height_m > 7.0)
    low, high = ground + 0.16 * size.height_m, top[2] + 0.15
    for number in range(count):
        share = number / count
        bottom = low + share * (high - low)
        rise = 1.75 * (high - low) / count
        reach = 0.40 * size.crown_m * (1.0 - 0.86 * share) * rng.uniform(0.92, 1.08)
        apex = np.array([*foot[:2], min(bottom + rise, high)])
        tiers[number % 2].append(_skirt(rng, apex, bottom, reach))
    bark = _BARK[int(rng.integers(len(_BARK)))]
    return [
        Prop(f"{name} trunk", "tree", *wood, colour=bark),
        *_foliage(f"{name} needles", "leaves", tiers, _NEEDLES),
    ]


def _foliage(name: str, kind: str, shades: Sequence[Sequence[Mesh]], colours: Sequence[Colour]) -> list[Prop]:
    return [
        Prop(f"{name} {k}", kind, *merge_meshes(shade), False, colour=colour, segment=Segment.VEGETATION)
        for k, (shade, colour) in enumerate(zip(shades, colours, strict=True), start=1)
        if shade
    ]


def fallen_trunk(
    terrain: HeightField, name: str, xy: ArrayLike, yaw: float, length: float, radius: float
) -> Prop:
    """A fallen trunk along `yaw`, at least a third of its radius in the ground."""
    along = unit_vector(yaw)
    s = np.linspace(-length / 2, length / 2, 9)
    ground = terrain.height(np.asarray(xy) + s[:, None] * along)
    pitch, level = np.polyfit(s, ground, 1)
    level += float((ground - level - pitch * s).min()) + radius / 3
    ends = [[*(np.asarray(xy) + u * along), level + pitch * u] for u in (s[0], s[4], s[-1])]
    mesh = limb(np.array(ends), radius * np.array([1.0, 0.92, 0.8]), sides=9)
    return Prop(name, "log", *mesh, colour=(0.37, 0.29, 0.22))


def undergrowth(terrain: HeightField, places: Array, rng: np.random.Generator) -> list[Prop]:
    """Bushes at `places` (K, 2), one prop per shade, not solid."""
    shades: list[list[Mesh]] = [[], [], []]
    for xy in places:
        width, height = rng.uniform(0.35, 0.9), rng.uniform(0.3, 0.75)
        centre = np.array([*xy, float(terrain.height(xy)) + 0.35 * height])
        radii = np.array([width / 2, width / 2, height / 2])
        for shade, mesh in zip(shades, _clump(rng, centre, radii, 18, 0.30 * width), strict=True):
            shade.append(mesh)
    return _foliage("undergrowth", "undergrowth", shades, _BUSH)


def _foot(terrain: HeightField, xy: ArrayLike, radius: float) -> Array:
    around = 1.25 * radius * np.stack([unit_vector(yaw) for yaw in np.linspace(-np.pi, np.pi, 9)])
    ground = terrain.height(np.asarray(xy) + around).min()
    return np.array([*np.asarray(xy, dtype=np.float64), ground - _SUNK_M])


def _clump(rng: np.random.Generator, centre: Array, radii: Array, count: int, leaf_m: float) -> list[Mesh]:
    # Leaves in an ellipsoid, most of them near its surface and facing outward: one mesh for each of three
    # shades, the darkest inside and below.
    out = rng.standard_normal((count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    depth = rng.uniform(0.35, 1.0, count) ** 0.5
    at = centre + out * depth[:, None] * radii
    normal = out + rng.normal(0.0, 0.35, out.shape) + [0.0, 0.0, 0.35]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    side = np.cross(normal, rng.standard_normal((count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(normal, side)
    size = leaf_m * rng.uniform(0.7, 1.3, (count, 1))
    # Each leaf is a quadrilateral with pointed, drooping ends.
    tip, flank = size * side, 0.55 * size * other
    drop = -0.25 * size * normal
    corners = np.stack([at - tip + drop, at + flank, at + tip + drop, at - flank], axis=1)
    light = 0.5 * depth + 0.3 * out[:, 2] + rng.normal(0.0, 0.16, count)
    order = np.argsort(light, kind="stable")
    return [_quads(corners[part]) for part in np.array_split(order, 3)]


def _quads(corners: Array) -> Mesh:
    first = 4 * np.arange(len(corners), dtype=np.int32)
    # Counter-clockwise about the normal, which is side x other: from -tip over -flank.
    faces = np.concatenate(
        [np.stack([first, first + 3, first + 1], axis=1), np.stack([first + 1, first + 3, first + 2], axis=1)]
    )
    return corners.reshape(-1, 3), faces


def _skirt(rng: np.random.Generator, apex: Array, bottom: float, reach: float, points: int = 9) -> Mesh:
    # A cone with a star-shaped rim, for drooping branches.
    angle = np.linspace(0.0, 2 * np.pi, 2 * points, endpoint=False) + rng.uniform(0.0, 2 * np.pi)
    angle += rng.normal(0.0, 0.06, 2 * points)
    out = np.tile([1.0, 0.62], points) * rng.uniform(0.85, 1.12, 2 * points) * reach
    drop = np.tile([0.0, 0.22], points) * (apex[2] - bottom)
    rim = np.column_stack([apex[0] + out * np.cos(angle), apex[1] + out * np.sin(angle), bottom + drop])
    here = np.arange(2 * points)
    faces = np.stack([np.full(2 * points, 2 * points), here, np.roll(here, -1)], axis=1)
    return np.vstack([rim, apex]), faces.astype(np.int32)
