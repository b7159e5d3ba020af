"""Pictures from a camera that stands still: of all pixels, only those that change are traced again."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.rendering.moving_mesh import PosedBodies, PosedMesh
from dune_rl.rendering.renderer import Renderer, Traced, Viewpoint, mark_both_sides, to_bytes

Pixels = NDArray[np.int64]

_NEAR_M = 0.1
_OFF_SURFACE_M = 0.01
# Of the grid in which the sun sees bodies: the smallest cells, and the most of them along a side.
_CELL_M, _CELLS = 0.05, 2048


class FixedCamera:
    """A viewpoint in a renderer's world, whose picture without bodies is rendered once."""

    def __init__(
        self, renderer: Renderer, view: Viewpoint, width: int, height: int, samples: int = 1
    ) -> None:
        self.view, self.width, self.height = view, width, height
        self._renderer, self._samples = renderer, samples
        self._to_sun = renderer.baked.light.to_sun
        self._eye = np.asarray(view.eye, np.float32)
        self._pixel_rad = 2.0 * np.tan(view.fov_rad / 2) / width
        self._still = renderer.render(view, width, height, (), samples).reshape(-1, 3)
        self._directions = view.directions(width, height).reshape(-1, 3)
        self._fine = view.directions(width, height, samples)
        self._world = renderer.trace(self._eye, self._directions, None)
        self._sunlit = _SunlitPixels(*self._sunlit_points(), self._to_sun)

    def render(self, bodies: Sequence[PosedMesh]) -> NDArray[np.uint8]:
        """SRGB bytes (height, width, 3) with `bodies` in the world: as `Renderer.render`, but that the edges
        of shadows are not smoothed.
        """
        picture = self._still.copy()
        if not bodies:
            return picture.reshape(self.height, self.width, 3)
        posed = PosedBodies(bodies)
        pixels, traced = self._trace_changed(posed)
        directions = self._directions[pixels]
        colours = self._renderer.colours(self._eye, directions, traced, posed, self._pixel_rad)
        picture[pixels] = to_bytes(colours)
        if self._samples > 1 and len(pixels):
            first, end = int(pixels[0]) // self.width, int(pixels[-1]) // self.width + 1
            seen = np.zeros((end - first, self.width), np.bool_)
            seen.reshape(-1)[pixels - first * self.width] = traced.is_body
            edge = (
                np.flatnonzero(mark_both_sides(np.diff(seen, axis=1), np.diff(seen, axis=0)))
                + first * self.width
            )
            smooth = self._renderer.antialiased(
                self._eye, self._fine, edge, posed, self._pixel_rad, self._samples
            )
            picture[edge] = to_bytes(smooth)
        return picture.reshape(self.height, self.width, 3)

    def _sunlit_points(self) -> tuple[Pixels, Floats]:
        """The pixels (K,) that show a part of the world in the sun, and those parts (K, 3)."""
        light = self._renderer.baked.light
        pixels = np.flatnonzero(self._world.face >= 0)
        points = self._eye + self._directions[pixels] * self._world.range[pixels, None]
        points += np.float32(_OFF_SURFACE_M) * self._to_sun
        if not light.shadows:
            return pixels[:0], points[:0]
        lit = ~self._renderer.baked.rays.any_hit(points, np.broadcast_to(self._to_sun, points.shape))
        return pixels[lit], points[lit]

    def _trace_changed(self, posed: PosedBodies) -> tuple[Pixels, Traced]:
        """Sorted numbers (K,) of the pixels that show a body or its shadow, and what their rays meet."""
        near = self._near(posed)
        hit = posed.rays.hits(self._eye[None], self._directions[near], self._world.range[near])
        met = np.flatnonzero(hit.face >= 0)
        shows = near[met]
        shaded = self._shaded(posed)
        changed = np.zeros(self.width * self.height, np.bool_)
        changed[shows], changed[shaded] = True, True
        pixels = np.flatnonzero(changed)
        traced = self._world.select(pixels)
        traced.in_shade[np.searchsorted(pixels, shaded)] = True
        at = np.searchsorted(pixels, shows)
        traced.face[at], traced.range[at], traced.normal[at] = hit.face[met], hit.range[met], hit.normal[met]
        traced.is_body[at], traced.in_shade[at] = True, False
        return pixels, traced

    def _shaded(self, posed: PosedBodies) -> Pixels:
        """Numbers of the pixels that show a part of the world from which bodies hide the sun."""
        pixels, points = self._sunlit.behind(posed)
        return pixels[posed.rays.any_hit(points, np.broadcast_to(self._to_sun, points.shape))]

    def _near(self, posed: PosedBodies) -> Pixels:
        """Numbers of the pixels in the rectangles about the faces of bodies, with a margin."""
        mask = np.zeros((self.height, self.width), np.bool_)
        if _mark_faces(mask, posed.faces, *self.view.project(posed.vertices, self.width, self.height)):
            mask[:] = True
        return np.flatnonzero(mask)


