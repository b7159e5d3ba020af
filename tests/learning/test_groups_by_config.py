"""Learners of groups with settings of their own, and groups that are frozen."""

from pathlib import Path

import pytest
import torch
from point_mass import make_team, make_two_groups
from training import small, trainer

from dune_rl.core.errors import CheckpointError
from dune_rl.learning.checkpoint import BEST_POLICY_FILE, CHECKPOINT_FILE, read_checkpoint_file
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import load_group_policy
from dune_rl.learning.settings import EvaluationConf

FEW = EvaluationConf(every_frames=10_000, episodes=2, scenes=2)
SHORT = small(hidden=(8,), learning_starts=128, evaluation=FEW)


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """A run of a rover and two walkers, whose walkers have smaller networks and learn more often."""
    run = tmp_path_factory.mktemp("runs") / "source"
    groups = {"walker": {"hidden": [4, 4], "updates_per_frame": 0.125, "replay": {"capacity": 500}}}
    learning = type(SHORT).model_validate({**SHORT.model_dump(), "groups": groups})
    made = trainer(run, learning, make_env=make_two_groups, total_frames=384)
    made.train()
    assert made._learners["walker"].updates == 2 * made._learners["rover"].updates > 0
    return run


@pytest.mark.slow
def test_each_group_has_settings_of_its_own(source: Path) -> None:
    sizes = {
        group: [tuple(value.shape) for key, value in entry["policy"].items() if key.endswith("weight")]
        for group, entry in read_checkpoint_file(source / BEST_POLICY_FILE, "policy")["groups"].items()
    }
    assert any(shape[0] == 8 for shape in sizes["rover"])
    assert (4, 4) in sizes["walker"] and (4, 4) not in sizes["rover"]


@pytest.mark.slow
def test_a_frozen_group_acts_by_its_policy_and_does_not_learn(source: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    learning = SHORT.model_copy(update={"groups": {"walker": {"frozen": str(source)}}})
    made = trainer(run, learning, make_env=make_two_groups, total_frames=384)
    before = {key: value.clone() for key, value in made._learners["walker"].policy.state_dict().items()}
    result = made.train(256)
    assert result.updates == made._learners["rover"].updates > 0
    after = made._learners["walker"].policy.state_dict()
    assert all(torch.equal(value, after[key]) for key, value in before.items())
    # It acts as it does in evaluations, without noise.
    env = make_two_groups(3, 5)
    observation = env.reset()
    policy = made._learners["walker"].policy
    assert torch.equal(
        policy(observation.clone())["walker", "action"], policy(observation.clone())["walker", "action"]
    )
    resumed = trainer(run, learning, make_env=make_two_groups, total_frames=384, resume=run)
    result = resumed.train()
    assert result.frames == 384 and set(result.evaluation) == {"rover", "walker"}
    spec = PolicySpec.of(env, "walker")
    played = load_group_policy(run, "walker", spec)[0].network.state_dict()
    saved = load_group_policy(source, "walker", spec)[0].network.state_dict()
    assert all(torch.equal(value, played[key]) for key, value in saved.items())
    learner = read_checkpoint_file(run / CHECKPOINT_FILE, "checkpoint")["groups"]["walker"]["learner"]
    assert learner.keys() == {"policy", "updates"}


def test_a_checkpoint_that_does_not_fit_is_named_with_its_setting(source: Path, tmp_path: Path) -> None:
    missing = SHORT.model_copy(update={"groups": {"walker": {"frozen": str(tmp_path / "none.pt")}}})
    with pytest.raises(CheckpointError, match=r"learning\.groups\.walker\.frozen: There is no .*none\.pt"):
        trainer(tmp_path / "a", missing, make_env=make_two_groups)
    other = SHORT.model_copy(update={"groups": {"rover": {"frozen": str(source)}}})
    made = trainer(tmp_path / "b", other, make_env=make_team)
    assert made._learners["rover"].context.spec == PolicySpec.of(make_team(1, 0), "rover")
    made._log.close()
    made._folder.release()
