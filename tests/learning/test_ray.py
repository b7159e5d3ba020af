"""Training that collects on a Ray cluster: nodes that die, clusters out of reach, machines without Ray."""

import errno
import math
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ray_nodes import kill_node, ray_nodes
from training import SMALL_PPO, small, trainer

from dune_rl.commands.train import train
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError, TrainingError
from dune_rl.core.ray_cluster import RayCluster, check_usable
from dune_rl.learning import ray_workers
from dune_rl.learning.ray_workers import RayWorkers
from dune_rl.learning.run.progress import Reporter, TrainingStatus
from dune_rl.learning.settings import CollectorConf, EvaluationConf
from dune_rl.train import main


class Watcher(Reporter):
    """Kills a node once there are frames, and ends the run in order 64 frames after it got a line."""

    def __init__(self, node: Any) -> None:
        self.lines: list[str] = []
        self._node, self._frames, self._until = node, 0, math.inf

    def update(self, status: TrainingStatus) -> None:
        if self._node is not None:
            kill_node(self._node)
            self._node = None
        if status.frames >= self._until:
            signal.raise_signal(signal.SIGTERM)
            self._until = math.inf
        self._frames = status.frames

    def note(self, line: str) -> None:
        if "no batch from Ray workers" in line:
            # A machine that is busy.
            return
        if not self.lines:
            self._until = self._frames + 64
        self.lines.append(line)


