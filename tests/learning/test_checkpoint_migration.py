"""Files of format 2, of one policy with flat keys, are read as those of groups."""

from functools import partial
from pathlib import Path

import pytest
import torch
from point_mass import PointMass, make_point_mass
from training import small, trainer, weights

from dune_rl.learning.checkpoint import CHECKPOINT_FILE, read_checkpoint_file
from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import load_group_policy

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


@pytest.mark.parametrize("study", ["flat/seed1", "flat/seed2"])
def test_policies_of_the_studies_load(study: str) -> None:
    file = EXPERIMENTS / study / "policy.pt"
    saved = torch.load(file, weights_only=True)
    assert saved["version"] == 2
    spec = PolicySpec.from_plain(saved["layout"])
    policy, config = load_group_policy(file, "rover", spec)
    assert isinstance(policy, GroupPolicy) and config == saved["config"]
    state = policy.network.state_dict()
    assert all(torch.equal(state[key], value) for key, value in saved["policy"].items())
    assert read_checkpoint_file(file, "policy")["groups"].keys() == {"rover"}


def as_version_2(file: Path) -> None:
    """Rewrite a checkpoint of format 3, of one group, in format 2."""
    content = torch.load(file, weights_only=True)
    (group,) = content.pop("groups").values()
    learner, counters = group["learner"], content["counters"]
    counters |= {"updates": learner.pop("updates"), "updates_due": learner.pop("updates_due")}
    counters["best_success"] = counters.pop("best_score")
    ((recent,), history) = content["log"]["recent"].values(), content["log"]["history"]
    old = {
        **content,
        "version": 2,
        "layout": group["spec"],
        "architecture": group["network"],
        "learner": learner,
        "replay": group["experience"],
        "log": {**recent, "history": history},
    }
    torch.save(old, file)


@pytest.mark.parametrize("robot", ["rover_zero", "dog"])
def test_a_run_goes_on_from_a_checkpoint_of_format_2(tmp_path: Path, robot: str) -> None:
    make_env = make_point_mass if robot == "rover_zero" else partial(PointMass, groups={"dog": 1})
    learning = small(hidden=(8,))
    run = tmp_path / "run"
    first = trainer(run, learning, make_env=make_env)
    first._folder.config["robot"] = {"name": robot}
    updates = first.train(stop_after_frames=640).updates
    before = weights(run)
    as_version_2(run / CHECKPOINT_FILE)
    again = trainer(run, learning, make_env=make_env, resume=run)
    assert (again.frames, again.updates) == (640, updates)
    (learner,) = again._learners.values()
    state = learner.state_dict()
    group = learner.context.group
    assert all(torch.equal(value, before[f"{group}.{key}"]) for key, value in state["policy"].items())
    assert all(torch.equal(value, before[f"{group}.{key}"]) for key, value in state["loss"].items())
    assert len(learner._replay) == 640
    assert again.train(stop_after_frames=768).frames == 768
