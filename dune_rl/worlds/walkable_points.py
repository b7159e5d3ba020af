"""Checks of points and ways: world's edge, obstacles, slopes and water."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array
from dune_rl.worlds.passage import water_depth
from dune_rl.worlds.world import World

_LEAST_APART_M = 0.1
# Water as deep as is allowed, by rays that differ in their last digits from processor to processor.
_ROUNDING_M = 1e-5
_MOST_FAULTS = 12
_OUTSIDE, _IN_OBSTACLE, _TOO_NEAR = "outside the world", "in an obstacle", "too near an obstacle"


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


class _Fault(NamedTuple):
    """A point where a body cannot be: its index, what it is, its measure, and the limit to change."""

    point: int
    kind: str
    measure: str = ""
    remedy: str = ""


_PLAIN = PointWords()


def check_points(
    world: World, points: Array, limits: TerrainLimits | None, words: PointWords = _PLAIN
) -> None:
    """Raise `WorldError` with a line for each of `points` (n, 2) [m] at which a body of `limits` cannot be.

    Without `limits` they need only be in the world.
    """
    _raise(_point_lines(world, points, limits, words))


def check_way_points(
    world: World, waypoints: Array, limits: TerrainLimits | None, words: PointWords = _PLAIN, *, closed: bool
) -> None:
    """As `check_points`; `waypoints` (n, 2) [m] are also enough, and apart, for a way, or a `closed` one."""
    least, setting = 3 if closed else 2, words.setting or "waypoints"
    if len(waypoints) < least:
        raise WorldError(
            f"{setting} must have at least {least}{' for mode=loop' if closed else ''}, "
            f"as [[x, y], [x, y]] (got {len(waypoints)})"
        )
    if not np.isfinite(waypoints).all():
        raise WorldError(f"{setting} must be finite numbers")
    ends = np.concatenate([waypoints, waypoints[:1]]) if closed else waypoints
    near = np.flatnonzero(np.linalg.norm(np.diff(ends, axis=0), axis=1) < _LEAST_APART_M)
    pairs = [
        f"{words.lead}{words.point}s {k + 1} and {(k + 1) % len(waypoints) + 1} are less than "
        f"{_LEAST_APART_M:g} m apart: leave one out"
        for k in near.tolist()
    ]
    _raise([*_point_lines(world, waypoints, limits, words), *pairs])


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
    lines: dict[tuple[int, str], str] = {}
    count = len(stops) - 1
    # A way into an obstacle was too near it before.
    for fault in sorted(_faults(world, xyz[:, :2], limits, words), key=lambda each: each.kind == _TOO_NEAR):
        stretch = int(np.clip(np.searchsorted(stops, fault.point, side="right") - 1, 0, count - 1))
        # The last stretch of a loop leads to the first way-point.
        to = 1 if np.allclose(xyz[stops[-1]], xyz[stops[0]]) and stretch == count - 1 else stretch + 2
        lines.setdefault(
            (stretch, _IN_OBSTACLE if fault.kind == _TOO_NEAR else fault.kind),
            f"{words.lead}between {words.point}s {stretch + 1} and {to} the way is {fault.kind} at "
            f"{_place(xyz[fault.point])}{fault.measure}: add {words.point}s that lead round it{fault.remedy}",
        )
    _raise(list(lines.values()))


def _point_lines(world: World, points: Array, limits: TerrainLimits | None, words: PointWords) -> list[str]:
    xmin, xmax, ymin, ymax = world.extent
    extent = f", which has x from {xmin:g} to {xmax:g} m and y from {ymin:g} to {ymax:g} m"
    return [
        f"{words.lead}{words.point} {k + 1}, {_place(points[k])}, is {kind}"
        f"{extent if kind == _OUTSIDE else measure}: move it{remedy}"
        for k, kind, measure, remedy in _faults(world, points, limits, words)
    ]


def _faults(world: World, xy: Array, limits: TerrainLimits | None, words: PointWords) -> Iterator[_Fault]:
    """The points (P, 2) beyond the limits or the world's edge."""
    xmin, xmax, ymin, ymax = world.extent
    inside = ((xy >= [xmin, ymin]) & (xy <= [xmax, ymax])).all(axis=1)
    yield from (_Fault(k, _OUTSIDE) for k in np.flatnonzero(~inside).tolist())
    if limits is None:
        return
    clearance, name = np.asarray(world.clearance(xy)), f"{words.limits}." if words.limits else ""
    needed = "the body's radius" if words.limits else "radius_m"
    smaller = f", or choose a smaller {words.limits}" if words.limits else ", or lower radius_m"
    for k in np.flatnonzero(inside & ((clearance < limits.radius_m) | (clearance <= 0.0))).tolist():
        if clearance[k] <= 0.0:
            yield _Fault(k, _IN_OBSTACLE)
        else:
            measure = f" ({clearance[k]:.2f} m from it, and {needed} is {limits.radius_m:g})"
            yield _Fault(k, _TOO_NEAR, measure, smaller)
    slope, steepest = np.rad2deg(world.terrain.slope(xy)), limits.max_slope_deg
    for k in np.flatnonzero(inside & (slope > steepest)).tolist():
        measure = f" ({slope[k]:.1f} degrees, and {name}max_slope_deg is {steepest:g})"
        yield _Fault(k, "on too steep ground", measure, f", or raise {name}max_slope_deg")
    depth = water_depth(world, xy)
    for k in np.flatnonzero(inside & (depth > limits.max_water_m + _ROUNDING_M)).tolist():
        measure = f" ({depth[k]:.2f} m deep, and {name}max_water_m is {limits.max_water_m:g})"
        yield _Fault(k, "in water", measure, f", or raise {name}max_water_m")


def _place(point: Array) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"


def _raise(faults: list[str]) -> None:
    if faults:
        more = len(faults) - _MOST_FAULTS
        raise WorldError("\n".join([*faults[:_MOST_FAULTS], *([f"and {more} more"] if more > 0 else [])]))
