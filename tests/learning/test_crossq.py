"""CrossQ: values without target networks, statistics of batches, and resuming."""

from pathlib import Path

import pytest
import torch
from point_mass import make_point_mass
from test_sac import TINY, _one_step_episodes
from training import SMALL, assert_halves_make_a_whole, make_context

from dune_rl.learning.crossq.learner import BatchRenorm, Crossq
from dune_rl.learning.crossq.settings import CrossqConf

SMALL_CROSSQ = CrossqConf(
    hidden=(16,),
    batch_size=64,
    learning_starts=64,
    warm_up="random",
    norm_warm_up=8,
    precision="float32",
    replay=SMALL.replay,
    collector=SMALL.collector,
    evaluation=SMALL.evaluation,
    checkpoint=SMALL.checkpoint,
)


@pytest.mark.slow
@pytest.mark.parametrize("terminated", [True, False])
def test_time_limits_bootstrap_and_terminations_do_not(tmp_path: Path, terminated: bool) -> None:
    torch.manual_seed(0)
    conf = CrossqConf(
        hidden=(16,),
        gamma=0.9,
        learning_rate=2e-2,
        initial_entropy_coefficient=1e-9,
        precision="float32",
        norm_momentum=0.1,
    )
    crossq = Crossq(make_context(TINY, tmp_path), conf)
    steps = _one_step_episodes(TINY, terminated=terminated)
    # A batch has statistics where its members differ.
    for part in (steps, steps["next"]):
        part["observation", "goal"].normal_()
    steps["action"].uniform_(-1.0, 1.0)
    rows = crossq._codec.encode(steps)
    crossq._learn([rows] * 60)
    values = crossq._step.action_values(lambda encode: crossq._codec.decode(rows, encode, 1.0))
    if terminated:
        assert values.mean().item() == pytest.approx(1.0, abs=0.3)
    else:
        assert values.mean() > 5


def test_the_correction_of_batch_statistics_does_not_grow() -> None:
    torch.manual_seed(0)
    norm = BatchRenorm(1, warmup_steps=4)
    batch = 10.0 * torch.randn(64, 1)
    for _ in range(4):
        norm(batch)
    # The running deviation is still about 1, so that the correction is at its bound, 3.
    first = norm(batch).std().item()
    for _ in range(6):
        later = norm(batch).std().item()
    assert first == pytest.approx(3.0, rel=0.2) and later <= first * 1.01


@pytest.mark.slow
def test_halves_make_a_whole(tmp_path: Path) -> None:
    assert_halves_make_a_whole(make_point_mass, tmp_path, SMALL_CROSSQ, frames=384, half=200)
