"""The sensor of obstacles below the LiDAR's plane: steps of the ground that were seen, kept by odometry."""

from typing import Any, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.ground_profile import GroundProfile
from dune_rl.sensors.perception.agent_tracks import AgentTracks
from dune_rl.sensors.sensor import VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

_CELL_M = 0.1
# Cells of a map, which is a torus: a point's cell is that of its coordinates modulo the map's size.
_CELLS = 80
# A cell this much above a neighbour within two cells is a step, beyond what slopes of 27 degrees rise.
_STEP_M = 0.05
_SLOPE = 0.5
_REACH = 2
# So is one this far over the plane through at least so many cells there; a little keeps the plane level where
# these do not fix its slope [cells²].
_BUMP_M, _LEAST_CELLS, _LEVELLING = 0.045, 6.0, 1.0
# And one this far over as many lower cells, if the standard deviation of their heights is below this [m] and
# they are on more sides than one: their middle is this near [cells].
_LOW_BUMP_M, _LOWER_M, _LEVEL_M, _OFF_CENTRE_CELLS = 0.03, 0.02, 0.004, 0.6
# Heights that differ from the map's by more than this, in the middle of at least so many hits, are the
# odometry's drift, not the ground's [m].
_DRIFT_M, _LEAST_HITS = 0.02, 12
# A lower height takes the place of a higher one by this share in each look. A hit that is lower by no more
# than this is one of the highest of its cell [m].
_NEW_SHARE, _AS_HIGH_M = 0.3, 0.03
# Hits this near to what moves are taken for its own, also those on stones there.
_MOVING_M = 0.5
_NEAREST_M = 0.1
# A robot that is tilted by more than 60 degrees does not stand on its plane, and climbs nothing (the cosine).
_LEAST_UP = 0.5


class LowObstaclesConf(SensorSettings):
    """Steps of the ground within `range_m`, from the rays of a sensor ground_profile.

    They are remembered in a map of 8 by 8 m that moves along by odometry.
    """

    sensor: Literal["low_obstacles"] = "low_obstacles"
    realism: None = Field(None, description="none of its own: that of what it reads")
    profile: str = Field("ground_profile", description="name of the sensor whose rays it takes")
    tracks: str = Field("agent_tracks", description="name of the sensor whose odometry it takes")
    range_m: float = Field(3.0, gt=0.2, le=3.5, description="reading where there is no step [m]")


