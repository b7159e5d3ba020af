"""Where cameras stand that film a robot on its way: each in one place, until the robot leaves its view."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.rendering.baked_scenery import BakedScenery
from dune_rl.rendering.renderer import Viewpoint

_FOV_RAD = 0.85
_LONGEST_S, _SHORTEST_S = 9.0, 1.0
# Lengths of way [m] that a view may hold, and room beside it.
_REACHES_M, _MARGIN_M = (2.5, 5.0, 8.0), 1.2
_NEAREST_M = 3.4
_BEARINGS = 16
# Height above the middle of the way, as a share of the distance, and above the ground.
_RISE, _ABOVE_GROUND_M = 0.5, 1.2
# Part of the robot that must be in sight, above its centre.
_SEEN_ABOVE_M = 0.15
# What a metre of distance, and the sun in the eye, cost in seconds of length; and a place off the site.
_PER_METRE, _AGAINST_SUN, _OFF_SITE = 0.45, 0.8, 4.0
# What a second costs in which another agent covers the robot: nearer to the line of sight, and so tall.
_COVERED, _ROOM_M, _TALL_M = 1.5, 0.45, 1.8


@dataclass(frozen=True)
class Shot:
    """The frames from `first` until before `end` are seen from `view`."""

    first: int
    end: int
    view: Viewpoint


def plan_shots(
    track: Array,
    others: Array,
    rate_hz: float,
    baked: BakedScenery,
    aspect: float,
    otherwise: Callable[[int], Viewpoint],
) -> list[Shot]:
    """Shots that follow one another of a robot at `track` (T, 3) [m] among `others` (T, K, 2), at `rate_hz`.

    Their pictures have an `aspect`, width by height.

    The length of a shot is weighed against the camera's distance. Where the robot can be seen from no place
    about it, the shot has the viewpoint of `otherwise` at its first frame.
    """
    shots: list[Shot] = []
    while not shots or shots[-1].end < len(track):
        first = shots[-1].end if shots else 0
        most = slice(first, first + max(1, round(_LONGEST_S * rate_hz)))
        frames, view = _best(track[most], others[most], rate_hz, baked, aspect)
        if view is None or frames < min(_SHORTEST_S * rate_hz, len(track) - first):
            frames, view = min(max(1, round(_SHORTEST_S * rate_hz)), len(track) - first), otherwise(first)
        shots.append(Shot(first, first + frames, view))
    return shots


def _best(
    track: Array, others: Array, rate_hz: float, baked: BakedScenery, aspect: float
) -> tuple[int, Viewpoint | None]:
    """The best shot from the first point of `track` (T, 3): its number of frames, and its viewpoint."""
    best = -np.inf
    found: tuple[int, Viewpoint | None] = (0, None)
    bearings = 2.0 * np.pi * np.arange(_BEARINGS) / _BEARINGS
    ways = np.column_stack([np.cos(bearings), np.sin(bearings)])
    gone = np.linalg.norm(track[:, :2] - track[0, :2], axis=1)
    xmin, xmax, ymin, ymax = baked.terrain.extent
    for reach in _REACHES_M:
        beyond = np.flatnonzero(gone > reach)
        stretch = track[: beyond[0]] if len(beyond) else track
        middle = (stretch.min(axis=0) + stretch.max(axis=0)) / 2
        room = float(np.linalg.norm(stretch - middle, axis=1).max()) + _MARGIN_M
        away = max(_NEAREST_M, room / np.tan(_FOV_RAD / 2) * max(1.0, 0.75 * aspect))
        xy = middle[:2] + away * ways
        ground = baked.terrain.height(np.clip(xy, [xmin, ymin], [xmax, ymax]))
        z = np.maximum(middle[2] + _RISE * away, ground + _ABOVE_GROUND_M)
        eyes = np.column_stack([xy, z])
        frames = _frames_in_sight(eyes, stretch, baked)
        covered = _is_covered(eyes, stretch, others[: len(stretch)])
        covered &= np.arange(len(stretch)) < frames[:, None]
        outside = (xy < [xmin, ymin]).any(axis=1) | (xy > [xmax, ymax]).any(axis=1)
        score = frames / rate_hz - _PER_METRE * away - _OFF_SITE * outside
        score += _AGAINST_SUN * ways @ baked.light.to_sun[:2] - _COVERED * covered.sum(axis=1) / rate_hz
        chosen = int(score.argmax())
        if score[chosen] > best and frames[chosen]:
            best = score[chosen]
            eye = (*xy[chosen].tolist(), float(z[chosen]))
            found = (int(frames[chosen]), Viewpoint(eye, tuple(middle.tolist()), _FOV_RAD))
    return found


def _frames_in_sight(eyes: Array, track: Array, baked: BakedScenery) -> Array:
    """How many points of `track` (T, 3), from its first on, are in sight of each of `eyes` (E, 3)."""
    seen = track + np.array([0.0, 0.0, _SEEN_ABOVE_M])
    ways = seen[None] - eyes[:, None]
    lengths = np.linalg.norm(ways, axis=2)
    directions = (ways / lengths[..., None]).reshape(-1, 3).astype(np.float32)
    ranges = lengths.reshape(-1).astype(np.float32)
    baked.rays.shorten_ranges(eyes.astype(np.float32), directions, ranges)
    hidden = ranges.reshape(lengths.shape) < lengths - 0.05
    return np.where(hidden.any(axis=1), hidden.argmax(axis=1), len(track))


def _is_covered(eyes: Array, track: Array, others: Array) -> NDArray[np.bool_]:
    """Whether one of `others` (T, K, 2) is between `track` (T, 3) and each of `eyes` (E, 3), (E, T)."""
    way = eyes[:, None, :2] - track[None, :, :2]
    offset = others - track[:, None, :2]
    length = np.einsum("etx,etx->et", way, way)
    share = np.einsum("tkx,etx->etk", offset, way) / length[..., None]
    aside = np.abs(offset[..., 0] * way[..., None, 1] - offset[..., 1] * way[..., None, 0])
    rise = share * (eyes[:, None, 2] - track[:, 2])[..., None]
    is_between = (share > 0.0) & (share < 1.0) & (aside < _ROOM_M * np.sqrt(length)[..., None])
    covered: NDArray[np.bool_] = (is_between & (rise < _TALL_M)).any(axis=2)
    return covered
