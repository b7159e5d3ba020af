"""A worker process that is killed: the run ends with a line that says so, and with all saved."""

import multiprocessing
import os
import signal
import threading
import time
from functools import partial
from pathlib import Path

import pytest
from training import small, trainer

from dune_rl.core.errors import TrainingError
from dune_rl.learning.collector import TransitionCollector
from dune_rl.learning.process import StopRequest, WorkerMonitor
from dune_rl.learning.settings import CollectorConf
from dune_rl.learning.trainer import Trainer


def kill_a_worker_after(trained: Trainer, frames: int) -> None:
    """Kill a worker once the run has so many frames."""
    made = trained._make_collector

    def make_collector(stop: StopRequest) -> TransitionCollector:
        collector = made(stop)

        def kill() -> None:
            while trained.frames < frames:
                time.sleep(0.01)
            os.kill(collector._collector.procs[0].pid, signal.SIGKILL)

        threading.Thread(target=kill, daemon=True).start()
        return collector

    trained._make_collector = make_collector


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["async", "sync"])
def test_a_killed_worker_ends_the_run_with_all_saved(mode: str, tmp_path: Path) -> None:
    # Without a warm-up, which has no workers.
    conf = small(learning_starts=0, collector=CollectorConf(mode=mode, workers=1, scenes=4, steps=4))
    endless = trainer(tmp_path / "run", conf, total_frames=10**9)
    kill_a_worker_after(endless, 256)
    before = signal.getsignal(signal.SIGURG)
    with pytest.raises(TrainingError, match=r"SIGKILL.*\nAll is saved at [\d,]+ frames; go on with resume="):
        endless.train()
    assert signal.getsignal(signal.SIGURG) == before
    frames = endless.frames
    assert frames >= 256
    resumed = trainer(tmp_path / "run", conf, resume=tmp_path / "run", total_frames=frames + 128)
    assert resumed.frames == frames
    assert resumed.train().frames >= frames + 128


@pytest.mark.slow
def test_a_worker_that_ends_at_any_moment_is_told() -> None:
    before = signal.getsignal(signal.SIGURG)
    for lifetime in (0.0, 0.02, 0.05):
        child = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(lifetime,))
        child.start()
        watch = WorkerMonitor([child])
        with pytest.raises(TrainingError, match="ended, with exit code 0"):
            for _ in range(100_000):
                watch.wait(partial(time.sleep, 0.001))
        # Nothing interrupts what is done afterwards, such as to save.
        time.sleep(0.7)
        with pytest.raises(TrainingError):
            watch.wait(partial(time.sleep, 60.0))
        watch.close()
        watch.close()
    assert signal.getsignal(signal.SIGURG) == before


def test_nobody_is_watched_without_processes() -> None:
    threads = threading.active_count()
    watch = WorkerMonitor(())
    assert threading.active_count() == threads
    assert watch.wait(lambda: 3) == 3
    watch.close()


@pytest.mark.slow
def test_workers_are_started_anew_after_their_episodes(tmp_path: Path) -> None:
    collector = CollectorConf(mode="sync", workers=1, scenes=4, steps=16, episodes_per_worker=8)
    run = trainer(tmp_path / "run", small(learning_starts=0, collector=collector), total_frames=768)
    made, processes = run._make_collector, set()

    def make_collector(stop: StopRequest) -> TransitionCollector:
        one = made(stop)
        processes.update(process.pid for process in one._collector.procs)
        return one

    run._make_collector = make_collector
    assert run.train().frames == 768
    assert len(processes) >= 2
