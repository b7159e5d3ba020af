"""Other people's software on environments of ours: recorders, wrappers, and their own checks."""

import os

import gymnasium
import numpy as np
import pytest

import dune_rl

ID = "dune_rl:dune_rl/Flat-v0"
SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": 5}}}}


def test_episodes_are_recorded() -> None:
    env = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.make(ID, **SHORT))
    env.reset(seed=0)
    for _ in range(5):
        *_, info = env.step(env.action_space.sample())
    assert info["episode"]["l"] == 5
    assert info["episode"]["r"] == pytest.approx(info["return"], rel=1e-5)
    assert info["episode_id"] == 0.0
    env.close()


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


def test_a_list_of_pictures() -> None:
    env = gymnasium.make(ID, render_mode="rgb_array_list")
    env.reset(seed=0)
    for _ in range(2):
        env.step(env.action_space.sample())
    pictures = env.render()
    assert len(pictures) == 3 and pictures[0].shape == (480, 640, 3)
    env.close()


def test_a_window(monkeypatch) -> None:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setitem(os.environ, "SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make(ID, render_mode="human")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert env.render() is None
    surface = pygame.display.get_surface()
    shown = pygame.surfarray.array3d(surface).swapaxes(0, 1)
    other = gymnasium.make(ID, render_mode="rgb_array")
    other.reset(seed=0)
    assert shown.shape == other.render().shape and shown.std() > 5.0
    env.close()
    assert pygame.display.get_surface() is None
    other.close()


def test_without_pygame_there_is_no_window(monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(dune_rl.ConfigError, match="pip install pygame"):
        dune_rl.parallel_env("flat", 0, render_mode="human")


def test_pettingzoo_s_render_and_state_tests(monkeypatch) -> None:
    pytest.importorskip("pygame")
    from pettingzoo.test.render_test import render_test
    from pettingzoo.test.state_test import test_parallel_env as check_state
    from pettingzoo.utils.conversions import parallel_to_aec

    monkeypatch.setitem(os.environ, "SDL_VIDEODRIVER", "dummy")
    render_test(
        lambda render_mode=None: parallel_to_aec(dune_rl.parallel_env("flat", 0, render_mode=render_mode))
    )
    env = dune_rl.parallel_env("flat", 0, actors="walkers")
    with pytest.raises(RuntimeError, match="reset"):
        env.state()
    check_state(env)
    env.reset()
    state = env.state().reshape(3, 14)
    np.testing.assert_allclose(state[0, :3], env.simulation.group().body.motion.position_w[0], rtol=1e-6)
    assert env.state_space.contains(env.state())
    env.close()


def test_torchrl_s_wrapper_of_gymnasium() -> None:
    from torchrl.envs import GymEnv

    env = GymEnv(ID)
    assert env.rollout(3).batch_size == (3,)
    env.close()
    pixels = GymEnv(ID, from_pixels=True, pixels_only=False)
    assert pixels.rollout(2)["pixels"].shape == (2, 480, 640, 3)
    pixels.close()


def test_torchrl_records_pixels() -> None:
    from torchrl.envs import TransformedEnv
    from torchrl.record import PixelRenderTransform

    env = TransformedEnv(dune_rl.make("flat", 2), PixelRenderTransform())
    pictures = env.rollout(2)["pixels"]
    assert np.asarray(pictures[0][0]).shape == (480, 640, 3)
    env.close()


def test_gymnasium_s_own_copies_differ() -> None:
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="sync")
    seen, _ = envs.reset()
    assert (seen["goal"][0] != seen["goal"][1]).any()
    envs.close()


def test_supersuit_copies_the_environment() -> None:
    supersuit = pytest.importorskip("supersuit")
    env = dune_rl.parallel_env("flat", 0, flatten=True)
    envs = supersuit.pettingzoo_env_to_vec_env_v1(env)
    envs = supersuit.concat_vec_envs_v1(envs, 2, num_cpus=0, base_class="gymnasium")
    seen, _ = envs.reset(seed=1)
    assert seen.shape == (2, *env.observation_space("rover_0").shape)
    envs.step(np.zeros((2, 2), np.float32))
    envs.close()


@pytest.mark.parametrize("algorithm", ["SAC", "PPO"])
@pytest.mark.parametrize("policy", ["MultiInputPolicy", "MlpPolicy"])
def test_stable_baselines3_learns(algorithm: str, policy: str) -> None:
    library = pytest.importorskip("stable_baselines3")
    settings = {
        "SAC": {"learning_starts": 30, "batch_size": 8},
        "PPO": {"n_steps": 32, "batch_size": 8, "n_epochs": 1},
    }
    env = gymnasium.make(ID, flatten=policy == "MlpPolicy", **SHORT)
    learner = getattr(library, algorithm)
    model = learner(policy, env, policy_kwargs={"net_arch": [8]}, seed=0, **settings[algorithm])
    model.learn(64)
    # Its Monitor records the episodes.
    assert len(model.ep_info_buffer) > 5 and model.ep_info_buffer[0]["l"] == 5
    env.close()


def test_stable_baselines3_s_monitor_of_several() -> None:
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    envs = vec_env.VecMonitor(vec_env.DummyVecEnv([lambda: gymnasium.make(ID, **SHORT)] * 2))
    envs.reset()
    for _ in range(5):
        *_, infos = envs.step(np.zeros((2, 2), np.float32))
    assert [info["episode"]["l"] for info in infos] == [5, 5]
    envs.close()
