"""What a machine computes: digests of short drives in every built-in world and engine, and its speed."""

import hashlib
import time
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np

import dune_rl
from dune_rl.physics.interface import OWN_ENGINES

_WORLDS = ("flat", "inspection", "construction", "rubicon", "island", "obstacle_course")
_SCENES, _STEPS = 4, 50
_SPEED_SCENES, _LEAST_S = 16, 2.0


def digest_drives() -> dict[str, str]:
    """By "ENGINE WORLD", a digest of all that 50 random steps of four scenes observe, earn and end with.

    Without DART where its library is not installed.
    """
    engines = [engine for engine in OWN_ENGINES if engine != "dart" or find_spec("dartpy")]
    return {f"{engine} {world}": _digest_drive(engine, world) for world in _WORLDS for engine in engines}


def _digest_drive(engine: str, world: str) -> str:
    env = dune_rl.gym_vector_env(world, _SCENES, actors="walkers", overrides=[f"physics={engine}"])
    draws, digest = np.random.default_rng(0), hashlib.sha256()
    observations, _ = env.reset(seed=0)
    add_values(digest, observations)
    for _ in range(_STEPS):
        add_values(digest, env.step(_draw_actions(draws, _SCENES)))
    env.close()
    return digest.hexdigest()[:16]


def _draw_actions(draws: np.random.Generator, scenes: int) -> np.ndarray:
    """Speeds [m/s] from 0 to 1 and headings [rad] within 0.6, (scenes, 2)."""
    return draws.uniform([0.0, -0.6], [1.0, 0.6], (scenes, 2)).astype(np.float32)


def add_values(digest: Any, values: Any) -> None:
    """Add to a `digest` of hashlib the bytes, types and shapes of arrays in mappings, by key, and tuples."""
    if isinstance(values, Mapping):
        for key in sorted(values):
            digest.update(key.encode())
            add_values(digest, values[key])
    elif isinstance(values, tuple):
        for each in values:
            add_values(digest, each)
    else:
        array = np.ascontiguousarray(values)
        digest.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())


def measure_speed() -> float:
    """Control steps of `inspection` among two walkers per second of the clock, on one core."""
    env = dune_rl.gym_vector_env("inspection", _SPEED_SCENES, actors="walkers")
    draws = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(_STEPS):
        env.step(_draw_actions(draws, _SPEED_SCENES))
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < _LEAST_S:
        env.step(_draw_actions(draws, _SPEED_SCENES))
        steps += _SPEED_SCENES
    found = steps / (time.perf_counter() - start)
    env.close()
    return found
