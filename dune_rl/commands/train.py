"""`python -m dune_rl.train`: compose the settings, train, and show how it ended."""

import multiprocessing
import os
import re
import shutil
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dune_rl.commands import command_line
from dune_rl.commands.end_of_training import FILM_FILE, film_run, show_end
from dune_rl.commands.resuming import (
    AUTO,
    SavedRun,
    check_own_folder,
    find_named_run,
    find_own_run,
)
from dune_rl.config.compose import check_sweep, compose, override_value
from dune_rl.config.group_files import describe_owner
from dune_rl.config.schema import Conf
from dune_rl.core import paths
from dune_rl.core.errors import CheckpointError, ConfigError, DuneError
from dune_rl.core.files import removing_empty
from dune_rl.core.folder_lock import FolderLock
from dune_rl.core.machine import available_cores
from dune_rl.core.ray_cluster import check_usable
from dune_rl.core.suggestions import text_word
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.learning.run.locks import (
    check_unused,
    has_files_of_a_run,
    lock_run,
    remove_beginnings,
    reserve_cores,
)

if TYPE_CHECKING:
    from dune_rl.learning.trainer import TrainingResult

_HYDRA_FOLDER = ".hydra"
_NO_WORDS = "hydra.output_subdir=null"
_SIDE_BY_SIDE = ("joblib", "submitit_local")


def run(words: Sequence[str]) -> None:
    """Train, resume or sweep, as the command line says."""
    parsed = command_line.parse_arguments(words, sweeps=True)
    folders = command_line.config_folders(parsed)
    source = override_value(parsed.overrides, "resume")
    if source == AUTO:
        check_own_folder(parsed.overrides, is_sweep=parsed.multirun)
    elif source is not None:
        if parsed.multirun:
            raise ConfigError(f"resume=FOLDER goes on with one run; write resume={AUTO}, or leave -m out")
        run = find_named_run(str(source), parsed.overrides, folders)
        run_dir = Path(run.conf.run_dir)
        with removing_empty(run_dir.parent), _locked(run_dir) as lock:
            if run_dir.resolve() != run.checkpoint.parent.resolve():
                check_unused(run_dir)
            train(run.conf, resume=run.checkpoint, lock=lock)
        return
    if parsed.multirun and override_value(parsed.overrides, "run_dir") is not None:
        raise ConfigError("run_dir names the folder of one run; with -m write hydra.sweep.dir=FOLDER")
    if not parsed.multirun:
        conf = compose(Conf, parsed.overrides, folders)
        if parsed.cfg == "job":
            command_line.print_settings(conf)
            return
        # Before Hydra writes its own files.
        _check_device(conf)
        # Only now: it loads what simulates, which a misspelt setting need not wait for.
        from dune_rl.config.group_files import check_group_files

        check_group_files(conf)
    ready = check_sweep(parsed.overrides, folders)
    if not any(word.lstrip("+").startswith("hydra.output_subdir=") for word in ready):
        # A job writes its words itself, when it has the lock of its folder: another run may be there.
        ready.append(_NO_WORDS)
    flags = [word for word in sys.argv[1:] if word not in parsed.overrides]
    with nullcontext() if parsed.multirun else removing_empty(Path(conf.run_dir).parent):
        _run_hydra([*flags, *ready])


def _run_hydra(words: Sequence[str]) -> None:
    # Hydra raises what happens in a job only if told so; otherwise it prints a traceback and exits with 1.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    sys.argv[1:] = words
    try:
        hydra.main(version_base="1.3", config_path=str(paths.conf_folder()), config_name="train")(_job)()
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(_explain(str(error).splitlines()[0], words)) from error
    except command_line.Terminated:
        # Jobs in processes of their own, as of joblib, end with this one.
        if {"-m", "--multirun"} & {*words}:
            command_line.print_error(
                "The sweep was ended at once. What its jobs saved last stays; the same command with "
                f"resume={AUTO} and hydra.sweep.dir=FOLDER goes on with them"
            )
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0]
        if not (type(error).__module__.startswith("submitit.") or 'Could not detect "srun"' in reason):
            raise
        raise ConfigError(
            f"Slurm: {reason}; submit jobs where sinfo lists nodes, and see the logs in .submitit below "
            "hydra.sweep.dir"
        ) from error


def _explain(message: str, words: Sequence[str]) -> str:
    """Hydra's message with what it does not name: a missing plugin, or the settings of Hydra's own."""
    if plugin := re.search(r"Could not find 'hydra/(launcher|sweeper)/(\w+)'", message):
        kind, name = plugin.groups()
        return (
            f"hydra/{kind}={name}: there is no such {kind} here; pip install 'dune_rl[sweeps]' has joblib, "
            "submitit and Optuna, and docs/how_to/cluster.md says how to install Ray's"
        )
    own = [word for word in words if word.lstrip("+~").startswith("hydra.") and word != _NO_WORDS]
    if not own:
        return message
    return (
        f"{' '.join(own)}: {message}; quote a value that holds a comma, as in 'hydra.sweep.dir=\"a,b\"', and "
        r"write \${ for ${ that is no reference"
    )


