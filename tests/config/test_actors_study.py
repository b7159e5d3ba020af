"""The study of actors: its policies are those of the commands in `train.sh`."""

import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.learning.checkpoint import read_checkpoint_file

STUDY = Path(__file__).parents[2] / "experiments" / "actors"
NAMES = ("walkers", "adversaries", "both", "longer", "social", "hardened", "guarded", "direct")
# What the machine decides.
_NOT_SET = ("device",)


def train_words() -> dict[str, list[str]]:
    """The words of the training commands of the study, by the name of their run, without its seed."""
    found = {}
    for line in (STUDY / "train.sh").read_text().splitlines():
        words = shlex.split(line, comments=True)
        if "dune_rl.train" in words:
            folder = next(word for word in words if word.startswith("run_dir="))
            name = folder.removeprefix("run_dir=runs/").removesuffix("_1")
            found[name] = words[words.index("dune_rl.train") + 1 :]
    return found


def test_every_policy_has_its_command() -> None:
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
    expected = compose(Conf, words).model_dump(mode="json")
    saved: dict[str, Any] = yaml.safe_load((STUDY / f"{name}_{seed}" / "config.yaml").read_text())
    used = read_checkpoint_file(STUDY / f"{name}_{seed}" / "policy.pt", "policy")["config"]
    for config in (saved, used):
        # Settings that came later are at their defaults.
        found = compose(Conf, [], (), config).model_dump(mode="json")
        # `auto` is stored as what it was.
        assert found["learning"].pop("precision") in ("float32", "bfloat16")
        learning = {key: value for key, value in expected["learning"].items() if key != "precision"}
        assert found["learning"] == learning
        rest = {key: value for key, value in expected.items() if key not in ("learning", *_NOT_SET)}
        assert {key: found[key] for key in rest} == rest
