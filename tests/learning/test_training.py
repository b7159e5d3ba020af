"""Training of the real environment: that it continues exactly, and (slow) that it learns."""

import csv
from functools import partial
from pathlib import Path

import pytest
from training import assert_halves_make_a_whole, small

from dune_rl.commands.train import train
from dune_rl.config.build import make_learning_env
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf

CONF = compose(Conf, ["+world=inspection", "task.terminations.time_limit.max_steps=40"])
MAKE_ENV = partial(make_learning_env, CONF)


@pytest.mark.slow
def test_halves_make_a_whole_on_inspection(tmp_path: Path) -> None:
    learning = small(learning_starts=128, warm_up="go_to_goal", hidden=(16,))
    assert_halves_make_a_whole(MAKE_ENV, tmp_path, learning, frames=512, half=300)


@pytest.mark.slow
def test_quick_learns_flat(tmp_path: Path) -> None:
    train(compose(Conf, ["+experiment=quick", f"run_dir={tmp_path / 'run'}"]))
    with (tmp_path / "run" / "metrics.csv").open() as file:
        last = [row for row in csv.DictReader(file) if row["kind"] == "eval"][-1]
    assert float(last["SR"]) >= 0.9
    assert (tmp_path / "run" / "curve.png").stat().st_size > 10_000
