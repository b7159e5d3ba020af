"""Loops over the beams of scans: the nearest return of each segment, and the past scan's."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

# What two rings meet is upright if the upper return is farther by no more than this share of its rise, and
# both are of the same thing if by no more than this.
_UPRIGHT, _SHEER = 1.0 / 0.6, 1.0 / 3.0
# What is higher over the LiDAR is in nobody's way [m].
_OVERHEAD_M = 1.2
# Upright returns within this of the nearest one are of one thing [m].
_ONE_THING_M = 0.15


@compile_function
def nearest_in_segments(ranges: Any, found: Any) -> None:
    """Nearest of `ranges` (N, B) in each of S runs of neighbouring beams, `found` (N, S)."""
    rows, segments = found.shape
    width = ranges.shape[1] // segments
    for row in range(rows):
        for segment in range(segments):
            nearest = ranges[row, segment * width]
            for beam in range(segment * width + 1, (segment + 1) * width):
                nearest = min(nearest, ranges[row, beam])
            found[row, segment] = nearest


@compile_function
def turn_beams(directions: Any, rotation: Any, found: Any, found32: Any) -> None:
    """`directions` (B, 3) turned by `rotation` (N, 3, 3), as `found` (N, B, 3) of two precisions."""
    for row in range(rotation.shape[0]):
        for beam in range(directions.shape[0]):
            for axis in range(3):
                turned = 0.0
                for part in range(3):
                    turned += rotation[row, axis, part] * directions[beam, part]
                found[row, beam, axis] = turned
                found32[row, beam, axis] = turned


@compile_function
def find_ends(directions: Any, ranges: Any, limits: Any, origin: Any, rotation: Any, found: Any) -> None:
    """Where beams of `ranges` (N, B) along `directions` (B, 3) end in the world, `found` (N, B, 3).

    Sensors are at `origin` (N, 3), turned by `rotation` (N, 3, 3). `limits` are the range of a beam that
    meets nothing, and how far away it ends.
    """
    farthest, nowhere = limits
    for row in range(ranges.shape[0]):
        for beam in range(ranges.shape[1]):
            along = np.float64(ranges[row, beam] if ranges[row, beam] < farthest else nowhere)
            for axis in range(3):
                turned = 0.0
                for part in range(3):
                    turned += rotation[row, axis, part] * (directions[beam, part] * along)
                found[row, beam, axis] = origin[row, axis] + turned


@compile_function
def nearest_seen_from(
    ends: Any, origin: Any, rotation: Any, first: Any, per_rad: Any, full_circle: bool, limits: Any,
    found: Any,
) -> None:  # fmt: skip
    """Nearest in each segment, `found` (N, S), of the points `ends` (N, B, 3) in the world.

    Sensors are at `origin` (N, 3), turned by `rotation` (N, 3, 3). Segments begin at the bearing `first`
    [rad] and there are `per_rad` in a radian; those of a full circle go on at its beginning. Ranges are
    horizontal, within two `limits` [m], the second where there is none.
    """
    nearest, farthest = limits
    rows, segments = found.shape
    for row in range(rows):
        for segment in range(segments):
            found[row, segment] = farthest
        turn = rotation[row]
        for beam in range(ends.shape[1]):
            x = ends[row, beam, 0] - origin[row, 0]
            y = ends[row, beam, 1] - origin[row, 1]
            z = ends[row, beam, 2] - origin[row, 2]
            ahead = x * turn[0, 0] + y * turn[1, 0] + z * turn[2, 0]
            aside = x * turn[0, 1] + y * turn[1, 1] + z * turn[2, 1]
            segment = int(np.floor((np.arctan2(aside, ahead) - first) * per_rad))
            if full_circle:
                segment %= segments
            if 0 <= segment < segments:
                found[row, segment] = min(found[row, segment], np.sqrt(ahead * ahead + aside * aside))
        for segment in range(segments):
            found[row, segment] = max(found[row, segment], nearest)


@compile_function
def nearest_upright(ranges: Any, rises: Any, nearest: float, farthest: float, found: Any) -> None:
    """Level distance of the nearest upright thing in each of B bearings, `found` (N, B) [m].

    `ranges` (N, R, B) [m] are those of R rings, the lowest first, `farthest` where nothing returns, and
    `rises` (N, R, B) the sines of their elevations over the level plane. Distances are between `nearest` and
    `farthest`. A return is upright where it is steeply over that of the ring below it, or nearer than that.
    Of those within 0.15 m of the nearest one, the return next to the height of the LiDAR counts: at one
    height, people are about round. Ground and obstacles are told apart as in Bogoslavskyi and Stachniss,
    "Fast range image-based segmentation of sparse 3D laser scans" (2016).
    """
    rows, rings, beams = ranges.shape
    level, height, upright = np.empty(rings), np.empty(rings), np.empty(rings, np.bool_)
    for row in range(rows):
        for beam in range(beams):
            least, below = farthest, -1
            for ring in range(rings):
                upright[ring] = False
                along = ranges[row, ring, beam]
                if along >= farthest:
                    continue
                height[ring] = along * rises[row, ring, beam]
                level[ring] = np.sqrt(max(along * along - height[ring] ** 2, 0.0))
                if below >= 0 and height[ring] < _OVERHEAD_M:
                    rise_m, farther_m = height[ring] - height[below], level[ring] - level[below]
                    upright[ring] = farther_m < _UPRIGHT * rise_m
                    # The lower of the two may be the ground before it.
                    upright[below] = upright[below] or abs(farther_m) < _SHEER * rise_m
                    if upright[ring]:
                        least = min(least, level[ring])
                below = ring
            chosen, off_m = least, np.inf
            for ring in range(rings):
                if upright[ring] and level[ring] < least + _ONE_THING_M and abs(height[ring]) < off_m:
                    chosen, off_m = level[ring], abs(height[ring])
            found[row, beam] = max(chosen, nearest)