@compile_function
def _mark_faces(mask: Any, faces: Any, columns: Any, rows: Any, depths: Any) -> bool:
    """Mark the rectangles about faces (F, 3) in a picture's `mask` (height, width), by the `columns` (V,) and
    `rows` (V,) [px] and the `depths` (V,) [m] of vertices. Returns whether a face has none: it reaches behind
    the eye.
    """
    height, width = mask.shape
    for number in range(len(faces)):
        a, b, c = faces[number, 0], faces[number, 1], faces[number, 2]
        if max(depths[a], depths[b], depths[c]) <= _NEAR_M:
            continue
        if min(depths[a], depths[b], depths[c]) <= _NEAR_M:
            return True
        left = max(0, int(min(columns[a], columns[b], columns[c])))
        right = min(width, int(max(columns[a], columns[b], columns[c])) + 1)
        top = max(0, int(min(rows[a], rows[b], rows[c])))
        bottom = min(height, int(max(rows[a], rows[b], rows[c])) + 1)
        for row in range(top, bottom):
            for column in range(left, right):
                mask[row, column] = True
    return False


class _SunlitPixels:
    """Pixels (K,) that show `points` (K, 3) in the sun, by the cell of a grid in which the sun sees them."""

    def __init__(self, pixels: Pixels, points: Floats, to_sun: Floats) -> None:
        across = np.cross(to_sun, [0.0, 1.0, 0.0] if abs(to_sun[1]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        self._axes = np.column_stack([across, np.cross(to_sun, across)])
        seen = points @ self._axes
        self._low = seen.min(axis=0) if len(seen) else np.zeros(2)
        self._cell_m = max(_CELL_M, float((seen - self._low).max(initial=0.0)) / _CELLS)
        column, row = self._cells(points).astype(np.int64).T
        self._shape = int(row.max(initial=0)) + 1, int(column.max(initial=0)) + 1
        cell = row * self._shape[1] + column
        order = np.argsort(cell, kind="stable")
        self._cell, self._pixels, self._points = cell[order], pixels[order], points[order]

    def behind(self, bodies: PosedBodies) -> tuple[Pixels, Floats]:
        """Pixels (N,) and their points (N, 3) from which `bodies` may hide the sun."""
        mask, (columns, rows) = np.zeros(self._shape, np.bool_), self._cells(bodies.vertices).T
        _mark_faces(mask, bodies.faces, columns, rows, np.full(len(columns), np.inf))
        chosen = np.flatnonzero(mask.reshape(-1)[self._cell])
        return self._pixels[chosen], self._points[chosen]

    def _cells(self, points: NDArray[np.floating]) -> Array:
        """Columns and rows (N, 2), as fractions, in which the sun sees `points` (N, 3)."""
        cells: Array = (points @ self._axes - self._low) / self._cell_m
        return cells
