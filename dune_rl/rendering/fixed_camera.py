"""Pictures from a camera that stands still: of all pixels, only those that change are traced again."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.spatial import ConvexHull

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.rendering.moving_mesh import PosedBodies, PosedMesh
from dune_rl.rendering.renderer import Renderer, Traced, Viewpoint, mark_both_sides, to_bytes

Pixels = NDArray[np.int64]

_NEAR_M, _FAR_M = 0.1, 60.0
_OFF_SURFACE_M = 0.01
# Shadows are looked for so far behind the first surface under a body's middle.
_BEYOND_M = 2.0


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
        self._points, self._sunlit = self._sunlit_points()

    def render(self, bodies: Sequence[PosedMesh]) -> NDArray[np.uint8]:
        """SRGB bytes (height, width, 3) with `bodies` in the world: as `Renderer.render`, but that the edges
        of shadows are not smoothed.
        """
        picture = self._still.copy()
        if not bodies:
            return picture.reshape(self.height, self.width, 3)
        posed = PosedBodies(bodies)
        pixels, traced = self._trace_changed(bodies, posed)
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

    def _sunlit_points(self) -> tuple[Floats, NDArray[np.bool_]]:
        """Points (N, 3) of the world that the pixels show, and whether the sun reaches them (N,)."""
        world = self._world
        points = self._eye + self._directions * world.range[:, None]
        sunlit = world.face >= 0
        if not self._renderer.baked.light.shadows:
            return points, np.zeros_like(sunlit)
        lit = np.flatnonzero(sunlit)
        points[lit] += np.float32(_OFF_SURFACE_M) * self._to_sun
        directions = np.tile(self._to_sun, (len(lit), 1))
        sunlit[lit] = ~self._renderer.baked.rays.any_hit(points[lit], directions)
        return points, sunlit

    def _trace_changed(self, bodies: Sequence[PosedMesh], posed: PosedBodies) -> tuple[Pixels, Traced]:
        """Sorted numbers (K,) of the pixels that show a body or its shadow, and what their rays meet."""
        near = self._within([body.corners for body in bodies])
        hit = posed.rays.hits(self._eye[None], self._directions[near], self._world.range[near])
        met = np.flatnonzero(hit.face >= 0)
        shows = near[met]
        changed = np.zeros(self.width * self.height, np.bool_)
        changed[shows] = True
        if self._renderer.baked.light.shadows:
            maybe = self._within(self._swept_from_sun(bodies))
            maybe = maybe[self._sunlit[maybe] & ~changed[maybe]]
            directions = np.broadcast_to(self._to_sun, (len(maybe), 3))
            changed[maybe[posed.rays.any_hit(self._points[maybe], directions)]] = True
        pixels = np.flatnonzero(changed)
        traced = self._world.select(pixels)
        at = np.searchsorted(pixels, shows)
        traced.face[at], traced.range[at], traced.normal[at] = hit.face[met], hit.range[met], hit.normal[met]
        traced.is_body[at] = True
        return pixels, traced

    def _within(self, solids: Sequence[Array]) -> Pixels:
        """Numbers of the pixels that show the convex hulls of some points, or are beside them.

        The points are (8, 3), or (2, 8, 3) with ways from one to the other, of which the part behind the eye
        is left out.
        """
        mask = Image.new("L", (self.width, self.height))
        draw = ImageDraw.Draw(mask)
        for points in solids:
            column, row, depth = self.view.project(points.reshape(-1, 3), self.width, self.height)
            if (depth <= _NEAR_M).all():
                continue
            if (depth <= _NEAR_M).any():
                if points.ndim == 2:
                    # It is all about the eye.
                    draw.rectangle((0, 0, self.width, self.height), fill=1)
                    continue
                cut = _cut_at(points, depth.reshape(2, -1) - _NEAR_M)
                column, row, _ = self.view.project(cut, self.width, self.height)
            outline = np.column_stack([column, row])
            outline = outline[ConvexHull(outline, qhull_options="QJ").vertices]
            # Far outside the picture, numbers are too large to draw with.
            outline = np.clip(outline, -20_000, 20_000)
            draw.polygon([tuple(point) for point in outline.tolist()], fill=1, outline=1, width=3)
        return np.flatnonzero(np.asarray(mask))

    def _swept_from_sun(self, bodies: Sequence[PosedMesh]) -> list[Array]:
        """The corners (2, 8, 3) of bodies where they are, and away from the sun where their shadows end."""
        corners = np.array([body.corners for body in bodies])
        down = np.full(len(bodies), _FAR_M, np.float32)
        from_sun = np.tile(-self._to_sun, (len(bodies), 1))
        self._renderer.baked.rays.shorten_ranges(corners.mean(axis=1).astype(np.float32), from_sun, down)
        sizes = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
        reach = (down + sizes + _BEYOND_M)[:, None, None]
        return [*np.stack([corners, corners - reach * self._to_sun], axis=1)]


def _cut_at(points: Array, ahead: Array) -> Array:
    """Ends of the ways from `points` (2, 8, 3) that are in front of the eye, by distances `ahead` (2, 8) [m];
    where a way passes the eye, it ends beside it.
    """
    share = ahead[0] / np.where(ahead[0] == ahead[1], 1.0, ahead[0] - ahead[1])
    cut = points[0] + np.clip(share, 0.0, 1.0)[:, None] * (points[1] - points[0])
    passes = (ahead[0] > 0.0) != (ahead[1] > 0.0)
    return np.concatenate([points[0][ahead[0] > 0.0], points[1][ahead[1] > 0.0], cut[passes]])
