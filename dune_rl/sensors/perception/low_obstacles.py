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
# Heights that differ from the map's by more than this, in the middle of at least so many hits, are the
# odometry's drift, not the ground's [m].
_DRIFT_M, _LEAST_HITS = 0.02, 12
# A lower height takes the place of a higher one by this share in each look.
_NEW_SHARE = 0.3
# Hits this near to the range of a segment that moves are of what moves there.
_MOVING_M = 0.5
_NEAREST_M = 0.1


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
    4.5 cm: stones, bricks, kerbs, walls; and where the ground ends. Segments and distances are from the
    LiDAR's mount. Heights are those of the rays' hits, by the robot's attitude and speed readings and by
    ground that is seen again; what moves in the scan is left out, and a step fades where lower ground is
    seen.
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
        self._velocity, self._step_s = context.reading_of("velocity"), context.step_s
        shape = (context.num_rows, _CELLS, _CELLS)
        # Heights in the frame of the odometry, which cell of the plane each is of, and where steps are.
        self._heights = np.zeros(shape, np.float32)
        self._places = np.full((*shape, 2), np.iinfo(np.int32).min, np.int32)
        self._steps = np.zeros(shape, bool)
        self._climbed_m = np.zeros(context.num_rows)

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Begin the maps of the agents in `mask` (N,) anew, with what is seen at the start."""
        self._places[mask] = np.iinfo(np.int32).min
        self._steps[mask] = False
        self._climbed_m[mask] = 0.0
        self._look(mask)

    def measure(self, now: GroupState, state: State) -> None:
        self._climbed_m += self._velocity()[:, 0] * self._profile.pitch_sine * self._step_s
        self._look(np.ones(len(self._climbed_m), bool))

    @property
    def map(self) -> tuple[Flags, Any, float]:
        """Where steps are (N, C, C), the cells in the odometry frame (N, C, C, 2), their width [m]."""
        return self._steps, self._places, _CELL_M

    def _look(self, mask: Flags) -> None:
        """Enter what the rays of the agents in `mask` (N,) meet; the others keep their maps and readings."""
        profile, tracks = self._profile, self._tracks
        found = self._reading.copy()
        _update(
            mask, tracks.tracker.poses, tracks.mount, tracks.bearings, tracks.ranges, tracks.moves,
            self._climbed_m, profile.points, profile.sees, profile.drops, self._heights, self._places,
            self._steps, self._high[0], found,
        )  # fmt: skip
        self._store(found)


@compile_function
def _update(
    mask: Any, poses: Any, mount: Any, bearings: Any, ranges: Any, moves: Any, height: Any, points: Any,
    sees: Any, drops: Any, heights: Any, places: Any, steps: Any, farthest: float, found: Any,
) -> None:  # fmt: skip
    """Enter hits into the maps of the rows in `mask` (N,), and find their nearest steps, `found` (N, S) [m].

    `poses` (N, 3: x, y [m], yaw [rad]) and `height` (N,) [m] are of the odometry, `mount` (2,) [m] is the
    LiDAR's, `bearings` (S,) [rad] are the middles of its segments, `ranges` (N, S) [m] its scan, and `moves`
    (N, S) tells where something moves. `points` (N, P, 3) [m] are the hits in level frames with the robots'
    headings, over the robots' ground, `sees` (N, P) which rays have one, and `drops` (N, P) those over the
    end of the ground. Maps are `heights` (N, C, C) [m], `places` (N, C, C, 2), the numbers of cells that they
    are of, and `steps` (N, C, C).
    """
    hits = np.empty(points.shape[1], np.bool_)
    for row in range(len(poses)):
        if not mask[row]:
            continue
        _leave_out_moving(points[row], mount, bearings, ranges[row], moves[row], sees[row], hits)
        height[row] -= _drift_of(
            poses[row], height[row], points[row], hits, heights[row], places[row], steps[row]
        )
        _enter(poses[row], height[row], points[row], hits, heights[row], places[row], steps[row])
        _enter_drops(poses[row], height[row], points[row], drops[row], heights[row], places[row], steps[row])
        _look_around(poses[row], mount, bearings, places[row], steps[row], farthest, found[row])


@compile_function
def _leave_out_moving(
    points: Any, mount: Any, bearings: Any, ranges: Any, moves: Any, sees: Any, hits: Any
) -> None:  # fmt: skip
    """Which of the rays that `sees` (P,) has met something, `hits` (P,), that does not move in the scan."""
    count = len(bearings)
    for number in range(len(points)):
        hits[number] = sees[number]
        ahead, left = points[number, 0] - mount[0], points[number, 1] - mount[1]
        place, is_circle = _place_in_scan(np.arctan2(left, ahead), bearings)
        segment = np.int64(np.round(place))
        if is_circle or 0 <= segment < count:
            is_near = abs(np.hypot(ahead, left) - ranges[segment % count]) < _MOVING_M
            hits[number] = sees[number] and not (moves[segment % count] and is_near)


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
def _cell_of(pose: Any, point: Any) -> Any:
    """Numbers (x, y) of the cell in the odometry's frame of a point in the body's."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x = np.int64(np.floor((pose[0] + cos * point[0] - sin * point[1]) / _CELL_M))
    y = np.int64(np.floor((pose[1] + sin * point[0] + cos * point[1]) / _CELL_M))
    return x, y


