"""Checks of points and ways: world's edge, obstacles, slopes and water."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.worlds.passage import water_depth
from dune_rl.worlds.world import World

_LEAST_APART_M = 0.1
_MOST_FAULTS = 12
_IN_OBSTACLE, _TOO_NEAR = "in an obstacle", "too near an obstacle"


class TerrainLimits(Settings):
    """Limits of an actor: distance from obstacles, slope of the ground and depth of water."""

    radius_m: float = Field(0.25, ge=0.0, le=20.0)
    max_slope_deg: float = Field(35.0, gt=0.0, le=90.0)
    max_water_m: float = Field(0.0, ge=0.0, le=100.0)


@dataclass(frozen=True)
class PointWords:
    """How errors call the points, where they are set, and the limits.

    `setting` begins each line, as the path of the setting that has the points. `limits` is the path of those
    of a body, whose radius is no setting; without it they are `TerrainLimits` themselves.
    """

    point: str = "way-point"
    setting: str = ""
    limits: str = ""

    @property
    def lead(self) -> str:
        """How a line begins."""
        return f"{self.setting}: " if self.setting else ""

    @property
    def limit(self) -> str:
        """What stands before the name of a limit."""
        return f"{self.limits}." if self.limits else ""


_PLAIN = PointWords()


def check_points(
    world: World, points: Array, limits: TerrainLimits | None, words: PointWords = _PLAIN
) -> None:
    """Raise `WorldError` with a line for each of `points` (n, 2) [m] at which a body of `limits` cannot be.

    Without `limits` they need only be in the world.
    """
    _raise([*_points_outside(world, points, words), *_points_beyond_limits(world, points, limits, words)])


def check_way_points(
    world: World, waypoints: Array, limits: TerrainLimits | None, words: PointWords = _PLAIN, *, closed: bool
) -> None:
    """As `check_points`; `waypoints` (n, 2) [m] are also enough, and apart, for a way, or a `closed` one."""
    least = 3 if closed else 2
    if len(waypoints) < least:
        raise WorldError(
            f"{words.setting or 'waypoints'} must have at least {least}{' for mode=loop' if closed else ''}, "
            f"as [[x, y], [x, y]] (got {len(waypoints)})"
        )
    if not np.isfinite(waypoints).all():
        raise WorldError(f"{words.setting or 'waypoints'} must be finite numbers")
    _raise(
        [
            *_points_outside(world, waypoints, words),
            *_pairs_too_close(waypoints, words, closed=closed),
            *_points_beyond_limits(world, waypoints, limits, words),
        ]
    )


def check_stretches(
    world: World,
    xyz: Array,
    stops: NDArray[np.int64],
    limits: TerrainLimits | None,
    words: PointWords = _PLAIN,
) -> None:
    """Raise `WorldError` with a line for each stretch between way-points on which the way cannot be walked.

    The way has the points `xyz` (P, 3) [m]; those at the way-points are `xyz[stops]`.
    """
    faults = []
    inside = _is_inside(world, xyz[:, :2])
    found = [(int(k), "outside the world", "", "") for k in np.flatnonzero(~inside)]
    if limits is not None:
        found += [each for each in _faults(world, xyz[:, :2], limits, words) if inside[each[0]]]
    count = len(stops) - 1
    reported = set()
    # A way into an obstacle was too near it before.
    for point, kind, reason, remedy in sorted(found, key=lambda each: each[1] == _TOO_NEAR):
        stretch = int(np.clip(np.searchsorted(stops, point, side="right") - 1, 0, count - 1))
        # The last stretch of a loop leads to the first way-point.
        to = 1 if np.allclose(xyz[stops[-1]], xyz[stops[0]]) and stretch == count - 1 else stretch + 2
        if (stretch, subject := _IN_OBSTACLE if kind == _TOO_NEAR else kind) in reported:
            continue
        reported.add((stretch, subject))
        faults.append(
            f"{words.lead}between {words.point}s {stretch + 1} and {to} the way is {kind} at "
            f"{_place(xyz[point])}{_in_brackets(reason)}: add {words.point}s that lead round it{_or(remedy)}"
        )
    _raise(faults)


def _points_beyond_limits(
    world: World, points: Array, limits: TerrainLimits | None, words: PointWords
) -> Iterator[str]:
    if limits is None:
        return
    inside = _is_inside(world, points)
    for number, kind, reason, remedy in _faults(world, points, limits, words):
        if inside[number]:
            yield (
                f"{words.lead}{words.point} {number + 1}, {_place(points[number])}, is {kind}"
                f"{_in_brackets(reason)}: move it{_or(remedy)}"
            )


def _faults(
    world: World, xy: Array, limits: TerrainLimits, words: PointWords
) -> Iterator[tuple[int, str, str, str]]:
    """The points (P, 2) beyond the limits: index, what it is, its measure, and which limit to change."""
    clearance, name = np.asarray(world.clearance(xy)), words.limit
    needed = "the body's radius" if words.limits else "radius_m"
    smaller = f"choose a smaller {words.limits}" if words.limits else "lower radius_m"
    for k in np.flatnonzero((clearance < limits.radius_m) | (clearance <= 0.0)).tolist():
        if clearance[k] <= 0.0:
            yield k, _IN_OBSTACLE, "", ""
        else:
            distance = f"{clearance[k]:.2f} m from it, and {needed} is {limits.radius_m:g}"
            yield k, _TOO_NEAR, distance, smaller
    slope = np.rad2deg(world.terrain.slope(xy))
    for k in np.flatnonzero(slope > limits.max_slope_deg).tolist():
        steep = f"{slope[k]:.1f} degrees, and {name}max_slope_deg is {limits.max_slope_deg:g}"
        yield k, "on too steep ground", steep, f"raise {name}max_slope_deg"
    depth = water_depth(world, xy)
    for k in np.flatnonzero(depth > limits.max_water_m).tolist():
        deep = f"{depth[k]:.2f} m deep, and {name}max_water_m is {limits.max_water_m:g}"
        yield k, "in water", deep, f"raise {name}max_water_m"


def _is_inside(world: World, xy: Array) -> Flags:
    xmin, xmax, ymin, ymax = world.extent
    return np.asarray(((xy >= [xmin, ymin]) & (xy <= [xmax, ymax])).all(axis=1))


def _points_outside(world: World, points: Array, words: PointWords) -> Iterator[str]:
    xmin, xmax, ymin, ymax = world.extent
    for k in np.flatnonzero(~_is_inside(world, points)).tolist():
        yield (
            f"{words.lead}{words.point} {k + 1}, {_place(points[k])}, is outside the world, which has x from "
            f"{xmin:g} to {xmax:g} m and y from {ymin:g} to {ymax:g} m: move it"
        )


def _pairs_too_close(waypoints: Array, words: PointWords, *, closed: bool) -> Iterator[str]:
    ends = np.concatenate([waypoints, waypoints[:1]]) if closed else waypoints
    apart = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    for k in np.flatnonzero(apart < _LEAST_APART_M).tolist():
        other = (k + 1) % len(waypoints) + 1
        pair = f"{words.lead}{words.point}s {k + 1} and {other}"
        yield f"{pair} are less than {_LEAST_APART_M:g} m apart: leave one out"


def _place(point: Array) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"


def _in_brackets(reason: str) -> str:
    return f" ({reason})" if reason else ""


def _or(remedy: str) -> str:
    return f", or {remedy}" if remedy else ""


def _raise(faults: list[str]) -> None:
    if faults:
        more = len(faults) - _MOST_FAULTS
        raise WorldError("\n".join([*faults[:_MOST_FAULTS], *([f"and {more} more"] if more > 0 else [])]))
