"""`resume=auto`: one command that begins a run, goes on with it, and finds it finished."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import pytest
import torch
from test_cli_runs import TINY
from test_overrides import EXPERIMENTS
from training import weights

from dune_rl import train
from dune_rl.commands import train as commands_train
from dune_rl.commands.command_line import Terminated
from dune_rl.commands.resuming import find_own_run
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.core.folder_lock import LOCK_FILE
from dune_rl.learning.checkpoint import write_checkpoint_file
from dune_rl.learning.run import log, progress
from dune_rl.learning.run.locks import lock_run
from dune_rl.learning.run.progress import LineReporter, TrainingStatus

Call = Callable[..., int]
# Of one batch of warm-up and one of learning.
SHORT = [
    *("+world=flat", *TINY, "total_frames=64", "learning.learning_starts=32"),
    *("learning.evaluation.episodes=1", "task.terminations.time_limit.max_steps=3"),
]
AUTO = [*SHORT, "resume=auto"]


class Stopping(LineReporter):
    """Sends a signal to this process after the first batch."""

    signal = signal.SIGTERM

    def update(self, status: TrainingStatus) -> None:
        os.kill(os.getpid(), self.signal)


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def assert_equal_weights(one: Path, other: Path) -> None:
    first, second = weights(one), weights(other)
    assert first.keys() == second.keys()
    assert not [name for name, value in first.items() if not torch.equal(value, second[name])]


def test_a_finished_run_is_left_alone_and_one_of_other_settings_refused(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "run").mkdir()
    content = {
        "groups": {},
        "config": compose(Conf, SHORT).model_dump(mode="json"),
        "counters": {"frames": 64, "evaluated_at": 64},
    }
    write_checkpoint_file(folder / "run" / "checkpoint.pt", "checkpoint", content)
    before = files_of(folder)
    assert call(train.main, *AUTO, "run_dir=run") == 0
    assert capsys.readouterr().out == "run is a finished run of 64 frames: there is nothing to do\n"
    assert call(train.main, *AUTO, "run_dir=run", "seed=2", "learning.tau=0.1") == 2
    assert capsys.readouterr().err == (
        "run holds a run of other settings: learning.tau=0.1 (the run has 0.005), seed=2 (the run has 1)\n"
        "Give the settings that it began with, or another folder; resume=run goes on with changed ones.\n"
    )
    assert files_of(folder) == before


@pytest.mark.slow
def test_a_run_killed_amid_its_last_save_is_ended_when_it_goes_on(call: Call, folder: Path) -> None:
    assert call(train.main, *AUTO, "run_dir=run") == 0
    run = folder / "run"
    assert not (run / LOCK_FILE).exists()
    before = files_of(run)
    ended = torch.load(run / "policy_last.pt", weights_only=True)
    # The lock stays where a process was killed, and what it had not written yet is of before, or missing.
    for file in (run / LOCK_FILE, run / ".policy_last.pt.x1.tmp"):
        file.write_bytes(b"")
    for name in ("policy_last.pt", "curve.png", "metrics.csv"):
        (run / name).unlink()
    assert call(train.main, *AUTO, "run_dir=run") == 0
    again = torch.load(run / "policy_last.pt", weights_only=True)
    assert again["frames"] == ended["frames"]
    for group, entry in ended["groups"].items():
        policy = again["groups"][group]["policy"]
        assert entry["policy"] and all(
            torch.equal(value, policy[name]) for name, value in entry["policy"].items()
        )
    assert {file for file in before if "tfevents" not in file} == {
        file for file in files_of(run) if "tfevents" not in file
    }


@pytest.mark.slow
def test_a_run_cut_off_by_ctrl_c_after_its_last_save_is_ended_when_it_goes_on(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut_off(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(log, "draw_curve", cut_off)
        assert call(train.main, *AUTO, "run_dir=run") == 130
    assert not (folder / "run" / "curve.png").exists()
    assert call(train.main, *AUTO, "run_dir=run") == 0
    assert (folder / "run" / "curve.png").exists() and not (folder / "run" / LOCK_FILE).exists()
    whole = files_of(folder)
    assert call(train.main, *AUTO, "run_dir=run") == 0
    assert files_of(folder) == whole


def test_a_run_cut_off_as_it_writes_its_first_file_goes_on(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class KilledError(Exception):
        pass

    def write(path: Path) -> NoReturn:
        raise KilledError

    with monkeypatch.context() as changed:
        changed.setattr("dune_rl.learning.run.folder.write_atomically", write)
        with pytest.raises(KilledError):
            call(train.main, *AUTO, "run_dir=run")
    # Of these the next start takes no notice, as it would of files whose settings are not known.
    assert {file.name for file in (folder / "run").glob("*")} <= {".lock", ".hydra"}


def test_a_second_command_leaves_the_folder_of_a_run_that_begins(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lock = lock_run(folder / "run")
    (folder / "run" / ".hydra").mkdir()
    (folder / "run" / ".hydra" / "config.yaml").write_text("of the first")
    before = files_of(folder)
    for words in (SHORT, AUTO):
        assert call(train.main, *words, "run_dir=run") == 2
        assert capsys.readouterr().err.startswith("Another run is writing to run.\n")
        assert files_of(folder) == before
    lock.release()


def test_a_refused_run_leaves_the_folder_as_it_was(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise ConfigError("found late")

    monkeypatch.setattr(commands_train, "train", refuse)
    (folder / "here").mkdir()
    (folder / "link").symlink_to("here")
    (folder / "full").mkdir()
    (folder / "full" / "slurm.out").write_text("mine")
    for name in ("new", "link", "full", "."):
        before = files_of(folder)
        assert call(train.main, *SHORT, f"run_dir={name}") == 2
        assert capsys.readouterr().err == "found late\n"
        assert files_of(folder) == before
    assert not (folder / "new").exists() and not (folder / ".hydra").exists()


def test_the_settings_of_something_else_are_not_replaced(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "run").mkdir()
    (folder / "run" / "config.yaml").write_text("my: file")
    for words, told in ((SHORT, "is no run's"), (AUTO, "has no settings of a run")):
        assert call(train.main, *words, "run_dir=run") == 2
        assert f"run/config.yaml {told}" in capsys.readouterr().err
        assert files_of(folder) == {str(folder / "run" / "config.yaml"): b"my: file"}


@pytest.mark.slow
def test_a_run_that_goes_on_elsewhere_replaces_no_other_run(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one", "other"):
        assert call(train.main, *SHORT, f"run_dir={name}") == 0
    before = files_of(folder)
    assert call(train.main, "resume=one", "run_dir=other", "total_frames=128") == 2
    assert "other already holds a run" in capsys.readouterr().err
    assert files_of(folder) == before
    assert call(train.main, "resume=one", "run_dir=new", "total_frames=128") == 0
    assert {key: value for key, value in files_of(folder).items() if key in before} == before


@pytest.mark.slow
def test_a_run_that_was_stopped_after_its_last_save_films_when_it_goes_on(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = log.draw_curve

    def draw_and_stop(*given: Any) -> None:
        draw(*given)
        os.kill(os.getpid(), signal.SIGTERM)

    with monkeypatch.context() as changed:
        changed.setattr(log, "draw_curve", draw_and_stop)
        assert call(train.main, *AUTO, "run_dir=run", "film=true") == 143
    filmed: list[Path] = []
    monkeypatch.setattr(commands_train, "film_run", lambda *given: filmed.append(given[2].run_dir))
    assert call(train.main, *AUTO, "run_dir=run", "film=true") == 0
    assert len(filmed) == 1 and not (folder / "run" / LOCK_FILE).exists()


@pytest.mark.slow
def test_a_run_whose_output_nobody_reads_goes_on_later(call: Call, folder: Path) -> None:
    command = [sys.executable, "-m", "dune_rl.train", *AUTO, "run_dir=run"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=folder, **pipes) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "Run folder: run\n"
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == ("", 141)
    assert (folder / "run" / LOCK_FILE).exists()
    assert call(train.main, *AUTO, "run_dir=run") == 0
    assert not (folder / "run" / LOCK_FILE).exists()


@pytest.mark.slow
def test_a_run_that_was_ended_amid_its_film_films_when_it_goes_on(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def end(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    with monkeypatch.context() as changed:
        changed.setattr(commands_train, "film_run", end)
        assert call(train.main, *AUTO, "run_dir=run", "film=true") == 130
    filmed: list[Path] = []
    monkeypatch.setattr(commands_train, "film_run", lambda *given: filmed.append(given[2].run_dir))
    assert call(train.main, *AUTO, "run_dir=run", "film=true") == 0
    assert len(filmed) == 1 and filmed[0].samefile(folder / "run")
    assert call(train.main, *AUTO, "run_dir=run", "film=true") == 0
    assert len(filmed) == 1


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on(call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as changed:
        changed.setattr(progress, "LineReporter", Stopping)
        assert call(train.main, *AUTO, "run_dir=run") == 143
    for name in ("config.yaml", "hydra.yaml", "overrides.yaml"):
        assert (folder / "run" / ".hydra" / name).is_file()
    assert call(train.main, *AUTO, "run_dir=run") == 0
    assert call(train.main, *SHORT, "run_dir=whole") == 0
    assert_equal_weights(folder / "run", folder / "whole")


@pytest.mark.slow
def test_a_run_without_a_save_begins_anew(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, cut = folder / "run", folder / "cut"
    assert call(train.main, *AUTO, "run_dir=run") == 0
    shutil.copytree(run, cut, ignore=shutil.ignore_patterns("checkpoint.pt"))
    before = files_of(cut)
    assert call(train.main, *AUTO, "run_dir=cut") == 2
    assert "of an earlier run, and no checkpoint.pt to go on with" in capsys.readouterr().err
    assert files_of(cut) == before

    # As one that was killed after an evaluation, before its first save.
    (cut / "policy_last.pt").unlink()
    before = files_of(cut)
    assert call(train.main, *AUTO, "run_dir=cut", "seed=2") == 2
    assert "cut holds a run of other settings: seed=2 (the run has 1)\n" in capsys.readouterr().err
    assert files_of(cut) == before
    assert call(train.main, *AUTO, "run_dir=cut") == 0
    assert_equal_weights(run, cut)
    assert len(list(cut.glob("events.out.tfevents.*"))) == 1


@pytest.mark.slow
def test_each_job_of_a_sweep_finds_its_own_run(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["-m", *AUTO, "hydra.sweep.dir=sweep", "seed=1,2"]
    with monkeypatch.context() as changed:
        changed.setattr(progress, "LineReporter", Stopping)
        assert call(train.main, *words) == 143
    jobs = [folder / "sweep" / f"{number}_flat_seed{number + 1}" for number in (0, 1)]
    assert [job.exists() for job in jobs] == [True, False]
    assert call(train.main, *words) == 0
    for seed, job in enumerate(jobs, start=1):
        assert call(train.main, *SHORT, f"seed={seed}", f"run_dir=whole{seed}") == 0
        assert_equal_weights(job, folder / f"whole{seed}")
        assert f"- seed={seed}\n" in (job / ".hydra" / "overrides.yaml").read_text()

    before = [files_of(job) for job in jobs]
    capsys.readouterr()
    assert call(train.main, *words) == 0
    assert capsys.readouterr().out.count(" is a finished run of 64 frames: there is nothing to do\n") == 2
    assert call(train.main, *words, "learning.tau=0.1") == 2
    error = capsys.readouterr().err
    for number, job in enumerate(jobs):
        shown = job.relative_to(folder)
        assert f"job {number} failed: {shown} holds a run of other settings: learning.tau=0.1" in error
    assert [files_of(job) for job in jobs] == before


def test_a_sweep_that_is_ended_says_how_to_go_on(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def end(*_: object, **__: object) -> NoReturn:
        raise Terminated

    monkeypatch.setattr(commands_train.hydra, "main", end)
    assert call(train.main, "-m", *SHORT, "hydra.sweep.dir=sweep", "seed=1,2") == 143
    assert "The sweep was ended at once. What its jobs saved last stays" in capsys.readouterr().err
    assert call(train.main, *SHORT, "run_dir=run") == 143
    assert not capsys.readouterr().err


@pytest.mark.slow
def test_a_finished_run_still_has_its_objective(call: Call, folder: Path) -> None:
    words = [*AUTO, "run_dir=run", "objective=min_clearance"]
    assert call(train.main, *words) == 0
    lock = lock_run(folder / "run")
    run = find_own_run(compose(Conf, words), (), lock)
    # Nothing is near on flat ground without actors.
    assert run is not None and run.is_finished and run.objective == pytest.approx(12.0)
    more = find_own_run(compose(Conf, [*words, "total_frames=96"]), (), lock)
    assert more is not None and not more.is_finished and more.conf.total_frames == 96


@pytest.mark.parametrize(
    ("words", "setting"), [(["seed=1"], "run_dir"), (["-m", "seed=1,2", "run_dir=run"], "hydra.sweep.dir")]
)
def test_the_folder_must_be_named(
    words: list[str], setting: str, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(train.main, "+world=flat", "resume=auto", *words) == 2
    assert capsys.readouterr().err == (
        "resume=auto looks for the run in its folder, which has a new name at each start: add "
        f"{setting}=FOLDER\n"
    )
    assert not list(folder.iterdir())


def test_a_folder_that_is_not_there_may_be_auto_misspelt(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(train.main, "+world=flat", "resume=autoo", "run_dir=run") == 2
    assert capsys.readouterr().err == (
        "There is no folder autoo; resume=auto goes on with the run that the same command began\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_saved_settings_equal_those_of_their_command(experiment: str) -> None:
    conf = compose(Conf, [f"+experiment={experiment}"])
    assert compose(Conf, (), (), conf.model_dump(mode="json")) == conf


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGUSR2])
def test_a_warning_of_a_batch_system_saves_and_is_handed_on(
    number: signal.Signals, call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Stopping, "signal", number)
    handled: list[bool] = []
    with monkeypatch.context() as changed:
        changed.setattr(progress, "LineReporter", Stopping)
        assert call(train.main, *AUTO, "run_dir=run") == 128 + number
        before = signal.signal(number, lambda *_: handled.append((folder / "again/checkpoint.pt").exists()))
        assert call(train.main, *AUTO, "run_dir=again") == 128 + number
        signal.signal(number, before)
    assert handled == [True]
    assert call(train.main, *AUTO, "run_dir=run") == 0
