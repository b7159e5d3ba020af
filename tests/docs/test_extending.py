"""The examples of docs/how_to/add_a*.md: a package of a user's, whose parts run from the command line."""

import csv
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from documents import extension_text
from user_packages import REGISTRIES, packages_on_path, shown_files, write_package

from dune_rl import evaluate, train

DOCS = extension_text()
COMMANDS = [
    found
    for found in re.findall(r"^python -m dune_rl\.(\w+) (.*)$", DOCS, flags=re.MULTILINE)
    # Those that change our own terms are for the tests of pages.
    if not re.search(r"rewards\.(contact|slow)", found[1])
]
MAINS = {"evaluate": evaluate.main, "train": train.main}
# What the table of an evaluation has beside its other rows, and files beside the others.
SHORT = ["task.terminations.time_limit.max_steps=40", "actors=none"]


@pytest.fixture
def package(folder: Path) -> Iterator[Path]:
    """The current folder, with the package that the docs show, installed."""
    write_package(DOCS, folder)
    with packages_on_path(folder):
        yield folder


def test_there_is_an_example_of_every_kind(package: Path) -> None:
    for registry in REGISTRIES:
        (name,) = (each for each in registry.user_names() if each not in registry.own)
        assert registry.settings_class(name) is not None
    modules = [content for name, content in shown_files(DOCS).items() if name.endswith(".py")]
    assert len(modules) == len(REGISTRIES) == len(COMMANDS)
    for content in modules:
        assert len([line for line in content.splitlines() if line.strip()]) <= 20, content


@pytest.mark.slow(all_but=["robot=slow_rover", "*compass*"])
@pytest.mark.parametrize(
    ("program", "words"), COMMANDS, ids=[words.split()[0:2][-1][:40] for _, words in COMMANDS]
)
def test_examples_run_from_the_command_line(
    program: str, words: str, package: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    given = shlex.split(words)
    short = [word for word in SHORT if not (word.startswith("actors") and "agents=" in words)]
    assert call(MAINS[program], *given, *short, *(["run_dir=run"] if program == "train" else [])) == 0
    told = capsys.readouterr()
    assert told.err == ""
    if program == "train":
        assert {"policy_best.pt", "metrics.csv"} <= {path.name for path in (package / "run").iterdir()}
        assert call(evaluate.main, "checkpoint=run", "episodes=1") == 0
        return
    (file,) = package.glob("evaluations/*/episodes.csv")
    (row,) = csv.DictReader(file.read_text().splitlines())
    assert row["policy"] == "go_to_goal"
    columns = {"upright": "reward/upright", "metrics.terms.speed": "speed"}
    for word, column in columns.items():
        assert (word in words) == (column in row)


def test_a_term_that_ends_episodes_does(package: Path, call: Callable[..., int]) -> None:
    words = ["+world=flat", "policy=random", "episodes=2", "actors=none", "task.terminations.idle.steps=1"]
    assert call(evaluate.main, *words, "robot.drive.max_speed_mps=0.01", "out=rows") == 0
    rows = list(csv.DictReader((package / "rows" / "episodes.csv").read_text().splitlines()))
    assert [int(row["steps"]) <= 3 for row in rows] == [True, True]
