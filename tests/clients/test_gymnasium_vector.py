"""Gymnasium's vector environment: the batch by `make_vec`, as Gymnasium 1 specifies it."""

import copy
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector

import dune_rl
from dune_rl.core.errors import ConfigError

ID = "dune_rl:dune_rl/Flat-v0"
SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": 6}}}}


def make(num_envs: int = 3, **settings) -> gymnasium.vector.VectorEnv:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return gymnasium.make_vec(ID, num_envs=num_envs, **{**SHORT, **settings})


def equal(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(a[key], b[key]) for key in a)


@pytest.mark.client("Gymnasium", "the batch as its `VectorEnv`", "gymnasium.make_vec")
def test_make_vec_gives_the_batch() -> None:
    envs = make(seed=0)
    assert type(envs.unwrapped) is type(dune_rl.gym_vector_env("flat", 2))
    assert envs.num_envs == envs.unwrapped.simulation.num_scenes == 3
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, infos = envs.reset(seed=5)
    assert envs.observation_space.contains(observations)
    assert infos["episode_id"].tolist() == [0, 1, 2] and infos["_episode_id"].all()
    observations, reward, terminated, truncated, infos = envs.step(envs.action_space.sample())
    assert envs.observation_space.contains(observations)
    assert reward.shape == terminated.shape == truncated.shape == (3,)
    assert (terminated.dtype, truncated.dtype, reward.dtype) == (bool, bool, float)
    assert infos["steps"].tolist() == [1.0, 1.0, 1.0]
    envs.close()


def test_scenes_are_those_of_single_environments() -> None:
    envs, one = make(num_envs=2), gymnasium.make(ID, **SHORT)
    batch, _ = envs.reset(seed=3)
    for scene in range(2):
        alone, _ = one.reset(seed=3) if scene == 0 else one.reset(seed=3, options={"episode": 1})
        for key, value in alone.items():
            np.testing.assert_allclose(batch[key][scene], value, atol=1e-6)
    envs.close()
    one.close()


@pytest.mark.client("Gymnasium", "seeds, one or a list", "gymnasium.make_vec")
def test_seeds() -> None:
    envs = make()
    first, _ = envs.reset(seed=7)
    envs.step(envs.action_space.sample())
    again, _ = envs.reset(seed=7)
    other, _ = envs.reset(seed=8)
    assert equal(first, again) and not equal(first, other)
    listed, _ = envs.reset(seed=[1, 2, 3])
    listed_again, _ = envs.reset(seed=[1, 2, 3])
    otherwise, _ = envs.reset(seed=[1, 2, 4])
    assert equal(listed, listed_again) and not equal(listed, otherwise)
    with pytest.raises(ValueError, match="3 scenes, and 2 seeds"):
        envs.reset(seed=[1, 2])
    with pytest.raises(ConfigError, match="seed must be a whole number"):
        envs.reset(seed=-1)
    envs.close()


@pytest.mark.slow
def test_unseeded_copies_differ() -> None:
    starts = []
    for _ in range(2):
        envs, one = make(num_envs=1), gymnasium.make(ID)
        starts += [envs.reset()[0]["goal"].ravel(), one.reset()[0]["goal"].ravel()]
        envs.close()
        one.close()
    assert len({start.tobytes() for start in starts}) == 4


