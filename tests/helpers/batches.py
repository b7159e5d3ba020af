"""Batches in true physics, and how to ask them."""

from typing import Any

import numpy as np
import pytest

from dune_rl.config.build import make_batch
from dune_rl.config.compose import compose_environment
from dune_rl.env.batch import Batch
from dune_rl.physics.interface import ENGINES

every_engine = pytest.mark.parametrize("engine", ENGINES)


def real_batch(world: str = "flat", num_scenes: int = 1, seed: int = 0, **settings: Any) -> Batch:
    batch = make_batch(compose_environment(world, (), {"actors": "none"} | settings), num_scenes, seed)
    batch.reset()
    return batch


def idle(batch: Batch) -> np.ndarray:
    return np.zeros((batch.num_scenes, 2), np.float32)


def metric(batch: Batch, name: str) -> np.ndarray:
    return batch.metrics()[:, batch.metric_names.index(name)]
