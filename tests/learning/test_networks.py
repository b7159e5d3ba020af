"""Policies' networks: normalisation and action bounds."""

import math

import pytest
import torch
from point_mass import make_team

from dune_rl.learning.group_policy import GroupPolicy
from dune_rl.learning.networks.policy import Architecture, Normaliser, make_policy_network
from dune_rl.learning.policy_spec import PolicySpec


def test_actions_keep_to_their_bounds() -> None:
    env = make_team(16, 0)
    spec = PolicySpec.of(env, "rover")
    policy = GroupPolicy("rover", spec, make_policy_network(spec, Architecture((8,))))
    with torch.no_grad():
        policy.network[1].module[0].module.body[-1].weight.mul_(1000)
    action = policy(env.reset())["rover", "action"]
    assert env.full_action_spec["rover", "action"].is_in(action)
    assert action[..., 0].abs().max() > 0.79


def test_equal_agents_share_a_policy_and_act_each_by_its_own_observation() -> None:
    env = make_team(2, 0)
    spec = PolicySpec.of(env, "rover")
    policy = GroupPolicy("rover", spec, make_policy_network(spec, Architecture((8,))), ("action", "loc"))
    now = env.reset()
    now["rover", "observation", "goal"][:, 1] = now["rover", "observation", "goal"][:, 0]
    location = policy(now)["rover", "loc"]
    torch.testing.assert_close(location[:, 0], location[:, 1])
    assert (location[:, 0] - location[:, 2]).abs().max() > 1e-3


def test_ranges_are_normalised_by_their_logarithm() -> None:
    ranges = torch.tensor([[0.25, 5.0], [0.5, -5.0], [1.0, 0.0]])
    normaliser = Normaliser(torch.tensor([True, False]), clip=10.0)
    normaliser.observe(ranges)
    near, middle, far = normaliser(ranges)[:, 0].tolist()
    assert middle - near == pytest.approx(far - middle, rel=1e-4)
    assert normaliser.mean.tolist() == pytest.approx([math.log(0.5), 0.0], abs=1e-6)


def test_normaliser_merges_batches_exactly() -> None:
    torch.manual_seed(0)
    data = torch.randn(1000, 3) * torch.tensor([1.0, 5.0, 0.1]) + torch.tensor([0.0, -20.0, 3.0])
    normaliser = Normaliser(torch.zeros(3, dtype=torch.bool), clip=10.0)
    for part in data.split([1, 99, 400, 500]):
        normaliser.observe(part)
    assert torch.allclose(normaliser.mean, data.mean(0), atol=1e-4)
    assert torch.allclose(normaliser.variance, data.var(0, correction=0), rtol=1e-4)
    assert normaliser(torch.full((1, 3), 1e9)).max() == 10
