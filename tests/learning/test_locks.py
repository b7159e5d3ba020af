"""A run's folder: two runs at once, and a disk that is full."""

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from tensorboard.summary.writer.record_writer import RecordWriter
from training import small, trainer

from dune_rl.core import folder_lock
from dune_rl.core.errors import CheckpointError, DuneWarning
from dune_rl.learning.checkpoint import read_checkpoint_file, write_checkpoint_file
from dune_rl.learning.run.folder import RunFolder
from dune_rl.learning.run.locks import check_unused, lock_run, remove_beginnings
from dune_rl.learning.run.progress import Reporter, TrainingStatus
from dune_rl.learning.settings import CheckpointConf

HOLD = """
import sys, time
from pathlib import Path
from dune_rl.learning.run.locks import lock_run
lock = lock_run(Path(sys.argv[1]))
print("locked", flush=True)
time.sleep(60)
"""


def test_a_second_run_in_a_folder_is_refused(tmp_path: Path) -> None:
    first = trainer(tmp_path)
    with pytest.raises(
        CheckpointError, match=r"Another run is writing to .*\nName another folder with run_dir"
    ):
        trainer(tmp_path)
    first.train(stop_after_frames=128)
    with pytest.raises(CheckpointError, match="already holds a run"):
        check_unused(tmp_path)
    assert not list(tmp_path.glob(".lock"))
    trainer(tmp_path, resume=tmp_path).train(stop_after_frames=256)


def test_a_new_run_leaves_what_a_crashed_one_left_alone(tmp_path: Path) -> None:
    check_unused(tmp_path / "none")
    (tmp_path / "events.out.tfevents.1").touch()
    with pytest.raises(CheckpointError, match=r"of an earlier run, and no checkpoint.pt to go on with"):
        trainer(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["events.out.tfevents.1"]


@pytest.mark.parametrize("result", [None, "metrics.csv", "policy_best.pt", "checkpoint.pt"])
def test_only_a_run_without_results_makes_room_for_the_corrected_command(
    result: str | None, tmp_path: Path
) -> None:
    for name in ("config.yaml", "events.out.tfevents.1", *([result] if result else [])):
        (tmp_path / name).touch()
    remove_beginnings(tmp_path)
    left = {file.name for file in tmp_path.iterdir()}
    assert left == ({"config.yaml", "events.out.tfevents.1", result} if result else set())


def test_a_killed_run_leaves_no_lock_behind(tmp_path: Path) -> None:
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None and holder.stdout.readline() == "locked\n"
    with pytest.raises(CheckpointError, match="Another run"):
        lock_run(tmp_path)
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    holder.stdout.close()
    for _ in range(50):
        try:
            lock = lock_run(tmp_path)
            break
        except CheckpointError:
            time.sleep(0.1)
    assert lock.was_left
    check_unused(tmp_path)
    lock.release()
    assert not list(tmp_path.iterdir())


def test_the_file_of_a_lock_stays_until_all_is_whole(tmp_path: Path) -> None:
    lock = lock_run(tmp_path)
    lock.keep_file()
    lock.release()
    assert not lock.is_held
    again = lock_run(tmp_path)
    assert again.was_left and again.is_held
    again.keep_file()
    again.finish()
    again.release()
    assert not list(tmp_path.iterdir())


def test_a_file_system_without_locks_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_lock, "try_lock", lambda handle: None)
    with pytest.warns(DuneWarning, match="without locks of files"):
        assert not lock_run(tmp_path).is_held
        # The mark of a run that is cut off needs no lock.
        lock = lock_run(tmp_path)
        assert not lock.was_left
        lock.keep_file()
        lock.release()
        again = lock_run(tmp_path)
        assert again.was_left
        again.keep_file()
        again.finish()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["replay-rover-64.npy", "config.yaml", "checkpoint.pt", "curve.png"])
def test_what_a_killed_save_left_goes(tmp_path: Path, name: str) -> None:
    left, theirs = tmp_path / f".{name}.x1.tmp", tmp_path / ".notes.x1.tmp"
    for file in (left, theirs):
        file.write_bytes(b"half")
    folder = RunFolder(tmp_path, {}, fresh=False)
    assert not left.exists() and theirs.exists()
    folder.release()


def test_where_nothing_more_can_be_written_the_last_save_is_intact(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    write_checkpoint_file(path, "checkpoint", {"groups": {}, "config": {}, "value": 1})
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(CheckpointError, match=r"checkpoint\.pt cannot be written: .*\nFree some space"):
            write_checkpoint_file(path, "checkpoint", {"value": torch.zeros(1_000_000)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert read_checkpoint_file(path, "checkpoint")["value"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]


# TensorBoard's own thread dies of it.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_run_whose_log_fills_the_disk_ends_with_its_last_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_writer: RecordWriter, _data: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    class Filling(Reporter):
        """Has the disk full after 256 frames."""

        def update(self, status: TrainingStatus) -> None:
            if status.frames >= 256:
                monkeypatch.setattr(RecordWriter, "write", full)

    conf = small(checkpoint=CheckpointConf(every_frames=128))
    run = trainer(tmp_path / "run", conf, reporter=Filling())
    with pytest.raises(CheckpointError, match=r"No space left.*\n.*The last save is whole; go on .*resume="):
        run.train()
    monkeypatch.undo()
    assert trainer(tmp_path / "run", conf, resume=tmp_path / "run").frames >= 256


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_does_not_free_its_parent_s_lock(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from dune_rl.learning.run.locks import lock_run\n"
        "lock = lock_run(Path(sys.argv[1])); child = os.fork()\n"
        "if child == 0: lock.release(); os._exit(0)\n"
        "os.waitpid(child, 0)\n"
        "try: lock_run(Path(sys.argv[1]))\n"
        "except Exception as error: print(type(error).__name__)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert done.stdout == "CheckpointError\n"
