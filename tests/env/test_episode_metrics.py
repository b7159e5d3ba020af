"""Metrics as a transform: which, for whom, under which keys; in all wrappers, reset with the episodes."""

import copy
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.collectors import Collector, MultiSyncCollector
from torchrl.envs import (
    Compose,
    EnvBase,
    GymEnv,
    ParallelEnv,
    PettingZooWrapper,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    check_env_specs,
)
from torchrl.envs.utils import RandomPolicy

import dune_rl
from dune_rl.core.errors import ConfigError
from dune_rl.env.torchrl import EpisodeMetrics, SingleAgent
from dune_rl.metrics.episode import MetricsConf

TERMS: dict[str, Any] = {
    "way": {"term": "path_length", "reduce": "sum"},
    "duration": {"reduce": "last", "initial": 0.0},
    "jerk": {"reduce": "mean"},
}
STEPS = 5
SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": STEPS}}}}
STEP_S = 0.05


def make(*transforms: Any, scenes: int = 2, **settings: Any) -> EnvBase:
    chain = Compose(*transforms) if transforms else EpisodeMetrics(TERMS)
    return TransformedEnv(dune_rl.make("flat", scenes, 3, **SHORT, **settings), chain)


def test_each_metric_has_a_key_and_a_spec() -> None:
    env = make(actors="external_walkers")
    check_env_specs(env)
    data = env.rollout(STEPS)
    assert env.transform.metric_names == {group: tuple(TERMS) for group in ("rover", "walker")}
    for group, agents in env.group_map.items():
        assert env.observation_spec[group, "episode_jerk"].shape == (2, len(agents), 1)
        seconds = data["next", group, "episode_duration"][..., 0]
        expected = STEP_S * torch.arange(1, STEPS + 1)[None, :, None].expand_as(seconds)
        torch.testing.assert_close(seconds, expected)
    # What the step began with is what the one before ended with.
    assert data["rover", "episode_way"][:, 1:].equal(data["next", "rover", "episode_way"][:, :-1])
    env.close()


