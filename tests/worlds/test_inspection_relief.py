"""Inspection sites are the same on every processor."""

import csv
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from dune_rl.core.paths import assets_folder
from dune_rl.evaluation.episode_sets.files import read_episode_set
from dune_rl.worlds.inspection import terrain as terrain_module
from dune_rl.worlds.inspection.terrain import build_terrain, fit, known_amplitudes, triangle_slopes_deg

Array = NDArray[np.float64]
SETS = ("inspection-v1", "inspection-site-v1", "inspection-crowd-v1")
Misfit = Callable[[Array], Array]
Bounds = tuple[list[float], list[float]]
Fit = Callable[[Misfit, Array, Bounds], Array]


def fit_with_noise(rng: np.random.Generator) -> Fit:
    """`fit` of misfits whose last bits are another processor's: sines, sums and products differ there."""

    def noisy(
        misfit: Callable[[Array], Array], start: Array, bounds: tuple[list[float], list[float]]
    ) -> Array:
        return fit(lambda x: misfit(x) + 1e-14 * rng.standard_normal(len(misfit(x))), start, bounds)

    return noisy


@pytest.mark.slow(all_but=["73"])
@pytest.mark.parametrize("seed", [50, 73, 1000, 1001, 123456])
def test_terrain_does_not_hang_on_last_bits(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    assert known_amplitudes(seed) is None
    here, _ = build_terrain(seed)
    for draw in range(3):
        monkeypatch.setattr(terrain_module, "fit", fit_with_noise(np.random.default_rng(draw)))
        elsewhere, _ = build_terrain(seed)
        np.testing.assert_array_equal(elsewhere.heights, here.heights)


def test_the_sites_of_sets_and_the_first_ones_are_known() -> None:
    seeds = {one.world_seed for name in SETS for one in read_episode_set(name).episodes}
    assert len(seeds) == 50
    assert all(known_amplitudes(seed) is not None for seed in [*range(50), *seeds])


def test_known_amplitudes_give_the_slopes_of_the_real_site() -> None:
    found = []
    with (assets_folder() / "worlds" / "inspection_relief.csv").open(encoding="utf-8") as file:
        seeds = [int(row["seed"]) for row in csv.DictReader(file)]
    for seed in seeds[::5]:
        terrain, _ = build_terrain(seed)
        # 30 m round the origin: the margin is left out.
        inner = terrain.heights[2:-2, 2:-2]
        found.append([np.ptp(inner), *np.percentile(triangle_slopes_deg(inner, 1.0), [50, 90, 99])])
    np.testing.assert_allclose(np.mean(found, axis=0), [8.6, 13.0, 25.2, 35.6], rtol=0.06)
    np.testing.assert_allclose(found, [[8.6, 13.0, 25.2, 35.6]] * len(found), rtol=0.3)
