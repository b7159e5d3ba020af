"""A real Slurm: jobs that are warned, requeued and killed, and go on by themselves with `resume=auto`."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from local_slurm import slurm
from test_sweeps import SMALL
from training import weights

from dune_rl.core.files import read_csv
from dune_rl.learning.checkpoint import read_checkpoint_file

EXAMPLES = Path(__file__).parents[2] / "examples" / "slurm"
FRAMES = 3200
# Repeatable, with a save at every fifth batch.
WORDS = [
    *(word for word in SMALL if not word.startswith(("total_frames", "learning.replay"))),
    *(
        f"total_frames={FRAMES}",
        "learning.replay.capacity=10000",
        "film=false",
        "learning.collector.mode=serial",
    ),
    *("learning.checkpoint.every_frames=160", "resume=auto"),
]
# Of processes that load for a minute each on a busy machine.
_PATIENCE_S = 1200.0

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    with slurm(tmp_path_factory.mktemp("slurm")) as found:
        path = f"{Path(sys.executable).parent}:{found['PATH']}"
        yield {**found, "PATH": path, "OMP_NUM_THREADS": "1"}


def wait_until(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.2)


def asker(environment: dict[str, str]) -> Callable[..., str]:
    """A function that gives the output of a command of Slurm's."""

    def ask(*words: str) -> str:
        return subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout

    return ask


def _kill_step(job: str, ask: Callable[..., str]) -> None:
    """Kill the process that trains, as the system does where memory is short."""
    number = ask("squeue", "-h", "-j", job, "-o", "%A").strip()
    rows = [line.split() for line in ask("scontrol", "listpids", number).splitlines()]
    (pid,) = (int(row[0]) for row in rows if row[2:4] == ["0", "0"])
    os.kill(pid, signal.SIGKILL)


def _warn(job: str, name: str, ask: Callable[..., str], environment: dict[str, str]) -> None:
    """Send a signal to a job, which requeues itself."""
    # Slurm's command tries again and again while the job ends, and would warn the job that goes on, too.
    warning = subprocess.Popen(["scancel", f"--signal={name}", job], env=environment)
    try:
        wait_until(
            lambda: "JobState=PENDING" in ask("scontrol", "show", "job", job), f"{job} is not requeued"
        )
    finally:
        warning.kill()
        warning.wait()


def _start_now(job: str, ask: Callable[..., str]) -> None:
    """Start a requeued job without the two minutes that Slurm gives its node to recover."""
    wait_until(lambda: "JobState=PENDING" in ask("scontrol", "show", "job", job), f"{job} does not wait")
    # A node takes no credential of the second in which it ended the job before.
    ask("scontrol", "update", f"JobId={job}", "StartTime=now+3")


def frames_of(run: Path) -> int:
    file = run / "checkpoint.pt"
    return int(read_checkpoint_file(file, "checkpoint")["counters"]["frames"]) if file.exists() else 0


def assert_unbroken(run: Path, seed: int, folder: Path, environment: dict[str, str]) -> None:
    """The run ended with the weights of one that nobody stopped."""
    words = [*WORDS, f"seed={seed}", "run_dir=whole"]
    subprocess.run([sys.executable, "-m", "dune_rl.train", *words], cwd=folder, env=environment, check=True)
    stopped, whole = weights(run), weights(folder / "whole")
    assert not [name for name, value in whole.items() if not torch.equal(value, stopped[name])]


