"""Worlds, skies and bodies as surfaces of glTF: the light that the renderer bakes, shown as it is."""

from dataclasses import replace

import numpy as np
from PIL import Image
from scipy import ndimage

from dune_rl.geometry.arrays import Array, Bytes, Flags, Floats
from dune_rl.rendering.baked_scenery import BakedScenery, to_srgb_bytes
from dune_rl.rendering.light import linear_to_srgb, srgb_to_linear
from dune_rl.rendering.participating_media import TONES_FROM_BYTES
from dune_rl.rendering.scenery import ColouredMesh, Segment
from dune_rl.rendering.weather import Haze, Sky
from dune_rl.rendering.web.gltf import Surface

# Of light in surfaces for viewers with a tone map of their own: the value 1 is this bright.
GAIN = 2.0
_SKY_ROWS, _SKY_COLUMNS = 512, 1024
# The ground's picture is enlarged to at most this size.
_MOST_TEXELS = 2_048
_GRAIN_TEXELS, _GRAIN_SIGMAS, _GRAIN_STRENGTH = 256, (0.5, 1.3, 4.0), 0.07
_WATER_OPACITY, _MIRRORED = 0.88, 0.3


def body_surfaces(mesh: ColouredMesh) -> list[Surface]:
    """A body's mesh, in its own frame, to be lit by the viewer."""
    return [Surface(mesh.vertices[mesh.faces], mesh.albedo)]


def world_surfaces(baked: BakedScenery, *, tone_mapped: bool = False) -> list[Surface]:
    """Ground, props and water in the light that is baked for them.

    Colours are light, for viewers with a tone map of their own, or `tone_mapped` as in pictures.
    """
    paint = _Paint(tone_mapped)
    return [_ground(baked, paint), *_props(baked, paint), *_water(baked, paint)]


