"""Faults of processes, disks, caches and clocks while a command runs: does it go on, or end with all saved?

`python experiments/reliability/faults.py FOLDER` adds to `FOLDER/faults.csv` the faults that it lacks. Each
begins with its command in a process of its own; what is done to it is done once the run has its first save,
or an evaluation its first episodes. A command that ends is called once more, with `resume`. The full disk is
a file system in memory, which only root can mount. Root may also write to folders that are read-only, and
gives that up, by `setpriv`, for the command whose folder turns read-only.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from dune_rl.core.files import read_csv, write_csv
from dune_rl.core.machine import short_commit

_TRAIN = (
    *("dune_rl.train", "+world=inspection", "total_frames=6000", "film=false", "run_dir=run", "resume=auto"),
    *("task.terminations.time_limit.max_steps=100", "learning.learning_starts=512", "learning.batch_size=64"),
    *("learning.hidden=[64,64]", "learning.updates_per_frame=0.05", "learning.collector.scenes=4"),
    *(
        "learning.collector.steps=16",
        "learning.evaluation.every_frames=3000",
        "learning.evaluation.episodes=2",
    ),
    *("learning.checkpoint.every_frames=640",),
)
_SERIAL = (*_TRAIN, "learning.collector.mode=serial")
_NEW_SITES = ("randomisation=worlds", "randomisation.episodes_per_world=1")
_EVALUATE = ("dune_rl.evaluate", "policy=go_to_goal", "+world=inspection", "episodes=60", "scenes=2")
# A command that runs longer hangs.
_PATIENCE_S = 900.0
# Runs as `python -m MODULE WORDS` does, but by a clock that jumps by up to eleven days, to and fro.
_JUMPING = """
import random, runpy, sys, time
real, jumps = time.time, random.Random(1)
time.time = lambda: real() + jumps.uniform(-1e6, 1e6)
sys.argv = sys.argv[1:]
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


@dataclass
class Row:
    """What a command did: it went on to its `exit_code` 0, or ended `after_s` seconds after the fault.

    `exit_code` is "hangs" where it had to be killed. `said` is the last line that it wrote, or the last note
    or warning of one that went on; `resumed` is the exit code with which it was then called again, or ""
    where it had ended well. `commit` is that of the code, with "+" where files differed from it.
    """

    fault: str
    exit_code: int | str
    after_s: float
    said: str
    resumed: str
    commit: str


