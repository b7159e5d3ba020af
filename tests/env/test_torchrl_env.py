"""The TorchRL environment: groups, partial resets, state, workers, and physics that diverges."""

from typing import Any

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv
from torchrl_steps import SHORT, advance, make, metric, observed

import dune_rl
from dune_rl.core.errors import ConfigError
from dune_rl.env.torchrl import EpisodeMetrics, SingleAgent
from dune_rl.tasks.task import POINT_GOAL_REWARDS

ENDS = ("done", "terminated", "truncated")
PROMISED_METRICS = (
    "episode",
    "steps",
    "return",
    "success",
    "reached",
    "collisions",
    "time_to_goal",
    "clearance",
    "min_clearance",
    "vertical_roughness",
    "vort",
    "smoothness",
    "diverged",
    "stuck",
    "flipped",
    "out_of_world",
    "timeout",
)


# -- shapes and groups -----------------------------------------------------------------------------


def test_keys_of_a_single_agent_are_flat_with_the_transform() -> None:
    env = dune_rl.make("flat", 3, actors="walkers")
    env = TransformedEnv(env, Compose(EpisodeMetrics(), SingleAgent()))
    shapes = {"lidar": (3, 32), "lidar_past": (3, 32), "imu": (3, 9), "goal": (3, 2), "velocity": (3, 2)}
    assert env.batch_size == (3,)
    data = env.rollout(2)
    for key, shape in shapes.items():
        assert data[key][:, 0].shape == shape
        assert data[key].dtype == torch.float32
        assert env.observation_spec[key].space.low.shape == shape
    assert data["action"].shape == (3, 2, 2)
    assert data["next", "reward"].shape == (3, 2, 1)
    for key in ENDS:
        assert data["next", key].shape == (3, 2, 1)
        assert data["next", key].dtype == torch.bool
    assert data["metrics"].shape == (3, 2, len(env.metric_names["rover"]))
    assert set(data.keys()) == {*shapes, "action", "metrics", "next", *ENDS}
    env.close()


def test_flat_keys_have_the_values_of_the_group() -> None:
    settings: dict[str, Any] = {"actors": "none", "task": SHORT}
    env, flat = make("flat", 3, **settings), dune_rl.make("flat", 3, **settings)
    flat = TransformedEnv(flat, Compose(EpisodeMetrics(), SingleAgent()))
    expected, _ = advance(env, env.reset(), 12, 0)
    found, _ = advance(flat, flat.reset(), 12, 0)
    assert expected["next", "done"].any()
    for name in env.observation_spec["rover", "observation"]:
        assert torch.equal(found["next", name], observed(expected["next"], name))
    for key in ("reward", "metrics"):
        values, others = found["next", key], expected["next", "rover", key][..., 0, :]
        assert torch.equal(values.nan_to_num(-1.0), others.nan_to_num(-1.0))
    assert torch.equal(found["next", "done"], expected["next", "done"])
    env.close()
    flat.close()


@pytest.mark.parametrize("settings", [{"robots": ["rover_zero"] * 2}, {"actors": "external_walkers"}])
def test_several_agents_have_no_flat_keys(settings: dict[str, Any]) -> None:
    env = TransformedEnv(dune_rl.make("flat", 1, **{"actors": "none"} | settings), SingleAgent())
    with pytest.raises(ValueError, match=r"SingleAgent needs one agent, but the environment has rover_0, "):
        env.reset()
    env.close()


def test_an_environment_without_external_agents_is_refused() -> None:
    with pytest.raises(ConfigError, match="no agent group is external"):
        dune_rl.make("flat", 1, agents={"walker": {"body": "person", "controller": "path"}})


def test_agents_are_grouped() -> None:
    env = dune_rl.make("flat", 3, actors="external_walkers")
    assert env.group_map == {"rover": ["rover_0"], "walker": ["walker_0", "walker_1"]}
    data = env.rollout(2)
    widths = {
        "rover": {"lidar": 32, "lidar_past": 32, "imu": 9, "goal": 2, "velocity": 2},
        "walker": {"goal": 2, "nearest_agent": 4, "velocity": 2},
    }
    for group, members in env.group_map.items():
        count = len(members)
        observation = data[group, "observation"]
        assert {key: value.shape[-1] for key, value in observation.items()} == widths[group]
        for value in observation.values():
            assert value.shape[:-1] == (3, 2, count)
            assert value.dtype == torch.float32
        assert data[group, "action"].shape == (3, 2, count, 2)
        assert data["next", group, "reward"].shape == (3, 2, count, 1)
        for key in ENDS:
            assert data["next", group, key].shape == (3, 2, count, 1)
    assert data["next", "done"].shape == (3, 2, 1)
    env.close()


