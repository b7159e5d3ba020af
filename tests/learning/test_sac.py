"""Soft actor-critic: its targets, its replay buffer, its schedule."""

import math
from functools import partial
from pathlib import Path

import pytest
import torch
from point_mass import PointMass, make_point_mass
from tensordict import TensorDict
from training import make_sac

from dune_rl.learning.collector import TransitionCollector
from dune_rl.learning.group_policy import GroupPolicy, agent_sequences, select_group
from dune_rl.learning.networks.encoders import CircularConvolution
from dune_rl.learning.networks.policy import Architecture, Normaliser, make_policy_network
from dune_rl.learning.networks.settings import ReplayConf
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.sac.gradient_step import evaluate_critics
from dune_rl.learning.sac.replay import Replay, TransitionCodec, multi_step
from dune_rl.learning.settings import CollectorConf

SPEC = PolicySpec.of(make_point_mass(1, 0), "rover")
TINY = PolicySpec({"goal": 2}, (-1.0,), (1.0,))


def _one_step_episodes(spec: PolicySpec, *, terminated: bool, count: int = 64) -> TensorDict:
    shape = [count, 1]
    observation = TensorDict({key: torch.zeros(*shape, size) for key, size in spec.sizes.items()}, shape)
    ended = torch.full((*shape, 1), terminated)
    after = {
        "observation": observation,
        "reward": torch.ones(*shape, 1),
        "terminated": ended,
        "truncated": ~ended,
        "done": torch.ones(*shape, 1, dtype=torch.bool),
    }
    now = {
        "observation": observation,
        "action": torch.zeros(*shape, spec.action_size),
        "done": torch.zeros(*shape, 1, dtype=torch.bool),
    }
    return TensorDict({**now, "next": TensorDict(after, shape)}, shape)


@pytest.mark.slow
@pytest.mark.parametrize("terminated", [True, False])
def test_time_limits_bootstrap_and_terminations_do_not(tmp_path: Path, terminated: bool) -> None:
    torch.manual_seed(0)
    sac = make_sac(
        TINY, tmp_path, hidden=(16,), gamma=0.9, tau=0.2, learning_rate=2e-2, initial_entropy_coefficient=1e-9
    )
    rows = sac._codec.encode(_one_step_episodes(TINY, terminated=terminated))
    sac._learn([rows] * 120)
    loss = sac._step.loss
    with loss.qvalue_network_params[0].to_module(loss.qvalue_network):
        value = loss.qvalue_network.module(torch.zeros(1, 2), torch.zeros(1, 1)).item()
    # A reward of 1 for ever is worth 1 / (1 - 0.9) = 10; one that ends the episode is worth 1.
    if terminated:
        assert value == pytest.approx(1.0, abs=0.3)
    else:
        assert value > 3


def test_multi_step_returns_stop_at_ends() -> None:
    reward = torch.tensor([[1.0, 2.0, 4.0, 8.0]])
    done = torch.tensor([[False, True, False, False]])
    total, steps = multi_step(reward, done, 3, 0.5)
    assert steps.tolist() == [[2, 1, 2, 1]]
    assert total.tolist() == [[2.0, 2.0, 8.0, 8.0]]


def test_next_observation_is_the_final_one_not_the_reset_one() -> None:
    make_env = partial(PointMass, limit=4)
    codec = TransitionCodec(SPEC)
    policy = GroupPolicy("rover", SPEC, make_policy_network(SPEC, Architecture((8,))))
    conf = CollectorConf(mode="serial", scenes=2, steps=12)
    collector = TransitionCollector(conf, make_env, {"rover": policy}, seed=0)
    batch = agent_sequences(select_group(next(iter(collector)), "rover"))
    collector.close()
    ends = batch["next", "truncated"].squeeze(-1)
    assert ends.sum() == 6
    rows = codec.encode(batch).view(*batch.shape, -1)
    n = SPEC.observation_size
    moved = (rows[..., :2] - rows[..., n : n + 2]).abs()[..., 0]
    # A point moves at most 0.2 m a step; a new episode's goal is somewhere else.
    assert (moved[ends] <= 0.21).all()
    after = rows[:, 1:, :n][ends[:, :-1]]
    assert not torch.equal(after, rows[:, :-1, n : 2 * n][ends[:, :-1]])
    decoded = codec.decode(
        rows.flatten(0, 1),
        lambda packed: Normaliser(torch.zeros(n, dtype=torch.bool), clip=10.0)(packed.floats),
        reward_scale=1.0,
    )
    assert not decoded["next", "terminated"].any()


