"""Jobs side by side share the cores of a machine."""

import multiprocessing
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from dune_rl.learning.run.locks import reserve_cores

CORES, JOBS = 4, 5


def _job(folder: Path, needed: int, used: Any, most: Any, waits: Any) -> None:
    def wait() -> None:
        with waits:
            waits.value += 1

    with reserve_cores(folder, needed, CORES, wait):
        with used:
            used.value += needed
            with most:
                most.value = max(most.value, used.value)
        # Long enough for others to come in, if they could.
        multiprocessing.Event().wait(0.3)
        with used:
            used.value -= needed


@pytest.mark.slow
@pytest.mark.parametrize("needed", [1, 2, 3])
def test_jobs_never_use_more_cores_than_there_are(needed: int, tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    used, most, waits = (context.Value("i", 0) for _ in range(3))
    jobs = [context.Process(target=_job, args=(tmp_path, needed, used, most, waits)) for _ in range(JOBS)]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join(60)
        assert job.exitcode == 0
    assert needed <= most.value <= CORES
    assert waits.value <= JOBS


def test_a_job_that_needs_more_than_there_are_gets_all(tmp_path: Path) -> None:
    with reserve_cores(tmp_path, 99, CORES):
        pass
    with reserve_cores(tmp_path, CORES, CORES):
        pass


def _hold(folder: Path, ready: Any) -> None:
    with reserve_cores(folder, CORES, CORES):
        ready.set()
        signal.pause()


def test_cores_of_a_killed_job_are_free(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    ready = context.Event()
    job = context.Process(target=_hold, args=(tmp_path, ready))
    job.start()
    assert ready.wait(60)
    assert job.pid is not None
    os.kill(job.pid, signal.SIGKILL)
    job.join(60)
    with reserve_cores(tmp_path, CORES, CORES):
        pass
