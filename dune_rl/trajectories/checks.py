"""Where way-points and the spline through them cannot be walked: edge, obstacles, slopes and water."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.errors import WorldError
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.scenery import Segment
from dune_rl.settings import Settings
from dune_rl.worlds.props import merge_meshes
from dune_rl.worlds.world import World

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_LEAST_APART_M = 0.1
_MOST_FAULTS = 12
_IN_OBSTACLE, _TOO_NEAR = "in an obstacle", "too near an obstacle"


class TerrainLimits(Settings):
    """What an actor keeps to: its distance from obstacles, and the steepest ground and deepest water."""

    radius_m: float = Field(0.25, ge=0.0, le=20.0)
    max_slope_deg: float = Field(35.0, gt=0.0, le=90.0)
    max_water_m: float = Field(0.0, ge=0.0, le=100.0)


def check_way_points(world: World, waypoints: Array, limits: TerrainLimits | None, *, closed: bool) -> None:
    """Raise `WorldError` with a line for each of `waypoints` (n, 2) [m] that cannot be walked to."""
    least = 3 if closed else 2
    if len(waypoints) < least:
        raise WorldError(
            f"waypoints must have at least {least}{' for mode=loop' if closed else ''}, as [[x, y], [x, y]] "
            f"(got {len(waypoints)})"
        )
    if not np.isfinite(waypoints).all():
        raise WorldError("waypoints must be finite numbers")
    faults = [*_outside(world, waypoints), *_too_near(waypoints, closed=closed)]
    inside = _is_inside(world, waypoints)
    if limits is not None:
        for number, kind, reason, remedy in _faults(world, waypoints, limits):
            if inside[number]:
                faults.append(
                    f"way-point {number + 1}, {_place(waypoints[number])}, is {kind}{_in_brackets(reason)}: "
                    f"move it{_or(remedy)}"
                )
    _raise(faults)


def check_stretches(world: World, xyz: Array, stops: NDArray[np.int64], limits: TerrainLimits | None) -> None:
    """Raise `WorldError` with a line for each stretch between way-points on which the way cannot be walked.

    The way has the points `xyz` (P, 3) [m]; those at the way-points are `xyz[stops]`.
    """
    faults = []
    inside = _is_inside(world, xyz[:, :2])
    found = [(int(k), "outside the world", "", "") for k in np.flatnonzero(~inside)]
    if limits is not None:
        found += [each for each in _faults(world, xyz[:, :2], limits) if inside[each[0]]]
    count = len(stops) - 1
    told = set()
    # Who is in an obstacle was too near it before.
    for point, kind, reason, remedy in sorted(found, key=lambda each: each[1] == _TOO_NEAR):
        stretch = int(np.clip(np.searchsorted(stops, point, side="right") - 1, 0, count - 1))
        # The last stretch of a loop leads to the first way-point.
        to = 1 if np.allclose(xyz[stops[-1]], xyz[stops[0]]) and stretch == count - 1 else stretch + 2
        if (stretch, subject := _IN_OBSTACLE if kind == _TOO_NEAR else kind) in told:
            continue
        told.add((stretch, subject))
        faults.append(
            f"between way-points {stretch + 1} and {to} the way is {kind} at {_place(xyz[point])}"
            f"{_in_brackets(reason)}: add way-points that lead round it{_or(remedy)}"
        )
    _raise(faults)


def water_depth(world: World, xy: Array) -> Array:
    """Depth of water [m] at points (P, 2): its surface above the ground, 0 where there is none."""
    meshes = [
        (prop.vertices, prop.faces)
        for prop in world.props
        if prop.segment_class == Segment.WATER and len(prop.faces)
    ]
    ground = world.terrain.height(xy)
    if not meshes:
        return np.zeros(len(xy))
    vertices, faces = merge_meshes(meshes)
    top = float(vertices[:, 2].max()) + 1.0
    room = top - min(float(ground.min()), float(vertices[:, 2].min())) + 1.0
    origins = np.column_stack([xy, np.full(len(xy), top)])
    hit, _ = RayScene(vertices, faces).first_hit(
        origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape), room
    )
    return np.where(hit < room, np.maximum(top - hit - ground, 0.0), 0.0)


def _faults(world: World, xy: Array, limits: TerrainLimits) -> Iterator[tuple[int, str, str, str]]:
    """The points (P, 2) beyond the limits: index, what it is, its measure, and which limit to change."""
    clearance = np.asarray(world.clearance(xy))
    for k in np.flatnonzero(clearance < limits.radius_m).tolist():
        if clearance[k] <= 0.0:
            yield k, _IN_OBSTACLE, "", ""
        else:
            distance = f"{clearance[k]:.2f} m from it, and radius_m is {limits.radius_m:g}"
            yield k, _TOO_NEAR, distance, "lower radius_m"
    slope = np.rad2deg(world.terrain.slope(xy))
    for k in np.flatnonzero(slope > limits.max_slope_deg).tolist():
        steep = f"{slope[k]:.1f} degrees, and max_slope_deg is {limits.max_slope_deg:g}"
        yield k, "on too steep ground", steep, "raise max_slope_deg"
    depth = water_depth(world, xy)
    for k in np.flatnonzero(depth > limits.max_water_m).tolist():
        deep = f"{depth[k]:.2f} m deep, and max_water_m is {limits.max_water_m:g}"
        yield k, "in water", deep, "raise max_water_m"


def _is_inside(world: World, xy: Array) -> Flags:
    xmin, xmax, ymin, ymax = world.extent
    return np.asarray(((xy >= [xmin, ymin]) & (xy <= [xmax, ymax])).all(axis=1))


def _outside(world: World, waypoints: Array) -> Iterator[str]:
    xmin, xmax, ymin, ymax = world.extent
    for k in np.flatnonzero(~_is_inside(world, waypoints)).tolist():
        yield (
            f"way-point {k + 1}, {_place(waypoints[k])}, is outside the world, which has x from {xmin:g} to "
            f"{xmax:g} m and y from {ymin:g} to {ymax:g} m: move it"
        )


def _too_near(waypoints: Array, *, closed: bool) -> Iterator[str]:
    ends = np.concatenate([waypoints, waypoints[:1]]) if closed else waypoints
    apart = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    for k in np.flatnonzero(apart < _LEAST_APART_M).tolist():
        other = (k + 1) % len(waypoints) + 1
        yield f"way-points {k + 1} and {other} are less than {_LEAST_APART_M:g} m apart: leave one out"


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
