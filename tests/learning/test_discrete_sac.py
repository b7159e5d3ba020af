"""Discrete SAC: values of all commands, a policy that stays as it is at first, and what it starts from."""

from functools import partial
from pathlib import Path

import pytest
import torch
from point_mass import make_point_mass
from tensordict import TensorDict
from test_sac import _one_step_episodes
from torchrl.envs.utils import ExplorationType, set_exploration_type
from training import SMALL, assert_halves_make_a_whole, make_context

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.learning.discrete_sac.learner import DiscreteSac
from dune_rl.learning.discrete_sac.settings import DiscreteSacConf
from dune_rl.learning.group_policy import Deterministic
from dune_rl.learning.imitation.learner import Imitation
from dune_rl.learning.imitation.settings import ImitationConf
from dune_rl.learning.learners import require_same_networks
from dune_rl.learning.networks.commands import command_grid, make_command_network
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.state.command_grid import CommandGridConf

SPEC = PolicySpec({"goal": 2}, (-1.0, -1.0), (1.0, 1.0))
GRID = CommandGridConf(speeds=2, reverse_speeds=1, headings=3)
SMALL_DISCRETE = DiscreteSacConf(
    commands=GRID,
    hidden=(16,),
    batch_size=64,
    learning_starts=64,
    warm_up="random",
    precision="float32",
    replay=SMALL.replay,
    collector=SMALL.collector,
    evaluation=SMALL.evaluation,
    checkpoint=SMALL.checkpoint,
)


def learner(folder: Path, **changes: object) -> DiscreteSac:
    conf = SMALL_DISCRETE.model_copy(update={"gamma": 0.9, "learning_rate": 1e-2, **changes})
    return DiscreteSac(make_context(SPEC, folder), conf)


@pytest.mark.slow
@pytest.mark.parametrize("terminated", [True, False])
def test_time_limits_bootstrap_and_terminations_do_not(tmp_path: Path, terminated: bool) -> None:
    torch.manual_seed(0)
    found = learner(tmp_path, initial_entropy_coefficient=1e-9, entropy_learning_rate=1e-9, tau=0.1)
    rows = found._codec.encode(_one_step_episodes(SPEC, terminated=terminated))
    found._learn([rows] * 100)
    values = found._step.action_values(lambda encode: found._codec.decode(rows, encode, 1.0))
    # The reward of a step is 1.
    assert values.mean().item() == pytest.approx(1.0, abs=0.2) if terminated else values.mean() > 2.0


def test_an_action_is_the_command_next_to_it(tmp_path: Path) -> None:
    found = learner(tmp_path)
    commands = command_grid(SPEC, GRID)
    steps = _one_step_episodes(SPEC, terminated=True)
    wanted = torch.arange(steps["action"].shape[0] * steps["action"].shape[1]) % len(commands)
    steps["action"] = (commands[wanted] + 0.01).reshape(steps["action"].shape)
    rows = found._codec.encode(steps)
    batch = found._step._separate(found._codec.decode(rows, found._critic_features.encode, 1.0))
    assert sorted(batch["action"].tolist()) == sorted(wanted.tolist())


def test_the_policy_stays_as_it_is_while_the_critics_begin(tmp_path: Path) -> None:
    torch.manual_seed(0)
    found = learner(tmp_path, critic_updates=3)
    rows = found._codec.encode(_one_step_episodes(SPEC, terminated=True))
    before = {key: value.clone() for key, value in found.policy.network.state_dict().items()}
    critics = [value.clone() for value in found._step.loss.qvalue_network_params.values(True, True)]

    def changed() -> bool:
        after = found.policy.network.state_dict()
        return any(not torch.equal(before[key], after[key]) for key in before)

    found._learn([rows] * 3)
    assert not changed()
    now = found._step.loss.qvalue_network_params.values(True, True)
    assert any(not torch.equal(old, new) for old, new in zip(critics, now, strict=True))
    found._learn([rows])
    assert changed()