def test_actions_are_in_physical_units() -> None:
    env = dune_rl.make("flat", 2, actors="external_walkers", robot={"drive": {"max_speed_mps": 0.7}})
    rover, walker = (env.full_action_spec[group, "action"].space for group in ("rover", "walker"))
    torch.testing.assert_close(rover.high[0, 0], torch.tensor([0.7, torch.pi]))
    torch.testing.assert_close(rover.low[0, 0], -torch.tensor([0.7, torch.pi]))
    torch.testing.assert_close(walker.low[0, 1], torch.tensor([0.0, -torch.pi]))
    torch.testing.assert_close(walker.high[0, 1], torch.tensor([1.0, torch.pi]))
    env.close()


def test_metric_columns_are_named() -> None:
    env = make("flat", 2, actors="external_walkers")
    names = env.metric_names["rover"]
    assert set(env.metric_names["walker"]) >= {"steps", "return", "goals", "reward/progress"}
    assert set(PROMISED_METRICS) <= set(names)
    terms = [name.removeprefix("reward/") for name in names if name.startswith("reward/")]
    assert terms == list(POINT_GOAL_REWARDS)
    assert len(set(names)) == len(names)
    assert env.observation_spec["rover", "metrics"].shape == (2, 1, len(names))
    data = env.rollout(4)
    assert metric(env, data["next"], "steps").tolist() == [[1, 2, 3, 4]] * 2
    assert metric(env, data["next"], "episode").tolist() == [[0] * 4, [1] * 4]
    returns = data["next", "rover", "reward"][..., 0, 0].cumsum(dim=1)
    torch.testing.assert_close(metric(env, data["next"], "return"), returns)
    env.close()


def test_walkers_end_is_the_rovers_and_is_a_truncation() -> None:
    env = dune_rl.make("flat", 6, actors="external_walkers", task=SHORT)
    steps, _ = advance(env, env.reset(), 20, 0)
    following = steps["next"]
    terminated, truncated = following["terminated"], following["truncated"]
    assert terminated.any() and truncated.any()
    assert torch.equal(following["done"], terminated | truncated)
    assert not (terminated & truncated).any()
    for key in ENDS:
        assert torch.equal(following["rover", key][..., 0], following[key])
    both = following["done"].unsqueeze(2).expand(-1, -1, 2, -1)
    assert torch.equal(following["walker", "done"], both)
    assert torch.equal(following["walker", "truncated"], both)
    assert not following["walker", "terminated"].any()
    env.close()


def test_an_agent_s_end_is_its_own_and_stays_until_the_episode_s() -> None:
    env = make("flat", 4, robots=["rover_zero"] * 3, actors="none", task=SHORT)
    steps, _ = advance(env, env.reset(), 40, 0)
    following = steps["next"]
    team = {key: following["rover", key][..., 0] for key in ENDS}
    assert torch.equal(team["done"], team["terminated"] | team["truncated"])
    assert not (team["terminated"] & team["truncated"]).any()
    # All are done with the episode, and it is over when all are.
    over = following["done"][..., 0]
    assert torch.equal(over, team["done"].all(dim=-1))
    assert torch.equal(following["terminated"][..., 0], team["terminated"].all(dim=-1))
    assert torch.equal(following["truncated"][..., 0], over & ~following["terminated"][..., 0])
    waiting = team["done"] & ~over.unsqueeze(-1)
    assert waiting.any(), "nobody arrived before the others"
    for step in range(39):
        mine, later = waiting[step], team["done"][step + 1]
        assert later[mine].all(), "an end is taken back"
        for key in ENDS:
            assert torch.equal(team[key][step][mine], team[key][step + 1][mine])
        assert not following["rover", "reward"][step + 1][..., 0][mine].any()
        before, after = (following["rover", "metrics"][at][mine].nan_to_num(-1.0) for at in (step, step + 1))
        assert torch.equal(before, after)
    env.close()
