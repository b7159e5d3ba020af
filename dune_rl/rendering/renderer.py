"""Ray-traced pictures for people: every pixel is shaded separately, with shadows."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.rendering.baked_scenery import BakedScenery, smooth_normals
from dune_rl.rendering.foliage import Foliage
from dune_rl.rendering.moving_mesh import PosedBodies, PosedMesh
from dune_rl.rendering.participating_media import (
    BRIGHTEST,
    TONES,
    TONES_TO_BYTES,
    ParticipatingMedia,
    grass_colours,
)
from dune_rl.rendering.scenery import Segment
from dune_rl.rendering.shading import GRAIN_TEXELS, add_grain, interpolate_in_faces, sample_ground
from dune_rl.rendering.weather import Sky

_RAYS_AT_ONCE = 65_536
_FAR_M = 2_000.0
_OFF_SURFACE_M = 0.01
# Props have less of the ground's noise, which keeps large walls from looking like plastic.
_PROPS_GRAIN = 0.4
# Pixels that differ by more from a neighbour, in sRGB bytes, are traced by several rays.
_CONTRAST = 10
# Distance in clear air at which half of the colour is that of the horizon.
_AIR_M = 700.0
_CLEAR = ParticipatingMedia()


@dataclass(frozen=True)
class Viewpoint:
    """A pinhole camera at `eye` (3,) towards `target` (3,) [m], without roll; `fov_rad` is horizontal."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_rad: float = 1.1

    def directions(self, width: int, height: int, samples: int = 1) -> Floats:
        """Unit vectors (height * samples, width * samples, 3), world frame, through the pixels' samples."""
        right, down, ahead = self.axes.T
        columns, rows = width * samples, height * samples
        half = np.tan(self.fov_rad / 2)
        x = (np.arange(columns) + 0.5 - columns / 2) / (columns / 2) * half
        y = (np.arange(rows) + 0.5 - rows / 2) / (columns / 2) * half
        along_rows = (ahead + y[:, None] * down).astype(np.float32)
        rays = along_rows[:, None] + (x[:, None] * right).astype(np.float32)
        rays /= np.sqrt(np.einsum("ijk,ijk->ij", rays, rays))[..., None]
        return rays

    def project(self, points: Array, width: int, height: int) -> tuple[Array, Array, Array]:
        """Columns (N,), rows (N,) [px] and depths (N,) [m] of points (N, 3) in a picture of that size.

        Points behind the eye have depths below 0.
        """
        right, down, depth = self.place(points).T
        scale = self.focal_px(width) / np.where(depth > 0.0, depth, np.nan)
        return width / 2 + right * scale, height / 2 + down * scale, depth

    def place(self, points: Array) -> Array:
        """Points (N, 3) [m] of the world in the frame of the camera: to the right, down and ahead."""
        placed: Array = (np.asarray(points) - self.eye) @ self.axes
        return placed

    def focal_px(self, width: int) -> float:
        """Focal length in pixels of a picture of that width."""
        return float(width / (2.0 * np.tan(self.fov_rad / 2)))

    @cached_property
    def axes(self) -> Array:
        """Unit vectors to the right, down and ahead in the picture, world frame, in columns (3, 3)."""
        ahead = np.subtract(self.target, self.eye)
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([0.0, -1.0, 0.0])
        return np.column_stack([right, np.cross(ahead, right), ahead])


class Traced(NamedTuple):
    """What N rays meet: faces, -1 for the sky; ranges [m]; normals (N, 3), not normalised, of the surfaces;
    whether these are those of bodies, whose faces have numbers of their own; and whether the sun is known not
    to reach them.
    """

    face: NDArray[np.int32]
    range: Floats
    normal: Floats
    is_body: NDArray[np.bool_]
    in_shade: NDArray[np.bool_]

    def select(self, rays: NDArray[np.int64]) -> "Traced":
        """What some of the rays meet, by their numbers."""
        face, ranges, normal, is_body, in_shade = self
        return Traced(face[rays], ranges[rays], normal[rays], is_body[rays], in_shade[rays])