@compile_function
def _drift_of(
    pose: Any, height: float, points: Any, hits: Any, heights: Any, places: Any, steps: Any
) -> float:  # fmt: skip
    """Median height of the hits over the map [m], in cells that it knows, beyond what is little."""
    apart, count = np.empty(len(points)), 0
    for number in range(len(points)):
        if hits[number]:
            x, y = _cell_of(pose, points[number])
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
    pose: Any, height: float, points: Any, hits: Any, heights: Any, places: Any, steps: Any
) -> None:  # fmt: skip
    """Enter the `hits` (P,) among `points` (P, 3) into a map."""
    for number in range(len(points)):
        if not hits[number]:
            continue
        x, y = _cell_of(pose, points[number])
        z = points[number, 2] + height
        row, column = y % _CELLS, x % _CELLS
        if places[row, column, 0] == x and places[row, column, 1] == y:
            before = heights[row, column]
            z = max(z, before + _NEW_SHARE * (z - before))
        places[row, column, 0], places[row, column, 1] = x, y
        heights[row, column] = z
        is_step = _stands_out(z, x, y, heights, places, steps)
        for up in range(-_REACH, _REACH + 1):
            for right in range(-_REACH, _REACH + 1):
                other, beside = (y + up) % _CELLS, (x + right) % _CELLS
                if places[other, beside, 0] != x + right or places[other, beside, 1] != y + up:
                    continue
                rise = z - heights[other, beside]
                least = _STEP_M + _SLOPE * _CELL_M * np.hypot(up, right)
                if rise > least:
                    is_step = True
                elif -rise > least:
                    steps[other, beside] = True
        steps[row, column] = is_step


@compile_function
def _enter_drops(
    pose: Any, height: float, points: Any, drops: Any, heights: Any, places: Any, steps: Any
) -> None:  # fmt: skip
    """Enter the `drops` (P,) among `points` (P, 3) into a map, as steps at the robot's own level."""
    for number in range(len(points)):
        if drops[number]:
            x, y = _cell_of(pose, points[number])
            row, column = y % _CELLS, x % _CELLS
            places[row, column, 0], places[row, column, 1] = x, y
            heights[row, column], steps[row, column] = height, True


@compile_function
def _stands_out(z: float, x: Any, y: Any, heights: Any, places: Any, steps: Any) -> bool:
    """Whether a height [m] in a cell stands out of the plane through the cells around it, steps left out."""
    count, right, up, mean = 0.0, 0.0, 0.0, 0.0
    xx, xy, yy, xz, yz = _LEVELLING, 0.0, _LEVELLING, 0.0, 0.0
    for row in range(y - _REACH, y + _REACH + 1):
        for column in range(x - _REACH, x + _REACH + 1):
            other, beside = row % _CELLS, column % _CELLS
            if places[other, beside, 0] != column or places[other, beside, 1] != row:
                continue
            if steps[other, beside] or (row == y and column == x):
                continue
            height, along, across = heights[other, beside], float(column - x), float(row - y)
            count += 1.0
            right += along
            up += across
            mean += height
            xx += along * along
            xy += along * across
            yy += across * across
            xz += along * height
            yz += across * height
    if count < _LEAST_CELLS:
        return False
    right, up, mean = right / count, up / count, mean / count
    xx, xy, yy = xx - count * right * right, xy - count * right * up, yy - count * up * up
    xz, yz = xz - count * right * mean, yz - count * up * mean
    scale = xx * yy - xy * xy
    slope_x, slope_y = (yy * xz - xy * yz) / scale, (xx * yz - xy * xz) / scale
    result: bool = z - (mean - slope_x * right - slope_y * up) > _BUMP_M
    return result


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
    reach = np.int64(np.ceil(farthest / _CELL_M))
    middle_x, middle_y = np.int64(np.floor(origin_x / _CELL_M)), np.int64(np.floor(origin_y / _CELL_M))
    for y in range(middle_y - reach, middle_y + reach + 1):
        for x in range(middle_x - reach, middle_x + reach + 1):
            row, column = y % _CELLS, x % _CELLS
            if not steps[row, column] or places[row, column, 0] != x or places[row, column, 1] != y:
                continue
            along_x, along_y = (x + 0.5) * _CELL_M - origin_x, (y + 0.5) * _CELL_M - origin_y
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
