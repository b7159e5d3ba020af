"""The sensor of what each command of a grid would cost, by a look ahead over what the robot has seen."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.frames import frames_of_poses, out_of_frames
from dune_rl.geometry.planar import length
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.lidar import beam_angles
from dune_rl.sensors.perception.dynamic_window import (
    RESPONSE,
    STEP_S,
    STEPS,
    Situation,
    predict_actors,
    score_commands,
    window_vehicle,
)
from dune_rl.sensors.perception.motion_forecast import AHEAD_S
from dune_rl.sensors.perception.stuck_recovery import StuckRecovery
from dune_rl.sensors.perception.way_left import WayLeft
from dune_rl.sensors.perception.ways import way_left
from dune_rl.sensors.sensor import Reading, VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.command_grid import CommandGridConf, command_grid
from dune_rl.state.state import GroupState, State

# A square of so many cells around the robot: 6 m.
_CELL_M, _CELLS = 0.0625, 96
# Obstacles farther than this from a place do not matter there, and returns from farther are left out [m].
_FAR_M, _FARTHEST_M = 0.8, 4.0
# A low obstacle is a disc of this radius about where its cell was met [m]; a part of it may be beyond.
_LOW_RADIUS_M = 0.03
# A waypoint is the cell with the least way left on a circle of this radius [m].
_AHEAD_M = 0.8
# Radius of the circle that stands for what moves, and where it is if there is nothing [m].
_MOVER_RADIUS_M, _NOWHERE_M = 0.35, 1e4
# A robot may be waiting for what moves within this of its outline [m].
_WAITS_M = 1.0
# Room that commands should keep beside obstacles [m], and what it costs to have none [m/s].
_MARGIN = 0.1, 6.0
# Shares (STEPS, 1 + A) of where what moves is, and will be after AHEAD_S, in its places at the steps.
_BETWEEN = np.column_stack(
    [np.interp(STEP_S * np.arange(1, STEPS + 1), (0.0, *AHEAD_S), each) for each in np.eye(1 + len(AHEAD_S))]
)


class CommandCostsConf(SensorSettings):
    """What each command of a grid would cost, by simulating it for 2.5 s over what the robot has seen.

    It is the dynamic window of the driver `planner`, to which room beside obstacles is worth less, with
    readings in place of the truth: the returns of the LiDAR, low obstacles, tracks or their forecast, and the
    way left. Gaps to tracks are uncertain, and the more the later; what a contact costs counts by its
    probability. To a robot that nobody moves near, and that has stayed at a place for 4 s, or for 2 s while
    it was to drive, for 1.5 s those commands are cheap that lead away.
    """

    sensor: Literal["command_costs"] = "command_costs"
    realism: None = Field(None, description="none of its own: that of what it reads")
    way_left: str = Field("way_left", description="name of the sensor whose ways, tracks and scans it takes")
    commands: CommandGridConf = CommandGridConf()
    gap_error_m: float = Field(0.06, ge=0.0, le=1.0, description="standard deviation of gaps to tracks [m]")
    gap_error_growth_mps: float = Field(
        0.25, ge=0.0, le=2.0, description="its growth within the look ahead [m/s]"
    )
    max_cost: float = Field(8.0, gt=0.0, le=100.0, description="of a command above the best one's [m]")


class CommandCosts(VectorSensor):
    """The reading `name`, (N, C) [m of level way]: the cost of each command above that of the cheapest.

    The commands are those of `command_grid`, speed after speed: `actions` (C, 2: speed [m/s], relative
    heading [rad]). The look ahead takes place when it is read.
    """

    def __init__(self, name: str, context: SensorContext, conf: CommandCostsConf) -> None:
        vehicle = context.carrier.vehicle
        if vehicle is None:
            raise ConfigError(f"sensors.{name}: the body is not driven by its speed and heading; disable it")
        way = context.sensor_of(conf.way_left)
        if not isinstance(way, WayLeft):
            raise ConfigError(f"sensors.{name}.way_left must be the name of a sensor way_left")
        self.actions = command_grid(conf.commands, vehicle.min_speed_mps, vehicle.max_speed_mps)
        size = len(self.actions)
        super().__init__(name, context.num_rows, np.zeros(size), np.full(size, conf.max_cost))
        self._cap, self._way, self._tracks = conf.max_cost, way, way.tracks
        self._velocity = context.reading_of("velocity")
        self._bearings = np.ascontiguousarray(beam_angles(self._tracks.lidar))
        self._commands = np.column_stack([self.actions[:, 0], vehicle.yaw_rates(self.actions[:, 1])])
        gap_error = conf.gap_error_m, conf.gap_error_growth_mps
        self._limits = window_vehicle(vehicle, _MARGIN, gap_error=gap_error)
        self._recovery = StuckRecovery(context.num_rows)
        self._step_s, self._length_m = context.step_s, vehicle.length_m
        self._speeds = vehicle.min_speed_mps, vehicle.max_speed_mps
        self._waits_m = vehicle.footprint_radius_m + _MOVER_RADIUS_M + _WAITS_M
        # The cheapest command of the last look ahead.
        self._likely = np.zeros(context.num_rows, np.int64)
        cells = context.num_rows, _CELLS * _CELLS
        self._grids = np.zeros((context.num_rows, 5))
        self._fields, self._clearances = np.zeros((2, *cells), np.float32)
        self._waypoints = np.zeros(cells, np.int32)
        self._circle = _circle()
        self._no_low = (
            np.zeros((context.num_rows, 0, 0), bool),
            np.zeros((context.num_rows, 0, 0, 2), np.float32),
        )
        self._begins, self._is_due = np.ones(context.num_rows, bool), True

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        self._begins, self._is_due = self._begins | mask, True
        self._recovery.reset(mask)

    def measure(self, now: GroupState, state: State) -> None:
        self._begins, self._is_due = np.zeros_like(self._begins), True
        tracker = self._tracks.tracker
        if now.last_action is not None:
            slowest, fastest = self._speeds
            share = (now.last_action[:, 0] + 1.0) / 2.0
            self._recovery.record_command(slowest + share * (fastest - slowest))
        there = np.arange(tracker.moving.shape[1]) < tracker.moving_counts[:, None]
        apart = np.where(there, np.hypot(tracker.moving[..., 0], tracker.moving[..., 1]), np.inf).min(axis=1)
        self._recovery.update(tracker.poses, apart < self._waits_m, self._length_m, self._step_s)

    def read(self) -> dict[str, Reading]:
        """The latest reading."""
        if self._is_due:
            self._situation = self._look_around()
            costs = self.costs_in(self._situation, self._cap)
            self._likely = costs.argmin(axis=1)
            self._store(costs - costs.min(axis=1, keepdims=True))
            self._is_due = False
        return super().read()

    @property
    def situation(self) -> Situation:
        """What the latest reading takes for true, in the frame of the odometry."""
        self.read()
        return self._situation

    def costs_in(self, situation: Situation, cap: float) -> Array:
        """Costs (N, C) of the commands in a situation; one that is `cap` above the least is inf."""
        costs = np.zeros((len(situation.poses), len(self._commands)))
        score_commands(*situation, self._commands, self._likely, cap, costs)
        return costs

    def _look_around(self) -> Situation:
        tracks, way = self._tracks, self._way
        tracker, low = tracks.tracker, way.low_obstacles
        poses = tracker.poses.copy()
        ranges = tracks.beams
        rests = (ranges < min(_FARTHEST_M, tracks.lidar.range_m - 1e-3)) & ~tracks.moving_beams
        goals = out_of_frames(frames_of_poses(poses), tracks.goals()[:, None])[:, 0]
        steps, met_at = self._no_low if low is None else (low.map[0], low.met_at)
        _fill_windows(
            poses, tracks.mount, self._bearings, ranges, rests, steps, met_at,
            way.map.ways, way.map.origins, goals, self._begins, self._circle, self._grids, self._fields,
            self._waypoints, self._clearances,
        )  # fmt: skip
        movers = self._movers(poses)
        ahead = self._predict(movers)
        twists = np.ascontiguousarray(self._velocity()[:, :2], np.float64)
        return Situation(
            poses, twists, self._grids, self._fields, self._waypoints, self._clearances, movers, ahead,
            goals, self._limits, RESPONSE, self._recovery.recovering,
        )  # fmt: skip

    def _predict(self, movers: Array) -> Array:
        """Places (N, T, K, 2) of `movers` (N, K, 6) in the steps of the look ahead."""
        told = self._tracks.places_ahead
        if told is None:
            ahead = np.empty((len(movers), STEPS, movers.shape[1], 2))
            predict_actors(movers, ahead)
            return ahead
        count = movers.shape[1]
        there = np.arange(count) < self._tracks.tracker.moving_counts[:, None]
        known = np.where(there[..., None, None], told[:, :count], _NOWHERE_M)
        known = np.concatenate([movers[:, :, None, :2], known], axis=2)
        found: Array = np.einsum("ta,nkad->ntkd", _BETWEEN, known)
        return found

    def _movers(self, poses: Array) -> Array:
        """What moves, in the frame of the odometry, as `predict_actors` takes it."""
        tracker = self._tracks.tracker
        count = max(1, int(tracker.moving_counts.max()))
        moving = tracker.moving[:, :count]
        there = np.arange(count) < tracker.moving_counts[:, None]
        frames = frames_of_poses(poses)
        turned = frames.copy()
        turned[:, :2] = 0.0
        parts = out_of_frames(frames, moving[..., :2]), out_of_frames(turned, moving[..., 2:])
        others = np.broadcast_to((0.0, _MOVER_RADIUS_M), (*there.shape, 2))
        nobody = (_NOWHERE_M, _NOWHERE_M, 0.0, 0.0, 0.0, _MOVER_RADIUS_M)
        return np.where(there[..., None], np.concatenate([*parts, others], axis=-1), nobody)


@compile_function
def _fill_windows(
    poses: Any, mount: Any, bearings: Any, ranges: Any, rests: Any, steps: Any, met_at: Any,
    ways: Any, origins: Any, goals: Any, begins: Any, circle: Any, grids: Any, fields: Any,
    waypoints: Any, clearances: Any,
) -> None:  # fmt: skip
    """Fill the square grids around `poses` (N, 3): way left, waypoints, and distances of obstacles [m].

    Where an episode `begins` (N,), the ways to the `goals` (N, 2) are straight. Obstacles are where beams end
    that meet something at `rests` (N, B), and low ones at those places `met_at` (N, C, C, 2) [m]
    where `steps` (N, C, C) tells. Grids and their values are as in `dynamic_window`.
    """
    for row in range(len(poses)):
        pose, field, clearance = poses[row], fields[row], clearances[row]
        left = (np.floor(pose[0] / _CELL_M) - _CELLS // 2) * _CELL_M
        bottom = (np.floor(pose[1] / _CELL_M) - _CELLS // 2) * _CELL_M
        grids[row, 0], grids[row, 1], grids[row, 2] = left, bottom, 1.0 / _CELL_M
        grids[row, 3], grids[row, 4] = _CELLS, _CELLS
        for line in range(_CELLS):
            for column in range(_CELLS):
                cell = line * _CELLS + column
                at_x, at_y = left + column * _CELL_M, bottom + line * _CELL_M
                if begins[row]:
                    field[cell] = length(goals[row, 0] - at_x, goals[row, 1] - at_y)
                else:
                    field[cell] = way_left(ways[row], origins[row], at_x, at_y)
                clearance[cell] = _FAR_M
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        x = pose[0] + cos * mount[0] - sin * mount[1]
        y = pose[1] + sin * mount[0] + cos * mount[1]
        for beam in range(len(bearings)):
            if rests[row, beam]:
                bearing = pose[2] + bearings[beam]
                right, up = ranges[row, beam] * np.cos(bearing), ranges[row, beam] * np.sin(bearing)
                _enter_obstacle(x + right - left, y + up - bottom, 0.0, clearance)
        for line in range(steps.shape[1]):
            for column in range(steps.shape[2]):
                if steps[row, line, column]:
                    at_x, at_y = met_at[row, line, column, 0] - left, met_at[row, line, column, 1] - bottom
                    _enter_obstacle(at_x, at_y, _LOW_RADIUS_M, clearance)
        _find_waypoints(field, circle, waypoints[row])


@compile_function
def _enter_obstacle(x: float, y: float, radius: float, clearance: Any) -> None:
    """Lower the distances around an obstacle at x and y [m] from a grid's first cell."""
    reach = int(_FAR_M / _CELL_M) + 1
    across, along = round(x / _CELL_M), round(y / _CELL_M)
    for line in range(max(along - reach, 0), min(along + reach + 1, _CELLS)):
        for column in range(max(across - reach, 0), min(across + reach + 1, _CELLS)):
            right, up, cell = column * _CELL_M - x, line * _CELL_M - y, line * _CELLS + column
            limit = clearance[cell] + radius
            square = right * right + up * up
            if square < limit * limit:
                clearance[cell] = max(np.sqrt(square) - radius, 0.0)


def _circle() -> NDArray[np.int64]:
    """The cells (K, 2), right and up, on a circle around one."""
    reach = round(_AHEAD_M / _CELL_M)
    angles = np.arange(0.0, 2.0 * np.pi, np.pi / 8)
    return np.rint(reach * np.column_stack([np.cos(angles), np.sin(angles)])).astype(np.int64)


@compile_function
def _find_waypoints(field: Any, circle: Any, found: Any) -> None:
    """The cells with the least way left on a `circle` around each one, or itself where none is nearer.

    Four cells have the one of the first of them.
    """
    for line in range(0, _CELLS, 2):
        for column in range(0, _CELLS, 2):
            cell = line * _CELLS + column
            least, best = field[cell], cell
            for number in range(len(circle)):
                across, along = column + circle[number, 0], line + circle[number, 1]
                if 0 <= across < _CELLS and 0 <= along < _CELLS:
                    other = along * _CELLS + across
                    if field[other] < least:
                        least, best = field[other], other
            found[cell], found[cell + 1] = best, best
            found[cell + _CELLS], found[cell + _CELLS + 1] = best, best
