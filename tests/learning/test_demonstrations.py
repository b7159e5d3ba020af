"""Data of a driver beside the learner's own, in every batch."""

from functools import partial
from pathlib import Path

import pytest
import torch
from training import SMALL, small, trainer

from dune_rl.config.build import make_learning_env
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.learning.sac.settings import DemonstrationsConf, SacConf
from dune_rl.learning.settings import EvaluationConf

FLAT = partial(
    make_learning_env,
    compose_environment("flat", ["actors=none", "sensors=[goal,velocity]"]),
)


def learning_from(driver: str) -> SacConf:
    return small(
        hidden=(8,),
        batch_size=32,
        demonstrations=DemonstrationsConf(driver=driver, frames=64, share=0.25),
        collector=SMALL.collector.model_copy(update={"scenes": 2, "steps": 16}),
        evaluation=EvaluationConf(every_frames=10_000, episodes=1, scenes=1),
    )


def test_a_driver_demonstrates_first_and_every_batch_has_its_share(tmp_path: Path) -> None:
    made = trainer(tmp_path / "run", learning_from("planner"), make_env=FLAT, total_frames=10_000)
    learner = made._learners["rover"]
    result = made.train(stop_after_frames=128)
    assert result.frames == 128 and result.updates == (128 - 64 + 32) // 16
    assert len(learner._demonstrations.replay) == len(learner._replay) == 64
    # Towards the goal at full speed, which noise is not.
    driven = learner._demonstrations.replay._buffer.storage[:]
    own = learner._replay._buffer.storage[:]
    split = [*learner._codec._widths]
    speed, heading = (driven.split(split, -1)[2][:, each] for each in range(2))
    goal = driven[:, :2]
    assert (speed > 0.9 * learner.context.spec.high[0]).float().mean() > 0.5
    assert (heading * goal[:, 1] > 0).float().mean() > 0.8
    (rows,) = learner._demonstrations.minibatches(learner._replay, 1, 32)
    known = {row.numpy().tobytes() for row in driven}
    assert sum(row.numpy().tobytes() in known for row in rows) == 8
    assert not {row.numpy().tobytes() for row in own} & known
    again = trainer(
        tmp_path / "run",
        learning_from("planner"),
        make_env=FLAT,
        total_frames=10_000,
        resume=tmp_path / "run",
    )
    resumed = again._learners["rover"]
    assert torch.equal(resumed._demonstrations.replay._buffer.storage[:], driven)
    assert resumed.warmup_frames == 64 and again.frames == 128
    again._log.close()
    again._folder.release()


@pytest.mark.parametrize(
    ("driver", "fault"),
    [
        ("plannr", r"driver=plannr: there is no behaviour 'plannr'; did you mean planner\?"),
        ("mppi", r"driver=mppi: .* has no lidar"),
    ],
)
def test_a_driver_that_cannot_drive_is_refused_before_training(
    tmp_path: Path, driver: str, fault: str
) -> None:
    with pytest.raises(ConfigError, match=r"learning\.demonstrations\." + fault):
        trainer(tmp_path / "run", learning_from(driver), make_env=FLAT)
