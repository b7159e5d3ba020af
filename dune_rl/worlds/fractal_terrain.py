"""Rough ground: random self-affine height fields, as a model of natural terrain, and its roughness."""

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import GridField, HeightField


def rough_field(
    rng: np.random.Generator,
    shape: tuple[int, int],
    spacing_m: float,
    shortest_m: float,
    longest_m: float,
    hurst: float,
) -> Array:
    """A field (rows, columns) of zero mean and unit standard deviation with wavelengths in the given band.

    In the band, the power spectral density at wave number k is proportional to
    k^-(2 hurst + 2), as on a self-affine surface. Natural ground has a Hurst
    exponent of 0.7 to 0.9; a smaller one is rougher at short wavelengths.
    """
    # The field is periodic, so a quarter of one of twice the size is used: its edges do not match.
    rows, columns = 2 * shape[0], 2 * shape[1]
    across, along = np.fft.fftfreq(rows, spacing_m), np.fft.rfftfreq(columns, spacing_m)
    number = np.hypot(across[:, None], along)
    inside = (number >= 1.0 / longest_m) & (number <= 1.0 / shortest_m)
    amplitude = np.zeros_like(number)
    amplitude[inside] = number[inside] ** -(hurst + 1.0)
    noise = np.fft.rfft2(rng.standard_normal((rows, columns)))
    field: Array = np.fft.irfft2(noise * amplitude, s=(rows, columns))[: shape[0], : shape[1]]
    spread = field.std()
    if spread == 0.0:
        raise ValueError(
            f"no wavelength from {shortest_m:g} to {longest_m:g} m fits a grid of {shape} points "
            f"{spacing_m:g} m apart"
        )
    return (field - field.mean()) / spread


def slope_magnitude(heights: Array, spacing_m: float) -> Array:
    """Magnitude of the slope dz/ds, (rows, columns), of `heights` at the points of their grid."""
    rise_y, rise_x = np.gradient(heights, spacing_m)
    return np.hypot(rise_x, rise_y)


def smooth_step(t: Array) -> Array:
    """Smoothstep: 0 below 0, 1 above 1, and 3 t^2 - 2 t^3 between."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


# Lattice spacings per radius: 197 points in a disc.
_RESOLUTION = 8
_MAX_POINTS = 4_000_000
_LEAST_RESOLUTION = 3


class RoughnessField(GridField):
    """Callable: the roughness [m] of the ground within `radius_m` of any points.

    Roughness is the root mean square height about the least-squares plane in a disc seen from above: the
    RMS of detrended heights in Shepard et al., The roughness of natural terrain, J. Geophys. Res. Planets
    106 (2001), 32777-32795. It is computed on a lattice with a spacing of an eighth of the radius (coarser
    in a large world) and interpolated. Outside the world, the ground continues at the height of its edge.
    """

    def __init__(self, terrain: HeightField, radius_m: float) -> None:
        xmin, xmax, ymin, ymax = terrain.extent
        least = float(np.sqrt((xmax - xmin) * (ymax - ymin) / _MAX_POINTS))
        step = max(radius_m / _RESOLUTION, least)
        if not radius_m >= _LEAST_RESOLUTION * step:
            raise ValueError(
                f"radius_m={radius_m:g} is too small for a world of {xmax - xmin:g} by {ymax - ymin:g} m: "
                f"use {_LEAST_RESOLUTION * least:.2g} or more"
            )
        reach = int(radius_m / step + 1e-9)
        cells = np.ceil(np.array([xmax - xmin, ymax - ymin]) / step).astype(int)
        columns, rows = (np.arange(-reach, count + reach + 1) * step for count in cells)
        lattice = np.stack(np.meshgrid(xmin + columns, ymin + rows), axis=-1)
        offsets = step * np.arange(-reach, reach + 1, dtype=np.float64)
        disc = np.hypot(offsets[:, None], offsets) <= radius_m + 1e-9
        rms = _rms_about_plane(terrain.height(lattice), disc, offsets)
        super().__init__(rms.astype(np.float32), [xmin, ymin], step)


def _rms_about_plane(heights: Array, disc: Flags, offsets: Array) -> Array:
    """RMS of heights (rows, columns) about the plane of best fit, wherever the whole disc fits."""
    # SciPy's signal processing takes 20 MB and half a second to load, and most worlds do without it.
    from scipy.signal import oaconvolve

    count = float(disc.sum())
    ones = disc.astype(np.float64)

    def weighted_sum(values: Array, weights: Array) -> Array:
        return oaconvolve(values, weights[::-1, ::-1], mode="valid")

    centred = heights - heights.mean()
    mean = weighted_sum(centred, ones) / count
    spread = float((ones * offsets**2).sum())
    # The disc is symmetric, so the least-squares equations for the mean and both slopes decouple.
    slope_x = weighted_sum(centred, ones * offsets) / spread
    slope_y = weighted_sum(centred, ones * offsets[:, None]) / spread
    variance = weighted_sum(centred**2, ones) / count - mean**2 - (slope_x**2 + slope_y**2) * (spread / count)
    return np.sqrt(np.maximum(variance, 0.0))
