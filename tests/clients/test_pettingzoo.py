"""PettingZoo's own tests and conversions on an environment of ours."""

from functools import partial

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.utils.conversions import aec_to_parallel, parallel_to_aec
from pettingzoo.utils.wrappers import MultiEpisodeParallelEnv

import dune_rl

SHORT = {"task": {"name": "paper", "terminations": {"time_limit": {"max_steps": 6}}}}
each_setting = pytest.mark.parametrize(
    "settings",
    [
        {"actors": actors, "flatten": flatten}
        for actors in ("walkers", "external_walkers")
        for flatten in (False, True)
    ],
    ids=["one", "one, flat", "three", "three, flat"],
)


def make(**settings):
    return dune_rl.parallel_env("flat", 0, **SHORT, **settings)


@pytest.mark.slow(all_but=["one"])
@pytest.mark.client("PettingZoo", "`parallel_api_test`, `parallel_seed_test`", "dune_rl.parallel_env")
@each_setting
def test_parallel(settings) -> None:
    env = make(**settings)
    parallel_api_test(env, 40)
    env.close()
    parallel_seed_test(partial(make, **settings), 10)


@pytest.mark.client("PettingZoo", "`api_test`, `seed_test` through `parallel_to_aec`", "dune_rl.parallel_env")
@each_setting
# Recommendations of the test: observations are dicts, and agents of two kinds have two spaces.
@pytest.mark.slow(all_but=["one"])
@pytest.mark.filterwarnings("ignore:Observation(s are different shapes| space for each| is not a NumPy)")
@pytest.mark.filterwarnings("ignore:Agents have different observation space sizes")
def test_one_after_another(settings) -> None:
    env = parallel_to_aec(make(**settings))
    api_test(env, 30)
    env.close()
    seed_test(lambda: parallel_to_aec(make(**settings)), 10)


@pytest.mark.client("PettingZoo", "`aec_to_parallel`, `MultiEpisodeParallelEnv`", "dune_rl.parallel_env")
def test_conversions() -> None:
    there_and_back = aec_to_parallel(parallel_to_aec(make(actors="external_walkers")))
    parallel_api_test(there_and_back, 30)
    episodes = MultiEpisodeParallelEnv(make(), 3)
    parallel_api_test(episodes, 30)
    there_and_back.close()
    episodes.close()


@pytest.mark.client(
    "PettingZoo", "`render_test`, `test_parallel_env` of `state()`", "dune_rl.parallel_env", needs=["viser"]
)
def test_pettingzoo_s_render_and_state_tests() -> None:
    from pettingzoo.test.render_test import render_test
    from pettingzoo.test.state_test import test_parallel_env as check_state

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
