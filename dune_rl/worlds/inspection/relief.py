"""The relief of an inspection site: amplitudes of its waves that give it the slopes of the real site."""

import csv
from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.optimize import least_squares

from dune_rl.core.paths import assets_folder
from dune_rl.geometry.arrays import Array

# Of the site (hills, roughness, contrast) and of its yard (slant, bumps).
Amplitudes = tuple[Array, Array]

# Amplitudes and misfits are rounded to 10^-6: finer than slopes can be told apart, and far coarser than what
# processors differ by in the last bits of their arithmetic.
_AMPLITUDE_DECIMALS, _MISFIT_DECIMALS = 6, 6
_DIFFERENCE = 1e-3


def known_amplitudes(seed: int) -> Amplitudes | None:
    """Amplitudes of the site of `seed`, if they are recorded: those of the episode sets and of seeds 0 to 49.

    The studies were made on these sites. Their amplitudes were found without the rounding of `fit`: solved
    for again, they would be slightly different, and others on each kind of processor.
    """
    return _known().get(seed)


@cache
def _known() -> dict[int, Amplitudes]:
    with (assets_folder() / "worlds" / "inspection_relief.csv").open(encoding="utf-8", newline="") as file:
        rows = [[float(value) for value in row] for row in list(csv.reader(file))[1:]]
    return {int(row[0]): (np.array(row[1:4]), np.array(row[4:6])) for row in rows}


def fit(misfit: Callable[[Array], Array], start: Array, bounds: tuple[list[float], list[float]]) -> Array:
    """The amplitudes (A,) with the least sum of squares of `misfit`, the same ones on every processor.

    `misfit` maps amplitudes (A,) to residuals (R,) without unit; `start` and both `bounds` are (A,).

    The solver's way from step to step is chaotic, as slopes' percentiles have kinks: a misfit that differs in
    its last bit would lead it elsewhere. So it is told rounded misfits of rounded amplitudes.
    """

    def rounded(amplitudes: Array) -> Array:
        found: Array = np.round(misfit(np.round(amplitudes, _AMPLITUDE_DECIMALS)), _MISFIT_DECIMALS)
        return found

    def derivatives(amplitudes: Array) -> Array:
        here = rounded(amplitudes)
        steps = np.eye(len(amplitudes)) * _DIFFERENCE
        return np.stack([(rounded(amplitudes + step) - here) / _DIFFERENCE for step in steps], axis=1)

    found = least_squares(rounded, start, jac=derivatives, bounds=bounds).x
    return np.round(found, _AMPLITUDE_DECIMALS)
