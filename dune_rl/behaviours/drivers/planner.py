"""The driver `planner`: a global planner on the true map, and a dynamic-window follower."""

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from dune_rl.behaviours.drivers.context import BoundBehaviour
from dune_rl.behaviours.drivers.route_map import RouteMap, Routes, plan_routes
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import POSE_COLUMNS, wrap_angle
from dune_rl.sensors.perception.dynamic_window import (
    RESPONSE,
    STEPS,
    Situation,
    choose_commands,
    predict_actors,
    score_commands,
    window_vehicle,
)
from dune_rl.sensors.perception.stuck_recovery import StuckRecovery
from dune_rl.state.state import GroupState, State
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

# Routes lead through gaps with this room on either side.
_SIDE_ROOM_M = 0.08
# What it costs to have no room at all beside obstacles [m/s].
_MARGIN_COST_PER_S = 4.0
# Time constant of the filter of yaw rates [s].
_FILTER_S = 0.2
# A body that turns by more within a step has turned round, and goes straight on.
_TURNED_ROUND_RAD = 1.0


class Planner(BoundBehaviour):
    """Drives N bodies along the cheapest routes to their goals, round obstacles and moving actors.

    It is privileged: it knows the true map of the world (slopes, static obstacles), the true poses of all
    moving bodies, their velocities and yaw rates by the change of these, and its own true pose and velocity.
    What it does not know: where actors will turn, friction, and what wheels meet below 3 cm.

    Once for each goal, Dijkstra's algorithm gives the cheapest way from every cell (`RouteMap`). In every
    step, the follower simulates some 380 commands for 2.5 s and takes the best by the cost to go, by
    clearance and by the actors' predicted places: a dynamic window (Fox, Burgard and Thrun, 1997) with a
    navigation function (Brock and Khatib, 1999). A body that does not move as commanded takes what is before
    it for an obstacle that the map lacks, backs off and plans anew (`StuckRecovery`).

    `max_slope_deg` is the steepest ground on a route; `actor_radius_m` the radius of the circle that stands
    for a moving body; `margin_m` is the room that the follower should keep beside obstacles; `speed_mps`
    limits the speed below the body's own limit.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        speed_mps: Annotated[float, Field(gt=0.0, le=50.0, description="limit of the speed [m/s]")] = 50.0,
        max_slope_deg: Annotated[float, Field(gt=0.0, lt=90.0, description="steepest route [deg]")] = 25.0,
        actor_radius_m: Annotated[float, Field(ge=0.0, le=5.0, description="of moving bodies [m]")] = 0.35,
        margin_m: Annotated[float, Field(gt=0.0, le=2.0, description="room beside obstacles [m]")] = 0.1,
    ) -> None:
        self._num_rows, self._speed_mps = num_rows, speed_mps
        self._max_slope_deg, self._actor_radius_m, self._margin_m = max_slope_deg, actor_radius_m, margin_m
        self._goals_w = np.full((num_rows, 2), np.nan)
        self._actors = ActorMotion(num_rows)
        self._recovery = StuckRecovery(num_rows)
        # The cheapest of the actions that were last scored.
        self._likely = np.zeros(num_rows, np.int64)
        self._grids = np.zeros((num_rows, 5))
        # Cost to go, waypoints and clearance of each row's world, row after row of its grid.
        self._fields, self._clearances = np.zeros((2, num_rows, 0), np.float32)
        self._waypoints = np.zeros((num_rows, 0), np.int32)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Forget the routes, the actors' motion and the own progress of the bodies in `mask` (N,)."""
        self._goals_w[mask] = np.nan
        self._actors.forget(mask)
        self._recovery.reset(mask)

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2): speed [m/s] and relative heading [rad]."""
        chosen = np.zeros((self._num_rows, 2))
        arguments = (*self._situation(state, group), chosen)
        choose_commands(*arguments)
        self._recovery.record_command(chosen[:, 0])
        return np.column_stack([chosen[:, 0], self._heading(chosen[:, 1])])

    def action_costs(self, state: State, group: GroupState, actions: Array, cap: float) -> Array:
        """Costs (N, C) of `actions` (C, 2), as those of `act`, minus the least of each row, at most `cap`.

        It is called in place of `act`, and followed by `record_actions`. The unit is a metre of level way.
        """
        commands = np.column_stack([actions[:, 0], self.context.vehicle.yaw_rates(actions[:, 1])])
        costs = np.zeros((self._num_rows, len(commands)))
        arguments = (*self._situation(state, group), commands, self._likely, cap, costs)
        score_commands(*arguments)
        self._likely = costs.argmin(axis=1)
        return np.minimum(costs - costs.min(axis=1, keepdims=True), cap)

    def record_actions(self, actions: Array) -> None:
        """Record the actions (N, 2) that are executed, after `action_costs`."""
        self._recovery.record_command(actions[:, 0])

    def _heading(self, yaw_rate: Array) -> Array:
        return np.clip(yaw_rate / self.context.vehicle.heading_gain_per_s, -np.pi, np.pi)

    def _situation(self, state: State, group: GroupState) -> Situation:
        """What the follower's loops read; plans routes where they are due."""
        vehicle = self.context.vehicle
        motion, step_s = group.motion, group.episode.step_s
        begins = group.episode.steps == 0
        self._recovery.reset(begins)
        poses = np.column_stack([motion.position_w[:, :2], motion.yaw])
        twists = np.column_stack([motion.velocity_b[:, 0], motion.angular_b[:, 2]])
        actors = self._actors.estimate(group.neighbours, begins, step_s, self._actor_radius_m)
        # With an actor this near, a body may be waiting for it.
        apart = np.hypot(*np.moveaxis(actors[..., :2] - poses[:, None, :2], -1, 0)).min(
            axis=1, initial=np.inf
        )
        waits = apart < vehicle.footprint_radius_m + self._actor_radius_m + 1.0
        self._plan(state, group, begins | self._recovery.update(poses, waits, vehicle.length_m, step_s))
        return Situation(
            poses, twists, self._grids, self._fields, self._waypoints, self._clearances, actors,
            self._predict(actors), group.goal.position_w,
            window_vehicle(vehicle, (self._margin_m, _MARGIN_COST_PER_S), self._speed_mps), RESPONSE,
            self._recovery.recovering,
        )  # fmt: skip

    @property
    def _steps(self) -> int:
        """How many steps ahead are simulated."""
        return STEPS

    def _predict(self, actors: Array) -> Array:
        """Places (N, T, K, 2) of `actors` (N, K, 6) in the steps of the follower."""
        places = np.empty((len(actors), self._steps, actors.shape[1], 2))
        predict_actors(actors, places)
        return places

    def _plan(self, state: State, group: GroupState, anew: Flags) -> None:
        """Plan the routes of the rows in `anew` (N,) and of those whose goals are new, one after another."""
        goals = group.goal.position_w
        new = np.flatnonzero((goals != self._goals_w).any(axis=1) | anew)
        if not len(new):
            return
        worlds = state.ground
        assert isinstance(worlds, BatchedWorlds)
        for row in new.tolist():
            world, start = worlds.worlds[row // group.count], group.motion.position_w[row, :2]
            known, routes = self._routes(world, goals[row], start, self._recovery.blocked[row])
            size = routes.cost.size
            missing = size - self._fields.shape[1]
            if missing > 0:
                wider = ((0, 0), (0, missing))
                self._fields, self._clearances = np.pad(self._fields, wider), np.pad(self._clearances, wider)
                self._waypoints = np.pad(self._waypoints, wider)
            self._grids[row] = known.x[0], known.y[0], 1.0 / known.cell_m, *routes.cost.shape
            self._fields[row, :size] = routes.cost.ravel()
            self._waypoints[row, :size] = routes.waypoint.ravel()
            self._clearances[row, :size] = routes.clearance.ravel()
        self._goals_w = goals.copy()

    @property
    def _map_settings(self) -> tuple[float, ...]:
        vehicle = self.context.vehicle
        return vehicle.footprint_radius_m, self._max_slope_deg, vehicle.width_m / 2 + _SIDE_ROOM_M

    def _routes(self, world: World, goal: Array, start: Array, blocked: Any) -> tuple[RouteMap, Routes]:
        """The map of a world around the way from `start` to `goal` (2,) [m], and the routes on it."""
        return plan_routes(world, self._map_settings, goal, start, blocked)


class ActorMotion:
    """Estimates how the K bodies beside each of N rows move, by the change of their poses."""

    def __init__(self, num_rows: int) -> None:
        self._poses = np.zeros((num_rows, 0, POSE_COLUMNS))
        self._yaw_rates = np.zeros((num_rows, 0))
        self._begun = np.ones(num_rows, bool)

    def forget(self, mask: Flags) -> None:
        """Forget the past of the rows in `mask` (N,)."""
        self._begun = self._begun | mask

    def estimate(self, poses: Array, begins: Flags, step_s: float, radius_m: float) -> Array:
        """The bodies at `poses` (N, K, 7: see `GroupState.neighbours`), as (N, K, 6): x, y [m], velocities
        [m/s], yaw rate [rad/s] and `radius_m`; at rest in rows that begin.
        """
        if self._poses.shape != poses.shape:
            self._poses, self._yaw_rates = poses.copy(), np.zeros(poses.shape[:2])
            self._begun[:] = True
        known = ~(self._begun | begins)[:, None]
        moved = np.where(known[..., None], poses[..., :2] - self._poses[..., :2], 0.0)
        turned = wrap_angle(poses[..., 3] - self._poses[..., 3])
        share = min(1.0, step_s / _FILTER_S)
        rates = self._yaw_rates + share * (turned / step_s - self._yaw_rates)
        self._yaw_rates = np.where(known & (np.abs(turned) < _TURNED_ROUND_RAD), rates, 0.0)
        self._poses = poses.copy()
        self._begun = np.zeros(len(poses), bool)
        radius = np.full(poses.shape[:2], radius_m)
        parts = poses[..., :2], moved / step_s, np.stack([self._yaw_rates, radius], axis=-1)
        return np.concatenate(parts, axis=-1)
