"""Recurrent policies: what they remember, where they forget, and that learning sees them as they acted."""

from pathlib import Path

import numpy as np
import pytest
import torch
from point_mass import PointMass, make_point_mass, make_team, make_two_groups
from tensordict import TensorDict
from training import SMALL_PPO, assert_halves_make_a_whole, make_context, trainer

from dune_rl.config.build import make_learning_env, make_simulation
from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose, compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.env.controllers import PolicyController
from dune_rl.learning.checkpoint import write_checkpoint_file
from dune_rl.learning.collector import TransitionCollector
from dune_rl.learning.group_policy import Deterministic, GroupPolicy, select_group
from dune_rl.learning.networks.policy import BEGINS, MEMORY, Architecture, make_policy_network
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.ppo.learner import Ppo
from dune_rl.learning.ppo.settings import PpoConf
from dune_rl.learning.saved_policies import load_policy, policy_entry
from dune_rl.learning.settings import CollectorConf, PopulationConf
from dune_rl.reporting.views.episode import EpisodeView

TINY = PolicySpec({"goal": 2}, (-1.0,), (1.0,))
RECURRENT = SMALL_PPO.model_copy(update={"recurrent": 8, "hidden": (16,)})


def test_memory_is_kept_until_an_episode_begins() -> None:
    network = make_policy_network(TINY, Architecture((8,), recurrent=4))
    policy = GroupPolicy("rover", TINY, network, ("action", "loc"))

    def act(begins: list[bool]) -> TensorDict:
        flags = torch.tensor(begins).view(2, 1, 1)
        parts = TensorDict(
            {"observation": TensorDict({"goal": torch.ones(2, 1, 2)}, [2, 1]), BEGINS: flags}, [2, 1]
        )
        return Deterministic(policy)(TensorDict({"rover": parts}, [2]))["rover"]

    first, second, third = act([True, True]), act([False, False]), act([True, False])
    assert first[MEMORY].abs().max() == 0.0 and second[MEMORY].abs().max() > 0.0
    assert not torch.allclose(first["loc"], second["loc"])
    assert torch.equal(third["loc"][0], first["loc"][0])
    assert not torch.allclose(third["loc"][1], first["loc"][1])


def test_learning_finds_the_probabilities_of_remembering_policies(tmp_path: Path) -> None:
    torch.manual_seed(0)
    spec = PolicySpec.of(make_team(1, 0), "rover")
    conf = PpoConf(hidden=(16,), recurrent=8, epochs=1, batch_size=10_000)
    ppo = Ppo(make_context(spec, tmp_path, agents=3), conf)
    # Episodes last 40 steps: batches begin in the middle of some, and others begin within them.
    collected = CollectorConf(mode="serial", scenes=4, steps=30)
    collector = TransitionCollector(collected, make_team, {"rover": ppo.make_policy()}, seed=0)
    collector.send({"rover": ppo.policy})
    for index, batch in zip(range(3), collector, strict=False):
        ppo.absorb(select_group(batch, "rover"), 0)
        losses = ppo.update()
        collector.send({"rover": ppo.policy})
        if index:
            assert losses["ppo/kl"] == pytest.approx(0.0, abs=1e-5) and losses["ppo/clipped"] == 0.0
    assert ppo.updates == 2
    collector.close()


@pytest.mark.slow
def test_halves_make_a_whole(tmp_path: Path) -> None:
    assert_halves_make_a_whole(make_point_mass, tmp_path, RECURRENT, frames=384, half=200)
    env = PointMass(2, 0)
    policy, _ = load_policy(tmp_path / "whole", env)
    observation = env.reset()
    first = policy(observation.clone())["rover", "action"]
    observation = env.step_mdp(env.step(policy(observation)))
    later = policy(observation.clone())["rover", "action"]
    again = policy(env.reset())["rover", "action"]
    assert first.shape == later.shape == again.shape == (2, 1, 2)


def test_a_policy_that_cannot_tell_where_episodes_begin_is_refused() -> None:
    policy = GroupPolicy("rover", TINY, make_policy_network(TINY, Architecture((8,), recurrent=4)))
    parts = TensorDict({"observation": TensorDict({"goal": torch.ones(2, 1, 2)}, [2, 1])}, [2, 1])
    with pytest.raises(ConfigError, match="cannot tell where episodes begin; append"):
        policy(TensorDict({"rover": parts}, [2]))


def test_past_opponents_are_refused(tmp_path: Path) -> None:
    learning = RECURRENT.model_copy(update={"population": PopulationConf(probability=0.5)})
    with pytest.raises(ConfigError, match=r"the policy of rover is recurrent.*learning\.recurrent=0"):
        trainer(tmp_path, learning, make_env=make_two_groups)


def test_a_controller_says_once_whose_episodes_begin() -> None:
    told: list[list[bool]] = []

    def act(readings: dict, begins: np.ndarray) -> np.ndarray:
        told.append(begins.tolist())
        return np.zeros((2, 1))

    controller = PolicyController(act)
    controller.reset(np.array([True, True]), None)  # type: ignore[arg-type]
    for mask in ([False, False], [False, True]):
        controller.act(None, None, dict)  # type: ignore[arg-type]
        controller.reset(np.array(mask), None)  # type: ignore[arg-type]
    controller.act(None, None, dict)  # type: ignore[arg-type]
    assert told == [[True, True], [False, False], [False, True]]


@pytest.mark.slow
def test_saved_policies_remember_in_true_physics(tmp_path: Path) -> None:
    words = ["actors=none", "sensors=[goal,velocity]"]
    conf = compose(ViewConf, ["+world=flat", *words])
    env = make_learning_env(conf, 2, 0)
    ppo = Ppo(make_context(PolicySpec.of(env, "rover"), tmp_path), PpoConf(hidden=(8,), recurrent=4))
    content = {"groups": {"rover": policy_entry(ppo)}, "config": {}, "frames": 0}
    file = tmp_path / "policy.pt"
    write_checkpoint_file(file, "policy", content)
    policy, _ = load_policy(file, env)
    observation = env.reset()
    memories = []
    for _ in range(3):
        observation = policy(observation)
        memories.append(observation["rover", MEMORY].abs().amax().item())
        observation = env.step_mdp(env.step(observation))
    memories.append(policy(env.reset())["rover", MEMORY].abs().amax().item())
    assert memories[0] == memories[3] == 0.0 < min(memories[1:3])
    env.close()
    agents = {
        "idle": {"body": "leo_rover"},
        "rover": {
            "body": "rover_zero",
            "controller": {"checkpoint": str(file)},
            "sensors": ["goal", "velocity"],
        },
    }
    simulation = make_simulation(compose_environment("flat", (), {"agents": agents}), 1, 0)
    simulation.reset()
    for _ in range(3):
        simulation.advance({"idle": np.zeros((1, 1, 2), np.float32)})
    simulation.close()
    view = EpisodeView(conf.model_copy(update={"checkpoint": str(file)}))
    assert [ended for _, ended in zip(range(3), view.run(), strict=False)] == [False] * 3
    view.close()