class Renderer:
    """Renders a baked world, posed meshes in it, and the `media` in front of them."""

    def __init__(self, baked: BakedScenery, media: ParticipatingMedia = _CLEAR) -> None:
        self.baked = baked
        self._media = media
        self._light = baked.light
        self._sky = Sky(baked.light, media.haze)
        points = baked.ground_texel_positions()
        shape = points.shape[:2]
        self._albedo = baked.scenery.ground
        self._normals = smooth_normals(baked.terrain, points.reshape(-1, 3)[:, :2]).reshape(*shape, 3)
        self._grain = _draw_grain()
        xmin, xmax, ymin, ymax = baked.terrain.extent
        self._corner = np.array([xmin, ymin], np.float32)
        self._corners = baked.props.vertices[baked.props.faces].astype(np.float32)
        self._per_m = np.array([1.0 / (xmax - xmin), 1.0 / (ymax - ymin)], np.float32)

    @property
    def is_clear(self) -> bool:
        """Whether nothing is in the air or grows in front of the world."""
        return self._media.clear

    def render(
        self,
        view: Viewpoint,
        width: int = 1280,
        height: int = 720,
        bodies: Sequence[PosedMesh] = (),
        samples: int = 1,
    ) -> NDArray[np.uint8]:
        """SRGB bytes (height, width, 3).

        With `samples` > 1, pixels at edges are the mean of `samples` squared rays.
        """
        eye = np.asarray(view.eye, np.float32)
        pixel_rad = 2.0 * np.tan(view.fov_rad / 2) / width
        directions = view.directions(width, height).reshape(-1, 3)
        posed = PosedBodies(bodies) if bodies else None
        picture = to_bytes(self._colours_along(eye, directions, posed, pixel_rad))
        if samples > 1:
            uneven = np.flatnonzero(_is_uneven(picture.reshape(height, width, 3)))
            if len(uneven):
                fine = view.directions(width, height, samples)
                picture[uneven] = to_bytes(self.antialiased(eye, fine, uneven, posed, pixel_rad, samples))
        return picture.reshape(height, width, 3)

    def antialiased(
        self,
        eye: Floats,
        fine: Floats,
        pixels: NDArray[np.int64],
        bodies: PosedBodies | None,
        pixel_rad: float,
        samples: int,
    ) -> Floats:
        """Linear RGB (K, 3) of `pixels` (K,), numbers in the picture, each the mean of `samples` squared rays
        along `fine` (height * samples, width * samples, 3).
        """
        width = fine.shape[1] // samples
        row, column = np.divmod(pixels, width)
        step = np.arange(samples)
        rays = fine[
            (row[:, None] * samples + step)[:, :, None], (column[:, None] * samples + step)[:, None, :]
        ]
        colours = self._colours_along(eye, rays.reshape(-1, 3), bodies, pixel_rad / samples)
        # Clipped before averaging, so that one very bright sample does not dominate a pixel.
        means: Floats = np.minimum(colours, BRIGHTEST).reshape(len(pixels), samples**2, 3).mean(axis=1)
        return means

    def _colours_along(
        self, eye: Floats, directions: Floats, bodies: PosedBodies | None, pixel_rad: float
    ) -> Floats:
        """Linear RGB (N, 3) seen from `eye` (3,) along `directions` (N, 3), which are `pixel_rad` apart."""
        colours = np.empty((len(directions), 3), np.float32)
        for start in range(0, len(directions), _RAYS_AT_ONCE):
            part = slice(start, start + _RAYS_AT_ONCE)
            traced = self.trace(eye, directions[part], bodies)
            colours[part] = self.colours(eye, directions[part], traced, bodies, pixel_rad)
        return colours

    def trace(self, eye: Floats, directions: Floats, bodies: PosedBodies | None) -> Traced:
        """What rays from `eye` (3,) along `directions` (N, 3) meet first."""
        ranges = np.full(len(directions), _FAR_M, np.float32)
        face, ranges, normal = self.baked.rays.hits(eye[None], directions, ranges)
        is_body = np.zeros(len(directions), np.bool_)
        if bodies is not None:
            hit = bodies.rays.hits(eye[None], directions, ranges)
            is_body = hit.face >= 0
            face[is_body], normal[is_body] = hit.face[is_body], hit.normal[is_body]
        return Traced(face, ranges, normal, is_body, np.zeros(len(directions), np.bool_))

    def colours(
        self,
        eye: Floats,
        directions: Floats,
        traced: Traced,
        bodies: PosedBodies | None,
        pixel_rad: float,
    ) -> Floats:
        """Linear RGB (N, 3) of what was `traced` from `eye` (3,) along `directions` (N, 3)."""
        is_surface = traced.face >= 0
        if is_surface.all():
            colours = self._lit(eye, directions, traced, bodies, pixel_rad)
        else:
            colours = np.empty((len(directions), 3), np.float32)
            free, seen = np.flatnonzero(~is_surface), np.flatnonzero(is_surface)
            colours[free] = self._sky.colours(directions[free])
            colours[seen] = self._lit(eye, directions[seen], traced.select(seen), bodies, pixel_rad)
        if self._media.foliage is not None:
            self._blend_grass(self._media.foliage, colours, eye, directions, traced.range, bodies)
        return colours

    def _lit(
        self,
        eye: Floats,
        directions: Floats,
        traced: Traced,
        bodies: PosedBodies | None,
        pixel_rad: float,
    ) -> Floats:
        """Linear RGB (N, 3) of surfaces, behind air and haze."""
        points = eye + directions * traced.range[:, None]
        albedo, normals, sky_share, gloss = self._surfaces(points, traced, bodies, pixel_rad)
        towards_eye = np.einsum("ij,ij->i", normals, directions) > 0.0
        normals[towards_eye] *= -1.0
        sunlit = self._sunlit(points, normals, bodies, traced.in_shade)
        lit = self._light.shade(albedo, normals, sunlit, sky_share)
        if gloss.any():
            lit = self._add_reflections(lit, gloss, normals, directions)
        return self._fade(lit, traced.range)

    def _fade(self, colours: Floats, ranges: Floats) -> Floats:
        """Linear RGB (N, 3) of surfaces of `colours` (N, 3) seen through `ranges` (N,) [m] of air."""
        # Distant surfaces fade to the horizon's colour, and in haze to that of the haze.
        clear = np.exp(-ranges * np.float32(np.log(2.0) / _AIR_M))[:, None]
        faded: Floats = colours * clear + self._light.horizon * (1.0 - clear)
        return faded if self._media.haze is None else self._media.haze.blend_over(faded, ranges)

    def _blend_grass(
        self,
        foliage: Foliage,
        colours: Floats,
        eye: Floats,
        directions: Floats,
        ranges: Floats,
        bodies: PosedBodies | None,
    ) -> None:
        """Blend grass over `colours` (N, 3), in place, of surfaces at `ranges` (N,)."""
        transmission = foliage.transmission(eye[None], directions, ranges, tufts=True)
        grown = np.flatnonzero(transmission.passed < 0.998)
        if not len(grown):
            return
        passed, _, distance, height, tint = (values[grown] for values in transmission)
        upward = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), (len(grown), 3))
        sunlit = self._sunlit(eye + directions[grown] * distance[:, None], upward, bodies)
        grass = self._fade(grass_colours(self._light, height, tint, sunlit), distance)
        colours[grown] = grass + (colours[grown] - grass) * passed[:, None]

    def _surfaces(
        self, points: Floats, traced: Traced, bodies: PosedBodies | None, pixel_rad: float
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Albedo (N, 3), unit normals (N, 3), sky share (N,) and gloss (N,) of the surfaces at `points`."""
        baked, (face, ranges, normal, is_body, _) = self.baked, traced
        albedo = np.empty_like(points)
        normals = normal / np.maximum(np.sqrt(np.einsum("ij,ij->i", normal, normal)), 1e-12)[:, None]
        share, gloss = np.ones(len(points), np.float32), np.zeros(len(points), np.float32)
        ground = np.flatnonzero(~is_body & (face < baked.ground_faces))
        if len(ground):
            grids = self._albedo, self._normals, baked.sky_share
            sample_ground(points, ground, self._corner, self._per_m, *grids, albedo, normals, share)
            add_grain(points, ranges, ground, self._grain, 1.0, albedo)
        prop = np.flatnonzero(~is_body & (face >= baked.ground_faces))
        if len(prop):
            own = face[prop] - baked.ground_faces
            albedo[prop] = baked.props.albedo[own]
            add_grain(points, ranges, prop, self._grain, _PROPS_GRAIN, albedo)
            if baked.texture is not None:
                pictured = baked.texture.textured[own]
                seen = prop[pictured]
                pixel_m = ranges[seen] * np.float32(pixel_rad)
                albedo[seen] = baked.texture.albedo(own[pictured], points[seen], pixel_m, smooth=True)
            interpolate_in_faces(points, prop, own, self._corners, baked.props_corner_sky_share, share)
            gloss[prop] = np.where(baked.props.segments[own] == Segment.WATER, 1.0, 0.0)
        if bodies is not None:
            posed = np.flatnonzero(is_body)
            albedo[posed] = bodies.albedo[face[posed]]
        return albedo, normals, share, gloss

    def _sunlit(
        self,
        points: Floats,
        normals: Floats,
        bodies: PosedBodies | None,
        in_shade: NDArray[np.bool_] | None = None,
    ) -> Floats:
        """1 where the sun reaches `points` (N, 3), else 0; none of those `in_shade` (N,) is asked for."""
        to_sun = self._light.to_sun
        faces_sun = normals @ to_sun > 0.0
        facing = np.flatnonzero(faces_sun if in_shade is None else faces_sun & ~in_shade)
        sunlit = np.zeros(len(points), np.float32)
        if not self._light.shadows:
            sunlit[facing] = 1.0
            return sunlit
        origins = points[facing] + normals[facing] * np.float32(_OFF_SURFACE_M)
        directions = np.broadcast_to(to_sun, origins.shape)
        free = ~self.baked.rays.any_hit(origins, directions)
        if bodies is not None:
            free &= ~bodies.rays.any_hit(origins, directions)
        sunlit[facing] = free
        return sunlit

    def _add_reflections(self, lit: Floats, gloss: Floats, normals: Floats, directions: Floats) -> Floats:
        shiny = np.flatnonzero(gloss)
        into, normal = directions[shiny], normals[shiny]
        cosine = -np.einsum("ij,ij->i", into, normal)
        mirrored = into + 2.0 * cosine[:, None] * normal
        mirrored[:, 2] = np.abs(mirrored[:, 2])
        # Schlick's approximation for water.
        share = (0.02 + 0.98 * (1.0 - np.clip(cosine, 0.0, 1.0)) ** 5)[:, None] * gloss[shiny, None]
        lit[shiny] += share * (self._sky.colours(mirrored) - lit[shiny])
        return lit


@lru_cache(maxsize=1)
def _draw_grain() -> Floats:
    """Noise of several scales, of standard deviation 1, in a square of texels that repeats, row by row."""
    draws = np.random.default_rng(0).standard_normal((GRAIN_TEXELS, GRAIN_TEXELS))
    grain = sum(
        ndimage.gaussian_filter(draws, sigma, mode="wrap") * sigma * weight
        for sigma, weight in ((0.7, 1.0), (2.0, 1.2), (6.0, 1.0))
    )
    return (grain / np.std(grain)).astype(np.float32).ravel()


def to_bytes(colours: Floats) -> NDArray[np.uint8]:
    """SRGB bytes (N, 3) of linear RGB (N, 3)."""
    index = (colours * np.float32((TONES - 1) / BRIGHTEST)).astype(np.int32)
    return TONES_TO_BYTES.take(index, mode="clip")


def _is_uneven(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels (H, W) of a picture (H, W, 3) that differ visibly from a neighbour."""
    signed = picture.astype(np.int16)
    across: NDArray[np.bool_] = np.abs(np.diff(signed, axis=1)).max(axis=2) > _CONTRAST
    down: NDArray[np.bool_] = np.abs(np.diff(signed, axis=0)).max(axis=2) > _CONTRAST
    return mark_both_sides(across, down)


def mark_both_sides(across: NDArray[np.bool_], down: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (H, W) on both sides of the borders that are marked between columns, `across` (H, W - 1), and
    between rows, `down` (H - 1, W).
    """
    marked = np.zeros((len(across), down.shape[1]), np.bool_)
    marked[:, 1:] |= across
    marked[:, :-1] |= across
    marked[1:] |= down
    marked[:-1] |= down
    return marked
