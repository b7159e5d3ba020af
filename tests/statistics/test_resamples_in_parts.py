"""Intervals and tests of many entries: in bounded memory, and as those of few."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from dune_rl.core.seeding import stream
from dune_rl.statistics import resampling
from dune_rl.statistics.intervals import estimate_mean
from dune_rl.statistics.paired_comparison import ratio_exchange_test, sign_flip_test

MANY = 10_000


@pytest.mark.slow
@pytest.mark.parametrize("measure", [estimate_mean, sign_flip_test])
def test_ten_thousand_entries_take_bounded_memory(measure: Callable[[np.ndarray], object]) -> None:
    values = stream(0, "entries").normal(1.0, 1.0, MANY)
    tracemalloc.start()
    measure(values)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # 5,000 resamples at once would take 400 MB, 10,000 exchanges 800 MB.
    assert peak < 100e6


def test_the_interval_of_many_entries_is_that_of_the_normal_distribution() -> None:
    values = stream(0, "entries").exponential(2.0, MANY)
    found, error = estimate_mean(values), values.std() / np.sqrt(MANY)
    assert found.low == pytest.approx(found.value - 1.96 * error, abs=0.15 * error)
    assert found.high == pytest.approx(found.value + 1.96 * error, abs=0.15 * error)


def test_resamples_in_parts_are_of_all_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    values = stream(0, "entries").exponential(2.0, 60)
    whole = estimate_mean(values)
    monkeypatch.setattr(resampling, "_MOST_KEPT", 0)
    monkeypatch.setattr(resampling, "_MOST_AT_A_TIME", 60 * 700)
    parts = list(resampling._weight_parts(60))
    assert [len(part) for part in parts] == [700] * 7 + [100]
    assert all((part.sum(axis=1) == 60).all() for part in parts)
    # Other draws of the same kind.
    found = estimate_mean(values)
    assert (found.low, found.high) == pytest.approx((whole.low, whole.high), rel=0.02)


@pytest.mark.parametrize("count", [21, 50])
def test_exchanges_in_parts_are_the_same(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = stream(0, "entries").normal(1.1, 1.0, (2, count)) ** 2
    ones = np.ones(count)
    found = sign_flip_test(a - b), ratio_exchange_test((a, ones), (b, ones))
    signs = np.concatenate(list(resampling._sign_parts(count)))
    monkeypatch.setattr(resampling, "_MOST_KEPT", 0)
    monkeypatch.setattr(resampling, "_MOST_AT_A_TIME", count * 601)
    parts = list(resampling._sign_parts(count))
    assert len(parts) == 18 and max(map(len, parts)) == 600
    np.testing.assert_array_equal(np.concatenate(parts), signs)
    assert found == (sign_flip_test(a - b), ratio_exchange_test((a, ones), (b, ones)))
