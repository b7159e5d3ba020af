"""SuperSuit's wrappers and vector environments on an environment of ours."""

import copy

import numpy as np
import pytest

import dune_rl

SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": 5}}}}
TWO_ROVERS = {"actors": "none", "robots": ["rover_zero", "rover_zero"]}
WRAPPERS = {
    "black_death_v3": (),
    "clip_actions_v0": (),
    "clip_reward_v0": (),
    "delay_observations_v0": (2,),
    "frame_skip_v0": ((1, 3),),
    "frame_stack_v1": (3,),
    "max_observation_v0": (2,),
    "normalize_obs_v0": (-1, 1),
    "pad_action_space_v0": (),
    "pad_observations_v0": (),
    "sticky_actions_v0": (0.2,),
}


@pytest.mark.client(
    "SuperSuit", "11 wrappers, among them `frame_stack_v1`, `frame_skip_v0`", "dune_rl.parallel_env"
)
@pytest.mark.parametrize("actors", ["walkers", "external_walkers"])
@pytest.mark.parametrize("name", WRAPPERS)
def test_wrappers(name: str, actors: str) -> None:
    import supersuit

    env = dune_rl.parallel_env("flat", 0, flatten=True, actors=actors, **SHORT)
    env = getattr(supersuit, name)(env, *WRAPPERS[name])
    env.reset(seed=1)
    ends = 0
    for _ in range(12):
        seen, rewards, *_ = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        assert all(value.shape == env.observation_space(agent).shape for agent, value in seen.items())
        assert np.isfinite(list(rewards.values())).all()
        if not env.agents:
            ends += 1
            env.reset()
    assert ends >= 2
    env.close()


def test_skipped_frames_depend_on_the_seed_alone() -> None:
    env = dune_rl.parallel_env("flat", 0, **SHORT)
    env.reset(seed=4)
    first = env.np_random.random(3).tolist()
    other = copy.deepcopy(env)
    assert other.np_random.random() == env.np_random.random()
    env.reset(seed=4)
    assert env.np_random.random(3).tolist() == first
    env.reset(seed=5)
    assert env.np_random.random(3).tolist() != first
    env.close()
    other.close()


@pytest.mark.client(
    "SuperSuit",
    "`pettingzoo_env_to_vec_env_v1`, `concat_vec_envs_v1`, also in processes",
    "dune_rl.parallel_env",
)
@pytest.mark.parametrize("processes", [0, 2])
def test_copies_of_the_environment(processes: int) -> None:
    import supersuit

    env = dune_rl.parallel_env("flat", 0, flatten=True, **TWO_ROVERS)
    space = env.observation_space("rover_0")
    envs = supersuit.pettingzoo_env_to_vec_env_v1(env)
    envs = supersuit.concat_vec_envs_v1(envs, 2, num_cpus=processes, base_class="gymnasium")
    seen, _ = envs.reset(seed=1)
    assert seen.shape == (4, *space.shape)
    seen, *_ = envs.step(np.zeros((4, 2), np.float32))
    assert len({row.tobytes() for row in seen}) == 4
    envs.close()


@pytest.mark.client(
    "SuperSuit", "agents of two kinds padded to one vector environment", "dune_rl.parallel_env"
)
def test_walkers_and_rover_in_one() -> None:
    import supersuit

    env = supersuit.black_death_v3(
        dune_rl.parallel_env("flat", 0, flatten=True, actors="external_walkers", **SHORT)
    )
    env = supersuit.pad_action_space_v0(supersuit.pad_observations_v0(env))
    envs = supersuit.pettingzoo_env_to_vec_env_v1(env)
    envs.reset(seed=1)
    for _ in range(12):
        seen, *_ = envs.step(np.zeros((3, 2), np.float32))
    assert seen.shape[0] == 3
    envs.close()


@pytest.mark.client(
    "Stable-Baselines3",
    "PPO with shared parameters on two rovers, by SuperSuit",
    "dune_rl.parallel_env",
    needs=["SuperSuit"],
)
def test_shared_parameters() -> None:
    import supersuit
    from stable_baselines3 import PPO

    env = supersuit.pettingzoo_env_to_vec_env_v1(
        dune_rl.parallel_env("flat", 0, flatten=True, **TWO_ROVERS, **SHORT)
    )
    envs = supersuit.concat_vec_envs_v1(env, 2, base_class="stable_baselines3")
    assert PPO("MlpPolicy", envs, n_steps=8, batch_size=8, n_epochs=1).learn(32).num_timesteps == 32
    envs.close()