def sky_surface(
    baked: BakedScenery, haze: Haze | None, radius_m: float, *, tone_mapped: bool = False
) -> Surface:
    """The sky as a sphere of `radius_m` about the origin, seen from within alone.

    `tone_mapped` is as for `world_surfaces`.
    """
    elevation = np.pi / 2 - (np.arange(_SKY_ROWS) + 0.5) / _SKY_ROWS * np.pi
    bearing = (np.arange(_SKY_COLUMNS) + 0.5) / _SKY_COLUMNS * 2 * np.pi
    level = np.cos(elevation)[:, None]
    up = np.broadcast_to(np.sin(elevation)[:, None], (_SKY_ROWS, _SKY_COLUMNS))
    directions = np.stack([level * np.cos(bearing), level * np.sin(bearing), up], axis=-1)
    light = Sky(baked.light, haze).colours(directions.reshape(-1, 3).astype(np.float32))
    paint = _Paint(tone_mapped)
    picture = paint.picture(to_srgb_bytes(light)).reshape(_SKY_ROWS, _SKY_COLUMNS, 3)
    v, u = np.meshgrid(np.linspace(0, 1, 25), np.linspace(0, 1, 49), indexing="ij")
    turn, tilt = 2 * np.pi * u, np.pi / 2 - np.pi * v
    points = radius_m * np.stack(
        [np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)], axis=-1
    )
    index = np.arange(25 * 49).reshape(25, 49)
    a, b, c, d = (each.ravel() for each in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    corners, uv = points.reshape(-1, 3)[faces], np.stack([u, v], axis=-1).reshape(-1, 2)[faces]
    surface = Surface(corners, np.ones((len(faces), 3), np.float32), picture, uv, clamped=True, lit=False)
    return replace(surface, gain=paint.gain)


class _Paint:
    """Colours for viewers that have a tone map, and for those that show colours as they are."""

    def __init__(self, tone_mapped: bool) -> None:
        self._tone_mapped = tone_mapped
        self.gain = 1.0 if tone_mapped else GAIN

    def linear(self, shown: Bytes) -> Floats:
        """Linear RGB (..., 3), over the gain, of sRGB bytes that the renderer would show."""
        if self._tone_mapped:
            return srgb_to_linear(shown.astype(np.float32) / np.float32(255.0))
        return np.minimum(TONES_FROM_BYTES.take(shown) / np.float32(GAIN), np.float32(1.0))

    def picture(self, shown: Bytes) -> Bytes:
        """The same as sRGB bytes."""
        if self._tone_mapped:
            return shown
        return (linear_to_srgb(self.linear(shown)) * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)

    def light(self, light: Floats) -> Floats:
        """Light (..., 3) on a textured surface, over the gain."""
        return np.minimum(light / np.float32(self.gain), np.float32(1.0))


def _ground(baked: BakedScenery, paint: _Paint) -> Surface:
    vertices, faces = baked.terrain.mesh()
    xmin, xmax, ymin, ymax = baked.terrain.extent
    uv = (vertices[:, :2] - [xmin, ymin]) / [xmax - xmin, ymax - ymin]
    white = np.ones((len(faces), 3), np.float32)
    picture = paint.picture(_enlarge_ground(baked.ground))
    # The first row of the ground is at the lowest y.
    return Surface(
        vertices[faces],
        white,
        picture,
        uv[faces].astype(np.float32),
        clamped=True,
        lit=False,
        gain=paint.gain,
    )


def _enlarge_ground(ground: Bytes) -> Bytes:
    """The picture (rows, columns, 3), enlarged, with the fine noise by which near ground is not a blur."""
    rows, columns = ground.shape[:2]
    scale = max(1, _MOST_TEXELS // max(rows, columns))
    large = Image.fromarray(ground).resize((columns * scale, rows * scale), Image.Resampling.BICUBIC)
    draws = np.random.default_rng(0).standard_normal((_GRAIN_TEXELS, _GRAIN_TEXELS), np.float32)
    grain = sum(ndimage.gaussian_filter(draws, sigma, mode="wrap") * sigma for sigma in _GRAIN_SIGMAS)
    grain = _GRAIN_STRENGTH * grain / np.std(grain)
    repeats = -(-rows * scale // _GRAIN_TEXELS), -(-columns * scale // _GRAIN_TEXELS)
    tiled = np.tile(grain, repeats)[: rows * scale, : columns * scale, None]
    return np.clip(np.asarray(large, np.float32) * (1.0 + tiled), 0.0, 255.0).astype(np.uint8)


def _props(baked: BakedScenery, paint: _Paint) -> list[Surface]:
    props = baked.props
    dry = props.segments != Segment.WATER
    textured = np.zeros(len(props.faces), bool) if baked.texture is None else baked.texture.textured
    corners = props.vertices[props.faces]
    colours = paint.linear(baked.faces[baked.ground_faces : -1])
    plain = dry & ~textured
    found = [Surface(corners[plain], colours[plain], lit=False, gain=paint.gain, two_sided=True)]
    if props.texture is None:
        return found
    light = paint.light(baked.light_on_props)
    for number, picture in enumerate(props.texture.pictures):
        its = dry & textured & (props.texture.picture == number)
        if its.any():
            uv = _gltf_uv(props.texture.uv(its, corners[its]))
            found.append(
                Surface(corners[its], light[its], picture, uv, lit=False, gain=paint.gain, two_sided=True)
            )
    return found


def _gltf_uv(uv: Array) -> Floats:
    """Coordinates (F, 3, 2) as glTF has them: v from a picture's upper edge, and near the origin."""
    # Where 32-bit numbers are exact.
    uv = uv - np.floor(uv.min(axis=1, keepdims=True))
    uv[..., 1] = 1.0 - uv[..., 1]
    return uv.astype(np.float32)


def _water(baked: BakedScenery, paint: _Paint) -> list[Surface]:
    """Surfaces of water in one colour, with a share of the sky that they mirror."""
    whole, baked_wet = baked.scenery.props, baked.props.segments == Segment.WATER
    wet: Flags = whole.segments == Segment.WATER
    if not wet.any():
        return []
    mean = TONES_FROM_BYTES.take(baked.faces[baked.ground_faces : -1][baked_wet]).mean(axis=0)
    mirrored = baked.light.sky(np.array(0.5, np.float32))
    shown = to_srgb_bytes(mean + _MIRRORED * (mirrored - mean))
    colours = np.broadcast_to(paint.linear(shown), (int(wet.sum()), 3))
    corners = whole.vertices[whole.faces[wet]]
    return [Surface(corners, colours, lit=False, opacity=_WATER_OPACITY, gain=paint.gain, two_sided=True)]
