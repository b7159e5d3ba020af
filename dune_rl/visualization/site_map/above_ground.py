"""The parts of triangles that are above the ground, for maps."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.props import bisect_triangles

# Triangles that reach below the ground are cut into pieces of at most this size, or this share of the world.
_LONGEST_M, _LONGEST_SHARE = 0.5, 1 / 250
_MOST_CUTS = 16
_FLUSH_M = 0.005


def clip_above_ground(corners: Array, terrain: HeightField) -> Array:
    """The parts (N, 3, 3) of triangles (T, 3, 3) [m] that are above the ground.

    The ground is planar below each piece of half a metre (more in worlds over 125 m).
    """
    xmin, xmax, ymin, ymax = terrain.extent
    longest_m = max(_LONGEST_M, _LONGEST_SHARE * max(xmax - xmin, ymax - ymin))
    whole, rest = [], corners
    for _ in range(_MOST_CUTS):
        above = (_height_above_ground(rest, terrain) > 0.0).all(axis=1)
        whole.append(rest[above])
        rest = rest[~above]
        edges = np.linalg.norm((np.roll(rest, -1, axis=1) - rest)[..., :2], axis=2)
        long = edges.max(axis=1, initial=0.0) > longest_m
        if not long.any():
            break
        rest = np.concatenate([rest[~long], bisect_triangles(rest[long], edges[long].argmax(axis=1))])
    return np.concatenate([*whole, *_cut_at_ground(rest, _height_above_ground(rest, terrain))])


def _height_above_ground(corners: Array, terrain: HeightField) -> Array:
    return corners[..., 2] - terrain.height(corners[..., :2]) - _FLUSH_M


def _rotate(values: Array, first: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """The values of the three corners of triangles (N, 3, ...), from corner `first` (N,) on."""
    row = np.arange(len(values))
    return values[row, first], values[row, (first + 1) % 3], values[row, (first + 2) % 3]


def _cut_at_ground(corners: Array, height: Array) -> list[Array]:
    """The parts above the ground of triangles (N, 3, 3) with heights (N, 3) above it."""
    above = height > 0.0
    count = above.sum(axis=1)
    one, two = np.flatnonzero(count == 1), np.flatnonzero(count == 2)
    top, right, left = _rotate(corners[one], above[one].argmax(axis=1))
    h_top, h_right, h_left = _rotate(height[one], above[one].argmax(axis=1))
    tips = np.stack([top, _crossing(top, right, h_top, h_right), _crossing(top, left, h_top, h_left)], axis=1)
    low, next_, last = _rotate(corners[two], above[two].argmin(axis=1))
    h_low, h_next, h_last = _rotate(height[two], above[two].argmin(axis=1))
    start, end = _crossing(next_, low, h_next, h_low), _crossing(last, low, h_last, h_low)
    halves = [np.stack([start, next_, last], axis=1), np.stack([start, last, end], axis=1)]
    return [corners[count == 3], tips, *halves]


def _crossing(above: Array, below: Array, height_above: Array, height_below: Array) -> Array:
    """Points (N, 3) at height 0 on the edges between points above and below."""
    share = height_above / (height_above - height_below)
    return above + share[:, None] * (below - above)
