"""Random ground as a sum of waves whose power falls with their number: what natural terrain is like."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rough_field(
    rng: np.random.Generator,
    shape: tuple[int, int],
    spacing_m: float,
    shortest_m: float,
    longest_m: float,
    hurst: float,
) -> Array:
    """A field (rows, columns) of zero mean and unit standard deviation with wavelengths in the given band.

    In the band, power per area of wave numbers k falls as k^-(2 hurst + 2), as
    on a self-affine surface: 0.7 to 0.9 is what natural ground has, less is
    rougher in the small.
    """
    # Twice the size, of which a quarter is kept: opposite edges of the whole would join.
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
            f"no wave from {shortest_m:g} to {longest_m:g} m fits a grid of {shape} points, "
            f"{spacing_m:g} m apart"
        )
    return (field - field.mean()) / spread


def gradient(heights: Array, spacing_m: float) -> Array:
    """Steepness dz/ds, (rows, columns), of `heights` at the points of their grid."""
    rise_y, rise_x = np.gradient(heights, spacing_m)
    return np.hypot(rise_x, rise_y)


def smooth_step(t: Array) -> Array:
    """0 below 0 and 1 above 1, with no kink between."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