def _job(config: DictConfig) -> float | None:
    """Train; returns the objective, which sweepers optimise."""
    engine = HydraConfig.get()
    # In joblib's workers new processes would start in a way of theirs, which TorchRL's collectors cannot.
    if multiprocessing.get_start_method(allow_none=True) not in (None, "spawn", "fork", "forkserver"):
        multiprocessing.set_start_method("spawn", force=True)
    try:
        # Hydra knows neither the shorthands of agent groups nor options that groups name.
        sources = engine.runtime.config_sources
        folders = [source.path for source in sources if source.provider == "command-line"]
        conf = compose(Conf, engine.overrides.task, folders)
        conf = conf.model_copy(update={"run_dir": engine.runtime.output_dir})
        # As messages show it.
        shown = command_line.shown_path(Path(conf.run_dir))
        with _locked(Path(shown)) as lock:
            own = conf.model_copy(update={"run_dir": shown})
            run = find_own_run(own, folders, lock) if conf.resume == AUTO else None
            if run is not None and run.is_finished:
                _tell_finished(run)
                return run.objective
            if run is None:
                check_unused(Path(shown))
                if engine.output_subdir is None:
                    _save_words(config, Path(conf.run_dir) / _HYDRA_FOLDER)
            with _cores_of_a_sweep(conf, engine):
                if run is None:
                    result = train(conf, words=engine.overrides.task, lock=lock)
                else:
                    result = train(run.conf, resume=run.checkpoint, lock=lock)
        from dune_rl.statistics.measures import mean_of_known

        rows = result.evaluation[conf.driven_group.name]
        return mean_of_known(row[conf.objective] for row in rows)
    except (DuneError, OSError) as error:
        # Hydra would say of any other exception that the job failed.
        command_line.exit_if_unread(error)
        message = command_line.describe_user_error(error)
        if message is None:
            raise
        if engine.mode is not RunMode.MULTIRUN:
            command_line.exit_with_error(message)
        # The other jobs of the sweep go on; Hydra raises this one's error after the last.
        command_line.print_error(f"job {engine.job.num} failed: {message}")
        raise command_line.ReportedError from error
    return None


@contextmanager
def _locked(run_dir: Path) -> Iterator[FolderLock]:
    """The lock of a run's folder until all of the run is written, its film, too.

    The lock's file stays where a run was cut off. Where it was refused, and the folder has no files of a run,
    the command's words go, and the folder if it is empty then.
    """
    lock = lock_run(run_dir)
    if lock.was_left:
        lock.keep_file()
    try:
        yield lock
    except BaseException:
        if has_files_of_a_run(run_dir):
            lock.release()
        else:
            shutil.rmtree(run_dir / _HYDRA_FOLDER, ignore_errors=True)
            lock.finish()
            with suppress(OSError):
                run_dir.rmdir()
        raise
    lock.finish()


def _save_words(config: DictConfig, folder: Path) -> None:
    """Write the files that Hydra writes of a job, with `config` without its own settings."""
    folder.mkdir(parents=True, exist_ok=True)
    own = HydraConfig.get()
    engine = OmegaConf.create({"hydra": own})
    for name, content in (("config", config), ("hydra", engine), ("overrides", own.overrides.task)):
        OmegaConf.save(content, folder / f"{name}.yaml")


@contextmanager
def _cores_of_a_sweep(conf: Conf, engine: Any) -> Iterator[None]:
    """Wait for cores where jobs of a sweep run side by side on this machine.

    Slurm gives each job cores of its own, and Hydra's basic launcher runs one job at a time.
    """
    launcher = engine.runtime.choices.get("hydra/launcher")
    if engine.mode is not RunMode.MULTIRUN or launcher not in _SIDE_BY_SIDE:
        yield
        return
    from dune_rl.learning.collector import learner_threads

    collector = conf.learning.collector
    needed = collector.processes_here + (conf.learning.threads or learner_threads(collector))
    told = f"job {engine.job.num} waits for {needed} free cores"
    folder = Path(engine.sweep.dir).absolute() / ".cores"
    with reserve_cores(folder, needed, available_cores(), lambda: print(told, flush=True)):
        yield


def _tell_finished(run: SavedRun) -> None:
    print(f"{run.conf.run_dir} is a finished run of {run.frames:,} frames: there is nothing to do")


