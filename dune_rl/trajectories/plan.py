"""A trajectory through way-points on a world's ground, at constant speed."""

from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dune_rl.core.errors import WorldError
from dune_rl.geometry.arrays import Array
from dune_rl.worlds.actor_trajectory import MOST_WAY_POINTS, ActorTrajectory, unwrap_yaw
from dune_rl.worlds.walkable_points import TerrainLimits, check_stretches, check_way_points
from dune_rl.worlds.world import World

Mode = Literal["once", "loop", "back_and_forth"]

SPACING_M = 0.05
# Distance of the points with which the spline's length is measured.
_FINE_M = 0.01
# A point nearer to a stop than this share of the spacing gives way to it.
_NEAR = 1e-3


def plan_on_ground(
    world: World,
    waypoints: Array,
    *,
    velocity: float = 1.0,
    mode: Mode = "back_and_forth",
    pauses_s: Array | None = None,
    delay_s: float = 0.0,
    spacing_m: float = SPACING_M,
    limits: TerrainLimits | None = None,
    name: str = "walker",
) -> ActorTrajectory:
    """The trajectory through `waypoints` (n, 2) [m] with a pose every `spacing_m` of its way on the ground.

    A cubic spline leads through them, closed in the mode `loop` (Vice & Sukthankar 2025, section 2.4). The
    speed along the ground is `velocity` [m/s]. Yaw points to the next pose, and the last is repeated. At
    way-point k the actor stands for `pauses_s[k]` [s], and turns there. Raises `WorldError` that names the
    way-points and the stretches between them that go beyond the `limits` (None: those of the world's edge).
    """
    closed = mode == "loop"
    check_way_points(world, waypoints, limits, closed=closed)
    every = pauses_s is not None
    stations, xyz, stops = _sample_spline(world, waypoints, spacing_m, closed=closed, every=every)
    check_stretches(world, xyz, stops, limits)
    pauses = np.zeros(len(waypoints)) if pauses_s is None else pauses_s
    visited = np.append(np.arange(len(waypoints)), 0) if closed else np.arange(len(waypoints))
    if mode == "back_and_forth":
        stations = np.concatenate([stations, 2 * stations[-1] - stations[-2::-1]])
        xyz = np.concatenate([xyz, xyz[-2::-1]])
        stops = np.concatenate([stops, len(xyz) - 1 - stops[-2::-1]])
        visited = np.concatenate([visited, visited[-2::-1]])
    held = pauses[visited]
    if mode != "once":
        # The first way-point is the last, too: it has one pause, before the start.
        held[-1] = 0.0
    at_s, is_round = stations / velocity, mode != "once"
    times, poses = _timed_poses(at_s, xyz, stops, held, round_trip=is_round, closed=closed)
    if len(times) > MOST_WAY_POINTS:
        raise WorldError(
            f"the trajectory has {len(times):,} poses, and a file at most {MOST_WAY_POINTS:,}: raise "
            "spacing_m, or shorten the way"
        )
    return ActorTrajectory(name, times, poses, mode != "once", delay_s)


def _sample_spline(
    world: World, waypoints: Array, spacing_m: float, *, closed: bool, every: bool
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Distances along the way (P,), points (P, 3) there, and the indices of the way-points among them.

    Points are `spacing_m` apart, and the last is the end of the way. With `every`, all way-points are points
    as well; else the index is that of the point before.
    """
    ends = np.concatenate([waypoints, waypoints[:1]]) if closed else waypoints
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    spline = CubicSpline(knots, ends, bc_type="periodic" if closed else "natural")
    pieces = [
        np.linspace(low, high, max(2, int(np.ceil((high - low) / _FINE_M))), endpoint=False)
        for low, high in pairwise(knots.tolist())
    ]
    fine = np.append(np.concatenate(pieces), knots[-1])
    at_knots = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces])])
    steps = np.linalg.norm(np.diff(_on_ground(world, spline(fine)), axis=0), axis=1)
    travelled = np.cumsum(np.concatenate([[0.0], steps]))
    if travelled[-1] > MOST_WAY_POINTS * spacing_m:
        raise WorldError(
            f"the way is {travelled[-1]:,.0f} m long, and has at most {MOST_WAY_POINTS:,} poses: raise "
            f"spacing_m ({spacing_m:g} m), or shorten the way"
        )
    regular = np.arange(0.0, travelled[-1], spacing_m)
    fixed = travelled[at_knots] if every else travelled[[0, -1]]
    behind = np.searchsorted(fixed, regular).clip(1, len(fixed) - 1)
    apart = np.minimum(np.abs(regular - fixed[behind - 1]), np.abs(regular - fixed[behind]))
    stations = np.sort(np.concatenate([regular[apart > _NEAR * spacing_m], fixed]))
    xy = spline(np.interp(stations, travelled, fine))
    stops = np.searchsorted(stations, travelled[at_knots] + 1e-9, side="right") - 1
    # Way-points are met exactly.
    met = np.abs(stations[stops] - travelled[at_knots]) < 1e-9
    xy[stops[met]] = ends[met]
    return stations, _on_ground(world, xy), stops


def _on_ground(world: World, xy: Array) -> Array:
    return np.column_stack([xy, world.terrain.height(xy)])


def _timed_poses(
    times: Array, xyz: Array, stops: NDArray[np.int64], pauses: Array, *, round_trip: bool, closed: bool
) -> tuple[Array, Array]:
    """Times (T,) and poses (T, 4): the points (P, 3) at `times` (P,), and those of pauses twice."""
    step = np.diff(xyz[:, :2], axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    leaving = np.append(yaw, yaw[0] if closed else yaw[-1])
    arriving = np.append(yaw[-1] if round_trip else yaw[0], yaw)
    held = np.zeros(len(times))
    np.add.at(held, stops, pauses)
    repeats = np.where(held > 0.0, 2, 1)
    index = np.repeat(np.arange(len(times)), repeats)
    # The first of two equal points is where the actor arrives, and the second where it leaves.
    second = np.append(False, index[1:] == index[:-1])
    first = np.append(index[1:] == index[:-1], False)
    waited = np.cumsum(np.where(second, held[index], 0.0))
    poses = np.column_stack([xyz[index], np.where(first, arriving[index], leaving[index])])
    poses[:, 3] = unwrap_yaw(poses[:, 3])
    return times[index] + waited, poses
