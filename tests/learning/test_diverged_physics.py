"""A scene whose physics diverges while data are collected: the step is counted, told, and not learnt from."""

from pathlib import Path
from typing import Any

import torch
from point_mass import METRIC_NAMES, PointMass
from tensordict import TensorDictBase
from training import Notes, trainer

from dune_rl.learning.group_policy import select_group

_DIVERGED = METRIC_NAMES.index("diverged")


class Diverging(PointMass):
    """A point mass whose first scene diverges in its fifth step: the episode is truncated there."""

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after = super()._step(tensordict)
        wild = torch.zeros(self.batch_size, dtype=torch.bool)
        wild[0] = len(self._trace[0]) == 5
        after["rover", "metrics"][wild, :, _DIVERGED] = 1.0
        # What such a step earns means nothing.
        after["rover", "reward"][wild] = 1e6
        for part in (after, after["rover"]):
            part["truncated"][wild] = part["done"][wild] = True
            part["terminated"][wild] = False
        return after


def test_a_step_in_which_physics_diverged_is_not_learnt_from(tmp_path: Path) -> None:
    notes = Notes()
    run = trainer(tmp_path / "run", reporter=notes, make_env=Diverging)
    run.train(stop_after_frames=128)
    # Of 16 steps of the first scene three are the fifth of an episode; all others are in the buffer.
    assert run._diverged.scalars() == {"faults/diverged_episodes": 3.0}
    assert len([line for line in notes.lines if "diverged" in line]) == 1
    resumed = trainer(tmp_path / "run", resume=tmp_path / "run", make_env=Diverging)
    learner: Any = resumed._learners["rover"]
    assert len(learner._replay) == 128 - 3
    (rows,) = learner._replay.minibatches(1, 2048)
    assert rows.abs().max() < 1e3


def test_the_step_before_a_faulty_one_ends_its_sequence() -> None:
    env = Diverging(2, 1)
    batch = env.rollout(8, break_when_any_done=False, auto_reset=True)
    faulty = (batch["next", "rover", "metrics"][..., 0, _DIVERGED] > 0) & batch["next", "done"][..., 0]
    assert faulty.nonzero().tolist() == [[0, 4]]
    group = select_group(batch, "rover", faulty)
    idle, ends = group["done"][..., 0, 0], group["next", "done"][..., 0, 0]
    assert idle.nonzero().tolist() == [[0, 4]]
    assert ends.nonzero().tolist() == [[0, 3], [0, 4]]
    assert not group["next", "terminated"].any()
    assert not batch["rover", "done"].any()
