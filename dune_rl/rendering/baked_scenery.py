"""Scenery with baked light, so that a small picture costs little more than its rays."""

from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.light import Light, tone_map_to_srgb
from dune_rl.rendering.mesh_texture import TextureSampler
from dune_rl.rendering.scenery import ColouredMesh, Scenery, Segment, join_meshes, subdivide_mesh

# Longest edge of props' triangles, so that shadows can cover parts of a prop.
_LONGEST_EDGE_M = 0.6
_OFF_SURFACE_M = 0.02
# Corners of faces are one where they are nearer [m], and the components of the normals too.
_SAME_PLACE_M, _SAME_NORMAL = 1e-3, 0.05
# The visible share of the sky is smooth, so it is computed on a coarser grid.
_SKY_GRID_M = 0.5
_SKY_RAYS = 24
_SKY_STEPS = 64

# The array that is cached last: if it is there, so are the others.
LAST_CACHED = "sky share of props"

# Gets an array by name from a cache, or computes it.
GetOrCompute = Callable[[str, Callable[[], Floats]], Floats]


class BakedScenery:
    """Colours and segments of a `Scenery` at any point that a ray hits.

    `rays` has the ground's faces first, then those of the props. `texture` is
    the props' textures, None without any; `light_on_props` is the light that a white face of each would
    reflect, where there are any. `get_or_compute(name, make)` may
    cache arrays, which depend on the scenery but not on the light.
    """

    def __init__(
        self, scenery: Scenery, light: Light, get_or_compute: GetOrCompute = lambda _, make: make()
    ) -> None:
        self.scenery = scenery
        self.terrain = scenery.terrain
        ground_vertices, ground_faces = self.terrain.mesh()
        self.props = subdivide_mesh(scenery.props, _LONGEST_EDGE_M)
        count = self.ground_faces = len(ground_faces)
        no_colours, segments = np.zeros((count, 3), np.float32), np.full(count, Segment.GROUND, np.uint8)
        ground = ColouredMesh(ground_vertices, ground_faces, no_colours, segments)
        everything = join_meshes([ground, self.props])
        self.rays = RayScene(everything.vertices, everything.faces)
        # Index -1, for a miss, selects the last entry.
        self.segments = np.append(everything.segments, np.uint8(Segment.SKY))
        self.texture = None if self.props.texture is None else TextureSampler(self.props.texture)
        self.sky_share = get_or_compute("sky share of the ground", self._ground_sky_share)
        self._props_normals = _face_normals(self.props)
        self.props_sky_share = get_or_compute(LAST_CACHED, self._props_sky_share)
        self._bake(light)

    def relight(self, light: Light) -> "BakedScenery":
        """The same scenery in another light, at a fraction of the cost: sky shares are reused."""
        other = copy(self)
        other._bake(light)
        return other

    def _bake(self, light: Light) -> None:
        self.light = light
        self.ground = self._bake_ground()
        self.faces = np.concatenate(
            [np.zeros((self.ground_faces, 3), np.uint8), self._bake_props(), np.zeros((1, 3), np.uint8)]
        )
        # From straight down to straight up; only upward directions show the sky.
        self.sky = to_srgb_bytes(light.sky(np.linspace(-1.0, 1.0, 2 * _SKY_STEPS, dtype=np.float32)))

    def ground_texel_positions(self) -> Array:
        """Points (rows, columns, 3) on the ground at the centres of the texture's texels."""
        return _ground_grid(self.terrain, *self.scenery.ground.shape[:2])

    def grid_coordinates(self, points: Floats, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
        """Fractional rows and columns (N,) of points (N, 2 or 3) in a grid of `shape` over the ground."""
        xmin, xmax, ymin, ymax = self.terrain.extent
        rows, columns = shape
        row = (points[:, 1] - np.float32(ymin)) * np.float32(rows / (ymax - ymin)) - np.float32(0.5)
        column = (points[:, 0] - np.float32(xmin)) * np.float32(columns / (xmax - xmin)) - np.float32(0.5)
        return np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)

    def _ground_sky_share(self) -> Floats:
        xmin, xmax, ymin, ymax = self.terrain.extent
        rows, columns = (max(2, min(256, round(side / _SKY_GRID_M))) for side in (ymax - ymin, xmax - xmin))
        points = _ground_grid(self.terrain, rows, columns).reshape(-1, 3)
        normals = smooth_normals(self.terrain, points[:, :2])
        share = sky_share(self.rays, points, normals).reshape(rows, columns)
        return scipy.ndimage.gaussian_filter(share, 0.7)

    def _bake_ground(self) -> NDArray[np.uint8]:
        albedo = self.scenery.ground
        points = self.ground_texel_positions().reshape(-1, 3)
        normals = smooth_normals(self.terrain, points[:, :2])
        zoom = [a / b for a, b in zip(albedo.shape[:2], self.sky_share.shape, strict=True)]
        share = scipy.ndimage.zoom(self.sky_share, zoom, order=1, mode="nearest", grid_mode=True)
        sun = sunlit(self.rays, self.light, points, normals)
        lit = self.light.shade(albedo.reshape(-1, 3), normals, sun, share.ravel())
        return to_srgb_bytes(lit).reshape(albedo.shape)

    def _props_centres(self) -> Array:
        return self.props.vertices[self.props.faces].mean(axis=1)

    def _bake_props(self) -> NDArray[np.uint8]:
        props, normals = self.props, self._props_normals
        if not len(props.faces):
            return np.zeros((0, 3), np.uint8)
        sun = sunlit(self.rays, self.light, self._props_centres(), normals)
        if self.texture is not None:
            white = np.ones_like(props.albedo)
            self.light_on_props = self.light.shade(white, normals, sun, self.props_sky_share)
        return to_srgb_bytes(self.light.shade(props.albedo, normals, sun, self.props_sky_share))

    def _props_sky_share(self) -> Floats:
        return sky_share(self.rays, self._props_centres(), self._props_normals)

    @cached_property
    def props_corner_sky_share(self) -> Floats:
        """The share of the sky (F, 3) at the corners of the props' faces: the mean of all faces in one plane
        that meet there, so that shade is continuous over a wall.
        """
        corners = self.props.vertices[self.props.faces].reshape(-1, 3) / _SAME_PLACE_M
        normals = np.repeat(self._props_normals, 3, axis=0) / _SAME_NORMAL
        keys = np.rint(np.column_stack([corners, normals])).astype(np.int64)
        _, place = np.unique(keys, axis=0, return_inverse=True)
        sums = np.bincount(place, np.repeat(self.props_sky_share, 3))
        return (sums / np.bincount(place))[place].astype(np.float32).reshape(-1, 3)

    def textured_colours(self, face: NDArray[Any], points: Floats, pixel_m: Floats) -> NDArray[np.uint8]:
        """SRGB bytes (N, 3) at `points` (N, 3) on textured faces `face` (N,) of props; `pixel_m` is (N,)."""
        assert self.texture is not None
        return to_srgb_bytes(self.texture.albedo(face, points, pixel_m) * self.light_on_props[face])


