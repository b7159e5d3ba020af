"""Textures of the ground: colours mixed by noise and slope, by surface material, or taken from a picture."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.heightfield import HeightField, cell_centres
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.worlds.fractal_terrain import smooth_step
from dune_rl.worlds.surfaces import SurfaceMap

Colour = tuple[float, float, float]

_TEXEL_M = 0.1
_MOST_TEXELS = 1024


@dataclass(frozen=True)
class GroundColours:
    """Colours (sRGB) of a ground: patches between `low` and `high`, and `bare` earth on steep slopes.

    `bare_from_rad` is the slope above which earth shows; `contrast` scales the brightness noise.
    """

    low: Colour
    high: Colour
    bare: Colour
    bare_from_rad: float
    contrast: float = 1.0


MEADOW = GroundColours(
    low=(0.34, 0.38, 0.21), high=(0.50, 0.48, 0.29), bare=(0.46, 0.385, 0.305), bare_from_rad=0.30
)
GRAVEL = GroundColours(
    low=(0.55, 0.53, 0.49), high=(0.64, 0.61, 0.56), bare=(0.50, 0.46, 0.42), bare_from_rad=0.6, contrast=0.8
)

# Colours of surface materials, for worlds with a surface map; only grass gives way to bare earth.
SURFACE_COLOURS: dict[str, GroundColours] = {
    "grass": MEADOW,
    "gravel": GroundColours((0.43, 0.415, 0.39), (0.53, 0.51, 0.48), (0.46, 0.44, 0.41), 0.6, contrast=0.9),
    "mud": GroundColours((0.22, 0.165, 0.12), (0.31, 0.24, 0.18), (0.26, 0.20, 0.15), 0.6, contrast=0.6),
    "sand": GroundColours((0.70, 0.61, 0.44), (0.80, 0.72, 0.55), (0.72, 0.63, 0.47), 0.6, contrast=0.6),
    "rock": GroundColours((0.30, 0.295, 0.30), (0.40, 0.39, 0.38), (0.35, 0.34, 0.335), 0.6, contrast=0.8),
    "concrete": GroundColours((0.63, 0.63, 0.62), (0.70, 0.70, 0.68), (0.66, 0.65, 0.63), 0.6, contrast=0.3),
    "wood": GroundColours((0.45, 0.30, 0.17), (0.56, 0.40, 0.24), (0.48, 0.33, 0.20), 0.6, contrast=0.5),
}
# Neighbouring surfaces blend over about this distance.
_BLEND_M = 0.12


@dataclass(frozen=True, eq=False)
class GroundPicture:
    """Ground colours from a file: `colours` (rows, columns, 3) in sRGB over the terrain's rectangle.

    Row 0 is at the lowest y, column 0 at the lowest x. `detailed` (rows, columns) marks colours that come
    from a picture and are shown unchanged; the others get the brightness noise of a `GroundColours`.
    """

    colours: Floats
    detailed: Flags


def texture_shape(terrain: HeightField, texel_m: float = _TEXEL_M) -> tuple[int, int]:
    """Rows and columns of a ground texture on `terrain` with texels of `texel_m` [m]."""
    xmin, xmax, ymin, ymax = terrain.extent
    columns, rows = (
        int(np.clip(round(side / texel_m), 2, _MOST_TEXELS)) for side in (xmax - xmin, ymax - ymin)
    )
    return rows, columns


def ground_texture_from_picture(
    terrain: HeightField, ground: GroundColours, seed: int, picture: GroundPicture
) -> Floats:
    """Linear RGB (rows, columns, 3) of a `picture`, with the noise of `ground` where it is not detailed."""
    albedo = srgb_to_linear(picture.colours)
    if picture.detailed.all():
        return np.clip(albedo, 0.01, 0.95)
    rows, columns = albedo.shape[:2]
    plain = ground_texture(terrain, ground, seed)
    zoom = (rows / plain.shape[0], columns / plain.shape[1], 1.0)
    grain = scipy.ndimage.zoom(plain / plain.mean(axis=(0, 1)), zoom, order=1, mode="nearest", grid_mode=True)
    grain[picture.detailed] = 1.0
    return np.clip(albedo * grain, 0.01, 0.95).astype(np.float32)


def ground_texture(
    terrain: HeightField, ground: GroundColours, seed: int, surfaces: SurfaceMap | None = None
) -> Floats:
    """Linear RGB (rows, columns, 3) of `ground` on `terrain`, or of its `surfaces`, of a `seed`."""
    xmin, xmax, _, _ = terrain.extent
    rows, columns = texture_shape(terrain)
    rng = stream(seed, "ground texture")
    texel_m = (xmax - xmin) / columns
    patches = _noise(rng, rows, columns, [9.0, 4.0, 1.6, 0.6], texel_m)
    edges = _noise(rng, rows, columns, [3.0, 1.2, 0.5, 0.25], texel_m)
    grain = _noise(rng, rows, columns, [0.5, 0.2, 0.1], texel_m)
    xy = cell_centres(terrain.extent, rows, columns)
    slope = terrain.slope(xy)
    slope = scipy.ndimage.gaussian_filter(slope, 0.5 / texel_m)
    growth = smooth_step((patches + 0.8) / 1.6)[..., None]
    layers = [(ground, np.ones((rows, columns)))]
    if surfaces is not None:
        layers = _surface_layers(surfaces, surfaces.at(xy), ground, _BLEND_M / texel_m)
    texture = np.zeros((rows, columns, 3))
    for colours, share in layers:
        bare = smooth_step((slope - colours.bare_from_rad) / 0.12 + 0.5 + 0.9 * edges - 0.35)[..., None]
        low, high, earth = srgb_to_linear(np.array([colours.low, colours.high, colours.bare]))
        albedo = low + growth * (high - low)
        albedo = albedo + bare * (earth - albedo)
        # Grass has more contrast than earth.
        noise = 0.16 * grain[..., None] + 0.10 * patches[..., None]
        shade = 1.0 + colours.contrast * noise * (1.0 - 0.3 * bare)
        texture += share[..., None] * (albedo * shade)
    return np.clip(texture, 0.01, 0.95).astype(np.float32)


def _surface_layers(
    surfaces: SurfaceMap, numbers: NDArray[np.uint8], ground: GroundColours, blend: float
) -> list[tuple[GroundColours, Array]]:
    """Colours of each surface in `numbers` and its blended share (rows, columns); default `ground`."""
    layers = []
    for number in np.unique(numbers).tolist():
        share = scipy.ndimage.gaussian_filter((numbers == number).astype(np.float64), blend)
        layers.append((SURFACE_COLOURS.get(surfaces.names[number], ground), share))
    return layers


def _noise(
    rng: np.random.Generator, rows: int, columns: int, wavelengths_m: list[float], texel_m: float
) -> Array:
    # Value noise of several wavelengths, weaker at shorter ones, of about unit variance.
    total, power = np.zeros((rows, columns)), 0.0
    for level, wavelength in enumerate(wavelengths_m):
        cells = [max(2, round(n * texel_m / wavelength)) + 3 for n in (rows, columns)]
        coarse = rng.standard_normal(cells)
        along = np.linspace(1, cells[0] - 2, rows), np.linspace(1, cells[1] - 2, columns)
        at = np.meshgrid(*along, indexing="ij")
        weight = 0.65**level
        total += weight * scipy.ndimage.map_coordinates(coarse, at, order=2, mode="nearest")
        power += weight**2
    return total / (0.7 * np.sqrt(power))
