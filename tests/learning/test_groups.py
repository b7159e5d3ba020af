"""Teams and several groups: what a learner is given, and how a run names things."""

import csv
from pathlib import Path

import pytest
import torch
from point_mass import PointMass, make_team, make_two_groups
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torchrl.envs.utils import check_env_specs
from training import assert_halves_make_a_whole, make_sac, small, trainer, weights

from dune_rl.config.build import make_learning_env
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import CheckpointError
from dune_rl.learning.checkpoint import BEST_POLICY_FILE, read_checkpoint_file
from dune_rl.learning.collector import TransitionCollector
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.group_policy import agent_sequences, select_group
from dune_rl.learning.policies import GoToGoal, WarmupPolicy, built_in_policy
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import load_group_policy, load_policy
from dune_rl.learning.settings import CollectorConf
from dune_rl.statistics.measures import average_metrics


@pytest.mark.parametrize("make_env", [make_team, make_two_groups])
def test_the_stand_in_keeps_the_convention(make_env) -> None:
    check_env_specs(make_env(3, 0), return_contiguous=False)


@pytest.fixture(scope="module")
def batch():
    """Two scenes of three points that mostly reach their goals, over several episodes."""
    env = make_team(2, 0)
    policy = WarmupPolicy("rover", PolicySpec.of(env, "rover"))
    torch.manual_seed(1)
    conf = CollectorConf(mode="serial", scenes=2, steps=100)
    collector = TransitionCollector(conf, make_team, {"rover": policy}, seed=0)
    collected = next(iter(collector)).clone()
    collector.close()
    return collected


def test_an_agent_that_is_done_stays_so_until_its_scene_is_reset(batch) -> None:
    before, after = batch["rover", "done"].squeeze(-1), batch["next", "rover", "done"].squeeze(-1)
    root = batch["next", "done"].squeeze(-1)
    assert root.sum() >= 4 and (before.any(-1) & ~root).any()
    # A scene's reset clears its own agents alone; the other scene's are left as they are.
    assert torch.equal(before[:, 1:], after[:, :-1] & ~root[:, :-1, None])


def test_sequences_are_of_one_agent_each(batch) -> None:
    sequences = agent_sequences(select_group(batch, "rover"))
    assert sequences.batch_size == (6, 100)
    for scene in range(2):
        for agent in range(3):
            ours, theirs = sequences[3 * scene + agent], batch["rover"][scene, :, agent]
            assert torch.equal(ours["observation", "goal"], theirs["observation", "goal"])
            assert torch.equal(ours["action"], theirs["action"])


def test_idle_agents_are_left_out_and_the_others_bootstrap_on_their_own_ends(batch, tmp_path: Path) -> None:
    spec = PolicySpec.of(make_team(1, 0), "rover")
    sac = make_sac(spec, tmp_path, hidden=(8,), n_steps=5, gamma=0.9, agents=3)
    group = select_group(batch, "rover")
    rows = sac._codec.encode(agent_sequences(group))
    active = ~batch["rover", "done"].squeeze(-1)
    assert 0 < len(rows) == int(active.sum()) < active.numel()
    decoded = sac._codec.decode(rows, lambda packed: packed.floats, 1.0)
    expected = []
    for scene in range(2):
        for agent in range(3):
            steps = range(100)
            own = batch["next", "rover"][scene, :, agent]
            for start in (t for t in steps if active[scene, t, agent]):
                total, t = 0.0, start
                for ahead, t in enumerate(range(start, min(start + 5, 100))):
                    total += 0.9**ahead * own["reward"][t].item()
                    if own["done"][t]:
                        break
                later = own["observation", "goal"][t].tolist()
                expected.append([total, float(own["terminated"][t]), t - start + 1, *later])
    got = torch.cat(
        [
            decoded["next", "reward"],
            decoded["next", "terminated"].float(),
            decoded["steps_to_next_obs"],
            decoded["next", "features"][:, :2],
        ],
        1,
    )
    torch.testing.assert_close(got, torch.tensor(expected))
    assert got[:, 1].any() and not got[:, 1].all()


def test_an_end_of_the_scene_ends_every_sequence(batch) -> None:
    ends = batch["next", "done"].unsqueeze(-2).expand(-1, -1, 3, -1)
    changed = batch.clone()
    changed["next", "rover", "done"].zero_()
    assert torch.equal(select_group(changed, "rover")["next", "done"], ends)
    assert not changed["next", "rover", "done"].any(), "the batch itself is left as it was"


@pytest.mark.slow
def test_halves_of_a_team_make_a_whole(tmp_path: Path) -> None:
    assert_halves_make_a_whole(make_team, tmp_path, frames=1024, half=700)