def to_srgb_bytes(colour: Floats) -> NDArray[np.uint8]:
    """Tone-mapped sRGB bytes (...) of linear values (...)."""
    return (tone_map_to_srgb(colour) * 255.0 + 0.5).astype(np.uint8)


def smooth_normals(terrain: HeightField, xy: Array) -> Floats:
    """Unit normals (N, 3) at points (N, 2), interpolated between the terrain's vertices."""
    rise_y, rise_x = np.gradient(terrain.heights, terrain.spacing_m)
    at = ((xy - terrain.origin) / terrain.spacing_m).T[::-1]
    slopes = [scipy.ndimage.map_coordinates(rise, at, order=1, mode="nearest") for rise in (rise_x, rise_y)]
    normals = np.stack([-slopes[0], -slopes[1], np.ones(len(xy))], axis=1)
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


def sunlit(rays: RayScene, light: Light, points: Array, normals: Floats) -> Floats:
    """1 where the sun reaches points (N, 3) on surfaces with unit `normals` (N, 3), else 0."""
    facing = normals @ light.to_sun > 0.0
    share = facing.astype(np.float32)
    if light.shadows and facing.any():
        origins = (points[facing] + normals[facing] * _OFF_SURFACE_M).astype(np.float32)
        directions = np.ascontiguousarray(np.broadcast_to(light.to_sun, origins.shape))
        share[facing] = ~rays.any_hit(origins, directions)
    return share


def sky_share(rays: RayScene, points: Array, normals: Floats) -> Floats:
    """Cosine-weighted share of the hemisphere over points (N, 3) with unit `normals` (N, 3) that is free."""
    # Uniform directions on the sphere, in a golden spiral; each surface uses those on its side.
    index = np.arange(2 * _SKY_RAYS) + 0.5
    z = 1.0 - index / _SKY_RAYS
    turn = np.pi * (1.0 + 5**0.5) * index
    level = np.sqrt(1.0 - z * z)
    sphere = np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1).astype(np.float32)
    origins = (points + normals * _OFF_SURFACE_M).astype(np.float32)
    open_weight, weight = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for direction in sphere:
        cosine = np.maximum(normals @ direction, 0.0)
        faced = cosine > 0.0
        if not faced.any():
            continue
        towards = np.ascontiguousarray(np.broadcast_to(direction, (int(faced.sum()), 3)))
        open_weight[faced] += cosine[faced] * ~rays.any_hit(origins[faced], towards)
        weight += cosine
    return (open_weight / np.maximum(weight, 1e-6)).astype(np.float32)


def _face_normals(shape: ColouredMesh) -> Floats:
    corners = shape.vertices[shape.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals.astype(np.float32)


def _ground_grid(terrain: HeightField, rows: int, columns: int) -> Array:
    xy = cell_centres(terrain.extent, rows, columns)
    return np.concatenate([xy, terrain.height(xy)[..., None]], axis=-1)
