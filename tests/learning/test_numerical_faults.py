"""Numbers that are not finite: such an update or step is left out, and a run that diverges ends unspoilt."""

from pathlib import Path
from typing import Any

import pytest
import torch
from point_mass import make_point_mass
from tensordict import TensorDictBase
from training import SMALL_PPO, Notes, make_sac, small, trainer, weights

from dune_rl.core.errors import DivergenceError
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.learning.optimiser import FiniteAdam
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.run import finite
from dune_rl.learning.settings import CheckpointConf, LearningConf
from dune_rl.learning.trainer import Trainer


def spoil_losses(run: Trainer, name: str, spoiled: range) -> None:
    """Let the loss `name` of the run's calls numbered `spoiled` be NaN."""
    learner: Any = run._learners["rover"]
    loss = learner.loss if hasattr(learner, "loss") else learner._step.loss
    forward, calls = loss.forward, iter(range(10**9))

    def forward_or_nan(batch: TensorDictBase) -> TensorDictBase:
        losses = forward(batch)
        if next(calls) in spoiled:
            losses[name] = losses[name] * torch.nan
        return losses

    loss.forward = forward_or_nan


def test_a_step_without_finite_gradients_changes_nothing() -> None:
    layer = torch.nn.Linear(3, 2)
    optimiser = FiniteAdam(layer.parameters(), lr=0.1)
    for value in (1.0, torch.nan, torch.inf):
        before = [each.clone() for each in (*layer.parameters(), *_moments(optimiser))]
        optimiser.zero_grad()
        layer(torch.ones(4, 3)).square().mean().backward()
        layer.weight.grad[1, 2] *= value
        optimiser.step()
        after = [*layer.parameters(), *_moments(optimiser)]
        is_same = len(before) == len(after) and all(map(torch.equal, before, after))
        assert is_same == (value != 1.0)
    assert (optimiser.skipped, optimiser.in_a_row) == (2, 2)
    layer.weight.grad.fill_(1.0)
    optimiser.step()
    assert (optimiser.skipped, optimiser.in_a_row) == (2, 0)
    assert "skipped" not in optimiser.state_dict()


def _moments(optimiser: torch.optim.Optimizer) -> list[torch.Tensor]:
    return [value for state in optimiser.state.values() for value in state.values()]


@pytest.mark.parametrize(("conf", "name"), [(small(), "loss_qvalue"), (SMALL_PPO, "loss_critic")])
def test_an_update_with_a_loss_of_nan_is_left_out_and_told(
    conf: LearningConf, name: str, tmp_path: Path
) -> None:
    notes = Notes()
    run = trainer(tmp_path / "run", conf, reporter=notes)
    spoil_losses(run, name, range(2, 5))
    run.train(stop_after_frames=640)
    assert run._updates_left_out.scalars() == {"faults/skipped_updates": 3.0}
    assert len([line for line in notes.lines if "left out" in line]) == 1
    assert all(values.isfinite().all() for values in weights(tmp_path / "run").values())


def test_a_run_that_diverges_ends_and_keeps_its_last_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finite, "_MOST_IN_A_ROW", 10)
    conf = small(checkpoint=CheckpointConf(every_frames=640))
    run = trainer(tmp_path / "run", conf)
    spoil_losses(run, "loss_qvalue", range(12, 10**9))
    said = r"rover diverged: \d+ updates in a row .*\nThe last save is whole"
    with pytest.raises(DivergenceError, match=said):
        run.train()
    saved = torch.load(tmp_path / "run" / CHECKPOINT_FILE, weights_only=True)
    assert saved["counters"]["frames"] == 640 < run.frames
    assert trainer(tmp_path / "run", conf, resume=tmp_path / "run").frames == 640


def test_weights_that_are_lost_are_not_saved(tmp_path: Path) -> None:
    run = trainer(tmp_path / "run")
    run.train(stop_after_frames=128)
    before = (tmp_path / "run" / CHECKPOINT_FILE).read_bytes()
    resumed = trainer(tmp_path / "run", resume=tmp_path / "run")
    next(resumed._learners["rover"].policy.parameters()).data.fill_(torch.inf)
    said = r"weights are not finite\nThe last save is whole; go on from it with resume="
    with pytest.raises(DivergenceError, match=said):
        resumed.train(stop_after_frames=128)
    assert (tmp_path / "run" / CHECKPOINT_FILE).read_bytes() == before


def test_a_critic_of_nan_is_not_saved_either(tmp_path: Path) -> None:
    learner = make_sac(PolicySpec.of(make_point_mass(2, 0), "rover"), tmp_path, hidden=(8,))
    finite.check_weights({"rover": learner})
    critic = learner._step.loss.qvalue_network_params.flatten_keys()
    next(iter(critic.values())).data.view(-1)[0] = torch.nan
    with pytest.raises(DivergenceError, match="rover diverged: a part of its learner's state is NaN"):
        finite.check_weights({"rover": learner})