class LowObstacles(VectorSensor):
    """The reading `name`, (N, n_segments) [m]: distance of the nearest step in each segment of a scan.

    Steps are where the ground rises by more than 5 cm beyond a slope, or stands out of the plane around by
    4.5 cm, or of level ground by 3 cm: stones, bricks, kerbs, planks, walls; and where the ground ends.
    Segments and distances are from the LiDAR's mount. Heights are those of the rays' hits, by the robot's
    attitude and odometry and by ground that is seen again; hits within 0.5 m of what moves are left out. A
    step fades where lower ground is seen; one of 3 to 4.5 cm may come and go with each look.

    `met_at` (N, C, C, 2) [m] is where each cell of the `map` was hit, in the frame of the odometry: the last
    time at most 3 cm below its height.
    """

    def __init__(self, name: str, context: SensorContext, conf: LowObstaclesConf) -> None:
        profile, tracks = context.sensor_of(conf.profile), context.sensor_of(conf.tracks)
        if not isinstance(profile, GroundProfile):
            raise ConfigError(f"sensors.{name}.profile must be the name of a sensor ground_profile")
        if not isinstance(tracks, AgentTracks):
            raise ConfigError(f"sensors.{name}.tracks must be the name of a sensor agent_tracks")
        farthest = np.full(len(tracks.bearings), conf.range_m)
        super().__init__(name, context.num_rows, np.full_like(farthest, _NEAREST_M), farthest)
        self._profile, self._tracks = profile, tracks
        shape = (context.num_rows, _CELLS, _CELLS)
        # Heights in the frame of the odometry, which cell of the plane each is of, and where steps are.
        self._heights = np.zeros(shape, np.float32)
        self._places = np.full((*shape, 2), np.iinfo(np.int32).min, np.int32)
        self._steps = np.zeros(shape, bool)
        self.met_at = np.zeros((*shape, 2), np.float32)
        self._climbed_m, self._places_before = np.zeros(context.num_rows), np.zeros((context.num_rows, 2))

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Begin the maps of the agents in `mask` (N,) anew, with what is seen at the start."""
        self._places[mask] = np.iinfo(np.int32).min
        self._steps[mask] = False
        self._climbed_m[mask] = 0.0
        self._places_before[mask] = self._tracks.tracker.poses[mask, :2]
        self._look(mask)

    def measure(self, now: GroupState, state: State) -> None:
        self._climb()
        self._look(np.ones(len(self._climbed_m), bool))

    @property
    def map(self) -> tuple[Flags, Any, float]:
        """Where steps are (N, C, C), the cells in the odometry frame (N, C, C, 2), their width [m]."""
        return self._steps, self._places, _CELL_M

    def _climb(self) -> None:
        """Add what the robots have climbed since the last step, along the plane that they stand on."""
        x, y, yaw = self._tracks.tracker.poses.T
        moved, self._places_before = np.stack([x, y], axis=1) - self._places_before, np.stack([x, y], axis=1)
        cos, sin, up = np.cos(yaw), np.sin(yaw), self._profile.up
        ahead, left = cos * moved[:, 0] + sin * moved[:, 1], cos * moved[:, 1] - sin * moved[:, 0]
        climbed = -(up[:, 0] * ahead + up[:, 1] * left) / np.maximum(up[:, 2], _LEAST_UP)
        self._climbed_m += np.where(up[:, 2] > _LEAST_UP, climbed, 0.0)

    def _look(self, mask: Flags) -> None:
        """Enter what the rays of the agents in `mask` (N,) meet; the others keep their maps and readings."""
        profile, tracks, tracker = self._profile, self._tracks, self._tracks.tracker
        found = self._reading.copy()
        _update(
            mask, tracker.poses, tracks.mount, tracks.bearings, tracker.moving, tracker.moving_counts,
            self._climbed_m, profile.points, profile.sees, profile.drops, self._heights, self._places,
            self._steps, self.met_at, self._high[0], found,
        )  # fmt: skip
        self._store(found)


@compile_function
def _update(
    mask: Any, poses: Any, mount: Any, bearings: Any, movers: Any, mover_counts: Any, height: Any,
    points: Any, sees: Any, drops: Any, heights: Any, places: Any, steps: Any, met_at: Any, farthest: float,
    found: Any,
) -> None:  # fmt: skip
    """Enter hits into the maps of the rows in `mask` (N,), and find their nearest steps, `found` (N, S) [m].

    `poses` (N, 3: x, y [m], yaw [rad]) and `height` (N,) [m] are of the odometry, `mount` (2,) [m] is the
    LiDAR's, `bearings` (S,) [rad] are the middles of its segments, and `movers` (N, T, 4: x, y, velocity),
    `mover_counts` of them in a row, is what moves, in the robots' frames. `points` (N, P, 3) [m] are the hits
    in level frames with the robots' headings, over the robots' ground, `sees` (N, P) which rays have one, and
    `drops` (N, P) those over the end of the ground. Maps are `heights` (N, C, C) [m], `places` (N, C, C, 2),
    the numbers of cells that they are of, `steps` (N, C, C), and `met_at` (N, C, C, 2) [m], as
    `LowObstacles.met_at`.
    """
    count = points.shape[1]
    hits, cells, at = np.empty(count, np.bool_), np.empty((count, 2), np.int64), np.empty((count, 2))
    for row in range(len(poses)):
        if not mask[row]:
            continue
        _find_cells(poses[row], points[row], cells, at)
        _leave_out_moving(points[row], movers[row, : mover_counts[row]], sees[row], hits)
        height[row] -= _drift_of(cells, height[row], points[row], hits, heights[row], places[row], steps[row])
        layers = heights[row], places[row], steps[row], met_at[row]
        _enter(cells, at, height[row], points[row], hits, *layers)
        _enter_drops(cells, at, height[row], drops[row], *layers)
        _look_around(poses[row], mount, bearings, places[row], steps[row], farthest, found[row])


@compile_function
def _leave_out_moving(points: Any, movers: Any, sees: Any, hits: Any) -> None:
    """Which of the rays that `sees` (P,) has met something, `hits` (P,), that is at none of the `movers`."""
    for number in range(len(points)):
        hits[number] = sees[number]
        for mover in range(len(movers)):
            ahead, left = points[number, 0] - movers[mover, 0], points[number, 1] - movers[mover, 1]
            hits[number] = hits[number] and np.hypot(ahead, left) > _MOVING_M


@compile_function
def _find_cells(pose: Any, points: Any, cells: Any, at: Any) -> None:
    """Where points (P, 3) in the body's frame are in the odometry's, `at` (P, 2) [m], and the numbers (x, y)
    of their cells, `cells` (P, 2).
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    for number in range(len(points)):
        ahead, left = points[number, 0], points[number, 1]
        at[number, 0] = pose[0] + cos * ahead - sin * left
        at[number, 1] = pose[1] + sin * ahead + cos * left
        cells[number, 0] = np.int64(np.floor(at[number, 0] / _CELL_M))
        cells[number, 1] = np.int64(np.floor(at[number, 1] / _CELL_M))


