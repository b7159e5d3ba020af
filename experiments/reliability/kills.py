"""Training runs that are ended at random moments, and resumed: does each end as an unbroken run does?

`python experiments/reliability/kills.py FOLDER` adds to `FOLDER/kills.csv` the rows that it lacks, one for
each run: 34 are killed at any moment and 10 near their end, 31 amid the save of a file (from a moment on, as
soon as the run's folder has the temporary file of that), 10 get SIGTERM, and 10 SIGINT twice. A moment is a
share of the processor time of an unbroken run, so that it hardly depends on what else the machine does. The
run that is ended is a fork of this process, which has loaded the libraries, and does what `python -m
dune_rl.train ... resume=auto` does from there on; it is resumed by that command, in a new process whose
hashes are others.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

# Before NumPy and PyTorch are loaded, which read them.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))

import numpy as np
import torch

from dune_rl import train
from dune_rl.commands import train as _command  # noqa: F401
from dune_rl.commands.end_of_training import FILM_FILE
from dune_rl.core.files import read_csv, write_csv
from dune_rl.core.machine import short_commit
from dune_rl.learning import trainer as _loaded_once  # noqa: F401
from dune_rl.learning.checkpoint import BEST_POLICY_FILE, CHECKPOINT_FILE, LAST_POLICY_FILE
from dune_rl.learning.run.log import CURVE_FILE, METRICS_FILE

# In batches of 4 scenes, 16 steps of each.
_TOTAL_FRAMES, _BATCH_FRAMES = 3072, 64
SETTINGS = (
    "+world=flat",
    "seed=1",
    f"total_frames={_TOTAL_FRAMES}",
    "task.terminations.time_limit.max_steps=60",
    "learning.learning_starts=512",
    "learning.batch_size=64",
    "learning.hidden=[64,64]",
    "learning.precision=float32",
    "learning.collector.mode=serial",
    "learning.collector.scenes=4",
    "learning.collector.steps=16",
    "learning.evaluation.every_frames=1024",
    "learning.evaluation.episodes=2",
    "learning.checkpoint.every_frames=128",
)
_POLICY_FILES, _METRICS_FILES = (BEST_POLICY_FILE, LAST_POLICY_FILE), (METRICS_FILE, CURVE_FILE)
_SEED = 20
_POLL_S = 0.0005
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


# How runs are ended, and how many.
_AMID = "SIGKILL amid "
ENDINGS = {
    "SIGKILL": 34,
    f"{_AMID}{CHECKPOINT_FILE}": 6,
    f"{_AMID}{LAST_POLICY_FILE}": 5,
    f"{_AMID}{BEST_POLICY_FILE}": 5,
    "SIGTERM": 10,
    "SIGINT twice": 10,
    "SIGKILL near the end": 10,
    f"{_AMID}{CURVE_FILE}": 5,
    f"{_AMID}{FILM_FILE}": 5,
    # The start of the names of the replay buffer's files.
    f"{_AMID}replay": 5,
}
# Shares of an unbroken run's processor time between which moments are drawn.
_MOMENTS, _LATE_MOMENTS = (0.0, 0.95), (0.85, 1.0)
_NUMBERS = {"SIGTERM": signal.SIGTERM, "SIGINT twice": signal.SIGINT}
_BETWEEN_S = 0.1
# An end that takes longer is taken for none.
_PATIENCE_S = 300.0


@dataclass
class Kill:
    """A row of `kills.csv`.

    `moment` is the share of the unbroken run's processor time at which the run was ended, or from which on a
    save was waited for; `exit_code` is that of the ended run, `-N` by signal N, and `took_s` the seconds
    until it had ended. `temporary` are the temporary files of saves that it left, `saved_frames` the frames
    of the checkpoint that it left, 0 without one and -1 where it cannot be read; `resumed` is the exit code
    of the resumed run, and `resumed_at` the frames that it had before its first batch.
    `weights_equal` says whether its policies, critics and optimiser are the unbroken run's bit for bit,
    `metrics_equal` whether its metrics.csv and its curve.png are, and `files_equal` whether the weights of
    its policy_best.pt and policy_last.pt are; `left` are the temporary and replay files in its folder at the
    end that its checkpoint does not name. `commit` is that of the code, with "+" where files
    differed from it.
    """

    number: int
    ending: str
    moment: float
    exit_code: int
    took_s: float
    temporary: str
    saved_frames: int = 0
    resumed: int = 0
    resumed_at: int = 0
    weights_equal: int = 0
    metrics_equal: int = 0
    files_equal: int = 0
    left: str = ""
    missing: str = ""
    commit: str = ""


def start(words: Sequence[str], log: Path) -> int:
    """Fork a process that trains as the command line `words` say; returns its id."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        output = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_APPEND)
        os.dup2(output, 1)
        os.dup2(output, 2)
        sys.argv[1:] = words
        train.main()
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except KeyboardInterrupt:
        # As Python ends where nothing has begun.
        code = 128 + signal.SIGINT
    finally:
        sys.stdout.flush()
        os._exit(code)