def test_the_policy_draws_commands_and_is_evaluated_by_the_likeliest(tmp_path: Path) -> None:
    torch.manual_seed(0)
    found = learner(tmp_path)
    commands = command_grid(SPEC, GRID)
    observations = _one_step_episodes(SPEC, terminated=True).select("observation")[0]
    parts = observations["observation"]
    with set_exploration_type(ExplorationType.RANDOM):
        drawn = torch.cat([found.policy.network(parts.clone())["action"] for _ in range(20)])
    assert len(drawn.unique(dim=0)) > 3
    assert (torch.cdist(drawn.reshape(-1, 2), commands).min(1).values < 1e-6).all()
    acted = Deterministic(found.policy.network)(parts.clone())
    assert torch.equal(acted["action"], commands[acted["logits"].argmax(-1)])


def test_it_starts_from_an_imitated_policy_and_from_no_other(tmp_path: Path) -> None:
    found = learner(tmp_path)
    imitated = make_command_network(SPEC, found.network_settings())
    entry = {"algorithm": "imitation", "spec": SPEC.plain(), "network": found.network_settings()}
    check = partial(require_same_networks, found, source=tmp_path, conf=SMALL_DISCRETE, group="rover")
    check(entry, remedy="", relatives=found.starts_from)
    found.start_from({"policy": imitated.state_dict()})
    assert not found.has_new_critics(entry)
    assert found.has_new_critics({**entry, "algorithm": "discrete_sac"})
    with pytest.raises(CheckpointError, match=r"was trained with ppo\. Set learning=ppo"):
        check({**entry, "algorithm": "ppo"}, remedy="Set {}", relatives=found.starts_from)
    finer = {**entry["network"], "commands": GRID.model_copy(update={"headings": 5}).model_dump()}
    with pytest.raises(CheckpointError, match=r"Set learning\.commands\.headings=5$"):
        check({**entry, "network": finer}, remedy="Set {}", relatives=found.starts_from)
    # A run goes on with its own algorithm alone.
    with pytest.raises(CheckpointError, match="was trained with imitation"):
        check(entry, remedy="Resume with {}")


def test_it_begins_with_the_command_and_the_values_of_the_imitated_costs(tmp_path: Path) -> None:
    torch.manual_seed(0)
    found = learner(tmp_path, initial_entropy_coefficient=0.05, reward_scale=2.0, hidden=(16, 16))
    imitated = make_command_network(SPEC, found.network_settings())
    found.start_from({"policy": imitated.state_dict(), "algorithm": "imitation"})
    steps = _one_step_episodes(SPEC, terminated=True)
    costs = imitated(steps["observation"].clone())["costs"]
    logits = found.policy.network(steps["observation"].clone())["logits"]
    torch.testing.assert_close(logits, -2.0 * costs / 0.05)
    rows = found._codec.encode(steps)
    batch = found._step._separate(found._codec.decode(rows, found._critic_features.encode, 1.0))
    for parameters in (found._step.loss.qvalue_network_params, found._step.loss.target_qvalue_network_params):
        values = found._step.loss._vmap_qnetworkN0(batch.clone(), parameters)["action_value"]
        assert torch.allclose(values, -2.0 * costs.reshape(values[0].shape), atol=0.15)
        assert not torch.allclose(values[0], values[1])
    # The policy's own weights without critics are taken as they are.
    own = found.policy.network.state_dict()
    found.start_from({"policy": own, "algorithm": "discrete_sac"})
    torch.testing.assert_close(found.policy.network(steps["observation"].clone())["logits"], logits)


def learner_with_prior(folder: Path, *, privileged: bool = False, **changes: object) -> DiscreteSac:
    guess = len(command_grid(SPEC, GRID))
    spec, whole = (
        PolicySpec({"goal": 2, "guess": guess, **more}, SPEC.low, SPEC.high) for more in ({}, {"hidden": 3})
    )
    conf = SMALL_DISCRETE.model_copy(update={"prior": "guess", "reward_scale": 2.0, **changes})
    return DiscreteSac(make_context(spec, folder, critic_spec=whole if privileged else None), conf)


