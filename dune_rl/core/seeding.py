"""Named random streams: drawing more from one never moves another."""

import zlib

import numpy as np


def stream(seed: int, name: str, *indices: int) -> np.random.Generator:
    """A generator that depends on nothing but its arguments.

    `name` is the component that draws ("spawn", "actors", "lidar"), `indices`
    tell its uses apart (the episode, say). Equal arguments give equal draws in
    every process; a component added later changes none of the others.
    """
    key = (zlib.crc32(name.encode()), *indices)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
