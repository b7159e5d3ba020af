"""Proximal policy optimisation: its values, its probabilities, who is learned from, and that it learns."""

import statistics
from pathlib import Path

import pytest
import torch
from point_mass import PointMass, make_point_mass, make_team
from tensordict import TensorDict
from training import SMALL_PPO, assert_halves_make_a_whole, make_context, trainer

from dune_rl.learning.collector import TransitionCollector
from dune_rl.learning.group_policy import select_group
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.ppo.learner import Ppo
from dune_rl.learning.ppo.settings import PpoConf
from dune_rl.learning.settings import CollectorConf, EvaluationConf

TINY = PolicySpec({"goal": 2}, (-1.0,), (1.0,))


def make_ppo(spec: PolicySpec, folder: Path, agents: int = 1, **settings: object) -> Ppo:
    return Ppo(make_context(spec, folder, agents=agents), PpoConf(**settings))


def one_step_episodes(*, terminated: bool, scenes: int = 32, steps: int = 4) -> TensorDict:
    """Every step has a reward of 1 and ends its episode, by a termination or a time limit."""
    shape = [scenes, steps, 1]
    observation = TensorDict({"goal": torch.randn(*shape, 2)}, shape)
    flags = torch.full((*shape, 1), terminated)
    after = {
        "observation": observation,
        "reward": torch.ones(*shape, 1),
        "terminated": flags,
        "done": torch.ones_like(flags),
    }
    now = {
        "observation": observation,
        "action": torch.zeros(*shape, 1),
        "loc": torch.zeros(*shape, 1),
        "scale": torch.ones(*shape, 1),
        "done": torch.zeros_like(flags),
    }
    return TensorDict({**now, "next": TensorDict(after, shape)}, shape)


@pytest.mark.slow
@pytest.mark.parametrize("terminated", [True, False])
def test_time_limits_bootstrap_and_terminations_do_not(tmp_path: Path, terminated: bool) -> None:
    torch.manual_seed(0)
    ppo = make_ppo(
        TINY, tmp_path, hidden=(16,), gamma=0.9, learning_rate=1e-2, reward_scale=1.0, batch_size=64
    )
    for _ in range(8):
        ppo.absorb(one_step_episodes(terminated=terminated), 0)
        ppo.update()
    value = ppo._critic(torch.zeros(1, 2)).item()
    # A reward of 1 for ever is worth 1 / (1 - 0.9) = 10; one that ends the episode is worth 1.
    if terminated:
        assert value == pytest.approx(1.0, abs=0.3)
    else:
        assert value > 3


def collect(ppo: Ppo, make_env=make_point_mass) -> TensorDict:
    """A batch (4, 60, G) of a policy's own steps."""
    conf = CollectorConf(mode="serial", scenes=4, steps=60)
    collector = TransitionCollector(conf, make_env, {"rover": ppo.policy}, seed=0)
    batch = select_group(next(iter(collector)), "rover")
    collector.close()
    return batch


def test_the_first_pass_finds_the_probabilities_that_the_batch_was_collected_with(tmp_path: Path) -> None:
    torch.manual_seed(0)
    spec = PolicySpec.of(make_point_mass(1, 0), "rover")
    ppo = make_ppo(spec, tmp_path, hidden=(16,), epochs=1, batch_size=10_000, learning_rate=1e-3)
    first = collect(ppo)
    ppo.absorb(first, 0)
    assert ppo.update() == {} and ppo.updates == 0
    second = collect(ppo)
    ppo.absorb(second, 0)
    found = ppo.update()
    assert found["ppo/kl"] == pytest.approx(0.0, abs=1e-6) and found["ppo/clipped"] == 0.0
    # The same batch again: the policy has moved.
    ppo.absorb(second, 0)
    assert abs(ppo.update()["ppo/kl"]) > 1e-5


@pytest.mark.slow
def test_nothing_is_learned_from_agents_that_idle(tmp_path: Path) -> None:
    spec = PolicySpec.of(make_team(1, 0), "rover")
    results = []
    for reward in (0.0, 1e6):
        torch.manual_seed(0)
        ppo = make_ppo(spec, tmp_path, agents=3, hidden=(16,), batch_size=64)
        batch = collect(ppo, make_team)
        # The first agent reaches its goal in step 9, and idles until step 39, in which the episode ends.
        batch["next", "done"][:, 9:40, 0] = True
        batch["done"][:, 10:40, 0] = True
        batch["next", "reward"][batch["done"]] = reward
        for _ in range(2):
            ppo.absorb(batch, 0)
            losses = ppo.update()
        results.append((losses, ppo.state_dict()["loss"]))
    assert results[0][0] == results[1][0]
    assert all(torch.equal(value, results[1][1][key]) for key, value in results[0][1].items())


@pytest.mark.slow
def test_halves_make_a_whole(tmp_path: Path) -> None:
    assert_halves_make_a_whole(make_team, tmp_path, SMALL_PPO, frames=640, half=300)


def test_images_are_learned_from(tmp_path: Path) -> None:
    def make_env(scenes: int, seed: int) -> PointMass:
        return PointMass(scenes, seed, image=(8, 8, 3))

    result = trainer(tmp_path / "run", SMALL_PPO, make_env=make_env, total_frames=256).train()
    assert result.updates == SMALL_PPO.epochs * 2


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["sync", "async"])
def test_it_learns_from_worker_processes(tmp_path: Path, mode: str) -> None:
    collector = CollectorConf(mode=mode, workers=1, scenes=8, steps=16)
    learning = SMALL_PPO.model_copy(update={"collector": collector})
    result = trainer(tmp_path / "run", learning, total_frames=512).train()
    assert result.frames == 512 and result.updates == 3 * 2 * 2


@pytest.mark.slow
def test_learns_to_reach_the_goal(tmp_path: Path) -> None:
    learning = SMALL_PPO.model_copy(
        update={
            "hidden": (64, 64),
            "batch_size": 128,
            "epochs": 8,
            "gamma": 0.9,
            "learning_rate": 3e-3,
            "reward_scale": 1.0,
            "collector": CollectorConf(mode="serial", scenes=16, steps=16),
            "evaluation": EvaluationConf(every_frames=10**6, episodes=20, scenes=20),
        }
    )
    rates = []
    for seed in (1, 2, 3):
        run = trainer(tmp_path / str(seed), learning, total_frames=6144, seed=seed)
        rates.append(statistics.fmean(row["success"] for row in run.train().evaluation["rover"]))
    assert statistics.median(rates) > 0.8
