"""The length of the shortest way between two points of a world, past its obstacles."""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from dune_rl.geometry.arrays import Array
from dune_rl.worlds.passage import FreeSpace
from dune_rl.worlds.world import World

# Steps to half of the eight cells around; the others are the same ones backwards.
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


class _WayGraph:
    """Ways between neighbouring cells that a disc of `radius_m` can be in, straight and diagonal."""

    def __init__(self, world: World, radius_m: float, max_slope_deg: float) -> None:
        self.space = FreeSpace(world, radius_m, max_slope_deg)
        free = self.space.traversable
        rows, columns = free.shape
        number = np.arange(free.size).reshape(free.shape)
        starts, ends, lengths = [], [], []
        for down, right in _STEPS:
            here = slice(0, rows - down), slice(max(0, -right), columns - max(0, right))
            there = slice(down, rows), slice(max(0, right), columns + min(0, right))
            joined = free[here] & free[there]
            starts.append(number[here][joined])
            ends.append(number[there][joined])
            lengths.append(np.full(int(joined.sum()), self.space.cell_m * np.hypot(down, right)))
        pairs = np.concatenate(starts), np.concatenate(ends)
        self.graph = csr_matrix((np.concatenate(lengths), pairs), shape=(free.size, free.size))

    def cell_number(self, xy: Array) -> int:
        """Number of the free cell nearest to a point (2,) [m]."""
        rows, columns = np.nonzero(self.space.traversable)
        nearest = np.hypot(self.space.x[columns] - xy[0], self.space.y[rows] - xy[1]).argmin()
        return int(rows[nearest] * len(self.space.x) + columns[nearest])


def shortest_way_m(
    world: World, start: Array, goal: Array, radius_m: float, max_slope_deg: float = 25.0
) -> float:
    """Length [m] of the shortest way for a disc from `start` (2,) to `goal` (2,); inf where there is none.

    Ways lead over a grid of 0.1 m, whose diagonals make them up to 8 % longer than they are; a way that is
    free of obstacles is the straight one.
    """
    points = start + np.linspace(0.0, 1.0, 2 + int(np.hypot(*(goal - start)) / 0.05))[:, None] * (
        goal - start
    )
    if (world.clearance(points) >= radius_m).all():
        return float(np.hypot(*(goal - start)))
    ways = world.memoize(
        ("shortest ways", radius_m, max_slope_deg), lambda: _WayGraph(world, radius_m, max_slope_deg)
    )
    source = ways.cell_number(start)
    return float(dijkstra(ways.graph, directed=False, indices=source)[ways.cell_number(goal)])
