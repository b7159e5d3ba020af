"""Random numbers that depend on nothing but where they are used: nothing is kept between two draws."""

from collections.abc import Callable
from functools import cache, lru_cache
from hashlib import blake2b

import numpy as np
import scipy
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Counts, Floats
from dune_rl.state.state import EpisodeState

Words = NDArray[np.uint64]
# Which agents: their rows, or all of them.
Rows = NDArray[np.int64] | slice

# The constants of SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFTS = tuple(np.uint64(bits) for bits in (30, 27, 31))

# The normal distribution cut into 65,536 parts of equal weight: a look-up costs a sixth of Box and
# Muller's logarithm and cosine, and gives the same bytes on every processor. No part is beyond 4.33.
_PARTS = 2**16


@cache
def _quantiles() -> Floats:
    quantiles: Floats = scipy.special.ndtri((np.arange(_PARTS) + 0.5) / _PARTS).astype(np.float32)
    return quantiles


def uniform(seed: int, name: str, episodes: Counts, steps: Counts, entries: int) -> Floats:
    """Numbers (M, entries), evenly in [0, 1), for scenes in `episodes` (M,) at `steps` (M,).

    `name` tells what draws. Each number depends on (seed, name, episode, step,
    entry) alone: not on the other scenes, nor on how many entries are drawn.
    """
    halves = _words(seed, name, episodes, steps, -(-entries // 2)).view(np.uint32)
    halves >>= np.uint32(8)
    return halves[:, :entries].astype(np.float32) * np.float32(2.0**-24)


def normal(seed: int, name: str, episodes: Counts, steps: Counts, entries: int) -> Floats:
    """Normal numbers (M, entries) of mean 0 and deviation 1, at most 4.33; otherwise as `uniform`."""
    quarters = _words(seed, name, episodes, steps, -(-entries // 4)).view(np.uint16)
    drawn: Floats = _quantiles().take(quarters[:, :entries])
    return drawn


def draw(
    numbers: Callable[[int, str, Counts, Counts, int], Floats],
    episode: EpisodeState,
    name: str,
    entries: int,
    rows: Rows = slice(None),
    *,
    once: bool = False,
) -> Floats:
    """`uniform` or `normal` numbers (n, entries) of agents in `rows`: anew each step, or once an episode."""
    steps = episode.steps[rows]
    steps = np.zeros_like(steps) if once else steps
    return numbers(episode.seed, name, episode.streams[rows], steps, entries)


def _words(seed: int, name: str, episodes: Counts, steps: Counts, count: int) -> Words:
    """Random words (M, count): a SplitMix64 sequence for each scene, begun at a hash of what it is for."""
    key = _key(seed, name)
    begin = _mixed(key + np.asarray(episodes).astype(np.uint64) * _GOLDEN)
    begin = _mixed(begin + np.asarray(steps).astype(np.uint64) * _GOLDEN)
    return _mixed(begin[:, None] + _counters(count))


def _mixed(words: Words) -> Words:
    words ^= words >> _SHIFTS[0]
    words *= _FIRST
    words ^= words >> _SHIFTS[1]
    words *= _SECOND
    words ^= words >> _SHIFTS[2]
    return words


@lru_cache(maxsize=256)
def _key(seed: int, name: str) -> np.uint64:
    digest = blake2b(f"{seed} {name}".encode(), digest_size=8).digest()
    return np.uint64(int.from_bytes(digest, "little"))


@lru_cache(maxsize=16)
def _counters(count: int) -> Words:
    counters = np.arange(1, count + 1, dtype=np.uint64) * _GOLDEN
    counters.flags.writeable = False
    return counters