def run(
    words: Sequence[str],
    log: Path,
    ending: str | None = None,
    is_due: Callable[[int], bool] = lambda child: False,
) -> tuple[int, float, float]:
    """The exit code of a run, its processor time [s], and the time from its `ending` on [s].

    It is ended as soon as `is_due` says so of its process.
    """
    child = start(words, log)
    ended_at = None
    while True:
        done, status, used = os.wait4(child, os.WNOHANG)
        now = time.monotonic()
        if done:
            took_s = 0.0 if ended_at is None else now - ended_at
            return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, took_s
        if ended_at is None and ending is not None and is_due(child):
            ended_at = now
            os.kill(child, _NUMBERS.get(ending, signal.SIGKILL))
            if ending == "SIGINT twice":
                time.sleep(_BETWEEN_S)
                os.kill(child, signal.SIGINT)
        if ended_at is not None and now - ended_at > _PATIENCE_S:
            os.kill(child, signal.SIGKILL)
        time.sleep(_POLL_S)


def resume(words: Sequence[str], log: Path, number: int) -> int:
    """The exit code of the command in a new process; its output is the new `log`."""
    environment = {**os.environ, "PYTHONHASHSEED": str(number)}
    command = [sys.executable, "-m", "dune_rl.train", *words]
    with log.open("w") as output:
        return subprocess.run(command, stdout=output, stderr=output, env=environment, check=False).returncode


def processor_time(process: int) -> float:
    """What a process has used so far [s]."""
    words = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / _TICKS_PER_S


def temporary_files(folder: Path, of: str = "") -> list[str]:
    """The names of the temporary files in a run's folder, or of those of the file `of`."""
    names = os.listdir(folder) if folder.is_dir() else []
    return sorted(name for name in names if name.startswith(f".{of}") and name.endswith(".tmp"))


def learners_of(folder: Path) -> list[torch.Tensor]:
    """All tensors of the learners in a run's checkpoint."""
    content = torch.load(folder / CHECKPOINT_FILE, weights_only=True)
    return _tensors_of([entry["learner"] for entry in content["groups"].values()])


def policies_of(folder: Path) -> list[torch.Tensor]:
    """All tensors of a run's policy files."""
    return _tensors_of([torch.load(folder / name, weights_only=True) for name in _POLICY_FILES])


def _tensors_of(tree: object) -> list[torch.Tensor]:
    leaves = [leaf for leaf in torch.utils._pytree.tree_leaves(tree) if isinstance(leaf, torch.Tensor)]
    assert leaves, "files without weights compare nothing"
    return leaves


def _are_equal(ones: list[torch.Tensor], others: list[torch.Tensor]) -> int:
    return int(all(torch.equal(*pair) for pair in zip(ones, others, strict=True)))


