"""Options of `reset`: the episode, and starts and goals."""

import copy

import gymnasium
import numpy as np
import pytest

import dune_rl
from dune_rl.core.errors import ConfigError


@pytest.fixture
def env():
    env = dune_rl.parallel_env("inspection", 0)
    yield env
    env.close()


def place(env) -> list[float]:
    motion = env.simulation.group().body.motion
    return [*motion.position_w[0, :2], float(motion.yaw[0])]


def test_the_episode_by_its_number(env) -> None:
    starts = []
    for _ in range(3):
        env.reset()
        starts.append(place(env))
    _, infos = env.reset(options={"episode": 1})
    assert place(env) == starts[1] and infos["rover_0"]["episode_id"] == 1.0
    env.reset()
    assert place(env) == starts[2]


def test_start_and_goal(env) -> None:
    env.reset()
    x, y, _ = place(env)
    goal = env.simulation.group().starts.goals_w[0].tolist()
    env.reset(seed=4, options={"start": (x, y, 1.0), "goal": goal})
    np.testing.assert_allclose(place(env), [x, y, 1.0], atol=0.1)
    np.testing.assert_array_equal(env.simulation.state.groups["rover"].goal.position_w[0], goal)
    env.reset(seed=4, options={"start": [x, y]})
    first = place(env)
    np.testing.assert_allclose(first[:2], [x, y], atol=0.1)
    # The next episode is as it would have been.
    env.reset()
    after = place(env)
    assert np.abs(np.subtract(after[:2], [x, y])).max() > 0.5
    env.reset(seed=4, options={"episode": 1})
    assert place(env) == after


def test_a_start_alone_gets_a_goal_of_its_own(env) -> None:
    goals = []
    for episode in range(12):
        env.reset(options={"episode": episode})
        sampled = env.simulation.group().starts.goals_w[0].copy()
        # Where the goal was to be.
        env.reset(options={"episode": episode, "start": sampled})
        goals.append(float(env.simulation.state.groups["rover"].goal.distance[0]))
    assert min(goals) > 1.8


def test_of_several_agents() -> None:
    env = dune_rl.parallel_env("flat", 0, robots=["rover_zero", "rover_zero"])
    env.reset(options={"start": {"rover_1": (3.0, 3.0, 0.0)}})
    np.testing.assert_allclose(env.simulation.group().body.motion.position_w[1, :2], [3.0, 3.0], atol=0.05)
    with pytest.raises(ValueError, match="must be a mapping from agents: rover_0, rover_1"):
        env.reset(options={"start": (3.0, 3.0)})
    with pytest.raises(ValueError, match="names no agent rover_7"):
        env.reset(options={"goal": {"rover_7": (3.0, 3.0)}})
    env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"places": 1}, "reset has no options 'places'; there are start, goal, episode"),
        ({"start": (1.0,)}, r"options\['start'\] must be 2 or 3 finite numbers"),
        ({"goal": (np.nan, 0.0)}, r"options\['goal'\] must be 2 finite numbers"),
        ({"goal": "there"}, "must be 2 finite numbers"),
        ({"start": (999.0, 0.0)}, "the start of rover_0 .* is outside the world"),
    ],
)
def test_wrong_options(env, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)


def test_a_place_in_an_obstacle_is_refused(env) -> None:
    env.reset()
    world = env.simulation.worlds.worlds[0]
    xmin, xmax, ymin, ymax = world.extent
    xy = np.random.default_rng(0).uniform((xmin, ymin), (xmax, ymax), (4000, 2))
    inside = xy[world.clearance(xy) == 0.0][0]
    with pytest.raises(ValueError, match=r"the goal of rover_0 .* from an obstacle.*choose another"):
        env.reset(options={"goal": inside})
    with pytest.raises(ConfigError, match=r"options\['episode'\] must be a whole number"):
        env.reset(options={"episode": -1})


def test_a_refused_reset_leaves_nothing_half_done(env) -> None:
    env.reset(seed=3)
    env.step({"rover_0": np.zeros(2, np.float32)})
    with pytest.raises(ValueError, match="outside the world"):
        env.reset(seed=9, options={"goal": (999.0, 0.0)})
    with pytest.raises(RuntimeError, match="reset"):
        env.step({"rover_0": np.zeros(2, np.float32)})
    # Neither the number of the episode is used up, nor is the place remembered.
    other = copy.deepcopy(env)
    for each in (env, other):
        _, infos = each.reset()
        assert infos["rover_0"]["episode_id"] == 0.0
    assert place(env) == place(other)
    other.close()
    fresh = dune_rl.parallel_env("inspection", 0)
    for each in (env, fresh):
        each.reset(seed=9)
    assert place(env) == place(fresh)
    fresh.close()


def test_robots_do_not_start_in_one_another() -> None:
    env = dune_rl.parallel_env("flat", 1, robots=["rover_zero"] * 2)
    with pytest.raises(ValueError, match="rover_0 and rover_1 would start in one another, at"):
        env.reset(options={"start": {"rover_0": (1.0, 1.0), "rover_1": (1.2, 1.0)}})
    env.close()


def test_robots_without_a_given_start_make_room_for_those_with_one() -> None:
    env = dune_rl.parallel_env("flat", 1, robots=["rover_zero", "rover_zero", "leo_rover"])
    groups = [group.body.motion for group in env.simulation.groups if group.name in ("rover", "leo_rover")]
    for seed in range(3):
        env.reset(seed=seed)
        before = np.concatenate([each.position_w[:, :2] for each in groups])
        # Where the last and the second would have started.
        for agent, start in (("rover_0", before[2]), ("leo_rover_0", before[1])):
            env.reset(seed=seed, options={"start": {agent: start}})
            groups = [env.simulation.group(name).body.motion for name in ("rover", "leo_rover")]
            after = np.concatenate([each.position_w[:, :2] for each in groups])
            number = 0 if agent == "rover_0" else 2
            np.testing.assert_allclose(after[number], start, atol=0.05)
            gaps = np.hypot(*(after[:, None] - after).transpose(2, 0, 1))[np.triu_indices(3, 1)]
            # Two footprints and half a metre.
            assert gaps.min() > 1.1
    env.close()


def test_the_number_of_an_episode_is_exact(env) -> None:
    _, infos = env.reset(options={"episode": 16_777_217})
    assert infos["rover_0"]["episode_id"] == 16_777_217


@pytest.mark.parametrize("options", [1, ["goal"]])
def test_options_are_a_mapping(env, options) -> None:
    with pytest.raises(ValueError, match="options must be a mapping"):
        env.reset(options=options)
    with pytest.raises(ValueError, match="must be at most"):
        env.reset(options={"episode": 2**63})


def test_walkers_do_not_start_where_they_are_told() -> None:
    env = dune_rl.parallel_env("flat", 0, actors="external_walkers")
    with pytest.raises(ValueError, match="walker_0: only robots"):
        env.reset(options={"start": {"walker_0": (1.0, 1.0)}})
    env.close()


def test_gymnasium_passes_them_on() -> None:
    env = gymnasium.make("dune_rl:dune_rl/Flat-v0")
    env.reset(options={"start": (2.0, 1.0, 0.0)})
    np.testing.assert_allclose(place(env.unwrapped)[:2], [2.0, 1.0], atol=0.05)
    env.close()
