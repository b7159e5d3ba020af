"""Stable-Baselines3 on environments of ours."""

from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from user_packages import shown_files

from dune_rl import evaluate

ID = "dune_rl:dune_rl/Flat-v0"
SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": 5}}}}
CAMERA = {"sensors": {"enabled": ["camera", "lidar", "goal"], "camera": {"height": 36, "width": 36}}}
SETTINGS = {
    "A2C": {},
    "PPO": {"n_steps": 32, "batch_size": 8, "n_epochs": 1},
    "SAC": {"learning_starts": 30, "batch_size": 8},
    "TD3": {"learning_starts": 30, "batch_size": 8},
}


@pytest.mark.client("Stable-Baselines3", "A2C, PPO, SAC and TD3 learn", "gymnasium.make")
@pytest.mark.parametrize("algorithm", SETTINGS)
@pytest.mark.parametrize("policy", ["MultiInputPolicy", "MlpPolicy"])
def test_learning(algorithm: str, policy: str) -> None:
    import stable_baselines3

    env = gymnasium.make(ID, flatten=policy == "MlpPolicy", **SHORT)
    learner = getattr(stable_baselines3, algorithm)
    model = learner(policy, env, policy_kwargs={"net_arch": [8]}, seed=0, **SETTINGS[algorithm])
    before = {name: weights.clone() for name, weights in model.policy.state_dict().items()}
    model.learn(64)
    # Its Monitor records the episodes.
    assert len(model.ep_info_buffer) > 5 and model.ep_info_buffer[0]["l"] == 5
    assert any((weights != before[name]).any() for name, weights in model.policy.state_dict().items())
    env.close()


@pytest.mark.client("Stable-Baselines3", "`check_env`", "gymnasium.make")
@pytest.mark.parametrize("settings", [{}, {"flatten": True}, CAMERA], ids=["dict", "flat", "camera"])
@pytest.mark.filterwarnings("ignore:.*We recommend you to use a symmetric and normalized Box")
def test_its_check(settings) -> None:
    from stable_baselines3.common.env_checker import check_env

    env = gymnasium.make(ID, **SHORT, **settings).unwrapped
    check_env(env)
    env.close()


@pytest.mark.client(
    "Stable-Baselines3", "`VecNormalize`, `VecFrameStack`, `VecMonitor`, a camera", "gymnasium.make"
)
@pytest.mark.parametrize("wrapper", ["VecNormalize", "VecFrameStack", "VecMonitor", "camera"])
def test_vector_wrappers(wrapper: str) -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common import vec_env

    settings = CAMERA if wrapper == "camera" else {}
    envs = vec_env.DummyVecEnv([lambda: gymnasium.make(ID, **SHORT, **settings)] * 2)
    if wrapper != "camera":
        arguments = {"n_stack": 2} if wrapper == "VecFrameStack" else {}
        envs = getattr(vec_env, wrapper)(envs, **arguments)
    model = PPO("MultiInputPolicy", envs, n_steps=8, batch_size=8, n_epochs=1)
    assert model.learn(16).num_timesteps == 16
    envs.close()


@pytest.mark.client("Stable-Baselines3", "`make_vec_env` in processes", "gymnasium.make")
def test_processes() -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    arguments = {"env_kwargs": {"flatten": True, **SHORT}, "vec_env_cls": SubprocVecEnv}
    envs = make_vec_env(ID, 2, **arguments)
    assert PPO("MlpPolicy", envs, n_steps=8, batch_size=8, n_epochs=1).learn(16).num_timesteps == 16
    envs.close()


@pytest.mark.client("Stable-Baselines3", "saving, loading, `evaluate_policy`", "gymnasium.make")
def test_a_saved_policy_is_evaluated(tmp_path: Path) -> None:
    from stable_baselines3 import SAC
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor

    env = Monitor(gymnasium.make(ID, flatten=True, **SHORT))
    SAC("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, **SETTINGS["SAC"]).learn(40).save(tmp_path / "sac")
    loaded = SAC.load(tmp_path / "sac", env=env)
    returns, lengths = evaluate_policy(loaded, env, n_eval_episodes=2, return_episode_rewards=True)
    assert lengths == [5, 5] and np.isfinite(returns).all()
    env.close()


@pytest.mark.client("Stable-Baselines3", "saving, loading, `evaluate_policy`", "gymnasium.make")
def test_a_saved_policy_is_measured_by_the_class_of_the_page(
    folder: Path, call: Callable[..., int], monkeypatch: pytest.MonkeyPatch
) -> None:
    from stable_baselines3 import SAC

    monkeypatch.syspath_prepend(folder)
    page = (Path(__file__).parents[2] / "docs" / "how_to" / "evaluate.md").read_text()
    (folder / "my_model.py").write_text(shown_files(page)["my_model.py"])
    env = gymnasium.make(ID, **SHORT)
    model = SAC("MultiInputPolicy", env, policy_kwargs={"net_arch": [8]}, **SETTINGS["SAC"])
    model.save(folder / "model.zip")
    env.close()
    words = ["+world=flat", "task.terminations.time_limit.max_steps=5", "episodes=2", "out=rows"]
    assert call(evaluate.main, "policy=my_model:Driver", *words) == 0
    assert len((folder / "rows" / "episodes.csv").read_text().splitlines()) == 3


@pytest.mark.client("Stable-Baselines3", "`VecMonitor` records the episodes of several", "gymnasium.make")
def test_its_monitor_of_several() -> None:
    from stable_baselines3.common import vec_env

    envs = vec_env.VecMonitor(vec_env.DummyVecEnv([lambda: gymnasium.make(ID, **SHORT)] * 2))
    envs.reset()
    for _ in range(5):
        *_, infos = envs.step(np.zeros((2, 2), np.float32))
    assert [info["episode"]["l"] for info in infos] == [5, 5]
    envs.close()
