"""Random self-affine height fields, as a model of natural terrain."""

import numpy as np

from dune_rl.geometry.arrays import Array


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