def end_and_resume(number: int, ending: str, folder: Path, unbroken: Path, whole_s: float) -> Kill:
    amid = ending.removeprefix(_AMID) if ending.startswith(_AMID) else None
    rng = np.random.default_rng([_SEED, number])
    has_film = amid == FILM_FILE
    words = [*SETTINGS, f"film={str(has_film).lower()}", f"run_dir={folder}", "resume=auto"]
    log = folder.with_suffix(".log")
    code, moment, took_s = 0, 0.0, 0.0
    # A run that came to its end before its moment, so that nothing was sent to it, is begun anew.
    while took_s == 0.0:
        shutil.rmtree(folder, ignore_errors=True)
        log.unlink(missing_ok=True)
        moment = float(rng.uniform(*(_LATE_MOMENTS if ending == "SIGKILL near the end" else _MOMENTS)))

        def is_due(child: int, least_s: float = moment * whole_s) -> bool:
            return processor_time(child) >= least_s and (amid is None or bool(temporary_files(folder, amid)))

        code, _, took_s = run(words, log, ending, is_due)
    temporary = " ".join(temporary_files(folder))
    row = Kill(number, ending, round(moment, 4), int(code), round(took_s, 2), temporary)
    if (folder / CHECKPOINT_FILE).exists():
        try:
            row.saved_frames = torch.load(folder / CHECKPOINT_FILE, weights_only=True)["counters"]["frames"]
        except (OSError, RuntimeError, ValueError, KeyError):
            row.saved_frames = -1
    row.resumed = resume(words, log, number)
    # It says so after the first batch, or in an evaluation that was cut off and comes before; only a run that
    # was saved at its end has none left.
    first = re.search(r"^(evaluat)?.*?([\d,]+) of [\d,]+ frames", log.read_text(), re.MULTILINE)
    if first is None:
        row.resumed_at = _TOTAL_FRAMES
    else:
        row.resumed_at = int(first[2].replace(",", "")) - (0 if first[1] else _BATCH_FRAMES)
    if row.resumed == 0:
        row.weights_equal = _are_equal(learners_of(folder), learners_of(unbroken))
        row.files_equal = _are_equal(policies_of(folder), policies_of(unbroken))
        row.metrics_equal = int(
            all((folder / name).read_bytes() == (unbroken / name).read_bytes() for name in _METRICS_FILES)
        )
        named = {path.name for path in unbroken.glob("replay-*")}
        replays = [path.name for path in folder.glob("replay-*") if path.name not in named]
        row.left = " ".join([*temporary_files(folder), *replays])
        wanted = {path.name for path in unbroken.glob("[!.e]*")} | ({FILM_FILE} if has_film else set())
        row.missing = " ".join(sorted(wanted - {path.name for path in folder.iterdir()}))
    row.commit = short_commit()
    return row


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    # Shells start background jobs with Ctrl-C ignored, and the runs would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder = Path(sys.argv[1]).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    runs, table = Path(tempfile.mkdtemp(prefix="kills-")), folder / "kills.csv"
    try:
        # The first one also loads and compiles what the others find.
        for _ in range(2):
            shutil.rmtree(runs / "unbroken", ignore_errors=True)
            words = [*SETTINGS, "film=false", f"run_dir={runs / 'unbroken'}"]
            code, whole_s, _ = run(words, runs / "unbroken.log")
        if code:
            sys.exit(f"The unbroken run ended with exit code {code}:\n{(runs / 'unbroken.log').read_text()}")
        rows: list[Mapping[str, object]] = [*read_csv(table)]
        if any(list(row) != [each.name for each in fields(Kill)] for row in rows):
            sys.exit(f"{table} has other columns than this script writes: move it away, and begin anew")
        endings = [ending for ending, count in ENDINGS.items() for _ in range(count)]
        done = {int(str(row["number"])) for row in rows}
        for number, ending in enumerate(endings):
            if number in done:
                continue
            row = end_and_resume(number, ending, runs / "ended", runs / "unbroken", whole_s)
            rows.append(asdict(row))
            write_csv(table, rows)
            print(row, flush=True)
    finally:
        shutil.rmtree(runs, ignore_errors=True)


if __name__ == "__main__":
    main()