@pytest.mark.client("Gymnasium", "automatic reset in the next step", "gymnasium.make_vec")
def test_next_step_autoreset() -> None:
    envs = make()
    envs.reset(seed=0)
    for step in range(1, 15):
        observations, reward, terminated, truncated, infos = envs.step(envs.action_space.sample())
        # Six steps of an episode, then one that begins another.
        place = step % 7
        assert truncated.all() == (place == 6) and not terminated.any()
        assert infos["steps"].tolist() == [float(place)] * 3
        assert infos["episode_id"].tolist() == [scene + 3.0 * (step // 7) for scene in range(3)]
        if place == 0:
            assert reward.tolist() == [0.0] * 3
            fresh = make()
            fresh.reset(seed=0)
            for _ in range(step // 7):
                begun, _ = fresh.reset()
            assert equal(observations, begun)
            fresh.close()
    envs.close()


@pytest.mark.client("Gymnasium", "automatic reset in the same step", "gymnasium.make_vec")
def test_same_step_autoreset() -> None:
    envs, other = make(autoreset_mode="same_step"), make()
    envs.reset(seed=0)
    other.reset(seed=0)
    for step in range(1, 7):
        action = envs.action_space.sample()
        observations, reward, _, truncated, infos = envs.step(action)
        last, same_reward, _, same_truncated, last_infos = other.step(action)
        np.testing.assert_array_equal(reward, same_reward)
        np.testing.assert_array_equal(truncated, same_truncated)
        assert ("final_obs" in infos) == (step == 6)
    assert infos["_final_obs"].all() and infos["_final_info"].all()
    for scene in range(3):
        assert equal(infos["final_obs"][scene], {key: value[scene] for key, value in last.items()})
    assert infos["final_info"]["return"].tolist() == last_infos["return"].tolist()
    begun, _, _, _, begun_infos = other.step(action)
    assert equal(observations, begun)
    assert infos["episode_id"].tolist() == begun_infos["episode_id"].tolist() == [3.0, 4.0, 5.0]
    envs.close()
    other.close()


@pytest.mark.slow(all_but=["next_step"])
@pytest.mark.client("Gymnasium", "`max_episode_steps`, as `TimeLimit` has it", "gymnasium.make_vec")
@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_gymnasium_s_time_limit(mode: str) -> None:
    envs = gymnasium.make_vec(ID, num_envs=2, autoreset_mode=mode, max_episode_steps=4)
    one = gymnasium.make(ID, max_episode_steps=4)
    envs.reset(seed=3)
    one.reset(seed=3)
    action = np.full((2, 2), 0.2, np.float32)
    for step in range(1, 5):
        seen, reward, terminated, truncated, infos = envs.step(action)
        alone, expected, *ends, _ = one.step(action[0])
        np.testing.assert_allclose(reward[0], expected, atol=1e-6)
        assert [terminated.tolist(), truncated.tolist()] == [[end] * 2 for end in ends]
        assert truncated.all() == (step == 4)
    last = {"same_step": lambda: infos["final_obs"][0]["lidar"]}.get(mode, lambda: seen["lidar"][0])()
    np.testing.assert_allclose(last, alone["lidar"], atol=1e-5)
    # A copy knows the limit, and goes on.
    other = copy.deepcopy(envs)
    for each in (envs, other):
        if mode == "disabled":
            each.reset(options={"reset_mask": np.array([True, True])})
        steps = 5 if mode == "next_step" else 4
        assert [bool(each.step(action)[3].all()) for _ in range(steps)] == [False] * (steps - 1) + [True]
        each.close()
    one.close()
    with pytest.raises(ConfigError, match="max_episode_steps must be a whole number of at least 1"):
        gymnasium.make_vec(ID, num_envs=2, max_episode_steps=0)


@pytest.mark.client("Gymnasium", "no automatic reset, and `reset_mask`", "gymnasium.make_vec")
def test_no_autoreset() -> None:
    envs = make(autoreset_mode="disabled")
    envs.reset(seed=0)
    for _ in range(6):
        *_, truncated, _ = envs.step(envs.action_space.sample())
    assert truncated.all()
    with pytest.raises(gymnasium.error.ResetNeeded, match="0, 1, 2"):
        envs.step(envs.action_space.sample())
    _, infos = envs.reset(options={"reset_mask": np.array([True, False, True])})
    assert infos["_steps"].tolist() == [True, False, True]
    with pytest.raises(gymnasium.error.ResetNeeded, match="scenes 1 have"):
        envs.step(envs.action_space.sample())
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    *_, infos = envs.step(envs.action_space.sample())
    assert infos["steps"].tolist() == [1.0] * 3
    envs.close()


def test_wrong_input() -> None:
    envs = make()
    with pytest.raises(RuntimeError, match="reset"):
        envs.step(envs.action_space.sample())
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"shape \(3, 2\) \(got \(2, 2\)\)"):
        envs.step(np.zeros((2, 2), np.float32))
    with pytest.raises(ValueError, match="finite"):
        envs.step(np.full((3, 2), np.nan, np.float32))
    for mask in (np.ones(2, bool), np.zeros(3, bool)):
        with pytest.raises(ValueError, match="reset_mask"):
            envs.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match="no reset options start"):
        envs.reset(options={"start": [0, 0]})
    with pytest.raises(ValueError, match="a seed is of all scenes"):
        envs.reset(seed=1, options={"reset_mask": np.array([True, False, False])})
    with pytest.raises(ConfigError, match="autoreset_mode must be one of next_step"):
        make(autoreset_mode="later")
    envs.close()
    with pytest.raises(RuntimeError, match="closed"):
        envs.unwrapped.step(np.zeros((3, 2), np.float32))


def test_the_first_reset_is_of_all_scenes() -> None:
    envs = make(render_mode="rgb_array")
    with pytest.raises(RuntimeError, match="the first reset must be of all scenes"):
        envs.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(RuntimeError, match="reset"):
        envs.render()
    with pytest.raises(ValueError, match="options must be a mapping"):
        envs.reset(options=3)
    envs.reset(seed=4)
    assert envs.unwrapped.np_random_seed == 4
    with pytest.raises(ValueError, match=r"shape \(3, 2\)"):
        envs.step("abc")
    envs.close()
    assert make(autoreset_mode="SameStep").unwrapped.autoreset_mode is AutoresetMode.SAME_STEP


WRAPPERS = {
    "clip action": vector.ClipAction,
    "clip reward": lambda envs: vector.ClipReward(envs, -1.0, 1.0),
    "flatten": vector.FlattenObservation,
    "list of infos": vector.DictInfoToList,
    "normalise reward": vector.NormalizeReward,
    "rescale action": lambda envs: vector.RescaleAction(envs, np.float32(-1), np.float32(1)),
}
OF_VECTORS = {
    "normalise": vector.NormalizeObservation,
    "rescale": lambda envs: vector.RescaleObservation(envs, np.float32(-1), np.float32(1)),
}


@pytest.mark.slow(all_but=["clip action, flat", "norm*, flat", "rescale, flat", "list of infos, flat"])
@pytest.mark.client(
    "Gymnasium", "9 vector wrappers, among them `NormalizeObservation`, `RescaleAction`", "gymnasium.make_vec"
)
@pytest.mark.parametrize(
    ("wrap", "flatten"),
    [
        *(pytest.param(wrap, False, id=name) for name, wrap in WRAPPERS.items()),
        *(pytest.param(wrap, True, id=f"{name}, flat") for name, wrap in {**WRAPPERS, **OF_VECTORS}.items()),
        pytest.param(lambda envs: vector.FilterObservation(envs, ["goal"]), False, id="filter"),
    ],
)
def test_wrappers(wrap, flatten: bool) -> None:
    envs = wrap(make(flatten=flatten))
    envs.reset(seed=0)
    ends = 0
    for _ in range(14):
        _, reward, _, truncated, _ = envs.step(envs.action_space.sample())
        ends += truncated.sum()
        assert reward.shape == (3,) and np.isfinite(reward).all()
    assert ends == 6
    envs.close()


@pytest.mark.client("Gymnasium", "vector `RecordEpisodeStatistics`", "gymnasium.make_vec")
def test_episodes_are_recorded() -> None:
    envs = vector.RecordEpisodeStatistics(make())
    envs.reset(seed=0)
    for _ in range(6):
        *_, infos = envs.step(envs.action_space.sample())
    assert infos["episode"]["l"].tolist() == [6, 6, 6]
    np.testing.assert_allclose(infos["episode"]["r"], infos["return"], rtol=1e-5)
    envs.close()


@pytest.mark.client("MoviePy", "`RecordVideo` of all scenes", "gymnasium.make_vec")
def test_films(tmp_path) -> None:
    envs = make(num_envs=2, render_mode="rgb_array")
    envs = vector.RecordVideo(
        envs, str(tmp_path / "films"), episode_trigger=lambda _: True, disable_logger=True
    )
    envs.reset(seed=0)
    for _ in range(7):
        envs.step(envs.action_space.sample())
    envs.close()
    sizes = [film.stat().st_size for film in (tmp_path / "films").glob("*.mp4")]
    assert len(sizes) == 2 and min(sizes) > 1000


@pytest.mark.slow
def test_pictures() -> None:
    envs = make(num_envs=2, render_mode="rgb_array")
    envs.reset(seed=0)
    one, two = envs.render()
    assert one.shape == two.shape == (480, 640, 3) and (one != two).any()
    envs.close()
