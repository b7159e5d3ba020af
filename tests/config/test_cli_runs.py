"""Commands that train and evaluate: whole runs, sweeps and signals."""

import csv
import errno
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from test_overrides import CHOOSE, NO_MOON

from dune_rl import evaluate, train
from dune_rl.learning.run import progress
from dune_rl.learning.run.progress import LineReporter, TrainingStatus

TINY = [
    "total_frames=192",
    "film=false",
    "learning.learning_starts=64",
    "learning.batch_size=32",
    "learning.hidden=[16]",
    "learning.updates_per_frame=0.1",
    "learning.replay.capacity=1000",
    "learning.collector.mode=serial",
    "learning.collector.scenes=4",
    "learning.collector.steps=8",
    "learning.evaluation.episodes=2",
    "learning.evaluation.scenes=2",
    "task.terminations.time_limit.max_steps=20",
    "actors=none",
]
Call = Callable[..., int]


def test_train_resume_and_evaluate(call: Call, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(train.main, "+world=flat", "run_dir=run", "seed=3", *TINY) == 0
    run = folder / "run"
    assert {
        "checkpoint.pt",
        "policy_best.pt",
        "policy_last.pt",
        "metrics.csv",
        "curve.png",
        "config.yaml",
    } <= {path.name for path in run.iterdir()}
    assert list(run.glob("events.out.tfevents.*"))
    assert (run / ".hydra" / "config.yaml").exists()
    resolved = yaml.safe_load((run / "config.yaml").read_text())
    assert (resolved["seed"], resolved["world"]["name"], resolved["run_dir"]) == (3, "flat", str(run))
    assert "evaluate checkpoint=run " in capsys.readouterr().out

    assert call(train.main, "resume=run", "total_frames=256") == 0
    assert "after 256 frames" in capsys.readouterr().out
    assert yaml.safe_load((run / "config.yaml").read_text())["seed"] == 3

    written = (run / "checkpoint.pt").read_bytes()
    assert call(train.main, "+world=flat", "run_dir=run", *TINY) == 2
    assert capsys.readouterr().err == (
        "run already holds a run; continue it with resume=run, or choose another run_dir\n"
    )
    assert (run / "checkpoint.pt").read_bytes() == written

    assert call(evaluate.main, "checkpoint=run", "episodes=3", "seed=7") == 0
    assert "flat: 3 episodes of seed 7" in capsys.readouterr().out
    (results,) = (folder / "evaluations").glob("*_run_flat")
    with (results / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["policy"], row["episode"]) for row in rows] == [("run", "0"), ("run", "1"), ("run", "2")]

    assert call(evaluate.main, "checkpoint=run", "sensors.lidar.n_segments=16", "episodes=1") == 2
    assert "lidar has 32 values there, 16 values here" in capsys.readouterr().err

    (folder / "short.pt").write_bytes((run / "policy_best.pt").read_bytes()[:3000])
    assert call(evaluate.main, "checkpoint=short.pt") == 2
    message = capsys.readouterr().err
    assert "short.pt is truncated" in message
    assert message.count("\n") <= 2


