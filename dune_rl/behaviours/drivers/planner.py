"""The driver `planner`: a global planner on the true map, and a dynamic-window follower."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.behaviours.drivers.context import DriverContext
from dune_rl.behaviours.drivers.route_map import shared_route_map
from dune_rl.behaviours.drivers.window_loops import choose_arcs
from dune_rl.errors import ConfigError
from dune_rl.state import GroupState, State
from dune_rl.worlds.batched_worlds import BatchedWorlds

Array = NDArray[np.float64]

_ACCELERATION_MPS2 = 2.0
_YAW_ACCELERATION_RADPS2 = 4.0
_WINDOW_S = 0.3
# Largest speed backwards over that forward.
_REVERSE_SHARE = 0.4


class Planner:
    """Drives N bodies along the cheapest routes to their goals, round obstacles and moving actors.

    It is privileged: it knows the true map of the world (slopes, static obstacles), the true poses of all
    moving bodies, their velocities by the change of their positions, and its own true pose and velocity.
    What it does not know: where actors will turn, friction, and what wheels meet below 3 cm.

    Once for each goal, Dijkstra's algorithm gives the cost of the cheapest way from every cell
    (`RouteMap`). In every step, the follower takes the best of 180 arcs of 2 s by that cost, by clearance
    and by the actors' predicted places: the dynamic window of Fox, Burgard and Thrun (1997), with a
    navigation function as in Brock and Khatib (1999).

    `max_slope_deg` is the steepest ground on a route; `actor_radius_m` the radius of the circle that stands
    for a moving body; `margin_m` is added to the body's own footprint; `speed_mps` limits the speed below the
    body's own limit.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        speed_mps: Annotated[
            float, Field(gt=0.0, le=50.0, description="limit of the speed, beside the body's own [m/s]")
        ] = 50.0,
        max_slope_deg: Annotated[
            float, Field(gt=0.0, lt=90.0, description="steepest ground on a route [deg]")
        ] = 25.0,
        actor_radius_m: Annotated[
            float, Field(ge=0.0, le=5.0, description="radius of the circle that stands for a moving body [m]")
        ] = 0.35,
        margin_m: Annotated[
            float, Field(ge=0.0, le=2.0, description="added to the robot's footprint in the follower [m]")
        ] = 0.03,
    ) -> None:
        self._num_rows, self._speed_mps = num_rows, speed_mps
        self._max_slope_deg, self._actor_radius_m, self._margin_m = max_slope_deg, actor_radius_m, margin_m
        self._context: DriverContext | None = None
        self._goals_w = np.full((num_rows, 2), np.nan)
        self._actors_before = np.zeros((num_rows, 0, 2))
        self._begun = np.ones(num_rows, bool)
        self._grids = np.zeros((num_rows, 5))
        # Cost to go and clearance of each row's world, row after row of its grid.
        self._fields, self._clearances = np.zeros((2, num_rows, 0), np.float32)

    def bind(self, context: DriverContext) -> None:
        """Take the vehicle's model."""
        self._context = context

    def reset(self, mask: NDArray[np.bool_], group: GroupState) -> None:
        """Forget the routes and the actors' motion of the bodies in `mask` (N,)."""
        self._goals_w[mask] = np.nan
        self._begun = self._begun | mask

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2): speed [m/s] and relative heading [rad]."""
        if self._context is None:
            raise ConfigError("planner must be bound to the group that it drives (`bind`) before it acts")
        vehicle = self._context.vehicle
        self._plan(state, group)
        motion = group.motion
        poses = np.column_stack([motion.position_w[:, :2], motion.yaw])
        twists = np.column_stack([motion.velocity_b[:, 0], motion.angular_b[:, 2]])
        # Two discs, about the middles of the front and the rear half, cover the rectangle.
        reach = vehicle.length_m / 4
        limits = (
            _REVERSE_SHARE * max(vehicle.min_speed_mps, -self._speed_mps),
            min(vehicle.max_speed_mps, self._speed_mps),
            vehicle.max_yaw_rate_radps,
            vehicle.turning_radius_m,
            reach,
            float(np.hypot(reach, vehicle.width_m / 2)) + self._margin_m,
        )
        window = (_ACCELERATION_MPS2, _YAW_ACCELERATION_RADPS2, _WINDOW_S)
        chosen = np.zeros((self._num_rows, 2))
        actors = self._actors(group)
        maps = self._grids, self._fields, self._clearances
        choose_arcs(poses, twists, *maps, actors, group.goal.position_w, limits, window, chosen)
        heading = np.clip(chosen[:, 1] / vehicle.heading_gain_per_s, -np.pi, np.pi)
        return np.column_stack([chosen[:, 0], heading])

    def _actors(self, group: GroupState) -> Array:
        """The other moving bodies (N, K, 5): x, y [m], velocities [m/s] and radius [m]."""
        places = group.neighbours[..., :2]
        if self._actors_before.shape != places.shape:
            self._actors_before = places.copy()
        known = ~(self._begun | (group.episode.steps == 0))
        moved = np.where(known[:, None, None], places - self._actors_before, 0.0)
        self._actors_before = places.copy()
        self._begun = np.zeros(self._num_rows, bool)
        radius = np.full((*places.shape[:2], 1), self._actor_radius_m)
        return np.concatenate([places, moved / group.episode.step_s, radius], axis=-1)

    def _plan(self, state: State, group: GroupState) -> None:
        """Plan the routes of the rows whose goals are new, one after another."""
        goals = group.goal.position_w
        new = np.flatnonzero((goals != self._goals_w).any(axis=1) | (group.episode.steps == 0))
        if not len(new):
            return
        worlds = state.ground
        assert self._context is not None and isinstance(worlds, BatchedWorlds)
        radius = self._context.vehicle.footprint_radius_m
        for row in new.tolist():
            routes = shared_route_map(worlds.worlds[row // group.count], radius, self._max_slope_deg)
            cost = routes.cost_to_go(goals[row], group.motion.position_w[row, :2])
            self._make_room(cost.size)
            self._grids[row] = routes.x[0], routes.y[0], 1.0 / routes.cell_m, *cost.shape
            self._fields[row, : cost.size] = cost.ravel()
            self._clearances[row, : cost.size] = routes.clearance.ravel()
        self._goals_w = goals.copy()

    def _make_room(self, cells: int) -> None:
        missing = cells - self._fields.shape[1]
        if missing > 0:
            wider = ((0, 0), (0, missing))
            self._fields, self._clearances = np.pad(self._fields, wider), np.pad(self._clearances, wider)
