"""What every test gets: one thread, so that figures repeat; a cache of its process's own; and time."""

import atexit
import os
import shutil
import tempfile

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# Not the user's: tests neither fill that nor depend on it. Each process of a run that is shared out has one.
os.environ["DUNE_RL_CACHE"] = tempfile.mkdtemp(prefix="dune_rl_cache_")

from collections.abc import Iterator

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from hypothesis import settings

atexit.register(shutil.rmtree, os.environ["DUNE_RL_CACHE"], ignore_errors=True)
torch.set_num_threads(1)
# Hypothesis fails a test that takes 0.2 s, which on a busy machine any may.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(autouse=True)
def _hydra_left_alone() -> Iterator[None]:
    yield
    assert not GlobalHydra.instance().is_initialized(), "a test left Hydra initialised for the next one"