@pytest.mark.parametrize("privileged", [False, True])
@pytest.mark.parametrize(("weight", "imitated"), [(0.0, False), (1.5, False), (1.5, True)])
def test_it_begins_with_the_command_and_the_values_that_a_prior_guesses(
    tmp_path: Path, weight: float, imitated: bool, privileged: bool
) -> None:
    torch.manual_seed(0)
    commands = command_grid(SPEC, GRID)
    found = learner_with_prior(tmp_path, privileged=privileged, prior_weight=weight)
    network, coefficient = found.policy.network, SMALL_DISCRETE.initial_entropy_coefficient
    guess = 8.0 * torch.rand(32, len(commands))
    parts = TensorDict({"goal": torch.randn(32, 2), "guess": guess}, [32])
    costs = (1.0 + weight) * guess
    if imitated:
        taught = make_command_network(found.context.spec, found.network_settings())
        torch.nn.init.normal_(taught[1].module.body[-1].weight)
        costs = taught(parts.clone())["costs"] + weight * guess
        found.start_from({"policy": taught.state_dict(), "algorithm": "imitation"})
    acted = Deterministic(network)(parts.clone())
    torch.testing.assert_close(acted["logits"], -2.0 * costs / coefficient, rtol=1e-4, atol=1e-3)
    assert torch.equal(acted["action"], commands[costs.argmin(-1)])
    read = TensorDict({"features": acted["features"], "critic_features": acted["features"]}, [32])
    if privileged:
        read["critic_features"] = torch.cat([acted["features"], torch.randn(32, 3)], -1)
    critics = found._step.loss.qvalue_network_params
    values = found._step.loss._vmap_qnetworkN0(read, critics)["action_value"]
    assert not torch.allclose(values[0], values[1])
    assert (values + 2.0 * costs).abs().mean() < 0.15 * (2.0 * costs).abs().mean()
    # The guess goes along to where the policy is used.
    copy = make_command_network(found.context.spec, found.network_settings(), draws=True)
    copy.load_state_dict(network.state_dict())
    torch.testing.assert_close(Deterministic(copy)(parts.clone())["logits"], acted["logits"])


@pytest.mark.parametrize("start_from", [None, "imitated"])
def test_a_policy_with_a_prior_learns_and_keeps_to_where_it_began(
    tmp_path: Path, start_from: str | None
) -> None:
    torch.manual_seed(0)
    settings = {"target_divergence": 0.1, "start_from": start_from, "prior_weight": 1.0}
    found = learner_with_prior(tmp_path, **settings)
    taught = make_command_network(found.context.spec, found.network_settings())
    if start_from is not None:
        found.start_from({"policy": taught.state_dict(), "algorithm": "imitation"})
    steps = _one_step_episodes(found.context.spec, terminated=True)
    rows = found._codec.encode(steps)
    first = found._learn([rows])
    assert first["sac/divergence"] == pytest.approx(0.0, abs=1e-4)
    assert found._learn([rows] * 20)["sac/divergence"] > 0.0
    resumed = learner_with_prior(tmp_path, **settings)
    resumed.load_state_dict(found.state_dict())
    observations = steps["observation"].clone()
    now, then = (each.policy.network(observations.clone())["logits"] for each in (resumed, found))
    torch.testing.assert_close(now, then)


def test_critics_keep_what_they_were_trained_to_add(tmp_path: Path) -> None:
    """Whether the prior is added to their values follows from the run that trained them."""
    torch.manual_seed(0)
    features = torch.rand(5, 2 + len(command_grid(SPEC, GRID)))
    before = learner_with_prior(tmp_path, target_divergence=0.1)
    after = learner_with_prior(tmp_path)
    assert not torch.allclose(_values(before, features), _values(after, features))
    after.start_from({**before.state_dict(), "algorithm": "discrete_sac"})
    torch.testing.assert_close(_values(after, features), _values(before, features))


def _values(learner: DiscreteSac, features: torch.Tensor) -> torch.Tensor:
    batch = TensorDict({"features": features}, [len(features)])
    loss = learner._step.loss
    values: torch.Tensor = loss._vmap_qnetworkN0(batch, loss.qvalue_network_params).get("action_value")
    return values


