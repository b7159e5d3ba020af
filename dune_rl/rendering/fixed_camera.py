"""Pictures from a camera that stands still: of all pixels, only those that change are traced again."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.rendering.moving_mesh import PosedBodies, PosedMesh
from dune_rl.rendering.rasteriser import mark_hidden, rasterise
from dune_rl.rendering.renderer import Renderer, Traced, Viewpoint, mark_both_sides, to_bytes

Pixels = NDArray[np.int64]

_OFF_SURFACE_M = 0.01
# Of the grid in which the sun sees bodies: the smallest cells, and the most of them along a side.
_CELL_M, _CELLS = 0.05, 1024


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
        self._depths = (self._world.range * (self._directions @ view.axes[:, 2])).astype(np.float32)
        self._sunlit = _SunlitPixels(*self._sunlit_points(), self._to_sun)

    def render(self, bodies: Sequence[PosedMesh]) -> NDArray[np.uint8]:
        """SRGB bytes (height, width, 3) with `bodies` in the world: as `Renderer.render`, but that the edges
        of shadows are not smoothed, and that grass is in the shade of a body only where the ground behind it
        is, too.
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
            first = max(0, int(pixels[0]) // self.width - 1)
            end = min(self.height, int(pixels[-1]) // self.width + 2)
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
        depths, seen = self._depths.copy(), np.full(len(self._depths), -1, np.int32)
        normals, shape = np.empty(posed.faces.shape, np.float32), (self.height, self.width)
        vertices, focal_px = self.view.place(posed.vertices), self.view.focal_px(self.width)
        rasterise(vertices, posed.faces, focal_px, depths.reshape(shape), seen.reshape(shape), normals)
        shows, shaded = np.flatnonzero(seen >= 0), self._sunlit.hidden_by(posed)
        changed = np.zeros(len(seen), np.bool_)
        changed[shows], changed[shaded] = True, True
        pixels = np.flatnonzero(changed)
        traced = self._world.select(pixels)
        traced.in_shade[np.searchsorted(pixels, shaded)] = True
        at, face, axes = np.searchsorted(pixels, shows), seen[shows], self.view.axes
        traced.face[at], traced.normal[at] = face, normals[face] @ axes.T
        traced.range[at] = depths[shows] / (self._directions[shows] @ axes[:, 2])
        traced.is_body[at], traced.in_shade[at] = True, False
        return pixels, traced


class _SunlitPixels:
    """Pixels (K,) that show `points` (K, 3) in the sun, in the grid in which the sun sees them."""

    def __init__(self, pixels: Pixels, points: Floats, to_sun: Floats) -> None:
        across = np.cross(to_sun, [0.0, 1.0, 0.0] if abs(to_sun[1]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        self._axes = np.column_stack([across, np.cross(to_sun, across), to_sun])
        seen = points @ self._axes
        self._low = seen.min(axis=0) if len(seen) else np.zeros(3)
        self._cell_m = max(_CELL_M, float((seen - self._low)[:, :2].max(initial=0.0)) / _CELLS)
        places = self._places(points)
        column, row = places[:, :2].astype(np.int64).T
        self._width = int(column.max(initial=0)) + 1
        cell = row * self._width + column
        order = np.argsort(cell, kind="stable")
        self._pixels, self._points = pixels[order], places[order]
        per_cell = np.bincount(cell, minlength=(int(row.max(initial=0)) + 1) * self._width)
        self._first = np.concatenate([[0], np.cumsum(per_cell)])

    def hidden_by(self, bodies: PosedBodies) -> Pixels:
        """The pixels (N,) from whose points `bodies` hide the sun."""
        hidden = np.zeros(len(self._pixels), np.bool_)
        vertices = self._places(bodies.vertices)
        mark_hidden(self._points, self._first, self._width, vertices, bodies.faces, hidden)
        return self._pixels[hidden]

    def _places(self, points: NDArray[np.floating]) -> Array:
        """Columns and rows, as fractions, and heights, (N, 3) [cells], where the sun sees points (N, 3)."""
        places: Array = (points @ self._axes - self._low) / self._cell_m
        return places
