"""Folders that a run may write to, and the cores that jobs of a sweep share."""

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import yaml

from dune_rl.core.errors import CheckpointError, DuneError
from dune_rl.core.files import try_lock
from dune_rl.core.folder_lock import FolderLock
from dune_rl.core.suggestions import typed_word
from dune_rl.core.untrusted_files import parse_yaml
from dune_rl.learning.checkpoint import CHECKPOINT_FILE, CONFIG_FILE

# Files of a run, which may have no checkpoint: it was cut off early, or published without it.
_OF_A_RUN = ("events.out.tfevents.*", "metrics.csv", "policy_*.pt", "replay-*")
_POLL_S = 0.2


def lock_run(folder: Path) -> FolderLock:
    """The lock of a run's folder, which is made where there is none.

    Raises CheckpointError if another process has it, or if the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Without a name, which a process that is killed would leave.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise CheckpointError(
            f"The folder {folder} cannot be written: {error.strerror or error}.\n"
            "Name another folder for the run."
        ) from error
    taken = f"Another run is writing to {folder}.\nName another folder with run_dir, or wait until it ends."
    return FolderLock(folder, CheckpointError(taken))


def check_unused(folder: Path) -> None:
    """Raise CheckpointError if `folder`, whose lock the caller holds, has files of a run.

    A new run would mix its files with those.
    """
    if (folder / CHECKPOINT_FILE).exists():
        raise CheckpointError(
            f"{folder} already holds a run; continue it with {typed_word('resume', folder)}, or choose "
            "another run_dir"
        )
    config = folder / CONFIG_FILE
    if config.exists() and not _is_of_a_run(config):
        raise CheckpointError(f"{config} is no run's, and a run would replace it: choose another run_dir")
    left = next(iter(_files_of_a_run(folder)), None)
    if left is not None:
        raise CheckpointError(
            f"{folder} holds {left.name} of an earlier run, and no {CHECKPOINT_FILE} to go on with: choose "
            "another run_dir, or begin that run anew with its own settings and resume=auto"
        )


def remove_leftovers(folder: Path) -> None:
    """Remove the files of a run without a save from `folder`, whose lock the caller holds."""
    for file in _files_of_a_run(folder):
        file.unlink()


def remove_beginnings(folder: Path) -> None:
    """Remove the files of a run that ended before it learned anything from `folder`.

    The corrected command may use the folder. Files of a run with results stay, and say whose they are.
    """
    begun = {*folder.glob("events.out.tfevents.*"), folder / CONFIG_FILE}
    if (folder / CHECKPOINT_FILE).exists() or {*_files_of_a_run(folder)} - begun:
        return
    for file in begun:
        file.unlink(missing_ok=True)


def has_files_of_a_run(folder: Path) -> bool:
    """Whether a run has begun to write to `folder`."""
    return any((folder / name).exists() for name in (CHECKPOINT_FILE, CONFIG_FILE)) or bool(
        _files_of_a_run(folder)
    )


def _is_of_a_run(config: Path) -> bool:
    try:
        found = parse_yaml(config.read_bytes())
    except (DuneError, OSError, ValueError, yaml.YAMLError):
        return False
    return isinstance(found, dict) and "learning" in found


def _files_of_a_run(folder: Path) -> list[Path]:
    return [file for pattern in _OF_A_RUN for file in folder.glob(pattern)]


@contextlib.contextmanager
def reserve_cores(
    folder: Path, needed: int, cores: int, waiting: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Hold `needed` of the machine's `cores` (all, if it needs more), among the jobs that share `folder`.

    It waits until so many are free, and calls `waiting` once if they are not. A core is the lock of a file,
    so that the cores of a job that dies are free at once. Where there are no such locks, nobody waits.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held, contextlib.ExitStack() as collecting:
        # One job at a time collects cores, lest two wait for each other's.
        gate = collecting.enter_context((folder / "gate").open("a"))
        free = [(folder / f"core{number}").open("a") for number in range(cores)]
        missing = min(needed, cores)
        has_gate = has_told = False
        while missing:
            has_gate = has_gate or try_lock(gate.fileno()) is not False
            for core in list(free) if has_gate else ():
                if missing and try_lock(core.fileno()) is not False:
                    free.remove(held.enter_context(core))
                    missing -= 1
            if missing:
                if not has_told:
                    waiting()
                has_told = True
                time.sleep(_POLL_S)
        for core in free:
            core.close()
        collecting.close()
        yield
