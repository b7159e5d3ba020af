"""What every environment must do, as functions that any test can call: each raises where it is not so.

`tests/planted` holds an environment for each that breaks it.
"""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env
from pettingzoo import ParallelEnv
from pettingzoo.test import parallel_api_test
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

MakeParallel = Callable[[], ParallelEnv]

# What every agent gets at a step, and what a reset gives: observations, infos, and who is there.
Record = list[Any]


@contextmanager
def _warnings_as_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


class _Actor:
    """Random actions that depend on nothing but a seed: never on the spaces' own generators."""

    def __init__(self, env: ParallelEnv, seed: int) -> None:
        self._spaces = {agent: deepcopy(env.action_space(agent)) for agent in env.possible_agents}
        for index, space in enumerate(self._spaces.values()):
            space.seed(seed + index)

    def __call__(self, env: ParallelEnv) -> dict[str, Any]:
        return {agent: self._spaces[agent].sample() for agent in env.agents}


def parallel_rollout(env: ParallelEnv, seed: int, steps: int, action_seed: int = 0) -> Record:
    """All that `steps` random steps from `reset(seed)` give, across the ends of episodes; all copied."""
    act = _Actor(env, action_seed)
    record: Record = [deepcopy((env.reset(seed=seed), env.agents))]
    for _ in range(steps):
        if not env.agents:
            record.append(deepcopy((env.reset(), env.agents)))
        record.append(deepcopy((env.step(act(env)), env.agents)))
    return record


def difference(one: Any, other: Any, path: str = "") -> str | None:
    """Where two nests of arrays and numbers differ, in bytes or types; None where they do not."""
    if type(one) is not type(other):
        return f"{path}: {type(one).__name__} and {type(other).__name__}"
    if isinstance(one, dict):
        if list(one) != list(other):
            return f"{path}: keys {list(one)} and {list(other)}"
        pairs = [(f"{path}/{key}", one[key], other[key]) for key in one]
    elif isinstance(one, list | tuple):
        if len(one) != len(other):
            return f"{path}: {len(one)} and {len(other)} long"
        pairs = [(f"{path}/{index}", *pair) for index, pair in enumerate(zip(one, other, strict=True))]
    else:
        a, b = np.asarray(one), np.asarray(other)
        same = a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
        return None if same else f"{path}: {one} and {other}"
    return next(filter(None, (difference(a, b, where) for where, a, b in pairs)), None)


def _same(one: Record, other: Record, claim: str) -> None:
    found = difference(one, other)
    assert found is None, f"{claim}, yet step{found}"


def check_parallel_api(env: ParallelEnv, num_cycles: int = 100) -> None:
    """PettingZoo's own test, whose warnings count as failures."""
    with _warnings_as_errors():
        parallel_api_test(env, num_cycles)


def check_seeding(make: MakeParallel, steps: int = 60) -> None:
    """Two environments of equal seed and actions agree in everything; another seed gives another episode.

    PettingZoo's `parallel_seed_test` stops after one step and so never sees a
    difference that comes later, or in a later episode.
    """
    one, other = make(), make()
    try:
        first = parallel_rollout(one, 11, steps)
        _same(first, parallel_rollout(other, 11, steps), "equal seeds must give equal steps")
        assert difference(first[0], parallel_rollout(other, 12, 1)[0]) is not None, "the seed changes nothing"
    finally:
        one.close()
        other.close()


