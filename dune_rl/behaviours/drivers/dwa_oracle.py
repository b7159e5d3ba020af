"""The driver `dwa_oracle`: as `dwa`, with the true obstacles and the future of those whose ways are fixed."""

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from dune_rl.behaviours.drivers.context import DriverContext
from dune_rl.behaviours.drivers.dwa import find_command_costs
from dune_rl.behaviours.drivers.oracle import Oracle
from dune_rl.behaviours.drivers.route_map import MARGIN_M, RouteMap, Routes, map_around
from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.sensors.perception.dynamic_window import Situation, interpolate_grid
from dune_rl.state.state import GroupState, State
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

# A look ahead comes less far [m].
_NEAR_EDGE_M = 0.5 * MARGIN_M
# An edge of a map this near to the world's is the world's [m].
_WORLDS_EDGE_M = 1.0

_SENSOR = Annotated[str, Field(description="name of the sensor command_costs")]


class DwaOracle(Oracle):
    """Drives N bodies as `Dwa`, with the true obstacles and the true future of actors in place of readings.

    It is privileged, but for the way, which is over what the robot has seen. As a teacher it differs from
    what a policy with `learning.prior` begins with by dangers alone: misjudged ones, hidden ones, steep
    ground, and those to come, of which it knows the gaps exactly. `Oracle` also knows the true ways.
    """

    reads_sensors = True

    def __init__(self, num_rows: int, *, sensor: _SENSOR = "command_costs") -> None:
        super().__init__(num_rows)
        self._sensor = sensor

    def bind(self, context: DriverContext) -> None:
        """Take the sensor; raises ConfigError without it."""
        super().bind(context)
        self._costs = find_command_costs(context, self._sensor, "dwa_oracle")

    def act(self, state: State, group: GroupState) -> Array:
        """Actions (N, 2): speed [m/s] and relative heading [rad]."""
        costs = self._costs.costs_in(self._situation(state, group), np.inf)
        found: Array = self._costs.actions[costs.argmin(axis=1)]
        return found

    def action_costs(self, state: State, group: GroupState, actions: Array, cap: float) -> Array:
        """Costs (N, C) of the sensor's commands minus the least of each row, at most `cap` [m].

        Raises ConfigError where `actions` (C, 2) are not these.
        """
        known = self._costs.actions
        if actions.shape != known.shape or not np.allclose(actions, known, atol=1e-5):
            raise ConfigError(
                f"dwa_oracle knows the costs of the commands of sensors.{self._sensor} alone; give "
                "learning.commands the same numbers"
            )
        costs = self._costs.costs_in(self._situation(state, group), cap)
        return np.minimum(costs - costs.min(axis=1, keepdims=True), cap)

    def record_actions(self, actions: Array) -> None:
        """Do nothing: the sensor knows the last action."""

    def _situation(self, state: State, group: GroupState) -> Situation:
        """That of the sensor, with the truth about obstacles and actors, in the frame of its odometry."""
        seen, true = self._costs.situation, super()._situation(state, group)
        clearances = np.empty_like(seen.clearances)
        _carry_clearances(true.poses, true.grids, true.clearances, seen.poses, seen.grids, clearances)
        turned = seen.poses[:, 2] - true.poses[:, 2]
        actors = true.actors.copy()
        actors[..., :2] = _carried(true.poses, seen.poses, turned, actors[..., :2])
        still = np.zeros_like(true.poses)
        actors[..., 2:4] = _carried(still, still, turned, actors[..., 2:4])
        return seen._replace(
            clearances=clearances,
            actors=actors,
            places=_carried(true.poses, seen.poses, turned, true.places),
            vehicle=true.vehicle,
        )

    def _plan(self, state: State, group: GroupState, anew: Flags) -> None:
        """Take a map where a goal is new, or a body has come near an edge of its map within the world."""
        worlds = state.ground
        assert isinstance(worlds, BatchedWorlds)
        extents = np.array([worlds.worlds[row // group.count].extent for row in range(len(anew))])
        first = self._grids[:, :2]
        last = first + (self._grids[:, [4, 3]] - 1) / np.maximum(self._grids[:, 2:3], 1e-9)
        place = group.motion.position_w[:, :2]
        low = (place < first + _NEAR_EDGE_M) & (first > extents[:, [0, 2]] + _WORLDS_EDGE_M)
        high = (place > last - _NEAR_EDGE_M) & (last < extents[:, [1, 3]] - _WORLDS_EDGE_M)
        super()._plan(state, group, anew | (low | high).any(axis=1))

    def _routes(self, world: World, goal: Array, start: Array, blocked: Any) -> tuple[RouteMap, Routes]:
        """The distances of obstacles on the map of a way, and no routes: the way is the sensor's."""
        known = map_around(world, self._map_settings, goal, start)
        return known, Routes(known.room, np.zeros(known.room.shape, np.int32), known.room)


def _carried(poses: Array, to: Array, turned: Array, points: Array) -> Array:
    """Points (N, ..., 2) at `poses` (N, 3) as they lie at the poses `to` (N, 3), turned by as much (N,)."""
    shape = (-1, *(1,) * (points.ndim - 2))
    x, y = points[..., 0] - poses[:, 0].reshape(shape), points[..., 1] - poses[:, 1].reshape(shape)
    cos, sin = np.cos(turned).reshape(shape), np.sin(turned).reshape(shape)
    right, up = to[:, 0].reshape(shape), to[:, 1].reshape(shape)
    return np.stack([right + cos * x - sin * y, up + sin * x + cos * y], axis=-1)


@compile_function
def _carry_clearances(poses: Any, grids: Any, clearances: Any, to: Any, to_grids: Any, found: Any) -> None:
    """Distances of obstacles in other grids, `found` (N, C), of which the rows' poses are `to` (N, 3)."""
    for row in range(len(poses)):
        pose, other, grid = poses[row], to[row], to_grids[row]
        cos, sin = np.cos(pose[2] - other[2]), np.sin(pose[2] - other[2])
        columns = np.int64(grid[4])
        for cell in range(np.int64(grid[3]) * columns):
            right = grid[0] + (cell % columns) / grid[2] - other[0]
            up = grid[1] + (cell // columns) / grid[2] - other[1]
            x, y = pose[0] + cos * right - sin * up, pose[1] + sin * right + cos * up
            found[row, cell] = interpolate_grid(grids[row], clearances[row], x, y)