@compile_function
def _drift_of(
    cells: Any, height: float, points: Any, hits: Any, heights: Any, places: Any, steps: Any
) -> float:  # fmt: skip
    """Median height of the hits over the map [m], in cells that it knows, beyond what is little."""
    apart, count = np.empty(len(points)), 0
    for number in range(len(points)):
        if hits[number]:
            x, y = cells[number, 0], cells[number, 1]
            row, column = y % _CELLS, x % _CELLS
            is_known = places[row, column, 0] == x and places[row, column, 1] == y
            if is_known and not steps[row, column]:
                apart[count] = points[number, 2] + height - heights[row, column]
                count += 1
    if count < _LEAST_HITS:
        return 0.0
    middle = np.median(apart[:count])
    result: float = np.sign(middle) * max(abs(middle) - _DRIFT_M, 0.0)
    return result


@compile_function
def _enter(
    cells: Any, at: Any, height: float, points: Any, hits: Any, heights: Any, places: Any, steps: Any,
    met_at: Any,
) -> None:  # fmt: skip
    """Enter the `hits` (P,) among `points` (P, 3), which are `at` (P, 2) in `cells` (P, 2), into a map."""
    # By how much a step rises over a cell `up` and `right` of it [m]; negative indices count from the end.
    plane, lower, leasts = np.empty(9), np.empty(5), np.empty((2 * _REACH + 1, 2 * _REACH + 1))
    for up in range(-_REACH, _REACH + 1):
        for right in range(-_REACH, _REACH + 1):
            leasts[up, right] = _STEP_M + _SLOPE * _CELL_M * np.hypot(up, right)
    for number in range(len(points)):
        if not hits[number]:
            continue
        x, y = cells[number, 0], cells[number, 1]
        z = points[number, 2] + height
        row, column = y % _CELLS, x % _CELLS
        is_highest = True
        if places[row, column, 0] == x and places[row, column, 1] == y:
            before = heights[row, column]
            is_highest = z > before - _AS_HIGH_M
            z = max(z, before + _NEW_SHARE * (z - before))
        if is_highest:
            met_at[row, column] = at[number]
        places[row, column, 0], places[row, column, 1] = x, y
        heights[row, column] = z
        is_step = False
        plane[:], lower[:] = 0.0, 0.0
        for up in range(-_REACH, _REACH + 1):
            for right in range(-_REACH, _REACH + 1):
                other, beside = _wrapped(row + up), _wrapped(column + right)
                if places[other, beside, 0] != x + right or places[other, beside, 1] != y + up:
                    continue
                rise = z - heights[other, beside]
                if not steps[other, beside] and (up != 0 or right != 0):
                    _add_to_plane(heights[other, beside], float(right), float(up), plane)
                    if rise > _LOWER_M:
                        lower[0] += 1.0
                        lower[1] += rise
                        lower[2] += rise * rise
                        lower[3] += right
                        lower[4] += up
                if rise > leasts[up, right]:
                    is_step = True
                elif -rise > leasts[up, right]:
                    steps[other, beside] = True
        steps[row, column] = is_step or _height_over(plane, z) > _BUMP_M or _is_low_bump(lower)


@compile_function
def _wrapped(index: int) -> int:
    """An index of the torus that is at most its size beside it; faster than by the remainder."""
    if index < 0:
        return index + _CELLS
    return index - _CELLS if index >= _CELLS else index


