"""Ray-traced pictures for people: every pixel is shaded separately, with shadows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dune_rl.geometry.arrays import Floats
from dune_rl.rendering.baked_scenery import BakedScenery, smooth_normals
from dune_rl.rendering.foliage import Foliage
from dune_rl.rendering.moving_mesh import PosedMesh
from dune_rl.rendering.participating_media import (
    BRIGHTEST,
    TONES,
    TONES_TO_BYTES,
    ParticipatingMedia,
    grass_colours,
)
from dune_rl.rendering.scenery import Segment
from dune_rl.rendering.weather import Sky

_RAYS_AT_ONCE = 65_536
_FAR_M = 2_000.0
_OFF_SURFACE_M = 0.01
# Noise finer than the ground's texture: a tile repeated over the ground.
_GRAIN_TILE_M, _GRAIN_TEXELS, _GRAIN_STRENGTH = 2.56, 512, 0.16
_GRAIN_FADES_M = 14.0
# Distance in clear air at which half of the colour is that of the horizon.
_AIR_M = 700.0
_CLEAR = ParticipatingMedia()


@dataclass(frozen=True)
class Viewpoint:
    """A pinhole camera at `eye` (3,) towards `target` (3,) [m], without roll; `fov_rad` is horizontal."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_rad: float = 1.1

    def directions(self, width: int, height: int) -> Floats:
        """Unit vectors (height, width, 3), world frame, through the centre of each pixel."""
        ahead = np.subtract(self.target, self.eye)
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([0.0, -1.0, 0.0])
        up = np.cross(right, ahead)
        half = np.tan(self.fov_rad / 2)
        x = (np.arange(width) + 0.5 - width / 2) / (width / 2) * half
        y = (np.arange(height) + 0.5 - height / 2) / (width / 2) * half
        rays = ahead + x[None, :, None] * right - y[:, None, None] * up
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return rays.astype(np.float32)


