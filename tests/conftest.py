"""What every test gets: one thread, so that figures repeat and tests can run side by side; and time."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from collections.abc import Iterator

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from hypothesis import settings

torch.set_num_threads(1)
# Hypothesis fails a test that takes 0.2 s, which on a busy machine any may.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(autouse=True)
def _hydra_left_alone() -> Iterator[None]:
    yield
    assert not GlobalHydra.instance().is_initialized(), "a test left Hydra initialised for the next one"
