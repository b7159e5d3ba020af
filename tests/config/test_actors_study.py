"""The study of actors: its policies are those of the commands that its page gives."""

import csv
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml
from documents import commands

from dune_rl.config.compose import compose
from dune_rl.learning.checkpoint import read_checkpoint_file
from dune_rl.learning.sac.settings import SacConf

STUDY = Path(__file__).parents[2] / "experiments" / "actors"
NAMES = ("walkers", "adversaries", "both", "longer", "social", "hardened", "guarded", "direct")
PAGE = STUDY / "README.md"
ROBOTS = ("walkers", "longer", "both", "social", "hardened", "guarded", "direct")
# Where those were tested that came later.
LATER = {"hardened": "cross_play_hardened", "guarded": "cross_play_hardened", "direct": "cross_play_direct"}
POPULATIONS = ("walkers", "two_social_force", "adversaries_1", "adversaries_2")
# What the machine decides.
_NOT_SET = ("device",)


def train_words() -> dict[str, list[str]]:
    """The words of the training commands of the page, by the name of their run, without its seed."""
    found = {}
    for line in commands(STUDY / "README.md"):
        words = shlex.split(line)
        if "dune_rl.train" in words:
            folder = next(word for word in words if word.startswith("run_dir="))
            name = folder.removeprefix("run_dir=runs/").removesuffix("_1")
            found[name] = words[words.index("dune_rl.train") + 1 :]
    return found


def test_the_page_gives_the_command_of_every_policy() -> None:
    assert tuple(train_words()) == NAMES
    folders = {path.parent.name for path in STUDY.glob("*/policy.pt")}
    assert folders == {f"{name}_{seed}" for name in NAMES for seed in (1, 2)}


@pytest.mark.slow(all_but=["walkers-1", "social-1"])
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", NAMES)
def test_a_policy_was_trained_with_the_settings_of_its_command(
    name: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(STUDY.parents[1])
    words = [word.replace("_1", f"_{seed}") for word in train_words()[name]]
    words = [f"seed={seed}" if word == "seed=1" else word for word in words]
    expected = compose(words).model_dump(mode="json")
    saved: dict[str, Any] = yaml.safe_load((STUDY / f"{name}_{seed}" / "config.yaml").read_text())
    used = read_checkpoint_file(STUDY / f"{name}_{seed}" / "policy.pt", "policy")["config"]
    for config in (saved, used):
        # Settings that came later are at their defaults.
        found = SacConf.model_validate(config["learning"]).model_dump(mode="json")
        # `auto` is stored as what it was.
        assert found.pop("precision") in ("float32", "bfloat16")
        learning = {key: value for key, value in expected["learning"].items() if key != "precision"}
        assert found == learning
        rest = {key: value for key, value in expected.items() if key not in ("learning", *_NOT_SET)}
        assert {key: config[key] for key in rest} == rest


def test_the_page_counts_how_episodes_end() -> None:
    """Its table of ends is that of the episodes' file: left the world / stuck or flipped / out of time."""
    lines = [line for line in PAGE.read_text().splitlines() if line[:1] == "|" and line.count(" / ") >= 6]
    robots = [f"{name}_{seed}" for seed in (1, 2) for name in ROBOTS]
    assert [line.split("|")[1].strip() for line in lines] == robots
    for line, robot in zip(lines, robots, strict=True):
        folder = STUDY / LATER.get(robot[:-2], "cross_play")
        ends = [_ends(folder / population, robot) for population in POPULATIONS]
        assert line == f"| {robot} | {' | '.join(ends)} |"


def _ends(folder: Path, robot: str) -> str:
    if not folder.is_dir():
        return "not run"
    with (folder / "episodes.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["policy"] == robot]
    failed = [row for row in rows if not float(row["reached"] or 0)]
    left = [row for row in failed if float(row["out_of_world"] or 0)]
    stuck = [row for row in failed if row not in left and (float(row["stuck"]) or float(row["flipped"]))]
    late = [row for row in failed if float(row["timeout"] or 0)]
    counts = [len(left), len(stuck), len(late)]
    assert len(rows) == 200 and sum(counts) == len(failed)
    return " / ".join(map(str, counts))