class _SurfaceHits(NamedTuple):
    """Hits of N rays: points, faces, normals, ranges [m], and number of the body, -1 for the world."""

    points: Floats
    face: NDArray[np.int32]
    normal: Floats
    range: Floats
    body: NDArray[np.int32]


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
        draws = np.random.default_rng(0).standard_normal((_GRAIN_TEXELS, _GRAIN_TEXELS))
        grain = sum(
            ndimage.gaussian_filter(draws, sigma, mode="wrap") * sigma * weight
            for sigma, weight in ((0.7, 1.0), (2.0, 1.2), (6.0, 1.0))
        )
        self._grain = (grain / np.std(grain)).astype(np.float32)

    def render(
        self,
        view: Viewpoint,
        width: int = 1280,
        height: int = 720,
        bodies: Sequence[PosedMesh] = (),
        samples: int = 1,
    ) -> NDArray[np.uint8]:
        """SRGB bytes (height, width, 3). `samples` > 1 antialiases, at a cost of `samples` squared."""
        directions = view.directions(width * samples, height * samples).reshape(-1, 3)
        eye = np.asarray(view.eye, np.float32)
        pixel_rad = 2.0 * np.tan(view.fov_rad / 2) / (width * samples)
        colours = np.empty((len(directions), 3), np.float32)
        for start in range(0, len(directions), _RAYS_AT_ONCE):
            part = slice(start, start + _RAYS_AT_ONCE)
            colours[part] = self._colours(eye, directions[part], bodies, pixel_rad)
        if samples > 1:
            # Clipped before averaging, so that one very bright sample does not dominate a pixel.
            blocks = np.minimum(colours, BRIGHTEST).reshape(height, samples, width, samples, 3)
            colours = blocks.mean(axis=(1, 3)).reshape(-1, 3)
        index = (colours * ((TONES - 1) / BRIGHTEST)).astype(np.int32)
        return TONES_TO_BYTES.take(index, mode="clip").reshape(height, width, 3)

    def _colours(
        self, eye: Floats, directions: Floats, bodies: Sequence[PosedMesh], pixel_rad: float
    ) -> Floats:
        """Linear RGB (N, 3) seen from `eye` (3,) along `directions` (N, 3), which are `pixel_rad` apart."""
        ranges = np.full(len(directions), _FAR_M, np.float32)
        face, ranges, normal = self.baked.rays.hits(eye[None], directions, ranges)
        body_of = np.full(len(directions), -1, np.int32)
        for number, body in enumerate(bodies):
            ray = body.candidate_rays(eye, directions)
            if not len(ray):
                continue
            hit = body.hits(np.broadcast_to(eye, (len(ray), 3)), directions[ray], ranges[ray])
            met = hit.face >= 0
            ray = ray[met]
            ranges[ray], face[ray], normal[ray] = hit.range[met], hit.face[met], hit.normal[met]
            body_of[ray] = number
        colours = self._sky.colours(directions)
        seen = np.flatnonzero(face >= 0)
        if len(seen):
            points = eye + directions[seen] * ranges[seen, None]
            hits = _SurfaceHits(points, face[seen], normal[seen], ranges[seen], body_of[seen])
            lit = self._shade(hits, directions[seen], bodies, pixel_rad)
            colours[seen] = self._fade(lit, hits.range)
        if self._media.foliage is not None:
            self._blend_grass(self._media.foliage, colours, eye, directions, ranges, bodies)
        return colours

    def _fade(self, colours: Floats, ranges: Floats) -> Floats:
        """Linear RGB (N, 3) of surfaces of `colours` (N, 3) seen through `ranges` (N,) [m] of air."""
        # Distant surfaces fade to the horizon's colour, and in haze to that of the haze.
        clear = np.exp(-ranges * np.float32(np.log(2.0) / _AIR_M))[:, None]
        faded: Floats = colours * clear + self._light.horizon * (1.0 - clear)
        return faded if self._media.haze is None else self._media.haze.blend_over(faded, ranges)

    def _shade(
        self, hits: _SurfaceHits, directions: Floats, bodies: Sequence[PosedMesh], pixel_rad: float
    ) -> Floats:
        """Linear RGB (N, 3) of surfaces hit by rays along `directions` (N, 3)."""
        albedo, normals, sky_share, gloss = self._surfaces(hits, bodies, pixel_rad)
        towards_eye = np.einsum("ij,ij->i", normals, directions) > 0.0
        normals[towards_eye] *= -1.0
        lit = self._light.shade(albedo, normals, self._sunlit(hits.points, normals, bodies), sky_share)
        return self._add_reflections(lit, gloss, normals, directions) if gloss.any() else lit

    def _blend_grass(
        self,
        foliage: Foliage,
        colours: Floats,
        eye: Floats,
        directions: Floats,
        ranges: Floats,
        bodies: Sequence[PosedMesh],
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
        self, hits: _SurfaceHits, bodies: Sequence[PosedMesh], pixel_rad: float
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Albedo (N, 3), unit normals (N, 3), sky share (N,) and gloss (N,) of the surfaces."""
        baked, (points, face, normal, ranges, body_of) = self.baked, hits
        albedo = np.empty_like(points)
        normals = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        share, gloss = np.ones(len(points), np.float32), np.zeros(len(points), np.float32)
        ground = np.flatnonzero((body_of < 0) & (face < baked.ground_faces))
        if len(ground):
            at = points[ground]
            texels = baked.grid_coordinates(at, self._albedo.shape[:2])
            albedo[ground] = _interpolate(self._albedo, texels) * (1.0 + self._grain_at(at, ranges[ground]))
            normals[ground] = _interpolate(self._normals, baked.grid_coordinates(at, self._normals.shape[:2]))
            share[ground] = _interpolate(baked.sky_share, baked.grid_coordinates(at, baked.sky_share.shape))
        prop = np.flatnonzero((body_of < 0) & (face >= baked.ground_faces))
        if len(prop):
            own = face[prop] - baked.ground_faces
            # A little of the ground's noise keeps large walls from looking like plastic.
            grained = 1.0 + 0.4 * self._grain_at(points[prop], ranges[prop])
            albedo[prop] = baked.props.albedo[own] * grained
            if baked.texture is not None:
                pictured = baked.texture.textured[own]
                seen = prop[pictured]
                pixel_m = ranges[seen] * np.float32(pixel_rad)
                albedo[seen] = baked.texture.albedo(own[pictured], points[seen], pixel_m, smooth=True)
            share[prop] = baked.props_sky_share[own]
            gloss[prop] = np.where(baked.props.segments[own] == Segment.WATER, 1.0, 0.0)
        for number in np.unique(body_of[body_of >= 0]):
            mine = body_of == number
            albedo[mine] = bodies[number].shape.albedo[face[mine]]
        return albedo, normals, share, gloss

    def _grain_at(self, points: Floats, ranges: Floats) -> Floats:
        """Relative brightness noise (N, 1) about 0 at points (N, 3), faded out where it would flicker."""
        # Sheared, so that vertical walls have noise, too.
        slanted = points[:, :2] + points[:, 2:] * np.float32(0.71)
        cell = (slanted * np.float32(_GRAIN_TEXELS / _GRAIN_TILE_M)).astype(np.int32) & (_GRAIN_TEXELS - 1)
        grain = self._grain.ravel().take(cell[:, 1] * _GRAIN_TEXELS + cell[:, 0])
        fade = np.float32(_GRAIN_STRENGTH) * np.exp(ranges * np.float32(-1.0 / _GRAIN_FADES_M))
        return (grain * fade)[:, None]

    def _sunlit(self, points: Floats, normals: Floats, bodies: Sequence[PosedMesh]) -> Floats:
        """1 where the sun reaches `points` (N, 3), else 0."""
        to_sun = self._light.to_sun
        facing = np.flatnonzero(normals @ to_sun > 0.0)
        sunlit = np.zeros(len(points), np.float32)
        if not self._light.shadows:
            sunlit[facing] = 1.0
            return sunlit
        origins = points[facing] + normals[facing] * np.float32(_OFF_SURFACE_M)
        directions = np.tile(to_sun, (len(origins), 1))
        free = ~self.baked.rays.any_hit(origins, directions)
        for body in bodies:
            near = body.shadow_candidates(origins, to_sun)
            if len(near):
                free[near] &= ~body.any_hit(origins[near], directions[near])
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


def _interpolate(grid: Floats, at: tuple[Floats, Floats]) -> Floats:
    """Bilinear values (N, ...) of a grid (rows, columns, ...) at fractional rows and columns (N,)."""
    rows, columns = grid.shape[:2]
    y, x = at
    y0, x0 = y.astype(np.int32), x.astype(np.int32)
    y0, x0 = np.minimum(y0, rows - 2), np.minimum(x0, columns - 2)
    v, u = y - y0, x - x0
    flat = grid.reshape(rows * columns, -1)
    index = y0 * np.int32(columns) + x0
    u, v = u[:, None], v[:, None]
    low = flat.take(index, axis=0) * (1 - u) + flat.take(index + 1, axis=0) * u
    high = flat.take(index + columns, axis=0) * (1 - u) + flat.take(index + columns + 1, axis=0) * u
    values: Floats = low * (1 - v) + high * v
    return values.reshape(-1, *grid.shape[2:])