def test_groups_and_names_are_chosen() -> None:
    transform = EpisodeMetrics(MetricsConf(terms=TERMS), groups=["walker"], out_keys=["a", "b", "c"])
    env = make(transform, actors="external_walkers")
    data = env.rollout(2)
    assert {"a", "b", "c"} <= set(data["walker"].keys())
    assert not {"a", "episode_way"} & set(data["rover"].keys())
    env.close()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: EpisodeMetrics({"jerks": {}}), "jerks.*did you mean jerk"),
        (lambda: EpisodeMetrics({"jerk": {"reduced": "sum"}}), "jerk.reduced"),
        (lambda: EpisodeMetrics(TERMS, out_keys=["one"]), "out_keys must be 3 different names"),
        (lambda: make(EpisodeMetrics(TERMS, groups=["rovers"])), "no external group 'rovers'"),
        (lambda: make(EpisodeMetrics({"energy_wh": {}})).rollout(2), "set metrics.energy=true"),
    ],
)
def test_wrong_settings_are_named(wrong: Callable[[], object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        wrong()


def test_values_are_those_of_the_settings_metrics() -> None:
    """The same terms give the same bytes, as a transform and in the settings, in whatever order."""
    settings = {"metrics": {"name": "paper", "terms": TERMS}}
    both = EpisodeMetrics(TERMS), EpisodeMetrics()
    env = make(*both, scenes=3, actors="external_walkers", **settings)
    data = env.rollout(2 * STEPS + 2, break_when_any_done=False)
    for group, columns in env.transform[1].metric_names.items():
        for place in (data, data["next"]):
            for name in TERMS:
                own = place[group, f"episode_{name}"][..., 0]
                theirs = place[group, "metrics"][..., columns.index(name)]
                assert own.numpy().tobytes() == theirs.numpy().tobytes()
    env.close()


def test_it_resets_itself_scene_by_scene() -> None:
    env = make(scenes=3)
    data = env.rollout(3)[:, -1]["next"]
    before = data["rover", "episode_way"].clone()
    chosen = torch.tensor([[False], [True], [False]])
    after = env.reset(data.clone().set("_reset", chosen))["rover", "episode_way"]
    assert after[1] == 0 and (before[1] > 0).all()
    assert after[[0, 2]].equal(before[[0, 2]])
    env.close()


@pytest.mark.slow(all_but=["after"])
@pytest.mark.parametrize(
    "chain",
    [
        (EpisodeMetrics(TERMS), SingleAgent()),
        (SingleAgent(), EpisodeMetrics(TERMS)),
        (SingleAgent(), StepCounter(), EpisodeMetrics(TERMS)),
    ],
    ids=["before", "after", "behind others"],
)
def test_flat_keys_of_one_agent(chain: tuple[Any, ...]) -> None:
    env = make(*chain)
    check_env_specs(env)
    data = env.rollout(STEPS)
    assert data["next", "episode_way"].shape == (2, STEPS, 1)
    assert (data["next", "episode_duration"][:, -1] == STEPS * STEP_S).all()
    env.close()
    flat = make(SingleAgent(), EpisodeMetrics())
    assert flat.rollout(2)["next", "metrics"].shape == (2, 2, len(flat.transform[1].metric_names["rover"]))
    flat.close()


@pytest.mark.slow
@pytest.mark.parametrize("batched", [SerialEnv, partial(ParallelEnv, mp_start_method="spawn")])
def test_in_several_environments(batched: Any) -> None:
    env = batched(2, make)
    if batched is SerialEnv:
        check_env_specs(env)
    data = env.rollout(2 * STEPS, break_when_any_done=False)
    seconds = data["next", "rover", "episode_duration"].squeeze()
    assert seconds.shape == (2, 2, 2 * STEPS)
    expected = STEP_S * torch.arange(1, STEPS + 1).repeat(2)
    torch.testing.assert_close(seconds, expected.expand_as(seconds))
    env.close()


def test_around_several_environments_it_says_where_to_go() -> None:
    env = SerialEnv(2, partial(dune_rl.make, "flat", 1))
    with pytest.raises(TypeError, match="goes into each process"):
        TransformedEnv(env, EpisodeMetrics(TERMS))


@pytest.mark.slow(all_but=["Collector"])
@pytest.mark.parametrize("kind", [Collector, MultiSyncCollector])
def test_in_collectors(kind: Any) -> None:
    sample = make()
    policy = RandomPolicy(sample.full_action_spec)
    source = make if kind is Collector else [make]
    collector = kind(source, policy, frames_per_batch=4 * STEPS, total_frames=4 * STEPS)
    (batch,) = collector
    seconds = batch["next", "rover", "episode_duration"].squeeze()
    torch.testing.assert_close(seconds, STEP_S * torch.arange(1, STEPS + 1).repeat(2).expand_as(seconds))
    collector.shutdown()
    sample.close()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version")
def test_in_wrappers_of_our_other_environments() -> None:
    gym = TransformedEnv(GymEnv("dune_rl:dune_rl/Flat-v0", **SHORT), EpisodeMetrics(TERMS))
    zoo = PettingZooWrapper(dune_rl.parallel_env("flat", 0, actors="external_walkers", **SHORT))
    for env, key in ((gym, "episode_duration"), (TransformedEnv(zoo, EpisodeMetrics(TERMS)), None)):
        check_env_specs(env)
        data = env.rollout(STEPS)["next"]
        values = data[key] if key else data["rover", "episode_duration"]
        torch.testing.assert_close(values.flatten(), STEP_S * torch.arange(1, STEPS + 1))
        env.close()


@pytest.mark.slow
def test_copies_of_the_environment_inside_go_on() -> None:
    env = make()
    env.rollout(3)
    inner = env.base_env
    for other in (copy.deepcopy(inner), pickle.loads(pickle.dumps(inner))):
        found = TransformedEnv(other, EpisodeMetrics(TERMS))
        assert found.transform._find()[0][1].values.tobytes() == env.transform._find()[0][1].values.tobytes()
        other.close()
    env.close()


def test_added_under_way_it_counts_from_there() -> None:
    inner = dune_rl.make("flat", 2, 3, **SHORT)
    now = inner.step(inner.rand_action(inner.reset()))["next"]
    env = TransformedEnv(inner, EpisodeMetrics(TERMS))
    inner_way = env.step(env.rand_action(now))["next", "rover", "episode_way"]
    moved = np.linalg.norm(inner.simulation.state.groups["rover"].motion.velocity_w[:, :2], axis=1) * STEP_S
    assert (inner_way.squeeze().numpy() < 3 * moved + 0.01).all()
    # Equal settings share one set, however many transforms there are.
    TransformedEnv(inner, EpisodeMetrics(TERMS))
    assert len(inner.simulation.group("rover").measured.added) == 1
    env.close()
