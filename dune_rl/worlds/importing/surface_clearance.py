"""Clearance from imported meshes, which may be thinner than a cell or have coincident faces."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import ndimage

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.rays import RayScene
from dune_rl.worlds.clearance import BAND_BOTTOM_M, BAND_TOP_M, ClearanceField, cross_upwards
from dune_rl.worlds.props import Mesh, bisect_triangles, merge_meshes

_COARSE_M = 0.5
# Distance of sample points in cells: at most this, marked cells touch at least at their corners.
_SPACING = 0.7
_POINTS_AT_ONCE = 1_000_000
# Limits of memory; beyond them, cells may be missed.
_MOST_TRIANGLES, _MOST_PIECES = 3_000_000, 64
_SAMPLES_PER_REGION, _MOST_CROSSINGS = 24, 64


class SurfaceClearance(ClearanceField):
    """A `ClearanceField` that marks every cell with a surface in it and fills the interior of closed ones.

    The vertical rays of the base class miss objects thinner than a cell and miscount coincident faces. Here
    they only decide, by majority, whether a region enclosed by surfaces is the interior of an object.
    """

    def _build(self, blocking: Sequence[Mesh], decks: Sequence[Mesh]) -> Floats | None:
        if decks:
            return super()._build(blocking, decks)
        free = np.ones((self.rows, self.columns), bool)
        near = [mesh for mesh in blocking if self._may_be_in_band(mesh[0][mesh[1]]).any()]
        for points in self._sample_surfaces([vertices[faces] for vertices, faces in near]):
            over = points[:, 2] - self._terrain.height(points[:, :2])
            band = points[(over > BAND_BOTTOM_M) & (over < BAND_TOP_M), :2]
            column, row = np.round((band - self._origin) * self._inverse_cell).astype(np.intp).T
            inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
            free[row[inside], column[inside]] = False
        if free.all():
            return None
        self._fill_interiors(free, near)
        distance = ndimage.distance_transform_edt(free, sampling=self.cell_m) - self.cell_m
        return np.maximum(distance, 0.0).astype(np.float32).reshape(-1)

    def _may_be_in_band(self, corners: Array) -> Flags:
        """Mask of triangles (F, 3, 3) that may reach the height band above the ground within the world."""
        low, high = corners.min(axis=1), corners.max(axis=1)
        xmin, xmax, ymin, ymax = self._terrain.extent
        ground = self._terrain.height(corners[..., :2])
        # The ground below the middle of a triangle differs from that below its corners.
        slack = 1.5 * (high - low)[:, :2].max(axis=1) + 0.1
        near: Flags = (high[:, 2] > ground.min(axis=1) - slack) & (
            low[:, 2] < ground.max(axis=1) + slack + BAND_TOP_M
        )
        return near & (high[:, :2] >= [xmin, ymin]).all(axis=1) & (low[:, :2] <= [xmax, ymax]).all(axis=1)

    def _sample_surfaces(self, meshes: Sequence[Array]) -> Iterator[Array]:
        """Points (N, 3), less than a cell apart, on the triangles (F, 3, 3) that may be in the band."""
        if not meshes:
            return
        corners = np.concatenate(meshes)
        longest = max(_COARSE_M, 4 * self.cell_m)
        while len(corners):
            # Triangles outside the band are dropped at every size, so few remain of a huge triangle.
            corners = corners[self._may_be_in_band(corners)]
            edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
            small = edges.max(axis=1) <= longest
            if len(corners) > _MOST_TRIANGLES:
                small[:] = True
            yield from self._sample_triangles(corners[small], edges[small].max(axis=1))
            corners = bisect_triangles(corners[~small], edges[~small].argmax(axis=1))

    def _sample_triangles(self, corners: Array, edges: Array) -> Iterator[Array]:
        pieces = np.clip(np.ceil(edges / (_SPACING * self.cell_m)), 1, _MOST_PIECES).astype(int)
        for count in np.unique(pieces):
            weights = _barycentric_lattice(int(count))
            chosen = corners[pieces == count]
            step = max(1, _POINTS_AT_ONCE // len(weights))
            for start in range(0, len(chosen), step):
                yield np.einsum("pc,fcx->fpx", weights, chosen[start : start + step]).reshape(-1, 3)

    def _fill_interiors(self, free: Flags, meshes: Sequence[Mesh]) -> None:
        """Remove the regions inside closed surfaces from `free` (rows, columns), in place."""
        labels, count = ndimage.label(free)
        flat = labels.reshape(-1)
        order = np.argsort(flat, kind="stable")[int((flat == 0).sum()) :]
        sizes = np.bincount(flat, minlength=count + 1)[1:]
        starts = np.cumsum(sizes) - sizes
        # A few cells of each region, spread over it.
        shares = (np.arange(_SAMPLES_PER_REGION) + 0.5) / _SAMPLES_PER_REGION
        samples = order[(starts[:, None] + (shares * sizes[:, None]).astype(np.intp)).reshape(-1)]
        rows, columns = np.divmod(samples, self.columns)
        xy = self._origin + self.cell_m * np.stack([columns, rows], axis=-1)
        inside = _is_inside(meshes, xy, self._terrain.height(xy) + (BAND_BOTTOM_M + BAND_TOP_M) / 2)
        is_interior = inside.reshape(count, _SAMPLES_PER_REGION).mean(axis=1) > 0.5
        free &= ~np.concatenate([[False], is_interior])[labels]


def _barycentric_lattice(count: int) -> Array:
    """Barycentric weights (P, 3) of a lattice with `count` intervals per edge."""
    first, second = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    inside = first + second <= count
    return np.stack([first[inside], second[inside], count - first[inside] - second[inside]], axis=1) / count


def _is_inside(meshes: Sequence[Mesh], xy: Array, z: Array) -> Flags:
    """Whether points (N, 2) at heights (N,) are inside closed meshes: upward rays leave more than enter."""
    vertices, faces = merge_meshes(meshes)
    scene = RayScene(vertices, faces)
    far = max(1.0, float(vertices[:, 2].max() - z.min()) + 1.0)
    _, balance = cross_upwards(scene, xy, z, far, _MOST_CROSSINGS)
    return balance > 0
