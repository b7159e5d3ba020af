"""Who and what is around the agents of M scenes: the bodies, and the nearest obstacles."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags, freeze
from dune_rl.state.body_description import BodyDescription

# Kinematic bodies stop this far from the world's edge [m].
EDGE_M = 1.0
# Half the distance of the points between which the slope of the clearance is taken: two cells of its grid.
_PROBE_M = 0.1
_PROBES = np.array([[0.0, 0.0], [_PROBE_M, 0.0], [-_PROBE_M, 0.0], [0.0, _PROBE_M], [0.0, -_PROBE_M]])


@dataclass(frozen=True)
class GroupBodies:
    """The bodies of one group: `position_w`, `velocity_w` (N, 2) [m, m/s], `yaw` (N,) [rad].

    `absent` (N,) marks bodies that are not there, but far outside; None: all are there.
    """

    name: str
    count: int
    position_w: Array
    velocity_w: Array
    yaw: Array
    body: BodyDescription
    absent: Flags | None = None


class Surroundings:
    """The K bodies of each of M scenes, group after group, and the nearest static obstacle of each.

    `position_w`, `velocity_w` (M, K, 2) [m, m/s]; `yaw` (M, K) [rad]; `reach_m` (K,) [m], `is_robot` and
    `avoids` (K,) as in `BodyDescription`. `are_here` (M, K) is False for bodies that are far outside.
    `clearance` measures points (M, ..., 2); `extents` are the terrains' rectangles (M, 4) [m].
    """

    def __init__(
        self, bodies: Sequence[GroupBodies], clearance: Callable[[Array], Array], extents: Array
    ) -> None:
        self.position_w = _by_scene([each.position_w for each in bodies], bodies)
        self.velocity_w = _by_scene([each.velocity_w for each in bodies], bodies)
        self.yaw = _by_scene([each.yaw for each in bodies], bodies)
        counts = [each.count for each in bodies]
        self.reach_m = freeze(np.repeat([each.body.reach_m for each in bodies], counts))
        self.is_robot = freeze(np.repeat([each.body.is_robot for each in bodies], counts))
        self.avoids = freeze(np.repeat([each.body.avoids for each in bodies], counts))
        absent = [np.zeros(len(each.yaw), bool) if each.absent is None else each.absent for each in bodies]
        self.are_here: Flags = freeze(~_by_scene(absent, bodies))
        firsts = np.cumsum([0, *counts]).tolist()
        self._columns: Mapping[str, slice] = {
            each.name: slice(first, first + each.count)
            for each, first in zip(bodies, firsts[:-1], strict=True)
        }
        self._clearance, self._extents = clearance, extents

    def columns(self, group: str) -> slice:
        """The columns of a group's agents among the K bodies of a scene."""
        return self._columns[group]

    def are_of(self, who: str) -> Flags:
        """Flags (K,) of the bodies of the group called `who`, or of all `robots`."""
        if who == "robots":
            return self.is_robot
        flags = np.zeros(len(self.reach_m), bool)
        flags[self._columns[who]] = True
        return flags

    def obstacles(self, group: str) -> tuple[Array, Array]:
        """Distance [m], (M, G), of each agent's origin from the nearest obstacle, and the direction to it.

        See `_obstacles`.
        """
        distance, direction = self._obstacles
        columns = self._columns[group]
        return distance[:, columns], direction[:, columns]

    @cached_property
    def _obstacles(self) -> tuple[Array, Array]:
        """Distances (M, K) [m] of the origins from the nearest obstacles, and unit vectors (M, K, 2) to them.

        The direction is against the slope of the clearance, by central differences; it is zero half-way
        between obstacles, and without any. The line at which bodies stop before the world's edge counts as
        an obstacle.
        """
        xy = self.position_w
        around = self._clearance(xy[:, :, None] + _PROBES)
        distance = around[..., 0].copy()
        with np.errstate(invalid="ignore"):
            slope = np.stack([around[..., 2] - around[..., 1], around[..., 4] - around[..., 3]], axis=-1)
        slope[~np.isfinite(slope)] = 0.0
        length = np.linalg.norm(slope, axis=-1, keepdims=True)
        direction = slope / np.where(length > 1e-6, length, np.inf)
        xmin, xmax, ymin, ymax = self._extents.T[:, :, None]
        x, y = xy[..., 0], xy[..., 1]
        edges = np.stack([x - xmin, xmax - x, y - ymin, ymax - y], axis=-1) - EDGE_M
        nearest = edges.argmin(axis=-1)
        to_edge = np.take_along_axis(edges, nearest[..., None], axis=-1)[..., 0]
        is_edge = to_edge < distance
        distance[is_edge] = to_edge[is_edge]
        direction[is_edge] = _TO_EDGES[nearest[is_edge]]
        return freeze(distance), freeze(direction)


_TO_EDGES = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])


def _by_scene(values: Sequence[NDArray[Any]], bodies: Sequence[GroupBodies]) -> NDArray[Any]:
    """Arrays (M * G, ...) of the groups as one (M, K, ...)."""
    parts = [
        value.reshape(-1, each.count, *value.shape[1:]) for value, each in zip(values, bodies, strict=True)
    ]
    return freeze(np.ascontiguousarray(np.concatenate(parts, axis=1)))