@pytest.mark.parametrize("prior", [None, "guess"])
def test_it_starts_from_what_imitation_saves(tmp_path: Path, prior: str | None) -> None:
    spec = PolicySpec({"goal": 2, "guess": len(command_grid(SPEC, GRID))}, SPEC.low, SPEC.high)
    taught = ImitationConf(commands=GRID, hidden=(16,), prior=prior)
    saved = Imitation(make_context(spec, tmp_path / "a"), taught).network_settings()
    found = DiscreteSac(
        make_context(spec, tmp_path / "b"), SMALL_DISCRETE.model_copy(update={"prior": prior})
    )
    entry = {"algorithm": "imitation", "spec": spec.plain(), "network": saved}
    check = partial(
        require_same_networks, source=tmp_path, conf=SMALL_DISCRETE, group="rover", remedy="Set {}"
    )
    if prior is None:
        check(found, entry, relatives=found.starts_from)
        return
    with pytest.raises(CheckpointError, match=r"Set learning\.prior_weight=1\.0$"):
        check(found, entry, relatives=found.starts_from)


@pytest.mark.slow(all_but=["1.0"])
@pytest.mark.parametrize("target", [0.1, 1.0])
def test_a_policy_goes_as_far_from_where_it_began_as_it_may(tmp_path: Path, target: float) -> None:
    torch.manual_seed(0)
    found = learner(
        tmp_path, target_divergence=target, start_from="imitated", initial_entropy_coefficient=0.2,
        entropy_learning_rate=0.05,
    )  # fmt: skip
    found.start_from({"policy": make_command_network(SPEC, found.network_settings()).state_dict()})
    steps = _one_step_episodes(SPEC, terminated=True)
    commands = command_grid(SPEC, GRID)
    drawn = torch.randint(len(commands), steps["action"].shape[:-1])
    steps["action"] = commands[drawn]
    # The faster the better.
    steps["next", "reward"] = 5.0 * steps["action"][..., :1]
    observations = steps["observation"].clone()
    before = found.policy.network(observations.clone())["logits"].log_softmax(-1)
    rows = found._codec.encode(steps)
    found._critic_features.observe(found._codec.observations(rows))
    logged = found._learn([rows] * 400)
    assert logged["sac/divergence"] > 0 and "sac/entropy" not in logged
    after = found.policy.network(observations.clone())["logits"].log_softmax(-1)
    divergence = (after.exp() * (after - before)).sum(-1).mean().item()
    assert target / 3 < divergence < 3 * target
    speeds = commands[:, 0]
    assert ((after.exp() - before.exp()) * speeds).sum(-1).mean() > 0.05
    # A resumed run measures from the same policy.
    resumed = learner(tmp_path, target_divergence=target, start_from="imitated")
    resumed.load_state_dict(found.state_dict())
    for step in (found._step, resumed._step):
        encoded = step._encode(found._codec.observations(rows))
        torch.testing.assert_close(encoded[:, -len(speeds) :], before.reshape(-1, len(speeds)))


def test_what_a_coefficient_adapts_to_follows_from_the_settings_of_the_run(tmp_path: Path) -> None:
    before = learner(tmp_path, target_entropy=1.3)
    found = learner(tmp_path, target_divergence=0.3, start_from="run")
    saved = {**before.state_dict(), "algorithm": "discrete_sac"}
    found.start_from(saved)
    assert float(found._step.loss.target_entropy) == pytest.approx(-0.3)
    with pytest.raises(CheckpointError, match="began without learning\\.target_divergence"):
        found.load_state_dict(saved)


def test_a_divergence_is_from_a_policy_that_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="two targets of one coefficient"):
        learner(tmp_path, target_divergence=0.5, target_entropy=0.3, start_from="run")
    with pytest.raises(ConfigError, match=r"learning\.start_from, or from learning\.prior"):
        learner(tmp_path, target_divergence=0.5)


@pytest.mark.slow
def test_two_halves_of_a_run_are_the_whole(tmp_path: Path) -> None:
    # The policy begins to learn in the second half.
    updates = round(0.0625 * (250 - 64))
    learning = SMALL_DISCRETE.model_copy(update={"critic_updates": updates})
    assert_halves_make_a_whole(make_point_mass, tmp_path, learning, frames=384, half=200)
