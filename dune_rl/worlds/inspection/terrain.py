"""Terrain of the inspection world: hills round a hollow, a gully, and a smoother yard."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import least_squares

from dune_rl.core.paths import assets_folder
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.fractal_terrain import smooth_step
from dune_rl.worlds.props import unit_vector

HALF_EXTENT_M = 32.0
HALF_MAIN_M = 30.0
SPACING_M = 1.0
YARD_CENTRE = (-23.0, -23.0)
YARD_HALF_M = 4.0
GULLY_DEPTH_M = 1.75
BRIDGE_LENGTH_M = 14.0
BRIDGE_WIDTH_M = 3.9

# Relief and slope percentiles of the real site that this world is modelled on. Every seed has them: the
# amplitudes of its waves are solved for.
_RELIEF_M = 8.6
_SLOPE_DEG = {50: 13.0, 90: 25.2, 99: 35.6}
_YARD_SLOPE_DEG = {10: 5.0, 50: 8.8, 90: 17.7}
# Slant and bumps of the yard while those of the site are solved for.
_FIRST_YARD = np.array([0.12, 0.2])
# Of the site (hills, roughness, contrast) and of its yard (slant, bumps).
Amplitudes = tuple[Array, Array]
# Amplitudes and misfits are rounded to 10^-6: finer than slopes can be told apart, and far coarser than what
# processors differ by in the last bits of their arithmetic.
_AMPLITUDE_DECIMALS, _MISFIT_DECIMALS = 6, 6
_DIFFERENCE = 1e-3


@dataclass(frozen=True)
class Gully:
    """A straight ditch through `centre`, crossed at a right angle by a bridge along `yaw` [rad]."""

    centre: tuple[float, float]
    yaw: float


def build_terrain(seed: int) -> tuple[HeightField, Gully]:
    """Terrain of 64 by 64 m round the origin, and its gully."""
    rng = stream(seed, "inspection terrain")
    axis = np.arange(-HALF_EXTENT_M, HALF_EXTENT_M + SPACING_M / 2, SPACING_M)
    x, y = np.meshgrid(axis, axis)
    xy = np.stack([x, y], axis=-1)
    gully = Gully(
        (float(rng.uniform(11.0, 15.0)), float(rng.uniform(13.0, 16.0))), float(rng.uniform(-0.35, 0.35))
    )
    hills = _waves(rng, xy, 34.0, 75.0)
    hills -= 2.2 * np.exp(-np.sum(xy**2, axis=-1) / 13.0**2)
    hills += 1.2 * np.exp(-np.sum((xy - YARD_CENTRE) ** 2, axis=-1) / 14.0**2)
    detail = _waves(rng, xy, 9.0, 20.0)
    patches = _waves(rng, xy, 25.0, 50.0)
    yard_tilt = rng.uniform(-np.pi, np.pi)
    yard_bumps = _waves(rng, xy, 7.0, 12.0) * np.exp(0.4 * _waves(rng, xy, 9.0, 16.0))
    window = _yard_window(xy)
    main = np.abs(axis) <= HALF_MAIN_M
    yard = np.abs(axis - YARD_CENTRE[0]) <= YARD_HALF_M

    def heights(amplitudes: Array, yard_amplitudes: Array) -> Array:
        hill, rough, contrast = amplitudes
        z = hill * hills + rough * np.exp(contrast * patches) * detail
        z = _dig(z, xy, axis, gully)
        level = (z * window).sum() / window.sum()
        slant, bump = yard_amplitudes
        smooth = level + slant * ((xy - YARD_CENTRE) @ unit_vector(yard_tilt)) + bump * yard_bumps
        return z + window * (smooth - z)

    def site_misfit(amplitudes: Array) -> Array:
        z = heights(amplitudes, _FIRST_YARD)[np.ix_(main, main)]
        relief = (np.ptp(z) - _RELIEF_M) / 0.8
        return np.array([relief, *(_slope_misfit(z, _SLOPE_DEG) * [2.5, 1.0, 0.7])])

    def solve() -> Amplitudes:
        site = fit(site_misfit, np.array([1.5, 0.4, 0.4]), ([0.3, 0.05, 0.0], [4.0, 2.0, 1.5]))

        def yard_misfit(amplitudes: Array) -> Array:
            z = heights(site, amplitudes)[np.ix_(yard, yard)]
            return _slope_misfit(z, _YARD_SLOPE_DEG)

        return site, fit(yard_misfit, _FIRST_YARD, ([0.0, 0.0], [0.3, 1.0]))

    amplitudes = known_amplitudes(seed) or solve()
    # Rounded to 1 mm, so that machines whose arithmetic differs in the last bits make the same terrain.
    z = np.round(heights(*amplitudes), 3)
    return HeightField(z, SPACING_M, (-HALF_EXTENT_M, -HALF_EXTENT_M)), gully


def _waves(
    rng: np.random.Generator, xy: Array, shortest_m: float, longest_m: float, count: int = 48
) -> Array:
    # A random field of zero mean and unit variance with wavelengths in the given band.
    wavelength = np.exp(rng.uniform(np.log(shortest_m), np.log(longest_m), count))
    towards = rng.uniform(0.0, 2 * np.pi, count)
    phase = rng.uniform(0.0, 2 * np.pi, count)
    number = 2 * np.pi / wavelength * np.stack([np.cos(towards), np.sin(towards)])
    field = np.cos(xy @ number + phase).sum(axis=-1)
    return (field - field.mean()) / field.std()


def _yard_window(xy: Array) -> Array:
    beyond = np.abs(xy - YARD_CENTRE) - YARD_HALF_M - 0.5
    return np.prod(1.0 - smooth_step(beyond / 6.0), axis=-1)


def _dig(z: Array, xy: Array, axis: Array, gully: Gully) -> Array:
    # The ditch ends 14 m from the bridge; at the bridge, the banks are levelled to a straight line.
    ahead, left = unit_vector(gully.yaw), unit_vector(gully.yaw + np.pi / 2)
    u, v = (xy - gully.centre) @ ahead, (xy - gully.centre) @ left
    half = BRIDGE_LENGTH_M / 2
    ditch = GULLY_DEPTH_M * (1.0 - smooth_step((np.abs(u) - 1.2) / (half - 2.2)))
    along = 1.0 - smooth_step((np.abs(v) - 6.0) / 8.0)
    field = HeightField(z, SPACING_M, (axis[0], axis[0]))
    first, last = field.height(np.array([gully.centre - half * ahead, gully.centre + half * ahead]))
    banks = (first + last) / 2 + (last - first) * u / BRIDGE_LENGTH_M
    near_u = 1.0 - smooth_step((np.abs(u) - half - 1.0) / 5.0)
    near_v = 1.0 - smooth_step((np.abs(v) - BRIDGE_WIDTH_M / 2 - 1.2) / 5.0)
    near = near_u * near_v
    return z + near * (banks - z) - ditch * along


def _slope_misfit(z: Array, targets_deg: dict[int, float]) -> Array:
    slopes = triangle_slopes_deg(z, SPACING_M)
    found = np.percentile(slopes, list(targets_deg))
    return (found - list(targets_deg.values())) / 2.0


def triangle_slopes_deg(z: Array, spacing_m: float) -> Array:
    """Slopes [deg] of a grid's triangles, which all cover the same area seen from above."""
    upper = np.hypot(z[1:, 1:] - z[1:, :-1], z[1:, :-1] - z[:-1, :-1])
    lower = np.hypot(z[:-1, 1:] - z[:-1, :-1], z[1:, 1:] - z[:-1, 1:])
    return np.rad2deg(np.arctan(np.concatenate([upper.ravel(), lower.ravel()]) / spacing_m))


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
    its last bit would lead it elsewhere. So the solver gets rounded misfits of rounded amplitudes.
    """

    def rounded(amplitudes: Array) -> Array:
        return np.round(misfit(np.round(amplitudes, _AMPLITUDE_DECIMALS)), _MISFIT_DECIMALS)

    def derivatives(amplitudes: Array) -> Array:
        here = rounded(amplitudes)
        steps = np.eye(len(amplitudes)) * _DIFFERENCE
        return np.stack([(rounded(amplitudes + step) - here) / _DIFFERENCE for step in steps], axis=1)

    found = least_squares(rounded, start, jac=derivatives, bounds=bounds).x
    return np.round(found, _AMPLITUDE_DECIMALS)