def train(
    conf: Conf, resume: Path | None = None, words: Sequence[str] = (), lock: FolderLock | None = None
) -> "TrainingResult":
    """Run or resume a training, and show how it ended; a signal ends the process once all is saved.

    `words` are those of the command line, KEY=VALUE: TensorBoard compares runs by what they set. The caller
    may hold the `lock` of the run's folder, and then ends it.
    """
    _check_machine(conf)
    # Imported here: these load PyTorch and the physics engine, which `--help` and collector processes, which
    # import this module too, do not need.
    from dune_rl.config.build import make_learning_env
    from dune_rl.learning.policy_spec import GroupMismatchError
    from dune_rl.learning.run.progress import BarReporter, LineReporter
    from dune_rl.learning.run.tensorboard import choose_hyperparameters
    from dune_rl.learning.trainer import Trainer
    from dune_rl.reporting.views.evaluation_pictures import EvaluationTracks

    console = command_line.make_console()
    reporter = BarReporter(console) if console.is_terminal else LineReporter(partial(print, flush=True))
    run_dir = Path(conf.run_dir)
    config = conf.model_copy(update={"resume": None}).model_dump(mode="json")
    evaluated = conf.model_copy(
        update={"randomisation": conf.randomisation.with_new_worlds(conf.learning.evaluation.world_seeds)}
    )
    try:
        trainer = Trainer(
            partial(make_learning_env, conf),
            run_dir,
            conf.learning,
            seed=conf.seed,
            total_frames=conf.total_frames,
            device=conf.device,
            config=config,
            resume=resume,
            reporter=reporter,
            title=f"{conf.world.name}, seed {conf.seed}",
            hyperparameters=choose_hyperparameters(config, words),
            make_pictures=EvaluationTracks,
            judged=conf.driven_group.name,
            action_repeat=conf.physics.action_repeat,
            make_evaluation_env=partial(make_learning_env, evaluated),
            lock=lock,
        )
    except GroupMismatchError as error:
        owner = describe_owner(error.location, error.group, conf.path_of(error.group))
        what_differs = str(error).splitlines()[0]
        raise CheckpointError(f"{what_differs}\n{owner}" if owner else str(error)) from None
    shown_dir = command_line.shown_path(run_dir)
    command_line.print_line(console, f"Run folder: {shown_dir}\nMaking worlds and scenes")
    command_line.print_world_notes(console, conf)
    if trainer.warms_up_throughout:
        command_line.print_error(
            f"note: others drive for all of the {conf.total_frames:,} frames before an update is made; raise "
            "total_frames, or lower learning.learning_starts or learning.demonstrations.frames"
        )
    go_on = f"go on with {command_line.shell_command('dune_rl.train', text_word('resume', shown_dir))}"
    try:
        result = trainer.train()
    except DuneError:
        remove_beginnings(run_dir)
        raise
    except KeyboardInterrupt:
        is_saved = (run_dir / CHECKPOINT_FILE).exists()
        what = f"its last save stays; {go_on}" if is_saved else "nothing of it was saved"
        command_line.print_error(f"The run was ended at once: {what}")
        raise
    if result.signal is not None:
        command_line.print_error(f"Stopped at {result.frames:,} frames and saved; {go_on}")
        _hand_on(result.signal)
        sys.exit(128 + result.signal)
    if conf.film:
        try:
            film_run(console, evaluated, result)
        except BrokenPipeError:
            raise
        except (DuneError, OSError) as error:
            # All else of the run is there, a sweep's objective too.
            command_line.print_error(f"note: {FILM_FILE} is left out: {error}")
    show_end(console, conf, result)
    return result


def _hand_on(number: int) -> None:
    """Call the earlier handler of a batch system's signal, now that all is saved: submitit's requeues."""
    handler = signal.getsignal(number)
    if number not in (signal.SIGINT, signal.SIGTERM) and callable(handler):
        handler(number, None)


def _check_device(conf: Conf) -> None:
    if conf.device == "cpu":
        return
    import torch

    if not torch.cuda.is_available():
        raise ConfigError("device=cuda, but PyTorch finds no GPU here; use device=cpu")


def _check_machine(conf: Conf) -> None:
    _check_device(conf)
    if conf.learning.collector.mode == "ray":
        check_usable("learning.collector.mode=ray")
    processes, cores = conf.learning.collector.processes_here, available_cores()
    # A single thread of the learner is busy for a part of the time: workers may take all cores.
    threads = conf.learning.threads or 1
    if processes > cores or (threads > 1 and processes + threads > cores):
        command_line.print_error(
            f"note: {processes} worker processes and {conf.learning.threads or 1} learner threads share "
            f"{cores} cores; fewer may be faster (learning.collector.workers, learning.threads)"
        )
