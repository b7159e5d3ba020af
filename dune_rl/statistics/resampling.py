"""Resamples and exchanges of entries: the same at every call, and in bounded memory for many entries."""

from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array

RESAMPLES, EXCHANGES = 5_000, 9_999
# The least p-value that these exchanges can show: it is at most that.
LEAST_P = 1.0 / (EXCHANGES + 1)
# Up to so many entries all exchanges are made, which makes a test exact.
_EXACT_UP_TO = 13
# Up to so many numbers are drawn once and kept; more are drawn in parts of at most so many.
_MOST_KEPT, _MOST_AT_A_TIME = 2**23, 2**20
# Relative differences below this are rounding.
ROUNDING = 1e-9


def resampled_sums(*parts: Array) -> list[Array]:
    """The sum of each of `parts` (n,) in each bootstrap resample of the n entries, (R,)."""
    return _weighted_sums(_weight_parts(len(parts[0])), parts)


def exchanged_sums(*parts: Array) -> list[Array]:
    """The sum of each of `parts` (n,) with signs exchanged at random, (R,); all exchanges of few entries."""
    return _weighted_sums(_sign_parts(len(parts[0])), parts)


def _weighted_sums(weights: Iterable[Array], parts: tuple[Array, ...]) -> list[Array]:
    sums = [[some @ part for part in parts] for some in weights]
    return [np.concatenate(each) for each in zip(*sums, strict=True)]


@lru_cache(maxsize=2)
def _bootstrap_weights(count: int) -> Array:
    drawn = stream(0, "bootstrap", count).multinomial(count, np.full(count, 1 / count), size=RESAMPLES)
    return drawn.astype(float)


def _weight_parts(count: int) -> Iterator[Array]:
    """How often each of `count` entries is drawn, for some resamples at a time, (r, count)."""
    if count * RESAMPLES <= _MOST_KEPT:
        yield _bootstrap_weights(count)
        return
    draws, rows = stream(0, "bootstrap in parts", count), max(1, _MOST_AT_A_TIME // count)
    for first in range(0, RESAMPLES, rows):
        # Quicker than numbers of a multinomial distribution, where there are many.
        yield times_drawn(draws.integers(0, count, (min(rows, RESAMPLES - first), count)), count)


def times_drawn(drawn: np.ndarray, count: int) -> Array:
    """How often each of `count` entries is among the numbers `drawn` (R, n) of each resample, (R, count)."""
    rows = np.arange(len(drawn))[:, None] * count
    return np.bincount((drawn + rows).ravel(), minlength=len(drawn) * count).reshape(-1, count).astype(float)


@lru_cache(maxsize=2)
def _signs(count: int) -> Array:
    if count <= _EXACT_UP_TO:
        return np.asarray(1.0 - 2.0 * (np.arange(2**count)[:, None] >> np.arange(count) & 1), np.float64)
    return np.concatenate(list(_random_signs(count, EXCHANGES)))


def _random_signs(count: int, rows: int) -> Iterator[Array]:
    """Random signs, at most `rows` exchanges at a time, (r, count); they are the same whatever `rows` is."""
    draws = stream(0, "permutation", count)
    # The observed signs are one of the permutations.
    yield np.ones((1, count))
    for first in range(0, EXCHANGES, rows):
        shape = (min(rows, EXCHANGES - first), count)
        yield 1.0 - 2.0 * draws.integers(0, 2, shape, np.int8)


def _sign_parts(count: int) -> Iterator[Array]:
    """Signs for some exchanges at a time, (r, count)."""
    if count <= _EXACT_UP_TO or count * EXCHANGES <= _MOST_KEPT:
        yield _signs(count)
        return
    # NumPy draws four numbers of 8 bits at a time, and forgets the rest of them at the end of a call.
    yield from _random_signs(count, max(4, _MOST_AT_A_TIME // count // 4 * 4))