@pytest.fixture(scope="module")
def two_groups(tmp_path_factory):
    """The folder and the result of a run of a rover and two walkers."""
    run = tmp_path_factory.mktemp("runs") / "run"
    learning = small(warm_up="go_to_goal", hidden=(16,))
    return run, trainer(run, learning, make_env=make_two_groups, total_frames=768).train()


@pytest.mark.slow
def test_every_group_has_a_learner_and_files_of_its_own(two_groups) -> None:
    run, result = two_groups
    assert result.updates == 2 * ((768 - 512 + 128) // 16)
    assert {key.partition(".")[0] for key in weights(run)} == {"rover", "walker"}
    assert len(result.evaluation["rover"]) == 10 and len(result.evaluation["walker"]) == 20
    with (run / "metrics.csv").open() as file:
        assert {row["group"] for row in csv.DictReader(file)} == {"rover", "walker"}
    names = {path.name for path in run.glob("replay-*")}
    assert names == {"replay-rover-768.npy", "replay-walker-768.npy"}
    env = make_two_groups(2, 0)
    policy, config = load_policy(run, env)
    assert config["seed"] == 3
    assert config["learning"]["hidden"] == [16]
    assert policy(env.reset())["walker", "action"].shape == (2, 2, 2)
    saved = read_checkpoint_file(run / BEST_POLICY_FILE, "policy")["groups"]
    assert saved["rover"]["algorithm"] == saved["walker"]["algorithm"] == "sac"


def scalar_tags(run: Path) -> set[str]:
    events = EventAccumulator(str(run))
    events.Reload()
    return set(events.Tags()["scalars"])


@pytest.mark.slow
def test_tags_begin_with_the_group_where_there_are_several(tmp_path: Path, two_groups) -> None:
    several = scalar_tags(two_groups[0])
    assert {"walker/warmup/SR", "rover/eval/SR", "walker/reward/goal", "speed/frames"} <= several
    assert "train/SR" not in several
    learning = small(learning_starts=0, warm_up="go_to_goal")
    trainer(tmp_path, learning, make_env=make_team, total_frames=512).train()
    assert {"train/SR", "eval/SR", "reward/progress", "loss/critic", "speed/frames"} <= scalar_tags(tmp_path)


def test_a_policy_serves_a_group_of_another_name_or_size(tmp_path: Path) -> None:
    trainer(tmp_path / "run", make_env=make_team).train(stop_after_frames=128)
    env = PointMass(2, 0, groups={"pack": 5})
    assert load_policy(tmp_path / "run", env)[0](env.reset())["pack", "action"].shape == (2, 5, 2)


@pytest.mark.slow
def test_a_missing_group_is_named(two_groups) -> None:
    run, _ = two_groups
    spec = PolicySpec.of(make_team(1, 0), "rover")
    assert load_group_policy(run, "walker", spec)[0].group == "walker"
    with pytest.raises(CheckpointError, match="no policy for the group dog, but for rover, walker"):
        load_group_policy(run, "dog", spec)


def test_an_evaluation_has_a_row_for_each_agent_of_an_episode() -> None:
    rows = evaluate(built_in_policy("go_to_goal", make_team(1, 0)), make_team(3, 0), 4, seed=5)["rover"]
    assert [(row["episode"], row["agent"]) for row in rows] == [(e, a) for e in range(4) for a in range(3)]
    alone = evaluate(built_in_policy("go_to_goal", make_team(1, 0)), make_team(1, 0), 4, seed=5)["rover"]
    assert [row["steps"] for row in alone] == [row["steps"] for row in rows]


def test_go_to_goal_drives_each_agent_to_its_own_goal() -> None:
    env = make_team(1, 0)
    now = env.reset()
    bearing = now["rover", "observation", "goal"][..., 1]
    action = GoToGoal("rover", PolicySpec.of(env, "rover"))(now)["rover", "action"]
    assert torch.equal(action[..., 1], bearing) and bearing.unique().numel() == 3


def test_go_to_goal_brings_cars_to_goals_wherever_they_are() -> None:
    # A car cannot turn on the spot.
    conf = compose_environment("flat", ["agents={car: {body: car, controller: external}}"])
    env = make_learning_env(conf, 8, seed=1)
    rows = evaluate(built_in_policy("go_to_goal", env), env, 8, seed=1)["car"]
    env.close()
    assert average_metrics(rows)["TR"] >= 0.75


@pytest.mark.slow
def test_two_workers_in_step_hand_over_the_scenes_of_both(tmp_path: Path) -> None:
    conf = CollectorConf(mode="sync", workers=2, scenes=4, steps=8)
    learning = small(learning_starts=64, warm_up="go_to_goal", hidden=(8,), collector=conf)
    result = trainer(tmp_path / "run", learning, make_env=make_two_groups, total_frames=512).train()
    assert result.frames == 512 and result.updates > 0
