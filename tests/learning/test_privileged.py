"""Critics that know more than policies: privileged sensors, and the observations of a whole group."""

from pathlib import Path
from typing import ClassVar

import pytest
import torch
from point_mass import PointMass, make_team
from training import SMALL_PPO, assert_halves_make_a_whole, make_context, small

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.learning.networks.critic import Value
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.ppo.learner import Ppo
from dune_rl.learning.ppo.settings import PpoConf
from dune_rl.learning.saved_policies import load_group_policy, load_policy
from dune_rl.learning.settings import LearningConf


class Privileged(PointMass):
    """Points whose goal's direction and scan only critics know."""

    privileged: ClassVar = {"rover": frozenset({"lidar", "goal"})}


SAC = small(hidden=(16,), learning_starts=64, scan_channels=2)
PPO = SMALL_PPO.model_copy(update={"hidden": (16,), "scan_channels": 2})


@pytest.mark.slow(all_but=["learning0"])
@pytest.mark.parametrize("learning", [SAC, PPO, PPO.model_copy(update={"recurrent": 4})])
def test_policies_do_without_what_critics_read(learning: LearningConf, tmp_path: Path) -> None:
    assert_halves_make_a_whole(Privileged, tmp_path, learning, frames=384, half=200)
    env = PointMass(2, 0)
    policy, _ = load_policy(tmp_path / "whole", env, allow_more=True)
    alone, _ = load_group_policy(tmp_path / "whole", "rover", PolicySpec.of(env, "rover"), allow_more=True)
    assert alone.policy_spec.keys == ["imu", "velocity"]
    observation = env.reset()
    del observation["rover", "observation", "lidar"], observation["rover", "observation", "goal"]
    assert policy(observation)["rover", "action"].shape == (2, 1, 2)
    # They know it at once where it is privileged here, too.
    load_policy(tmp_path / "whole", Privileged(2, 0))


def test_values_depend_on_privileged_parts_and_actions_do_not(tmp_path: Path) -> None:
    env = Privileged(3, 0)
    spec, whole = (PolicySpec.of(env, "rover", privileged=each) for each in (False, True))
    context = make_context(spec, tmp_path, critic_spec=whole)
    ppo = Ppo(context, PpoConf(hidden=(16,)))
    parts = env.reset()["rover", "observation"]
    values, actions = [], []
    for change in (0.0, 1.0):
        parts["goal"] = parts["goal"] + change
        packed = whole.pack(parts)
        values.append(ppo._critic(ppo._critic_features.encode(packed)))
        actions.append(ppo._critic_features.encode_public(packed))
    assert not torch.allclose(*values)
    assert torch.equal(*actions)


@pytest.mark.slow
def test_a_sensor_is_privileged_by_its_setting() -> None:
    conf = compose_environment("flat", ["+sensors.height_scan.privileged=true", "actors=none"])
    env = make_torchrl_env(conf, 1, 0)
    policy, critic = (PolicySpec.of(env, "rover", privileged=each).keys for each in (False, True))
    env.close()
    assert "height_scan" not in policy and sorted([*policy, "height_scan"]) == sorted(critic)
    with pytest.raises(ConfigError, match="sensors: all are privileged"):
        compose_environment("flat", ["sensors={enabled: [goal], goal: {privileged: true}}"])


def test_a_central_critic_sees_the_others_and_itself_first() -> None:
    torch.manual_seed(0)
    features = torch.randn(1, 3, 2)
    swapped = features[:, [0, 2, 1]]
    central, own = Value(2, (8,), agents=3), Value(2, (8,))
    assert torch.equal(own(features)[:, 0], own(swapped)[:, 0])
    assert not torch.allclose(central(features)[:, 0], central(swapped)[:, 0])
    # Agents are alike: who sees the same in the same order has the same value.
    assert torch.allclose(central(features)[:, 0], central(features.roll(1, 1))[:, 1])


@pytest.mark.slow
def test_a_team_learns_with_a_central_critic(tmp_path: Path) -> None:
    learning = PPO.model_copy(update={"central_critic": True, "recurrent": 4})
    assert_halves_make_a_whole(make_team, tmp_path, learning, frames=384, half=200)