def test_entropy_target_is_that_of_scaled_actions(tmp_path: Path) -> None:
    sac = make_sac(SPEC, tmp_path, target_entropy=-2.0)
    shift = math.log(0.8) + math.log(math.pi)
    assert sac._step.loss.target_entropy.item() == pytest.approx(-2 + shift, abs=1e-5)
    features = torch.zeros(20_000, SPEC.observation_size)
    unit = PolicySpec(SPEC.sizes, (-1.0, -1.0), (1.0, 1.0))
    entropies = []
    for each in (SPEC, unit):
        torch.manual_seed(0)
        actor = make_policy_network(each, Architecture((8,)))[1]
        distribution = actor.get_dist(TensorDict(features=features, batch_size=[20_000]))
        entropies.append(-distribution.rsample_and_log_prob()[1].mean().item())
    assert entropies[0] - entropies[1] == pytest.approx(shift, abs=1e-3)


def test_replay_keeps_the_newest_rows_and_survives_a_save(tmp_path: Path) -> None:
    replay = Replay(ReplayConf(capacity=100), 3, tmp_path / "ring")
    for start in range(0, 250, 50):
        replay.extend(torch.arange(start, start + 50).float()[:, None].expand(50, 3))
    again = Replay(ReplayConf(capacity=100), 3, tmp_path / "ring2")
    again.load(tmp_path / "r.npy", replay.save(tmp_path / "r.npy"))
    for each in (replay, again):
        assert {int(v) for rows in each.minibatches(40, 50) for v in rows[:, 0]} == set(range(150, 250))
    for each in (replay, again):
        each.extend(torch.full((10, 3), -1.0))
    assert torch.equal(replay._buffer.storage[:], again._buffer.storage[:])


def test_learning_rate_falls_linearly_to_its_end(tmp_path: Path) -> None:
    sac = make_sac(TINY, tmp_path, hidden=(4,))
    rates = [sac._step.schedule(share) for share in (0.0, 0.5, 1.0)]
    assert rates == pytest.approx([3e-4, 1.75e-4, 5e-5])


def test_half_precision_updates_stay_close(tmp_path: Path) -> None:
    losses = []
    for precision in ("float32", "bfloat16"):
        torch.manual_seed(0)
        sac = make_sac(SPEC, tmp_path, hidden=(32,), precision=precision)
        losses.append(sac._learn([torch.randn(256, sac._codec.width)])["loss/critic"])
    assert losses[0] != losses[1]
    assert losses[1] == pytest.approx(losses[0], rel=0.05)


def test_both_critics_at_once_are_each_by_itself(tmp_path: Path) -> None:
    torch.manual_seed(0)
    step = make_sac(SPEC, tmp_path, hidden=(8, 8))._step
    size = step.loss.qvalue_network.module.body[0].in_features - SPEC.action_size
    batch = TensorDict({"features": torch.randn(5, size), "action": torch.randn(5, SPEC.action_size)}, [5])
    found = evaluate_critics(batch, step.loss.qvalue_network_params)["state_action_value"]
    for number, value in enumerate(found):
        with step.loss.qvalue_network_params[number].to_module(step.loss.qvalue_network):
            alone = step.loss.qvalue_network(batch.clone())["state_action_value"]
        torch.testing.assert_close(value, alone)
    assert not torch.allclose(*found)
    # TorchRL calls it: where it no longer does, an update is slower.
    assert step.loss._vmap_qnetworkN0 is evaluate_critics


@pytest.mark.parametrize(("scans", "length", "stride"), [(2, 32, 2), (6, 9, 1), (1, 11, 2)])
def test_a_convolution_by_its_matrix_is_a_convolution(scans: int, length: int, stride: int) -> None:
    torch.manual_seed(0)
    convolution = CircularConvolution(scans, 3, stride, length)
    read = torch.randn(200, scans, length, requires_grad=True)
    expected = torch.nn.Conv1d.forward(convolution, read)
    found = convolution(read)
    torch.testing.assert_close(found, expected)
    weight = torch.randn_like(expected)
    of = (read, convolution.weight, convolution.bias)
    for one, two in zip(
        torch.autograd.grad((found * weight).sum(), of),
        torch.autograd.grad((expected * weight).sum(), of),
        strict=True,
    ):
        torch.testing.assert_close(one, two, atol=1e-4, rtol=1e-4)
    assert set(convolution.state_dict()) == {"weight", "bias"}