def test_jobs_of_a_sweep_go_on(environment: dict[str, str], tmp_path: Path) -> None:
    ask = asker(environment)
    launcher = ["timeout_min=60", "max_num_timeout=3", "cpus_per_task=1", "array_parallelism=2"]
    words = [*WORDS, "seed=1,2,3,4", "hydra.sweep.dir=sweep", "hydra/launcher=submitit_slurm"]
    words += [f"hydra.launcher.{word}" for word in launcher]
    sweep = subprocess.Popen(
        [sys.executable, "-m", "dune_rl.train", "-m", *words], cwd=tmp_path, env=environment
    )
    runs = [tmp_path / "sweep" / f"{number}_flat_seed{number + 1}" for number in range(4)]
    jobs: list[str] = []
    try:
        for number, run in enumerate(runs[:3]):
            wait_until(lambda run=run: frames_of(run) > 0 or sweep.poll() is not None, f"no save in {run}")
            (logs,) = (tmp_path / "sweep" / ".submitit").glob(f"*_{number}")
            if number == 0:
                # As Slurm does some time before the time limit.
                _warn(logs.name, "USR2", ask, environment)
            elif number == 1:
                # As for a job of higher priority: SIGTERM, and SIGKILL later.
                ask("scontrol", "requeue", logs.name)
            else:
                _kill_step(logs.name, ask)
                wait_until(
                    lambda job=logs.name: "JobState=FAILED" in ask("scontrol", "show", "job", job), "alive"
                )
                ask("scontrol", "requeue", logs.name)
            jobs.append(logs.name)
        for job in jobs:
            _start_now(job, ask)
        assert sweep.wait(_PATIENCE_S) == 0
    finally:
        if sweep.poll() is None:
            sweep.terminate()
            sweep.wait()
    assert [frames_of(run) for run in runs] == [FRAMES] * 4
    assert_unbroken(runs[0], 1, tmp_path, environment)


def test_the_script_of_a_training_requeues_itself(environment: dict[str, str], tmp_path: Path) -> None:
    ask, run = asker(environment), tmp_path / "run"
    words = [
        "sbatch",
        "--parsable",
        "--cpus-per-task=1",
        "--mem=500M",
        "--output=log.txt",
        f"--chdir={tmp_path}",
    ]
    words += [str(EXAMPLES / "train.sh"), *WORDS, "run_dir=run"]
    job = ask(*words).strip()
    wait_until(lambda: frames_of(run) > 0, "no save")
    _warn(job, "USR1", ask, environment)
    _start_now(job, ask)
    wait_until(lambda: frames_of(run) == FRAMES, "the run does not go on")
    wait_until(lambda: "JobState=COMPLETED" in ask("scontrol", "show", "job", job), "the job does not end")
    assert "and saved; go on with" in (tmp_path / "log.txt").read_text()
    # Once more is harmless.
    ask("sbatch", "--wait", *words[2:])
    assert (tmp_path / "log.txt").read_text().count("is a finished run") == 1


def test_the_script_of_an_array_of_evaluations_requeues_itself(
    environment: dict[str, str], tmp_path: Path
) -> None:
    ask, folder = asker(environment), tmp_path / "evaluations"
    words = ["sbatch", "--parsable", "--array=0-1", "--cpus-per-task=1", "--mem=500M", f"--chdir={tmp_path}"]
    words += [str(EXAMPLES / "evaluate.sh"), "policy=go_to_goal policy=random", "set=flat-v1", "evaluations"]
    job = ask(*words, "episodes=40").strip()
    wait_until(lambda: (folder / "1" / "provenance.json").exists(), "no evaluation")
    _warn(f"{job}_1", "USR1", ask, environment)
    _start_now(f"{job}_1", ask)
    for number in range(2):
        wait_until(
            lambda one=f"{job}_{number}": "JobState=COMPLETED" in ask("scontrol", "show", "job", one),
            "a job does not end",
        )
        assert len(read_csv(folder / str(number) / "episodes.csv")) == 40
    # Once more is harmless.
    ask("sbatch", "--wait", *words[2:], "episodes=40")
    report = [sys.executable, "-m", "dune_rl.report", "evaluations", "out=report"]
    subprocess.run(report, cwd=tmp_path, env=environment, check=True)
    assert "go_to_goal" in (tmp_path / "report" / "index.html").read_text()
