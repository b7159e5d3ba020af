"""Random numbers without a state: pure functions of their place, and as random as they claim."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from dune_rl.sensors.draws import normal, uniform

EPISODES, STEPS = np.arange(40), np.full(40, 77)


@pytest.mark.parametrize("draw", [uniform, normal])
def test_a_number_does_not_depend_on_what_is_drawn_beside_it(draw):
    many = draw(3, "imu noise", EPISODES, STEPS, 301)
    assert many.dtype == np.float32 and many.shape == (40, 301)
    for rows in ([5], [39, 0, 5], range(7, 20)):
        rows = np.array(list(rows))
        for entries in (1, 2, 3, 9, 301):
            some = draw(3, "imu noise", EPISODES[rows], STEPS[rows], entries)
            assert np.array_equal(some, many[rows, :entries])


@pytest.mark.parametrize("draw", [uniform, normal])
def test_everything_that_names_a_number_changes_it(draw):
    base = draw(3, "imu noise", EPISODES, STEPS, 50)
    others = [
        draw(4, "imu noise", EPISODES, STEPS, 50),
        draw(3, "imu noise 2", EPISODES, STEPS, 50),
        draw(3, "imu noise", EPISODES + 1, STEPS, 50),
        draw(3, "imu noise", EPISODES, STEPS + 1, 50),
        draw(3, "imu noise", STEPS, EPISODES, 50),
    ]
    for other in others:
        assert abs(np.corrcoef(base.ravel(), other.ravel())[0, 1]) < 0.08
        assert (base == other).mean() < 0.01


@pytest.mark.slow
def test_another_process_draws_the_same_bytes():
    code = (
        "import numpy as np; from dune_rl.sensors.draws import normal, uniform;"
        "at = (2**70 + 5, 'x', np.array([3, -1]), np.array([0, 2**40]), 9);"
        "print((normal(*at).tobytes() + uniform(*at).tobytes()).hex())"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    at = (2**70 + 5, "x", np.array([3, -1]), np.array([0, 2**40]), 9)
    assert said.strip() == (normal(*at).tobytes() + uniform(*at).tobytes()).hex()


def test_pinned():
    # Runs of old are repeated only as long as these stay what they are.
    assert normal(1, "a", np.array([2]), np.array([3]), 3).tobytes().hex() == "20b305bfe18f8e3d34b92ec0"
    assert uniform(1, "a", np.array([2]), np.array([3]), 3).tobytes().hex() == "4c1a073f0042cd3e6c9f9c3e"


@pytest.mark.parametrize(
    ("draw", "law", "mean", "variance"),
    [(uniform, stats.uniform(), 0.5, 1 / 12), (normal, stats.norm(), 0.0, 1.0)],
)
def test_they_follow_their_law_along_every_axis(draw, law, mean, variance):
    episodes, steps = (axis.ravel() for axis in np.mgrid[0:50, 0:40])
    drawn = draw(11, "law", episodes, steps, 100).astype(float)
    size = drawn.size
    assert abs(drawn.mean() - mean) < 4 * np.sqrt(variance / size)
    assert drawn.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / size))
    assert stats.kstest(drawn.ravel(), law.cdf).pvalue > 1e-3
    # One entry over all episodes and steps, one scene over all entries.
    assert stats.kstest(drawn[:, 17], law.cdf).pvalue > 1e-3
    assert stats.kstest(drawn[123], law.cdf).pvalue > 1e-3
    grid = drawn.reshape(50, 40, 100) - mean
    for neighbours in (
        grid[1:] * grid[:-1],
        grid[:, 1:] * grid[:, :-1],
        grid[..., 1:] * grid[..., :-1],
        grid[..., 4:] * grid[..., :-4],
        grid[1:, 1:] * grid[:-1, :-1],
    ):
        assert abs(neighbours.mean()) < 4.5 * variance / np.sqrt(neighbours.size)


def test_bounds():
    drawn = uniform(0, "bounds", np.arange(500), np.zeros(500, np.int64), 2000)
    assert drawn.min() >= 0.0 and drawn.max() < 1.0
    wide = normal(0, "bounds", np.arange(500), np.zeros(500, np.int64), 2000)
    assert 4.0 < np.abs(wide).max() < 4.33
