"""Past policies as opponents: who acts in which episode, what is learned of it, and resuming."""

from pathlib import Path

import pytest
import torch
from point_mass import PointMass, make_two_groups
from training import assert_halves_make_a_whole, make_sac, small, trainer

from dune_rl.learning.checkpoint import CHECKPOINT_FILE, read_checkpoint_file
from dune_rl.learning.collector import TransitionCollector
from dune_rl.learning.group_policy import PAST, acted_by_past, agent_sequences, select_group
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.population import DRAWS, Population, PopulationPolicy
from dune_rl.learning.settings import CollectorConf, EvaluationConf, PopulationConf

ALWAYS = PopulationConf(probability=1.0, every_frames=100, size=2)


def learners(folder: Path) -> dict:
    """Untrained learners of the rover and of the walkers."""
    env = make_two_groups(1, 0)
    torch.manual_seed(0)
    return {
        group: make_sac(PolicySpec.of(env, group), folder, hidden=(8,), group=group, agents=len(agents))
        for group, agents in env.group_map.items()
    }


def constant_actions(policy: torch.nn.Module, value: float) -> None:
    """Let a policy act by `value`, a share of the bounds from -1 to 1, whatever it observes."""
    state = policy.state_dict()
    last = max((key for key in state if key.endswith("weight") and state[key].dim() == 2), key=lambda k: k)
    state[last].zero_()
    bias = state[last.replace("weight", "bias")]
    bias.zero_()
    bias[: len(bias) // 2] = torch.atanh(torch.tensor(value))
    policy.load_state_dict(state)


@pytest.fixture
def population(tmp_path: Path) -> Population:
    """Two snapshots of each group: the first stands still, the second goes at half the top speed."""
    found = Population(ALWAYS, learners(tmp_path))
    for frames, value in ((100, -0.999), (200, 0.5)):
        for learner in found._learners.values():
            constant_actions(learner.policy, value)
        assert found.take_if_due(frames) and not found.take_if_due(frames)
    for learner in found._learners.values():
        constant_actions(learner.policy, 0.999)
    return found


def collect(population: Population, *, scenes: int = 8, batches: int = 2, **changes) -> list:
    conf = CollectorConf(mode="serial", scenes=scenes, steps=60)
    policies = {group: learner.make_policy() for group, learner in population._learners.items()}
    collector = TransitionCollector(conf, make_two_groups, policies, 0, population=population, **changes)
    collector.send({group: learner.policy for group, learner in population._learners.items()})
    iterator = iter(collector)
    found = [next(iterator).clone() for _ in range(batches)]
    collector.close()
    return found


@pytest.mark.slow
def test_one_group_acts_as_at_present_and_the_others_by_their_past(population) -> None:
    batch = torch.cat(collect(population), dim=1)
    rover, walker = acted_by_past(batch, "rover"), acted_by_past(batch, "walker")
    assert (rover ^ walker).all() and rover.any() and walker.any()
    for group, past in (("rover", rover), ("walker", walker)):
        speed = batch[group, "action"][..., 0]
        # Snapshots act without noise: at a standstill nearly, or at half the top speed.
        slow = -0.999 * 0.8
        of_past = speed[past]
        assert torch.isclose(of_past, torch.tensor(slow), atol=5e-3).any()
        assert torch.isclose(of_past, torch.tensor(0.4), atol=5e-3).any()
        known = torch.isclose(of_past, torch.tensor(slow), atol=5e-3) | torch.isclose(
            of_past, torch.tensor(0.4), atol=5e-3
        )
        assert known.all()


@pytest.mark.slow
def test_who_acts_stays_the_same_for_an_episode_and_depends_on_it_alone(population) -> None:
    batch = torch.cat(collect(population, scenes=6), dim=1)
    ends = batch["next", "done"].squeeze(-1)
    past = acted_by_past(batch, "rover")
    changes = past[:, 1:] != past[:, :-1]
    assert changes.any() and not (changes & ~ends[:, :-1]).any()
    episode = batch["rover", "metrics"][..., 0, 0].long()
    by_episode = {}
    for scenes in (6, 4):
        other = torch.cat(collect(population, scenes=scenes), dim=1)
        ids, flags = other["rover", "metrics"][..., 0, 0].long(), acted_by_past(other, "rover")
        for key, flag in zip(ids.flatten().tolist(), flags.flatten().tolist(), strict=True):
            assert by_episode.setdefault(key, flag) == flag
    assert len(set(episode.flatten().tolist())) >= 16


@pytest.mark.slow
def test_nothing_is_learned_of_what_a_snapshot_did(population) -> None:
    batch = collect(population, batches=1)[0]
    for group in ("rover", "walker"):
        past = acted_by_past(batch, group)
        idle = select_group(batch, group)["done"].squeeze(-1)
        assert idle[past].all()
        assert torch.equal(idle[~past], batch[group, "done"].squeeze(-1)[~past])
        assert not batch[group, "done"].squeeze(-1)[past].all(), "the batch itself is left as it was"
        learner = population._learners[group]
        rows = learner._codec.encode(agent_sequences(select_group(batch, group)))
        assert len(rows) == int((~idle).sum())


@pytest.mark.slow
def test_without_snapshots_or_in_other_episodes_all_act_as_at_present(tmp_path: Path) -> None:
    empty = Population(ALWAYS, learners(tmp_path))
    assert not acted_by_past(collect(empty, batches=1)[0], "rover").any()
    rare = Population(ALWAYS.model_copy(update={"probability": 0.5}), learners(tmp_path))
    rare.take_if_due(100)
    batch = torch.cat(collect(rare, scenes=16), dim=1)
    both = acted_by_past(batch, "rover") | acted_by_past(batch, "walker")
    assert 0.25 < both[:, 0].float().mean() < 0.8
    assert torch.equal(both[:, 0], batch[DRAWS][:, 0, 0] < 0.5)


def test_a_new_snapshot_takes_the_place_of_the_oldest(population) -> None:
    first, second = population.snapshots["rover"]
    assert len(population) == 2
    assert population.take_if_due(555) and not population.take_if_due(599)
    newest, kept = population.snapshots["rover"]
    assert kept is second and newest is not first and len(population) == 2
    again = Population(ALWAYS, population._learners)
    again.restore(population.state())
    assert again.state().keys() == population.state().keys()
    assert not again.take_if_due(599) and again.take_if_due(600)
    other = Population(ALWAYS.model_copy(update={"size": 3}), population._learners)
    other.restore(population.state())
    assert len(other) == 0


def test_a_policy_begins_with_new_draws_in_any_number_of_scenes(population) -> None:
    policy = population.join({g: each.make_policy() for g, each in population._learners.items()})["walker"]
    assert isinstance(policy, PopulationPolicy)
    policy.fill(population.snapshots["walker"])
    for scenes in (3, 5):
        env = PointMass(scenes, 0, groups={"rover": 1, "walker": 2})
        seen = env.reset().set(DRAWS, torch.tensor([[0.0, 0.0, 0.0, 0.9]]).expand(scenes, 4))
        acted = policy(seen)
        assert acted["walker", PAST].shape == (scenes, 2, 1) and acted["walker", PAST].all()
        torch.testing.assert_close(acted["walker", "action"][..., 0], torch.full((scenes, 2), 0.4))


# -- runs ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_halves_with_a_population_make_a_whole(tmp_path: Path) -> None:
    population = PopulationConf(probability=0.8, every_frames=128, size=2)
    evaluation = EvaluationConf(every_frames=512, episodes=2, scenes=2)
    learning = small(hidden=(8,), population=population, learning_starts=256, evaluation=evaluation)
    assert_halves_make_a_whole(make_two_groups, tmp_path, learning, frames=1024, half=700)
    pools = [
        read_checkpoint_file(tmp_path / run / CHECKPOINT_FILE, "checkpoint")["population"]
        for run in ("whole", "halves")
    ]
    for pool in pools:
        assert pool["taken"] >= 3
        assert [len(found) for found in pool["snapshots"].values()] == [2, 2]
    for group in ("rover", "walker"):
        for one, other in zip(*(pool["snapshots"][group] for pool in pools), strict=True):
            assert all(torch.equal(value, other[key]) for key, value in one.items())


def test_who_acted_by_a_pool_of_another_size_acts_as_at_present(population) -> None:
    chosen = {"draws": torch.rand(4, 4), "chosen": torch.tensor([-1, 0, 1, 4])}
    for size, expected in ((2, [-1, 0, 1, -1]), (1, [-1, -1, -1, -1])):
        other = Population(ALWAYS.model_copy(update={"size": size}), population._learners)
        other.restore(population.state())
        policies = {group: learner.make_policy() for group, learner in population._learners.items()}
        policy = other.join(policies)["rover"]
        policy.fill(other.snapshots["rover"])
        policy.resume_episodes(chosen)
        assert policy.episodes()["chosen"].tolist() == expected


@pytest.mark.slow
def test_worker_processes_get_the_snapshots(tmp_path: Path) -> None:
    population = PopulationConf(probability=1.0, every_frames=128, size=2)
    learning = small(hidden=(8,), population=population, mode="async", learning_starts=0)
    run = trainer(tmp_path / "run", learning, make_env=make_two_groups, total_frames=1536)
    seen = []
    learn = run._learn

    def spy(batch):
        seen.append(acted_by_past(batch, "rover").float().mean().item())
        learn(batch)

    run._learn = spy
    run.train()
    assert max(seen) > 0.0