@dataclass
class Command:
    """A command in a folder of its own, with what it has written so far."""

    folder: Path
    process: subprocess.Popen[bytes]

    @property
    def run(self) -> Path:
        return self.folder / "run"

    def written(self) -> str:
        return _log_of(self.folder).read_text(errors="replace")

    def descendants(self, word: str) -> list[int]:
        """The processes begun by this one, or by one of these, whose command line has `word`."""
        parents: dict[int, int] = {}
        for path in Path("/proc").glob("[0-9]*/stat"):
            try:
                parents[int(path.parent.name)] = int(path.read_text().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
        found = {self.process.pid}
        for _ in range(5):
            found |= {child for child, parent in parents.items() if parent in found}
        return [pid for pid in sorted(found - {self.process.pid}) if word in _command_line(pid)]

    def kill(self, word: str) -> None:
        """Kill the first process of this command whose command line has `word`, once there is one."""
        while self.process.poll() is None:
            if pids := self.descendants(word):
                os.kill(pids[0], signal.SIGKILL)
                return
            time.sleep(0.05)
        raise RuntimeError(f"there was no process {word} to kill")


def _command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""


def _log_of(folder: Path) -> Path:
    """What commands in `folder` write goes to another disk."""
    return folder.with_suffix(".log")


def _environment(folder: Path) -> dict[str, str]:
    threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    return {**os.environ, **threads, "HOME": str(folder), "DUNE_RL_CACHE": str(folder / "cache")}


def _start(folder: Path, words: tuple[str, ...], is_unprivileged: bool = False) -> Command:
    beginning = [sys.executable, "-m"] if words[0] != "-c" else [sys.executable]
    if is_unprivileged and os.geteuid() == 0:
        beginning = ["setpriv", "--bounding-set=-all", "--inh-caps=-all", *beginning]
    with _log_of(folder).open("ab") as log:
        process = subprocess.Popen(
            [*beginning, *words], cwd=folder, stdout=log, stderr=log, env=_environment(folder)
        )
    return Command(folder, process)


def _is_saved(command: Command) -> bool:
    return (command.run / "checkpoint.pt").exists()


def _has_episodes(command: Command) -> bool:
    rows = command.run / "episodes.part.jsonl"
    return rows.exists() and rows.stat().st_size > 0


def _call_again(command: Command) -> None:
    """Begin the same run beside the one that is under way."""
    other = subprocess.run(
        [sys.executable, "-m", *_SERIAL],
        cwd=command.folder,
        env=_environment(command.folder),
        capture_output=True,
        text=True,
        check=False,
    )
    said = other.stderr.strip().splitlines()
    (command.folder / "other.txt").write_text(f"{other.returncode}: {said[-1] if said else ''}")


def _fill(command: Command) -> None:
    with (command.folder / "filler").open("wb") as file:
        try:
            while True:
                file.write(bytes(2**16))
                file.flush()
        except OSError:
            pass


@dataclass
class Fault:
    """`do` happens to the command `words`, as soon as it `is_ready`; `mend` lets it go on later.

    With `is_mounted` it works in a file system of its own, and where `is_unprivileged` without root's rights.
    """

    words: tuple[str, ...]
    do: Callable[[Command], None]
    is_ready: Callable[[Command], bool] = _is_saved
    mend: Callable[[Path], None] = lambda folder: None
    is_mounted: bool = False
    is_unprivileged: bool = False


FAULTS = {
    "SIGKILL of a collector's worker (`sync`)": Fault(
        (*_TRAIN, "learning.collector.mode=sync", "learning.collector.workers=1"),
        lambda command: command.kill("spawn_main"),
    ),
    "SIGKILL of a collector's worker (`async`)": Fault(
        (*_TRAIN, "learning.collector.mode=async", "learning.collector.workers=2"),
        lambda command: command.kill("spawn_main"),
    ),
    "SIGKILL of the background process that builds worlds": Fault(
        (*_SERIAL, *_NEW_SITES), lambda command: command.kill("dune_rl.worlds.cache.store")
    ),
    "SIGKILL of a worker of an evaluation": Fault(
        (*_EVALUATE, "processes=2", "out=run"), lambda command: command.kill("spawn_main"), _has_episodes
    ),
    "SIGKILL of an evaluation": Fault(
        (*_EVALUATE, "out=run"), lambda command: command.process.kill(), _has_episodes
    ),
    "a full disk": Fault(_SERIAL, _fill, mend=lambda folder: (folder / "filler").unlink(), is_mounted=True),
    "a folder that turns read-only": Fault(
        _SERIAL,
        lambda command: command.run.chmod(0o555),
        mend=lambda folder: (folder / "run").chmod(0o755),
        is_unprivileged=True,
    ),
    "a cache that is deleted": Fault(
        (*_SERIAL, *_NEW_SITES), lambda command: shutil.rmtree(command.folder / "cache", ignore_errors=True)
    ),
    # It has no locks: an entry is written beside its name, and then renamed.
    "a cache that can no longer be read or written": Fault(
        (*_SERIAL, *_NEW_SITES),
        lambda command: (command.folder / "cache").chmod(0o000),
        is_unprivileged=True,
    ),
    "the same command beside it in the same folder": Fault(_SERIAL, _call_again),
    "a clock (Python's `time.time`) that jumps to and fro": Fault(
        ("-c", _JUMPING, *_SERIAL), lambda command: None
    ),
}


@contextmanager
def _place(is_mounted: bool) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="faults-") as base:
        folder = Path(base) / "work"
        folder.mkdir()
        try:
            if is_mounted:
                subprocess.run(["mount", "-t", "tmpfs", "-o", "size=48m", "none", str(folder)], check=True)
            yield folder
        finally:
            if is_mounted:
                subprocess.run(["umount", "-l", str(folder)], check=False)


def _wait(command: Command) -> int | str:
    try:
        return command.process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        command.process.kill()
        command.process.wait()
        return "hangs"


def meet(name: str, fault: Fault, folder: Path) -> Row:
    """Run the command of a fault, let it happen, and go on with what is there."""
    command = _start(folder, fault.words, fault.is_unprivileged)
    while not fault.is_ready(command):
        if command.process.poll() is not None:
            raise RuntimeError(f"it ended before the fault:\n{command.written()}")
        time.sleep(0.02)
    begun = time.monotonic()
    fault.do(command)
    code = _wait(command)
    taken_s, lines = time.monotonic() - begun, command.written().strip().splitlines()
    other = folder / "other.txt"
    told = lines if code else [line for line in lines if line.startswith(("note:", "warning:"))]
    said = other.read_text() if other.exists() else told[-1] if told else ""
    resumed = ""
    if code:
        fault.mend(folder)
        words = ("dune_rl.evaluate", "resume=run") if "dune_rl.evaluate" in fault.words else fault.words
        resumed = str(_wait(_start(folder, words, fault.is_unprivileged)))
    return Row(name, code, round(taken_s, 1), said.replace(str(folder), "."), resumed, short_commit())


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = Path(sys.argv[1]).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "faults.csv"
    rows: list[Mapping[str, object]] = [*read_csv(table)]
    done = {row["fault"] for row in rows}
    for name, fault in FAULTS.items():
        if name in done or (fault.is_mounted and os.geteuid() != 0):
            continue
        with _place(fault.is_mounted) as place:
            row = meet(name, fault, place)
        rows.append(asdict(row))
        write_csv(table, rows)
        print(row, flush=True)


if __name__ == "__main__":
    main()