@pytest.mark.slow
def test_a_run_ends_with_a_film_and_does_without_where_it_cannot_be_made(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["+world=flat", *TINY, "film=true"]
    assert call(train.main, "run_dir=filmed", *words) == 0
    assert (folder / "filmed" / "film.mp4").stat().st_size > 1000
    assert "  film.mp4" in capsys.readouterr().out

    def fail(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("dune_rl.reporting.views.film.write_video", fail)
    assert call(train.main, "run_dir=unfilmed", *words) == 0
    shown = capsys.readouterr()
    assert "note: film.mp4 is left out" in shown.err and "after 192 frames" in shown.out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "other", "words"),
    [
        ("bullet", "dart", ["+world=inspection", "robot=leo_rover"]),
        (
            "dart",
            "bullet",
            ["+world=island", "robot=hyperdog", "robot.action=joints", "learning.warm_up=random"],
        ),
    ],
    ids=["leo_rover", "hyperdog by joints"],
)
def test_a_policy_of_one_engine_is_evaluated_on_the_other(
    engine: str, other: str, words: list[str], call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(train.main, *words, *TINY, f"physics={engine}", "run_dir=run", "total_frames=96") == 0
    told = capsys.readouterr().out
    assert ("against=random" if "robot.action=joints" in words else "against=go_to_goal") in told
    if engine == "dart":
        assert call(train.main, "resume=run", "total_frames=128") == 0
        assert "after 128 frames" in capsys.readouterr().out
    for physics in (engine, other):
        assert (
            call(evaluate.main, "checkpoint=run", "episodes=2", f"physics={physics}", f"out={physics}") == 0
        )
    files = [folder / physics / "episodes.csv" for physics in (engine, other)]
    # The same episodes, which differ in their physics.
    one, two = (list(csv.DictReader(file.read_text().splitlines())) for file in files)
    assert [row["episode"] for row in one] == [row["episode"] for row in two] == ["0", "1"]
    assert {row["engine"] for row in one} == {engine} and {row["engine"] for row in two} == {other}
    assert [row["return"] for row in one] != [row["return"] for row in two]


@pytest.mark.slow
def test_a_kept_policy_arrives_on_the_second_engine(call: Call, folder: Path) -> None:
    policy = Path(__file__).parents[2] / "experiments" / "flat" / "seed1" / "policy.pt"
    assert call(evaluate.main, f"checkpoint={policy}", "episodes=2", "physics=dart", "out=rows") == 0
    rows = list(csv.DictReader((folder / "rows" / "episodes.csv").read_text().splitlines()))
    assert [row["success"] for row in rows] == ["1", "1"]


@pytest.mark.parametrize("policy", ["go_to_goal", "random"])
def test_built_in_policies(policy: str, call: Call, folder: Path) -> None:
    words = [
        "+world=flat",
        "episodes=2",
        "task.terminations.time_limit.max_steps=30",
        "out=new/rows",
        "actors=none",
    ]
    assert call(evaluate.main, f"policy={policy}", *words) == 0
    assert len((folder / "new" / "rows" / "episodes.csv").read_text().splitlines()) == 3


@pytest.mark.slow
def test_a_team_is_trained_and_several_groups_are_evaluated(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    team = "agents={rover: {body: rover_zero, count: 2}, scout: {body: leo_rover, controller: go_to_goal}}"
    words = [word for word in TINY if not word.startswith("actors")]
    assert call(train.main, "+world=flat", team, "run_dir=run", *words) == 0
    assert call(evaluate.main, "checkpoint=run", "episodes=2", "out=team") == 0
    rows = list(csv.DictReader((folder / "team" / "episodes.csv").read_text().splitlines()))
    assert [(row["agent"], row["episode"]) for row in rows] == [
        *(("rover_0", "0"), ("rover_1", "0"), ("rover_0", "1"), ("rover_1", "1")),
    ]
    robots = ["robots=[rover_zero,leo_rover]", "actors=external_walkers", "out=both"]
    limit = "task.terminations.time_limit.max_steps=20"
    assert call(evaluate.main, "+world=flat", "policy=go_to_goal", "episodes=1", *robots, limit) == 0
    told = capsys.readouterr().out
    assert "flat, rover: 1 episode of" in told and "flat, leo_rover: 1 episode of" in told
    rows = list(csv.DictReader((folder / "both" / "episodes.csv").read_text().splitlines()))
    assert [row["agent"] for row in rows] == ["rover_0", "leo_rover_0", "walker_0", "walker_1"]


def test_a_device_that_is_absent_leaves_nothing_behind(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert call(train.main, "+world=flat", "device=cuda", "run_dir=run") == 2
    assert capsys.readouterr().err == "device=cuda, but PyTorch finds no GPU here; use device=cpu\n"
    assert not list(folder.iterdir())


def test_a_refused_run_leaves_no_folder(call: Call, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = "+agents.other={body: truck, controller: dwa}"
    assert call(train.main, "+world=flat", other, "run_dir=runs/run") == 2
    assert "dwa cannot act for the group other" in capsys.readouterr().err
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_a_sweep_gives_each_job_its_folder_and_outlives_a_failure(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["-m", "+world=flat", "'task.spawn.region=[0,0.1,0,0.1],world'", "hydra.sweep.dir=sweep", *TINY]
    assert call(train.main, *(word.strip("'") for word in words)) == 2
    error = capsys.readouterr().err
    assert "job 0 failed: " in error
    assert "Traceback" not in error
    done = folder / "sweep" / "1_flat_seed1"
    assert yaml.safe_load((done / ".hydra" / "config.yaml").read_text())["task"]["spawn"]["region"] == "world"
    assert (done / "policy_best.pt").exists()
    assert list(done.glob("events.out.tfevents.*"))


@pytest.mark.slow(all_but=["*evaluate-words*"])
@pytest.mark.parametrize(
    ("program", "words", "message"),
    [
        (train, [], CHOOSE + "\n"),
        (train, ["+world=moon"], NO_MOON + "\n"),
        (train, ["-m", "+world=flat", "seed=1,-1"], "seed must be at least 0 (got -1)\n"),
        (train, ["+world=flat", "seed=-1", "+sensors.lidar.n_beam=5"],
         "sensors.lidar.n_beam is not a setting; did you mean sensors.lidar.n_beams?\n"
         "seed must be at least 0 (got -1)\n"),
        (train, ["+world=flat", "run_dir=file"],
         "cannot write file: a file of that name is in the way; choose another place\n"),
        (train, ["+world=flat", "run_dir=file/run"],
         "cannot write file/run: a part of the path is a file; choose another place\n"),
        (train, ["-m", "resume=run"],
         "resume=FOLDER goes on with one run; write resume=auto, or leave -m out\n"),
        (train, ["-m", "+world=flat", "run_dir=run", "seed=1,2"],
         "run_dir names the folder of one run; with -m write hydra.sweep.dir=FOLDER\n"),
        (train, ["-m", "+world=flat", "hydra/launcher=cluster"],
         "hydra/launcher=cluster: there is no such launcher here; pip install 'dune_rl[sweeps]' has joblib, "
         "submitit and Optuna, and docs/how_to/cluster.md says how to install Ray's\n"),
        (train, ["--wrold"], "there is no flag --wrold; settings are written key=value (see --help)\n"),
        (evaluate, ["policy=random", "+world=flat", "out=file/rows"],
         "cannot write file/rows: file is a file; choose another place\n"),
        (evaluate, ["policy=random", "+world=flat", "out=rows.csv"],
         "out=rows.csv: results are a folder of several files; write out=rows\n"),
        (evaluate, ["policy=randm", "+world=flat"],
         "policy: randm is no policy; did you mean random? There are dwa, dwa_oracle, go_to_goal, mppi, "
         "oracle, planner, random, FILE.onnx, MODULE:FUNCTION\n"),
        (evaluate, ["policy=random", "set=flat-v1", "world.size_m=30"],
         "set=flat-v1 determines world; leave world.size_m=30 out\n"),
        (evaluate, ["policy=random", "set=flat-v1", "episodes=201"],
         "set=flat-v1 has 200 episodes, fewer than episodes=201\n"),
        (evaluate, ["policy=model.zip", "+world=flat"],
         "policy: model.zip must be loaded by a function of yours: write policy=MODULE:FUNCTION "
         "(docs/how_to/evaluate.md has one for Stable-Baselines3)\n"),
        (evaluate, ["policy=runs/mine", "+world=flat"],
         "policy: runs/mine is no policy; did you mean checkpoint=runs/mine?\n"),
        (evaluate, ["verify=file"],
         "file holds no results of an evaluation (provenance.json is missing or damaged); give a folder "
         "that python -m dune_rl.evaluate wrote\n"),
        (evaluate, ["resume=file", "seed=3"],
         "resume=FOLDER has the settings of its folder; leave seed=3 out (it takes processes=N)\n"),
        (evaluate, ["verify=file", "sample=0"], "sample must be a whole number of at least 1 (got 0)\n"),
        (evaluate, ["-m", "policy=random"], "this command runs once; leave -m out\n"),
        (evaluate, ["+world=flat"],
         "choose a policy: checkpoint=PATH, or policy=NAME with dwa, dwa_oracle, go_to_goal, mppi, "
         "oracle, planner, random, FILE.onnx or MODULE:FUNCTION\n"),
    ],
)  # fmt: skip
def test_bad_input(
    program: object,
    words: list[str],
    message: str,
    call: Call,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (folder / "file").write_text("kept")
    assert call(program.main, *words) == 2
    assert capsys.readouterr().err == message
    assert [path.name for path in folder.iterdir()] == ["file"]
    assert (folder / "file").read_text() == "kept"


@pytest.mark.parametrize("words", [["resume=nowhere"], ["resume=empty"], ["resume=empty/policy_best.pt"]])
def test_nothing_to_resume(
    words: list[str], call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "empty").mkdir()
    assert call(train.main, *words) == 2
    error = capsys.readouterr().err
    assert 1 <= error.count("\n") <= 2
    assert "Traceback" not in error


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_save_and_end(
    number: int,
    code: int,
    call: Call,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Interrupting(LineReporter):
        def update(self, status: TrainingStatus) -> None:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(progress, "LineReporter", Interrupting)
    assert call(train.main, "+world=flat", "run_dir=run", *TINY) == code
    assert " -m dune_rl.train resume=run" in capsys.readouterr().err
    monkeypatch.setattr(progress, "LineReporter", LineReporter)
    assert call(train.main, "resume=run") == 0
    assert "after 192 frames" in capsys.readouterr().out
