"""Tall grass of a live page: a tuft of blades, which stands in many places."""

from typing import NamedTuple

import numpy as np

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.rendering.baked_scenery import BakedScenery, sunlit
from dune_rl.rendering.foliage import Foliage
from dune_rl.rendering.light import Light
from dune_rl.rendering.participating_media import grass_colours
from dune_rl.rendering.web.gltf import Surface
from dune_rl.rendering.web.surfaces import GAIN

# Where grass is dense, tufts are this far apart; all of them are there from half of the full density on.
# Of more tufts, those nearest to the middle of the world are kept.
_APART_M, _FULL_AT, _MOST_TUFTS = 0.45, 0.5, 8_000
_BLADES, _RADIUS_M, _WIDTH_M, _BELOW_M = 18, 0.3, 0.065, 0.12
# Tips lean by up to this share of the height. Then shares of the largest tuft and of the tallest blade.
_LEAN, _SMALLEST, _SHORTEST = 0.35, 0.8, 0.45
# Relative height at which the colour of a blade's root is taken.
_ROOT = 0.15


class Tufts(NamedTuple):
    """Positions (N, 3) [m] of N tufts, orientations (N, 4), scales (N,), and whether the sun is on them."""

    positions: Floats
    wxyzs: Floats
    scales: Floats
    in_sun: Flags


def place_tufts(foliage: Foliage, baked: BakedScenery) -> Tufts:
    """Tufts on a world's ground, as many as its grass is dense."""
    rng = np.random.default_rng(0)
    xmin, xmax, ymin, ymax = baked.terrain.extent
    x, y = np.meshgrid(np.arange(xmin, xmax - _APART_M, _APART_M), np.arange(ymin, ymax - _APART_M, _APART_M))
    xy = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(0.0, _APART_M, (x.size, 2))
    grown = np.flatnonzero(rng.uniform(size=len(xy)) < foliage.density_at(xy) / _FULL_AT)
    from_middle = np.linalg.norm(xy[grown] - [(xmin + xmax) / 2, (ymin + ymax) / 2], axis=1)
    xy = xy[grown[np.argsort(from_middle)[:_MOST_TUFTS]]]
    positions = np.column_stack([xy, baked.terrain.height(xy)]).astype(np.float32)
    half_yaw, zero = rng.uniform(0.0, np.pi, len(xy)), np.zeros(len(xy))
    wxyzs = np.stack([np.cos(half_yaw), zero, zero, np.sin(half_yaw)], axis=1)
    upward = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), positions.shape)
    middles = positions + 0.5 * foliage.height_m * upward
    in_sun = sunlit(baked.rays, baked.light, middles, upward) > 0.5
    scales = rng.uniform(_SMALLEST, 1.0, len(xy)).astype(np.float32)
    return Tufts(positions, wxyzs.astype(np.float32), scales, in_sun)


def tuft_surface(light: Light, height_m: float, *, in_sun: bool) -> Surface:
    """A tuft of grass at the origin, as tall as `height_m`: each blade is a triangle, dark at its root."""
    rng = np.random.default_rng(1)
    bearing = rng.uniform(0.0, 2 * np.pi, (2, _BLADES))
    outward, across = (np.stack([np.cos(angle), np.sin(angle)], axis=1) for angle in bearing)
    root = _RADIUS_M * np.sqrt(rng.uniform(size=(_BLADES, 1))) * outward
    tall = height_m * rng.uniform(_SHORTEST, 1.0, (_BLADES, 1))
    tall[0] = height_m
    tip = root + _LEAN * tall * rng.uniform(-1.0, 1.0, (_BLADES, 2))
    below = np.full((_BLADES, 1), -_BELOW_M)
    side = 0.5 * _WIDTH_M * across
    corners = [np.hstack([root - side, below]), np.hstack([root + side, below]), np.hstack([tip, tall])]
    height = np.tile(np.array([_ROOT, _ROOT, 1.0], np.float32), _BLADES)
    tint = np.repeat(np.clip(rng.normal(0.42, 0.2, _BLADES), 0.0, 1.0), 3).astype(np.float32)
    sun = np.full(3 * _BLADES, in_sun, np.float32)
    colours = np.minimum(grass_colours(light, height, tint, sun) / np.float32(GAIN), np.float32(1.0))
    return Surface(np.stack(corners, axis=1), colours.reshape(-1, 3, 3), lit=False, gain=GAIN, two_sided=True)