def check_no_leak(make: MakeParallel, steps: int = 40) -> None:
    """After `reset(seed)` nothing tells what was done before: the rollout equals a fresh environment's.

    "Before" is a rollout of another seed, then one of the same, each left in the middle of an episode.
    """
    used, fresh = make(), make()
    try:
        expected = parallel_rollout(fresh, 4, steps)
        for seed in (5, 4):
            parallel_rollout(used, seed, steps // 2 + 7, action_seed=3)
            act = _Actor(used, 9)
            if not used.agents:
                used.reset()
            used.step(act(used))
            _same(expected, parallel_rollout(used, 4, steps), "a reset must leave nothing behind")
    finally:
        used.close()
        fresh.close()


def _check_value(space: gymnasium.Space, value: Any, path: str) -> None:
    if isinstance(space, gymnasium.spaces.Dict):
        assert isinstance(value, dict), f"{path} is {type(value).__name__}, not a dict"
        assert set(value) == set(space), f"{path} has the keys {list(value)}, its space {list(space)}"
        for key, part in space.items():
            _check_value(part, value[key], f"{path}/{key}")
        return
    assert isinstance(space, gymnasium.spaces.Box), f"{path} has a {type(space).__name__}"
    assert space.dtype == np.float32, f"the space of {path} holds {space.dtype}"
    assert value.dtype == np.float32, f"{path} is {value.dtype}"
    assert value.shape == space.shape, f"{path} has shape {value.shape}, its space {space.shape}"
    assert np.isfinite(value).all(), f"{path} is not finite: {value}"
    assert (space.low <= value).all() and (value <= space.high).all(), f"{path} leaves its bounds: {value}"
    assert space.contains(value), f"{path} is not in its space: {value}"


def check_values(env: ParallelEnv, steps: int = 80) -> None:
    """At every step observations are float32, finite and within their bounds; rewards are finite."""
    act = _Actor(env, 1)

    def check(observations: dict[str, Any]) -> None:
        for agent, value in observations.items():
            _check_value(env.observation_space(agent), value, agent)

    check(env.reset(seed=1)[0])
    for _ in range(steps):
        if not env.agents:
            check(env.reset()[0])
        observations, rewards, *_ = env.step(act(env))
        check(observations)
        for agent, reward in rewards.items():
            assert isinstance(reward, float) and np.isfinite(reward), f"{agent} earns {reward!r}"


def check_kept(env: ParallelEnv, steps: int = 20) -> None:
    """What a step has given stays as it is: no later step writes to arrays that somebody keeps."""
    act = _Actor(env, 2)
    given = [env.reset(seed=2)]
    copies = deepcopy(given)
    for _ in range(steps):
        now = env.step(act(env)) if env.agents else env.reset()
        given.append(now)
        copies.append(deepcopy(now))
    found = difference(given, copies)
    assert found is None, f"a later step changed what an earlier one gave: {found}"


def check_time_limit(make: MakeParallel, limit: int) -> None:
    """Agents that do nothing for `limit` steps are truncated, not terminated, and neither before that.

    `make` gives an environment in which time alone ends an idle episode.
    """
    env = make()
    try:
        for _ in range(2):
            env.reset(seed=3)
            for step in range(1, limit + 1):
                assert env.agents, f"the episode ended after {step - 1} of {limit} steps"
                idle = {agent: np.zeros_like(env.action_space(agent).sample()) for agent in env.agents}
                _, _, terminated, truncated, _ = env.step(idle)
                assert not any(terminated.values()), f"step {step} of {limit} terminates: {terminated}"
                assert set(truncated.values()) == {step == limit}, f"step {step} of {limit}: {truncated}"
            assert not env.agents, f"still there after {limit} steps: {env.agents}"
    finally:
        env.close()


def check_spaces(env: ParallelEnv, steps: int = 40) -> None:
    """A space is the same object at every call, for the environment's whole life, and keeps its bounds."""

    def spaces() -> list[gymnasium.Space]:
        asked = (env.observation_space, env.action_space)
        return [space(agent) for agent in env.possible_agents for space in asked]

    first = spaces()
    kept = deepcopy(first)
    act = _Actor(env, 4)
    env.reset(seed=4)
    for _ in range(steps):
        if env.agents:
            env.step(act(env))
        else:
            env.reset()
        for was, copy, now in zip(first, kept, spaces(), strict=True):
            assert now is was, f"another object than before: {now}"
            assert now == copy, f"{copy} has become {now}"


def check_gymnasium(env: gymnasium.Env) -> None:
    """Gymnasium's own test, whose warnings count as failures; `env` is unwrapped and knows its `spec`.

    One recommendation is left out, to scale actions to [-1, 1]: ours are in
    physical units, which learners scale themselves and users can read.
    """
    with _warnings_as_errors():
        warnings.filterwarnings("ignore", ".*recommend using a symmetric and normalized space")
        check_env(env)


def check_torchrl(env: EnvBase) -> None:
    """TorchRL's own test, both up to the first end and across ends; its warnings count as failures."""
    with _warnings_as_errors():
        check_env_specs(env, break_when_any_done="both", seed=0)
        check_env_specs(env, break_when_any_done="both")
