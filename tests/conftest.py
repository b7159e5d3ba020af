"""Settings of all tests: one thread, so that figures repeat; a cache of worlds; slow parameter sets."""

import atexit
import os
import shutil
import tempfile

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# Not the user's: tests neither fill it nor depend on it. One of the run, shared by its workers.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["DUNE_RL_CACHE"] = tempfile.mkdtemp(prefix="dune_rl_cache_")
    atexit.register(shutil.rmtree, os.environ["DUNE_RL_CACHE"], ignore_errors=True)

import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from hypothesis import settings

torch.set_num_threads(1)
# Hypothesis fails a test that takes 0.2 s, which on a busy machine any may.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
# Shells start background jobs with Ctrl-C ignored, which commands started by tests would inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: Sequence[pytest.Item]) -> None:
    """Takes the mark `slow(all_but=[...])` off the parameter sets whose id matches one of its patterns."""
    for item in items:
        mark = item.get_closest_marker("slow")
        if mark is None or "all_but" not in mark.kwargs or not isinstance(item, pytest.Function):
            continue
        if any(fnmatchcase(item.callspec.id, pattern) for pattern in mark.kwargs["all_but"]):
            item.own_markers.remove(mark)


@pytest.fixture(autouse=True)
def _hydra_left_alone() -> Iterator[None]:
    yield
    assert not GlobalHydra.instance().is_initialized(), "a test left Hydra initialised for the next one"


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., int]]:
    """Runs a command line, `call(main, *words)`, in this process and gives its exit code."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")

    def run(program: Callable[[], None], *words: str) -> int:
        monkeypatch.setattr(sys, "argv", ["dune_rl", *words])
        with pytest.raises(SystemExit) as ended:
            program()
        return int(ended.value.code or 0)

    yield run
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder that is the working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
