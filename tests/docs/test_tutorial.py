"""The tutorial's commands, run one after another in one folder, each made short."""

import csv
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from documents import ROOT, TUTORIAL, commands
from user_packages import packages_on_path, write_package

from dune_rl import __main__ as overview
from dune_rl import evaluate, train
from dune_rl.view import main as view

STEPS = "task.terminations.time_limit.max_steps=20"
TRAINING = (
    *(
        "total_frames=64",
        "learning.learning_starts=32",
        "learning.batch_size=8",
        "learning.updates_per_frame=0.1",
    ),
    *("learning.collector.mode=serial", "learning.collector.scenes=2", "learning.collector.steps=8"),
    *(
        "learning.evaluation.episodes=1",
        "learning.evaluation.scenes=1",
        "learning.evaluation.every_frames=64",
    ),
    *(STEPS, "film=false"),
)
PICTURE = ("width=64", "height=64", "longest_s=0.5", "after_s=0.1", "samples=1")
MAP = ("dpi=72", "episodes=1", STEPS)


def shortened(words: list[str]) -> tuple[Callable[[], None], list[str]]:
    """The program of a command, and its words with those that make it short."""
    program, *given = words
    if program == "dune_rl.train":
        return train.main, [*given, *TRAINING]
    if program == "dune_rl.evaluate":
        given = [word for word in given if not word.startswith("episodes=")]
        return evaluate.main, [*given, "episodes=2", STEPS]
    assert program == "dune_rl.view"
    return view, [*given, *(MAP if "view=map" in given else PICTURE)]


@pytest.mark.slow
def test_every_command_of_the_tutorial_runs_in_its_order(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    call: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(write_package(TUTORIAL.read_text(), tmp_path))
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    shown = commands(TUTORIAL)
    assert shown[0] == "dune_rl" and len(shown) > 10
    monkeypatch.setattr("sys.argv", ["dune_rl"])
    assert overview.main() == 0
    with packages_on_path(tmp_path):
        for command in shown[1:]:
            program, words = shortened(shlex.split(command))
            code = call(program, *words)
            assert code == 0, (command, capsys.readouterr().err)
    assert {path.name for path in (tmp_path / "runs").iterdir()} >= {"first", "site", "careful", "crater"}
    written = {path.suffix for path in (tmp_path / "views").iterdir()}
    assert written == {".mp4", ".png"}
    tables = list(tmp_path.glob("evaluations/*inspection*/episodes.csv"))
    rows = [row for table in tables for row in csv.DictReader(table.read_text().splitlines())]
    hurried = [float(row["reward/hurry"]) for row in rows if "reward/hurry" in row]
    assert hurried and max(hurried) <= 0.0
