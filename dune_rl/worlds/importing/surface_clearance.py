"""Clearance from meshes as files have them: with things thinner than a cell, and faces on each other."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.clearance import BAND_BOTTOM_M, BAND_TOP_M, ClearanceField, Mesh

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_COARSE_M = 0.5
# Of a cell: closer than that, marked cells touch at least at their corners, and nothing leaks between.
_APART = 0.7
_POINTS_AT_ONCE = 1_000_000
# Where there is more than that, cells may be missed rather than memory run out.
_MOST_TRIANGLES, _MOST_PIECES = 3_000_000, 64
_ASKED, _MOST_CROSSINGS = 24, 64


class SurfaceClearance(ClearanceField):
    """A `ClearanceField` that marks every cell with a surface in it, and fills what is inside of closed ones.

    Rays up from the cells, which the base counts, miss what is thinner than a cell, and count wrong where two
    faces lie on each other. Here they only decide, by majority, whether a region that surfaces enclose is
    inside something.
    """

    def _build(self, blocking: Sequence[Mesh], decks: Sequence[Mesh]) -> NDArray[np.float32] | None:
        if decks:
            return super()._build(blocking, decks)
        free = np.ones((self.rows, self.columns), bool)
        near = [mesh for mesh in blocking if self._near(mesh[0][mesh[1]]).any()]
        for points in self._points([vertices[faces] for vertices, faces in near]):
            over = points[:, 2] - self._terrain.height(points[:, :2])
            band = points[(over > BAND_BOTTOM_M) & (over < BAND_TOP_M), :2]
            column, row = np.round((band - self._origin) * self._inverse_cell).astype(np.intp).T
            known = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
            free[row[known], column[known]] = False
        if free.all():
            return None
        self._fill(free, near)
        distance = ndimage.distance_transform_edt(free, sampling=self.cell_m) - self.cell_m
        return np.maximum(distance, 0.0).astype(np.float32).reshape(-1)

    def _near(self, corners: Array) -> Mask:
        """Which triangles (F, 3, 3) may come into the band over the ground, and are not beside the world."""
        low, high = corners.min(axis=1), corners.max(axis=1)
        xmin, xmax, ymin, ymax = self._terrain.extent
        ground = self._terrain.height(corners[..., :2])
        # The ground under the middle of a triangle is not that under its corners.
        slack = 1.5 * (high - low)[:, :2].max(axis=1) + 0.1
        near: Mask = (high[:, 2] > ground.min(axis=1) - slack) & (
            low[:, 2] < ground.max(axis=1) + slack + BAND_TOP_M
        )
        return near & (high[:, :2] >= [xmin, ymin]).all(axis=1) & (low[:, :2] <= [xmax, ymax]).all(axis=1)

    def _points(self, meshes: Sequence[Array]) -> Iterator[Array]:
        """Points (N, 3) all over the triangles (F, 3, 3) that may be in the band, less than a cell apart."""
        if not meshes:
            return
        corners = np.concatenate(meshes)
        longest = max(_COARSE_M, 4 * self.cell_m)
        while len(corners):
            # What is not near is dropped at every size, so that a huge triangle leaves only a little.
            corners = corners[self._near(corners)]
            edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
            small = edges.max(axis=1) <= longest
            if len(corners) > _MOST_TRIANGLES:
                small[:] = True
            yield from self._spread(corners[small], edges[small].max(axis=1))
            corners = _halved(corners[~small], edges[~small].argmax(axis=1))

    def _spread(self, corners: Array, edges: Array) -> Iterator[Array]:
        pieces = np.clip(np.ceil(edges / (_APART * self.cell_m)), 1, _MOST_PIECES).astype(int)
        for count in np.unique(pieces):
            weights = _lattice(int(count))
            chosen = corners[pieces == count]
            step = max(1, _POINTS_AT_ONCE // len(weights))
            for start in range(0, len(chosen), step):
                yield np.einsum("pc,fcx->fpx", weights, chosen[start : start + step]).reshape(-1, 3)

    def _fill(self, free: Mask, meshes: Sequence[Mesh]) -> None:
        """Takes the regions out of `free` (rows, columns) that lie inside closed surfaces."""
        labels, count = ndimage.label(free)
        flat = labels.reshape(-1)
        order = np.argsort(flat, kind="stable")[int((flat == 0).sum()) :]
        sizes = np.bincount(flat, minlength=count + 1)[1:]
        starts = np.cumsum(sizes) - sizes
        # A few cells of each region, spread over it.
        shares = (np.arange(_ASKED) + 0.5) / _ASKED
        asked = order[(starts[:, None] + (shares * sizes[:, None]).astype(np.intp)).reshape(-1)]
        rows, columns = np.divmod(asked, self.columns)
        xy = self._origin + self.cell_m * np.stack([columns, rows], axis=-1)
        inside = _inside(meshes, xy, self._terrain.height(xy) + (BAND_BOTTOM_M + BAND_TOP_M) / 2)
        filled = inside.reshape(count, _ASKED).mean(axis=1) > 0.5
        free &= ~np.concatenate([[False], filled])[labels]


def _halved(corners: Array, side: NDArray[np.intp]) -> Array:
    """Both halves of triangles (F, 3, 3), cut through the middle of the `side` (F,) after that corner."""
    row = np.arange(len(corners))
    first, second, third = (corners[row, (side + k) % 3] for k in range(3))
    middle = (first + second) / 2
    return np.concatenate(
        [np.stack([first, middle, third], axis=1), np.stack([middle, second, third], axis=1)]
    )


def _lattice(count: int) -> Array:
    """Weights (P, 3) of the points that cut a triangle's edges into `count` pieces."""
    first, second = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    kept = first + second <= count
    return np.stack([first[kept], second[kept], count - first[kept] - second[kept]], axis=1) / count


def _inside(meshes: Sequence[Mesh], xy: Array, z: Array) -> Mask:
    """Whether points (N, 2) at heights (N,) are inside closed meshes: rays up leave more often than enter."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes[:-1])])
    vertices = np.concatenate([vertices for vertices, _ in meshes])
    faces = np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=True)])
    scene = RayScene(vertices, faces)
    far = max(1.0, float(vertices[:, 2].max() - z.min()) + 1.0)
    height, balance, live = z.copy(), np.zeros(len(xy), int), np.arange(len(xy))
    for _ in range(_MOST_CROSSINGS):
        origins = np.column_stack([xy[live], height[live]])
        hit, normal = scene.first_hit(origins, np.broadcast_to([0.0, 0.0, 1.0], origins.shape), far)
        found = hit < far
        live, hit, normal = live[found], hit[found], normal[found]
        if not len(live):
            break
        height[live] += hit + 1e-4
        balance[live] += np.sign(normal[:, 2]).astype(int)
    return balance > 0