@compile_function
def _enter_drops(
    cells: Any, at: Any, height: float, drops: Any, heights: Any, places: Any, steps: Any, met_at: Any
) -> None:
    """Enter the `drops` (P,), `at` (P, 2) in `cells` (P, 2), into a map, as steps at the robot's level."""
    for number in range(len(drops)):
        if drops[number]:
            x, y = cells[number, 0], cells[number, 1]
            row, column = y % _CELLS, x % _CELLS
            places[row, column, 0], places[row, column, 1] = x, y
            heights[row, column], steps[row, column] = height, True
            met_at[row, column] = at[number]


@compile_function
def _add_to_plane(height: float, along: float, across: float, plane: Any) -> None:
    """Add a cell of a `height` [m] to the sums (9,) of a plane through cells."""
    plane[0] += 1.0
    plane[1] += along
    plane[2] += across
    plane[3] += height
    plane[4] += along * along
    plane[5] += along * across
    plane[6] += across * across
    plane[7] += along * height
    plane[8] += across * height


@compile_function
def _is_low_bump(lower: Any) -> bool:
    """Whether a cell stands out of level ground, by the sums (5,) over lower cells around: 1, its rise over
    them, the square of that, and how far they are to the right and up.
    """
    count = lower[0]
    if count < _LEAST_CELLS:
        return False
    mean, right, up = lower[1] / count, lower[3] / count, lower[4] / count
    is_level = lower[2] / count - mean * mean < _LEVEL_M * _LEVEL_M
    result: bool = (
        mean > _LOW_BUMP_M and is_level and right * right + up * up < _OFF_CENTRE_CELLS * _OFF_CENTRE_CELLS
    )
    return result


@compile_function
def _height_over(plane: Any, z: float) -> float:
    """How far a height [m] is over the plane of these sums (9,) at its origin; 0 where they are too few."""
    count = plane[0]
    if count < _LEAST_CELLS:
        return 0.0
    right, up, mean = plane[1] / count, plane[2] / count, plane[3] / count
    xx = _LEVELLING + plane[4] - count * right * right
    xy = plane[5] - count * right * up
    yy = _LEVELLING + plane[6] - count * up * up
    xz, yz = plane[7] - count * right * mean, plane[8] - count * up * mean
    scale = xx * yy - xy * xy
    slope_x, slope_y = (yy * xz - xy * yz) / scale, (xx * yz - xy * xz) / scale
    result: float = z - (mean - slope_x * right - slope_y * up)
    return result


@compile_function
def _place_in_scan(bearing: float, bearings: Any) -> Any:
    """Where a bearing [rad] lies in a scan, in segments from its first, and whether the scan is a circle."""
    count = len(bearings)
    per_rad = count / (2.0 * np.pi)
    if count == 1 or (bearings[1] - bearings[0]) * (count + 0.5) > 2.0 * np.pi:
        return (bearing - bearings[0]) * per_rad, True
    per_rad = 1.0 / (bearings[1] - bearings[0])
    # From the middle of the view.
    half = 0.5 * (count - 1) / per_rad
    return ((bearing - bearings[0] - half + np.pi) % (2.0 * np.pi) - np.pi + half) * per_rad, False


@compile_function
def _look_around(
    pose: Any, mount: Any, bearings: Any, places: Any, steps: Any, farthest: float, found: Any
) -> None:
    """Distance from the LiDAR's mount of the nearest step in each segment of a row, `found` (S,) [m]."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    origin_x = pose[0] + cos * mount[0] - sin * mount[1]
    origin_y = pose[1] + sin * mount[0] + cos * mount[1]
    count = len(bearings)
    found[:] = farthest
    for row in range(_CELLS):
        for column in range(_CELLS):
            if not steps[row, column]:
                continue
            along_x = (places[row, column, 0] + 0.5) * _CELL_M - origin_x
            along_y = (places[row, column, 1] + 0.5) * _CELL_M - origin_y
            away = np.hypot(along_x, along_y)
            if away >= farthest:
                continue
            bearing = np.arctan2(along_y, along_x) - pose[2]
            half = np.arctan2(0.5 * _CELL_M, away)
            low, is_circle = _place_in_scan(bearing - half, bearings)
            high = _place_in_scan(bearing + half, bearings)[0]
            for segment in range(np.int64(np.round(low)), np.int64(np.round(high)) + 1):
                if is_circle or 0 <= segment < count:
                    found[segment % count] = min(found[segment % count], away)
