"""Gymnasium's own wrappers, checks, recorders and vector environments on an environment of ours."""

import json
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env

import dune_rl

ID = "dune_rl:dune_rl/Flat-v0"
SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": 5}}}}
ONE = np.float32(1.0)


def drive(env: gymnasium.Env, steps: int = 12) -> list[tuple]:
    env.reset(seed=0)
    found = []
    for _ in range(steps):
        found.append(env.step(env.action_space.sample()))
        if found[-1][2] or found[-1][3]:
            env.reset()
    env.close()
    return found


@pytest.mark.client("Gymnasium", "`RecordEpisodeStatistics`", "gymnasium.make")
def test_episodes_are_recorded() -> None:
    env = wrappers.RecordEpisodeStatistics(gymnasium.make(ID, **SHORT))
    *_, info = drive(env, 5)[-1]
    assert info["episode"]["l"] == 5
    assert info["episode"]["r"] == pytest.approx(info["return"], rel=1e-5)
    assert info["episode_id"] == 0.0


def test_no_info_has_a_key_that_clients_reserve() -> None:
    reserved = {"episode", "final_obs", "final_info", "final_observation", "terminal_observation"}
    reserved |= {"TimeLimit.truncated", "is_success", "maybe_ep_info", "reset_info", "_episode"}
    env = dune_rl.parallel_env("flat", 0, actors="external_walkers", metrics={"energy": True})
    _, infos = env.reset()
    *_, stepped = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    for info in (*infos.values(), *stepped.values()):
        assert info and not reserved & info.keys()
    assert stepped["walker_0"]["steps"] == 1.0
    env.close()


WRAPPERS = {
    "autoreset": wrappers.Autoreset,
    "clip action": wrappers.ClipAction,
    "clip reward": lambda env: wrappers.ClipReward(env, -1.0, 1.0),
    "delay": lambda env: wrappers.DelayObservation(env, 2),
    "flatten": wrappers.FlattenObservation,
    "normalise reward": wrappers.NormalizeReward,
    "rescale action": lambda env: wrappers.RescaleAction(env, -ONE, ONE),
    "stack": lambda env: wrappers.FrameStackObservation(env, 3),
    "sticky action": lambda env: wrappers.StickyAction(env, 0.3),
    "time": lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, 4)),
}
OF_VECTORS = {
    "largest of two": lambda env: wrappers.MaxAndSkipObservation(env, 2),
    "normalise": wrappers.NormalizeObservation,
    "rescale": lambda env: wrappers.RescaleObservation(env, -ONE, ONE),
}


@pytest.mark.slow(
    all_but=[
        "clip reward",
        "stack",
        "autoreset",
        "rescale action, flat",
        "time, flat",
        "normalise reward, flat",
        "delay",
        "filter",
    ]
)
@pytest.mark.client(
    "Gymnasium",
    "14 wrappers, among them `FrameStackObservation`, `TimeLimit`, `RescaleAction`",
    "gymnasium.make",
)
@pytest.mark.parametrize(
    ("wrap", "flatten"),
    [
        *(pytest.param(wrap, False, id=name) for name, wrap in WRAPPERS.items()),
        *(pytest.param(wrap, True, id=f"{name}, flat") for name, wrap in {**WRAPPERS, **OF_VECTORS}.items()),
        pytest.param(lambda env: wrappers.FilterObservation(env, ["goal"]), False, id="filter"),
    ],
)
def test_wrappers(wrap, flatten: bool) -> None:
    env = wrap(gymnasium.make(ID, flatten=flatten, **SHORT))
    space = env.observation_space
    steps = drive(env)
    # Normalised values are float64 of a float32 space, by Gymnasium itself.
    assert all(np.shape(step[0]) == space.shape for step in steps) if space.shape else True
    assert np.isfinite([step[1] for step in steps]).all()
    assert any(step[3] for step in steps)


@pytest.mark.client("Gymnasium", "`check_env`", "gymnasium.make")
@pytest.mark.parametrize("flatten", [False, True])
# A recommendation: actions have physical units, so that wrappers rescale them.
@pytest.mark.slow(all_but=["True"])
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_gymnasium_s_check(flatten: bool) -> None:
    env = gymnasium.make(ID, flatten=flatten, **SHORT).unwrapped
    check_env(env)
    env.close()


