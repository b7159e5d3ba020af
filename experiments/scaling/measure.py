"""What a training on Ray costs its driver and its workers, for 1, 2 and 4 workers.

`python experiments/scaling/measure.py FOLDER` starts a Ray cluster of two nodes on this machine, trains on
it, and adds to `FOLDER/scaling.csv` a row for each training that it lacks. Processor times hardly depend on
how many processes share the cores, so that the ratio of a worker's to the driver's for a frame says at how
many workers, each with a core of its own, the driver is busy all the time.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from ray.cluster_utils import Cluster

from dune_rl.core.files import read_csv, write_csv
from dune_rl.core.machine import short_commit

# What is trained: the default learner, and the recipe of the policy for all worlds.
TRAININGS = {
    "sac": ("+world=inspection", "learning.learning_starts=8192", "total_frames=120_000"),
    "imitation": ("+experiment=all_worlds", "total_frames=120_000"),
}
WORKERS = (1, 2, 4)
_COMMON = (
    *("film=false", "seed=1", "learning.collector.mode=ray", "learning.threads=1"),
    *("learning.evaluation.every_frames=1_000_000_000", "learning.checkpoint.every_frames=1_000_000_000"),
)
# Frames from which on a training is measured: it has begun to learn, and its code is compiled.
_FROM_FRAMES = 30_000
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass
class Row:
    """What `frames` of a training cost once it learns.

    `driver_us` and `worker_us` are microseconds of processor time for a frame, of the driver and of all
    workers together; `frames_per_s` is by the clock, of as many `cores` as the machine has. `driver_mib` and
    `worker_mib` are the memory of the driver and of a worker at the end [MiB].
    """

    training: str
    workers: int
    cores: int
    frames: int
    frames_per_s: float
    driver_us: float
    worker_us: float
    driver_mib: float
    worker_mib: float
    commit: str


@dataclass
class Sample:
    """The `frames` of a training at a `time` [s], the processor times [s] and the memory [MiB] so far."""

    frames: int
    time: float
    driver_s: float
    workers_s: float
    driver_mib: float
    worker_mib: float


def used(pid: int) -> tuple[float, float]:
    """Processor time [s] and resident memory [MiB] of a process; zeros once it has ended."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0.0, 0.0
    return (int(words[11]) + int(words[12])) / _TICKS_PER_S, int(words[21]) * os.sysconf(
        "SC_PAGE_SIZE"
    ) / 2**20


def workers() -> list[int]:
    """Processes of Ray that collect."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if path.read_bytes().startswith(b"ray::_Worker"):
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


def samples(process: subprocess.Popen[str]) -> Iterator[Sample]:
    """One at every line in which the training says how far it is."""
    assert process.stdout is not None
    for line in process.stdout:
        sys.stderr.write(line)
        if found := re.search(r"([\d,]+) of [\d,]+ frames", line):
            driver, collecting = used(process.pid), [used(pid) for pid in workers()]
            frames = int(found[1].replace(",", ""))
            worker_s = sum(each[0] for each in collecting)
            worker_mib = max((each[1] for each in collecting), default=0.0)
            yield Sample(frames, time.monotonic(), driver[0], worker_s, driver[1], worker_mib)


def measure(name: str, number: int, address: str) -> Row:
    words = [*TRAININGS[name], *_COMMON, f"learning.collector.workers={number}"]
    with tempfile.TemporaryDirectory(prefix="scaling-") as folder:
        process = subprocess.Popen(
            [sys.executable, "-m", "dune_rl.train", *words, f"run_dir={folder}/run"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "RAY_ADDRESS": address, "OMP_NUM_THREADS": "1"},
        )
        taken = [sample for sample in samples(process) if sample.frames >= _FROM_FRAMES]
        if process.wait() or len(taken) < 2:
            sys.exit(f"{name} with {number} workers ended with code {process.returncode}")
    first, last = taken[0], taken[-1]
    frames = last.frames - first.frames
    return Row(
        training=name,
        workers=number,
        cores=os.cpu_count() or 0,
        frames=frames,
        frames_per_s=round(frames / (last.time - first.time)),
        driver_us=round(1e6 * (last.driver_s - first.driver_s) / frames),
        worker_us=round(1e6 * (last.workers_s - first.workers_s) / frames),
        driver_mib=round(last.driver_mib),
        worker_mib=round(last.worker_mib),
        commit=short_commit(),
    )


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    table = Path(sys.argv[1]).absolute() / "scaling.csv"
    rows: list[Mapping[str, object]] = [*read_csv(table)]
    done = {(row["training"], int(str(row["workers"]))) for row in rows}
    os.environ.update(RAY_USAGE_STATS_ENABLED="0", RAY_AUTH_MODE="disabled")
    head = {"include_dashboard": False, "include_log_monitor": False, "no_monitor": True}
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": max(WORKERS) // 2, **head})
    try:
        cluster.add_node(num_cpus=max(WORKERS) // 2)
        for name in TRAININGS:
            for number in WORKERS:
                if (name, number) in done:
                    continue
                row = measure(name, number, cluster.address)
                rows.append(asdict(row))
                write_csv(table, rows)
                print(row, flush=True)
    finally:
        cluster.shutdown()


if __name__ == "__main__":
    main()
