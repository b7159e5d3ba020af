"""Training of the real environment: that it continues exactly, and (slow) that it learns."""

import csv
from functools import partial
from pathlib import Path

import pytest
from test_learning import SMALL, assert_halves_make_a_whole, trainer, weights

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.compose import compose
from dune_rl.train import train

MAKE_ENV = partial(make_torchrl_env, compose(["+world=inspection", "task.termination.max_steps=60"]))


def test_halves_make_a_whole_on_inspection(tmp_path: Path) -> None:
    assert_halves_make_a_whole(MAKE_ENV, tmp_path)


def test_a_run_stopped_during_its_warm_up_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    guided = SMALL.model_copy(update={"warm_up": "go_to_goal"})
    trainer(tmp_path / "whole", sac=guided, make_env=MAKE_ENV).train(stop_after_frames=1024)
    first = trainer(tmp_path / "halves", sac=guided, make_env=MAKE_ENV).train(stop_after_frames=256)
    assert first.frames < guided.learning_starts and first.updates == 0
    trainer(tmp_path / "halves", sac=guided, make_env=MAKE_ENV, resume=tmp_path / "halves").train(1024)
    whole, halves = weights(tmp_path / "whole"), weights(tmp_path / "halves")
    assert not [key for key, value in whole.items() if not value.equal(halves[key])]


@pytest.mark.slow
def test_quick_learns_flat(tmp_path: Path) -> None:
    train(compose(["+experiment=quick", f"run_dir={tmp_path / 'run'}"]))
    with (tmp_path / "run" / "metrics.csv").open() as file:
        last = [row for row in csv.DictReader(file) if row["kind"] == "eval"][-1]
    assert float(last["SR"]) >= 0.9
    assert (tmp_path / "run" / "curve.png").stat().st_size > 10_000