@pytest.mark.client("Gymnasium", "`EnvSpec` as JSON, and back", "gymnasium.make")
def test_specifications() -> None:
    spec = gymnasium.make(ID, flatten=True, **SHORT).spec
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert json.loads(spec.to_json())["kwargs"]["flatten"]
    assert drive(again, 5)[-1][3]


@pytest.mark.slow
@pytest.mark.client("Gymnasium", '`render_mode="rgb_array_list"`', "gymnasium.make")
def test_a_list_of_pictures() -> None:
    env = gymnasium.make(ID, render_mode="rgb_array_list")
    env.reset(seed=0)
    for _ in range(2):
        env.step(env.action_space.sample())
    pictures = env.render()
    assert len(pictures) == 3 and pictures[0].shape == (480, 640, 3)
    env.close()


@pytest.mark.client("MoviePy", "`RecordVideo`", "gymnasium.make")
def test_films(tmp_path: Path) -> None:
    env = gymnasium.make(ID, render_mode="rgb_array", **SHORT)
    drive(
        wrappers.RecordVideo(
            env, str(tmp_path / "films"), episode_trigger=lambda _: True, disable_logger=True
        ),
        5,
    )
    from moviepy import VideoFileClip

    with VideoFileClip(str(tmp_path / "films" / "rl-video-episode-0.mp4")) as film:
        assert film.size == [640, 480] and film.fps == 20.0 and film.get_frame(0.1).std() > 5.0


@pytest.mark.client("viser", '`render_mode="human"`: a page in a browser', "gymnasium.make")
def test_a_page() -> None:
    from urllib.request import urlopen

    env = gymnasium.make(ID, render_mode="human")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert env.render() is None
    url = env.unwrapped.page.url
    with urlopen(url) as response:
        assert response.status == 200 and b"<html" in response.read()
    env.close()
    with pytest.raises(OSError, match="refused"):
        urlopen(url)


def test_without_viser_there_is_no_page(monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(dune_rl.ConfigError, match=r"render_mode='human' needs viser: .*dune_rl\[live\]"):
        dune_rl.parallel_env("flat", 0, render_mode="human")


@pytest.mark.client("Gymnasium", "`SyncVectorEnv` of single environments", "gymnasium.make_vec")
def test_gymnasium_s_own_copies_differ() -> None:
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="sync")
    seen, _ = envs.reset()
    assert (seen["goal"][0] != seen["goal"][1]).any()
    envs.close()


@pytest.mark.slow
@pytest.mark.client("Gymnasium", "`AsyncVectorEnv`, its processes forked or spawned", "gymnasium.make_vec")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes(method: str) -> None:
    options = {"vectorization_mode": "async", "vector_kwargs": {"context": method}}
    envs = gymnasium.make_vec(ID, num_envs=2, **options, **SHORT)
    alone = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="sync", **SHORT)
    for each in (envs, alone):
        each.reset(seed=3)
    action = np.full((2, 2), 0.3, np.float32)
    for _ in range(7):
        (seen, *_), (expected, *_) = envs.step(action), alone.step(action)
    assert all(np.array_equal(seen[key], expected[key]) for key in expected)
    envs.close()
    alone.close()


@pytest.mark.client(
    "Gymnasium",
    "CleanRL's PPO stack: flat, recorded, clipped, normalised, in a `SyncVectorEnv`",
    "gymnasium.make",
)
def test_the_wrappers_of_cleanrl() -> None:
    def make() -> gymnasium.Env:
        env = gymnasium.make(ID, flatten=True, **SHORT)
        env = wrappers.ClipAction(wrappers.RecordEpisodeStatistics(wrappers.FlattenObservation(env)))
        env = wrappers.NormalizeObservation(env)
        env = wrappers.TransformObservation(env, lambda seen: np.clip(seen, -10, 10), env.observation_space)
        env = wrappers.NormalizeReward(env, gamma=0.99)
        return wrappers.TransformReward(env, lambda reward: float(np.clip(reward, -10, 10)))

    envs = gymnasium.vector.SyncVectorEnv([make] * 2)
    envs.reset(seed=1)
    for _ in range(5):
        seen, _, _, truncated, infos = envs.step(envs.action_space.sample())
    assert truncated.all() and infos["episode"]["l"].tolist() == [5, 5]
    assert np.abs(seen).max() <= 10.0 and seen.std() > 0.01
    envs.close()
