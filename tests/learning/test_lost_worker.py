"""A worker process that is killed: the run ends with a line that says so, and with all saved."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from training import small, trainer

from dune_rl.errors import TrainingError
from dune_rl.learning.settings import CollectorConf
from dune_rl.learning.trainer import Trainer


def kill_a_worker_after(trained: Trainer, frames: int) -> None:
    """Kill a worker once the run has so many frames."""
    made = trained._make_collector

    def make_collector():
        collector = made()

        def kill() -> None:
            while trained.frames < frames:
                time.sleep(0.01)
            os.kill(collector._collector.procs[0].pid, signal.SIGKILL)

        threading.Thread(target=kill, daemon=True).start()
        return collector

    trained._make_collector = make_collector


@pytest.mark.parametrize("mode", ["async", "sync"])
def test_a_killed_worker_ends_the_run_with_all_saved(mode: str, tmp_path: Path) -> None:
    conf = small(collector=CollectorConf(mode=mode, workers=1, scenes=4, steps=4))
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
