"""Paths over the terrain that scripted actors walk, and a bank of them to draw from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from dune_rl.behaviours.paths.loops import interpolate_paths
from dune_rl.core.errors import WorldError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.world import World

SPACING_M = 0.05
# So often points are drawn for all paths, and for a first one.
_DRAWS, _MOST_DRAWS = 200, 2_000
_LOOKS = 25


def spline_path(way_points: Array, terrain: HeightField) -> Array:
    """Poses every 5 cm along a cubic spline through `way_points` (n, 2), shape (P, 4): x, y, z, yaw.

    Elevation is the terrain's; yaw points to the next pose, and the last is
    repeated (Vice & Sukthankar 2025, section 2.4). Distances are horizontal.
    """
    fine, travelled, _ = _spline(way_points)
    stations = np.arange(0.0, travelled[-1], SPACING_M)
    xy = _resampled(fine, travelled, stations)
    step = np.diff(xy, axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    return np.column_stack([xy, terrain.height(xy), np.concatenate([yaw, yaw[-1:]])])


def spline_loop(way_points: Array, terrain: HeightField) -> Array:
    """Poses about every 5 cm round a closed cubic spline through `way_points` (n, 2), shape (P, 4).

    As `spline_path`; the last pose leads to the first, as far from it as the others are from each other.
    """
    fine, travelled, _ = _spline(np.concatenate([way_points, way_points[:1]]), closed=True)
    stations = np.linspace(0.0, travelled[-1], max(4, round(travelled[-1] / SPACING_M)), endpoint=False)
    xy = _resampled(fine, travelled, stations)
    step = np.roll(xy, -1, axis=0) - xy
    return np.column_stack([xy, terrain.height(xy), np.arctan2(step[:, 1], step[:, 0])])


def way_point_stations(way_points: Array, *, closed: bool = False) -> NDArray[np.int64]:
    """Indices (n,) of the poses of `spline_path`, or of `spline_loop`, at the way-points (n, 2)."""
    ends = np.concatenate([way_points, way_points[:1]]) if closed else way_points
    _, travelled, at = _spline(ends, closed=closed)
    if closed:
        number = max(4, round(travelled[-1] / SPACING_M))
        return np.rint(at[:-1] / travelled[-1] * number).astype(np.int64)
    last = len(np.arange(0.0, travelled[-1], SPACING_M)) - 1
    return np.minimum(np.rint(at / SPACING_M).astype(np.int64), last)


def _spline(way_points: Array, *, closed: bool = False) -> tuple[Array, Array, Array]:
    """Close points (F, 2) of a spline, the way to each (F,) [m], and to each way-point, (n,) [m]."""
    chords = np.hypot(*np.diff(way_points, axis=0).T)
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    # A line through two points is its own spline; three points bend freely at their ends.
    spline = scipy.interpolate.CubicSpline(knots, way_points, bc_type="periodic" if closed else "natural")
    places = np.linspace(0.0, knots[-1], max(16, int(knots[-1] / 0.01)))
    fine = spline(places)
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    return fine, travelled, np.interp(knots, places, travelled)


def _resampled(fine: Array, travelled: Array, stations: Array) -> Array:
    return np.stack([np.interp(stations, travelled, fine[:, axis]) for axis in (0, 1)], axis=1)


def there_and_back(path: Array) -> Array:
    """The closed loop that walks `path` (P, 4) to its end and returns, (2P - 2, 4), facing where it goes."""
    back = path[-1:0:-1].copy()
    back[:, 3] = (path[-2::-1, 3] + 2 * np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([path[:-1], back])


@dataclass(frozen=True)
class PathBank:
    """Closed loops, end to end in one array, so that a batch is looked up in one go.

    `poses` (total, 4); loop b holds `lengths[b]` of them from `starts[b]`.
    """

    poses: Array
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]

    @classmethod
    def of(cls, loops: Sequence[Array]) -> "PathBank":
        """A bank of `loops`, each (L, 4)."""
        lengths = np.array([len(loop) for loop in loops])
        return cls(np.concatenate(loops), np.concatenate([[0], np.cumsum(lengths)[:-1]]), lengths)

    def pose(self, loop: NDArray[np.int64], travelled_m: Array) -> Array:
        """Pose (..., 4) on loops `loop` (...) after `travelled_m` (...), interpolated between its points."""
        found = np.empty((*np.shape(loop), 4))
        interpolate_paths(self.arrays, np.ravel(loop), np.ravel(travelled_m), SPACING_M, found.reshape(-1, 4))
        return found

    @property
    def arrays(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """What `paths.loops` calls `paths`."""
        return self.poses, self.starts, self.lengths

    def far_end(self, loop: NDArray[np.int64]) -> Array:
        """Pose (..., 4) half-way round loops `loop` (...): where a there-and-back path turns."""
        return self.poses[self.starts[loop] + self.lengths[loop] // 2]


def _surely_blocked(way_points: Array, world: World, radius_m: float) -> Flags:
    """Which of the splines through three points (N, 3, 2) come too near to an obstacle, of most that do.

    All at once and at a few places of each: making a path takes a hundred times as long as that.
    """
    start, middle, end = way_points[:, None, 0], way_points[:, None, 1], way_points[:, None, 2]
    first, second = (np.linalg.norm(leg, axis=-1, keepdims=True) for leg in (middle - start, end - middle))
    # The natural spline bends at its middle alone: its second derivative there.
    bend = 3.0 * ((end - middle) / second - (middle - start) / first) / (first + second)
    u = np.linspace(0.0, 1.0, _LOOKS)[:, None]
    points = np.concatenate(
        [
            start + u * (middle - start) + bend / 6.0 * first**2 * (u**3 - u),
            end + u * (middle - end) + bend / 6.0 * second**2 * (u**3 - u),
        ],
        axis=1,
    )
    # A pose of the path is within a spacing, and clearance, interpolated, changes by at most the root of 2.
    least = radius_m - np.sqrt(2.0) * SPACING_M - 1e-3
    return np.asarray(world.clearance(points).min(axis=1) < least)


def random_paths(
    world: World,
    sample_points: Callable[[np.random.Generator, int, float], Array],
    rng: np.random.Generator,
    count: int,
    radius_m: float,
    length_range_m: tuple[float, float],
    settings: str = "actors.walker",
) -> list[Array]:
    """Up to `count` random paths, each (P, 4), that keep `radius_m` from every obstacle.

    These are found in 200 draws or, if none is, in the first of 2,000 that has any. Each runs through three
    free points drawn by `sample_points(rng, n, radius_m)`. Raises WorldError, which names the path of the
    group's `settings`, where obstacles leave no room for any.
    """
    shortest, longest = length_range_m
    found: list[Array] = []
    for draw in range(_MOST_DRAWS):
        points = sample_points(rng, 3 * count, radius_m).reshape(count, 3, 2)
        legs = np.hypot(*np.moveaxis(np.diff(points, axis=1), -1, 0))
        fitting = (legs.sum(axis=1) > shortest) & (legs.sum(axis=1) < longest) & (legs.min(axis=1) > 1.0)
        # A hairpin in the middle is no way to walk.
        turn = np.sum(np.diff(points, axis=1)[:, 0] * np.diff(points, axis=1)[:, 1], axis=1)
        drawn = points[fitting & (turn > 0)]
        for way_points in drawn[~_surely_blocked(drawn, world, radius_m)]:
            path = spline_path(way_points, world.terrain)
            if world.clearance(path[:, :2]).min() >= radius_m:
                found.append(path)
                if len(found) == count:
                    return found
        if found and draw + 1 >= _DRAWS:
            return found
    raise WorldError(
        f"no path of {shortest:g} to {longest:g} m for an actor of radius {radius_m:g} m fits {world.name}: "
        f"take actors=none, shorten {settings}.path.length_range_m, or enlarge task.spawn.region"
    )
