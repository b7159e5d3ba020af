"""Rocks: their size distribution and meshes."""

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.props import Mesh, merge_meshes, unit_vector
from dune_rl.worlds.world import Colour, Prop

SMALLEST_M, LARGEST_M = 0.05, 2.0
# Smallest width that `rocks_per_100m2` counts.
COUNTED_FROM_M = 0.1
# The number of rocks wider than D is proportional to D to the power of minus this, as on debris slopes.
SIZE_EXPONENT = 1.3

# Share of a rock's height below the lowest ground it covers.
_SUNK = 0.22
_MERGED_BELOW_M = 0.6
_MERGE_SQUARE_M = 11.0
_GREYS: tuple[Colour, ...] = ((0.50, 0.47, 0.43), (0.43, 0.41, 0.39), (0.56, 0.52, 0.45), (0.47, 0.42, 0.37))


def relative_count_larger(width_m: ArrayLike) -> Array:
    """Number of rocks wider than `width_m`, relative to those wider than `COUNTED_FROM_M`."""
    most = (LARGEST_M / COUNTED_FROM_M) ** -SIZE_EXPONENT
    width = np.clip(width_m, SMALLEST_M, LARGEST_M)
    return ((width / COUNTED_FROM_M) ** -SIZE_EXPONENT - most) / (1.0 - most)


def power_law_widths(count: int) -> Array:
    """Widths (count,) [m], largest first: the quantiles of the power law.

    They are not drawn at random, so every seed has equally many large rocks.
    """
    least, most = SMALLEST_M**-SIZE_EXPONENT, LARGEST_M**-SIZE_EXPONENT
    quantile = (np.arange(count) + 0.5) / max(count, 1)
    return (most + quantile * (least - most)) ** (-1.0 / SIZE_EXPONENT)


def rock(terrain: HeightField, name: str, xy: ArrayLike, width: float, rng: np.random.Generator) -> Prop:
    """A rock about `width` [m] wide, sunk into the lowest ground it covers."""
    vertices, faces = _rock_mesh(rng, width)
    vertices[:, :2] += np.asarray(xy)
    height = float(np.ptp(vertices[:, 2]))
    lowest = float(terrain.height(vertices[:, :2]).min())
    vertices[:, 2] += lowest - _SUNK * height - vertices[:, 2].min()
    colour = _GREYS[int(rng.integers(len(_GREYS)))]
    # Rounded to 0.1 mm, so that machines whose arithmetic differs in the last bits make the same rock.
    return Prop(name, "rock", np.round(vertices, 4), faces, colour=colour)


def merge_rocks(name: str, kind: str, rocks: Sequence[Prop], *, drivable: bool = False) -> Prop:
    """Several rocks as one prop with the colour of the first."""
    mesh = merge_meshes(rock.mesh for rock in rocks)
    return Prop(name, kind, *mesh, drivable=drivable, colour=rocks[0].colour, surface="rock")


def merge_small_rocks(rocks: Sequence[Prop]) -> list[Prop]:
    """The large rocks unchanged, and one prop of the small rocks in each square of a grid.

    Engines spend time on every body in each step, however far away it is.
    """
    large: list[Prop] = []
    groups: dict[tuple[float, ...], list[Prop]] = {}
    for each in rocks:
        low, high = each.vertices[:, :2].min(axis=0), each.vertices[:, :2].max(axis=0)
        if (high - low).max() > _MERGED_BELOW_M:
            large.append(each)
        else:
            x, y = np.floor((low + high) / 2 / _MERGE_SQUARE_M).tolist()
            groups.setdefault((x, y), []).append(each)
    merged = enumerate(groups.values(), start=1)
    return large + [merge_rocks(f"rocks {number}", "rock", group) for number, group in merged]


def _rock_mesh(rng: np.random.Generator, width: float) -> Mesh:
    # The convex hull of points on a sphere, after random offsets, cuts, scaling and rotation.
    count = 10 if width < 0.15 else 20 if width < 0.5 else 36
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + 5**0.5) * index
    level = np.sqrt(1.0 - z * z)
    points = np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1)
    points += rng.normal(0.0, 0.13, points.shape)
    # Three sides are cut flat, as rock breaks.
    for _ in range(3):
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        over = np.maximum(points @ normal - rng.uniform(0.55, 0.85), 0.0)
        points -= over[:, None] * normal
    ahead = unit_vector(float(rng.uniform(-np.pi, np.pi)))
    left = np.array([-ahead[1], ahead[0]])
    scaled = points * [1.0, rng.uniform(0.65, 0.95), rng.uniform(0.6, 0.85)]
    turned = np.column_stack([scaled[:, :1] * ahead + scaled[:, 1:2] * left, scaled[:, 2]])
    turned *= width / np.ptp(turned @ [*ahead, 0.0])
    hull = scipy.spatial.ConvexHull(turned)
    used, faces = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = turned[used], faces.reshape(-1, 3)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, [0, 2, 1]]
    return vertices, faces.astype(np.int32)
