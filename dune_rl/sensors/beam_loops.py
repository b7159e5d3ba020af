"""Loops over the beams of scans: the nearest return of each segment, and the past scan's."""

from typing import Any

import numpy as np

from dune_rl.compiled import compile_function


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
def scale_directions(directions: Any, ranges: Any, farthest: Any, nowhere: Any, found: Any) -> None:
    """`directions` (B, 3) times `ranges` (N, B), as `found` (N, B, 3); a range of `farthest` is `nowhere`."""
    for row in range(ranges.shape[0]):
        for beam in range(ranges.shape[1]):
            along = np.float64(ranges[row, beam] if ranges[row, beam] < farthest else nowhere)
            for axis in range(3):
                found[row, beam, axis] = directions[beam, axis] * along


@compile_function
def nearest_by_bearing(
    ends: Any, bearings: Any, first: Any, per_rad: Any, full_circle: bool, limits: Any, found: Any
) -> None:
    """Nearest end point in each segment, `found` (N, S), of `ends` (N, B, 3) at `bearings` (N, B) [rad].

    Segments begin at `first` [rad] and there are `per_rad` in a radian; those of a full circle go on at its
    beginning. Ranges are horizontal, within two `limits` [m], the second where there is none.
    """
    nearest, farthest = limits
    rows, segments = found.shape
    for row in range(rows):
        for segment in range(segments):
            found[row, segment] = farthest
        for beam in range(ends.shape[1]):
            segment = int(np.floor((bearings[row, beam] - first) * per_rad))
            if full_circle:
                segment %= segments
            if 0 <= segment < segments:
                x, y = ends[row, beam, 0], ends[row, beam, 1]
                found[row, segment] = min(found[row, segment], np.sqrt(x * x + y * y))
        for segment in range(segments):
            found[row, segment] = max(found[row, segment], nearest)
