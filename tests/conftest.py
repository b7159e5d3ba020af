"""What every test gets: one thread, so that figures repeat and tests can run side by side."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from collections.abc import Iterator

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _hydra_left_alone() -> Iterator[None]:
    yield
    assert not GlobalHydra.instance().is_initialized(), "a test left Hydra initialised for the next one"