@pytest.fixture
def unreachable(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The RAY_ADDRESS of a port that refuses connections."""
    pytest.importorskip("ray", reason="no Ray: pip install 'dune_rl[ray]'")
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{deaf.getsockname()[1]}"
        monkeypatch.setenv("RAY_ADDRESS", address)
        yield address


@pytest.mark.slow
def test_a_node_that_dies_costs_a_line_and_the_last_one_ends_the_run_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learning = small(
        learning_starts=0,
        collector=CollectorConf(mode="ray", workers=2, scenes=4, steps=4),
        evaluation=EvaluationConf(every_frames=10**8, episodes=1),
    )
    # The driver's own node is none of these: Ray may end a driver whose node dies.
    with ray_nodes(monkeypatch, 3, head_cpus=0) as (_, one, other):
        watcher = Watcher(one)
        result = trainer(tmp_path / "run", learning, reporter=watcher, total_frames=10**8).train()
        assert result.signal == signal.SIGTERM
        lost, stopped = watcher.lines
        assert lost == (
            "note: a Ray worker was lost with the frames under way; another one begins where a CPU is free"
        )
        assert stopped.startswith("Stopping")
        more = {"resume": tmp_path / "run", "total_frames": 10**8}
        again = trainer(tmp_path / "run", learning, reporter=Watcher(other), **more)
        assert again.frames == result.frames >= 64
        with pytest.raises(TrainingError, match=r"Ray.*\nAll is saved at [\d,]+ frames; go on with resume="):
            again.train()
    assert trainer(tmp_path / "run", learning, **more).frames == again.frames > result.frames


@contextmanager
def failing_after(seconds: int) -> Iterator[None]:
    """Fails the test where what is inside the context does not end."""

    def fail(*_: Any) -> None:
        pytest.fail(f"no end within {seconds} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


class StopsWaiting(Reporter):
    """Sends SIGTERM once the run says that it gets no batch."""

    def note(self, line: str) -> None:
        if "no batch from Ray workers" in line:
            signal.raise_signal(signal.SIGTERM)


@pytest.mark.slow
def test_a_signal_ends_the_wait_for_a_cluster_that_others_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray_workers, "_PATIENCE_S", -1.0)
    ray_conf = CollectorConf(mode="ray", workers=1, scenes=8, steps=16)
    with ray_nodes(monkeypatch, 1):
        import ray

        # The training keeps the cluster that its program has connected to.
        ray.init(configure_logging=False, log_to_driver=False)
        try:
            assert ray.util.placement_group([{"CPU": 1}]).wait(60)
            learning = SMALL_PPO.model_copy(update={"collector": ray_conf})
            with failing_after(120):
                stopped = trainer(tmp_path / "run", learning, reporter=StopsWaiting()).train()
        finally:
            ray.shutdown()
    assert (stopped.signal, stopped.frames) == (signal.SIGTERM, 0)
    again = trainer(tmp_path / "run", SMALL_PPO, total_frames=128, resume=tmp_path / "run")
    assert again.train().frames == 128


def test_workers_that_are_lost_again_and_again_end_the_run_in_a_line() -> None:
    workers = RayWorkers.__new__(RayWorkers)
    workers._cluster = SimpleNamespace(check=lambda: None)  # type: ignore[assignment]
    workers._lost_in_a_row, workers._workers = 1, 1
    with pytest.raises(TrainingError) as ended:
        workers._replace(RuntimeError("The actor died.\n\tclass_name: _Worker\n\tactor_id: 7"))
    assert str(ended.value) == "Ray workers are lost before they give a batch: The actor died."


def test_a_full_disk_is_no_lost_connection() -> None:
    ray = pytest.importorskip("ray", reason="no Ray: pip install 'dune_rl[ray]'")
    workers = RayWorkers.__new__(RayWorkers)
    workers._ray = ray
    no_space = OSError(errno.ENOSPC, "No space left on device", "/spill")
    reset = ConnectionResetError(errno.ECONNRESET, "reset")
    errors = {
        no_space: "Ray cannot go on: [Errno 28] No space left on device: '/spill'",
        ray.exceptions.OutOfDiskError("Local disk is full"): "Ray cannot go on: Local disk is full",
        OSError("Broken pipe"): "the connection to the Ray cluster is lost (Broken pipe)",
        reset: "the connection to the Ray cluster is lost ([Errno 104] reset)",
    }
    for error, told in errors.items():
        with pytest.raises(TrainingError) as ended, workers._connection():
            raise error
        assert str(ended.value) == told


def test_without_ray_the_command_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    conf = compose(Conf, ["+world=flat", "learning.collector.mode=ray", f"run_dir={tmp_path / 'run'}"])
    with pytest.raises(ConfigError) as refused:
        train(conf)
    assert str(refused.value) == "learning.collector.mode=ray needs Ray: pip install 'dune_rl[ray]'"
    assert not (tmp_path / "run").exists()


def test_a_cluster_that_cannot_be_reached_is_told_before_any_frame(
    folder: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], unreachable: str
) -> None:
    words = ["+world=flat", "learning.collector.mode=ray", "run_dir=runs/first"]
    assert call(main, *words) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err == (
        f"no Ray cluster can be used at RAY_ADDRESS={unreachable} ([Errno 111] Connection refused); "
        "start one by `ray start`, or unset RAY_ADDRESS for one on this machine alone\n"
    )
    assert list(folder.iterdir()) == []


@pytest.mark.slow
def test_looking_for_a_cluster_leaves_no_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    with ray_nodes(monkeypatch, 1):
        import ray

        handler = signal.getsignal(signal.SIGTERM)
        check_usable("learning.collector.mode=ray")
        assert not ray.is_initialized()
        assert signal.getsignal(signal.SIGTERM) is handler
        cluster = RayCluster("learning.collector.mode=ray", cpus=2)
        assert cluster.cpus() == 1
        cluster.close()


def test_a_warm_up_is_saved_whose_cluster_has_gone(tmp_path: Path, unreachable: str) -> None:
    learning = small(learning_starts=128, collector=CollectorConf(mode="ray", workers=1, scenes=8, steps=16))
    with pytest.raises(
        TrainingError, match=rf"{unreachable}.*\nAll is saved at 128 frames; go on with resume="
    ):
        trainer(tmp_path / "run", learning).train()
    serial = small(learning_starts=128)
    again = trainer(tmp_path / "run", serial, total_frames=256, resume=tmp_path / "run")
    assert again.frames == 128
    assert again.train().frames == 256
