"""Every check passes on every world with one agent and with three, and fails on its planted fault."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from conformance import (
    check_gymnasium,
    check_kept,
    check_no_leak,
    check_parallel_api,
    check_seeding,
    check_spaces,
    check_time_limit,
    check_torchrl,
    check_values,
    parallel_rollout,
)
from pettingzoo import ParallelEnv
from planted import batched, parallel, single
from urdf_files import write_cart

import dune_rl

WORLDS = ("flat", "inspection")
AGENTS = {"one agent": "walkers", "three agents": "external_walkers"}
# Goals lie 2 m away and more: some episodes end by arrival, many at once, and the others by time.
SHORT = {"terminations": {"time_limit": {"max_steps": 12}, "goal_reached": {"distance_m": 4.0}}}
BY_TIME_ALONE = {"terminations": {"time_limit": {"max_steps": 12}, "goal_reached": {"distance_m": 1.0}}}
TWO_STEPS = {"terminations": {"time_limit": {"max_steps": 2}}}

Make = Callable[[], ParallelEnv]


@pytest.fixture(scope="module", params=WORLDS)
def world(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module", params=AGENTS.values(), ids=AGENTS)
def actors(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def make(world: str, actors: str) -> Make:
    return partial(dune_rl.parallel_env, world, actors=actors, task=SHORT)


@pytest.fixture(scope="module")
def env(make: Make) -> Iterator[ParallelEnv]:
    made = make()
    yield made
    made.close()


@pytest.mark.slow
def test_agents_of_each_setting(env: ParallelEnv, actors: str) -> None:
    walkers = ["walker_0", "walker_1"] if actors == "external_walkers" else []
    assert env.possible_agents == ["rover_0", *walkers]


@pytest.mark.slow(all_but=["flat-one*", "inspection-three*"])
@pytest.mark.parametrize("check", [check_parallel_api, check_values, check_kept, check_spaces])
def test_parallel_env(check: Callable[[ParallelEnv], None], env: ParallelEnv) -> None:
    check(env)


@pytest.mark.slow(all_but=["inspection-three agents-check_no_leak"])
@pytest.mark.parametrize("check", [check_seeding, check_no_leak])
def test_parallel_env_over_resets(check: Callable[[Make], None], make: Make) -> None:
    check(make)


def test_both_kinds_of_ends_come_up(env: ParallelEnv) -> None:
    steps = [step for step, _ in parallel_rollout(env, 11, 60) if len(step) == 5]
    assert len(steps) == 60
    for ended in (2, 3):
        assert any(step[ended]["rover_0"] for step in steps)


# Beside the rover on PyBullet above: every robot on both engines, and each engine in every world.
WALKERS = {"actors": "external_walkers"}
BODIES = {"actors": "walkers", "randomisation": "body"}
JOINTS = {"robot": {"name": "hyperdog", "action": "joints"}}
PLACES: dict[str, tuple[str, dict[str, Any]]] = {
    "leo": ("construction", {"physics": "bullet", "robot": "leo_rover", "actors": "walkers"}),
    "dog": ("rubicon", {"physics": "bullet", "robot": "hyperdog", **WALKERS}),
    "joints": ("island", {"physics": "bullet", **JOINTS, **BODIES}),
    "urdf": ("flat", {"physics": "bullet", "robot": "urdf", **WALKERS}),
    "rover, dart": ("rubicon", {"physics": "dart", "robot": "rover_zero", **WALKERS}),
    "leo, dart": ("island", {"physics": "dart", "robot": "leo_rover", **BODIES}),
    "dog, dart": ("construction", {"physics": "dart", "robot": "hyperdog", "actors": "walkers"}),
    "joints, dart": ("inspection", {"physics": "dart", **JOINTS, **WALKERS}),
    "urdf, dart": ("flat", {"physics": "dart", "robot": "urdf", "actors": "walkers"}),
}


@pytest.mark.slow(all_but=["joints"])
@pytest.mark.parametrize("place", PLACES)
def test_every_robot_on_both_engines(place: str, tmp_path: Path) -> None:
    world, settings = PLACES[place]
    if settings["robot"] == "urdf":
        settings = settings | {"robot": {"name": "urdf", "path": str(write_cart(tmp_path))}}
    here = partial(dune_rl.parallel_env, world, **settings, task=SHORT)
    env = here()
    check_parallel_api(env, 20)
    check_values(env, 30)
    env.close()
    # Which compares with a fresh environment of the same seed, too.
    check_no_leak(here, 14)
    batched = dune_rl.make(world, 2, **settings, task=TWO_STEPS)
    check_torchrl(batched)
    batched.close()


@pytest.mark.slow
def test_time_limit_truncates(world: str, actors: str) -> None:
    check_time_limit(partial(dune_rl.parallel_env, world, actors=actors, task=BY_TIME_ALONE), 12)


@pytest.mark.slow
def test_gymnasium(world: str) -> None:
    env = gymnasium.make(f"dune_rl/{world.title()}-v0").unwrapped
    check_gymnasium(env)
    env.close()


@pytest.mark.slow
def test_gymnasium_of_a_dog_on_the_second_engine() -> None:
    env = gymnasium.make("dune_rl/Inspection-v0", physics="dart", **JOINTS).unwrapped
    check_gymnasium(env)
    env.close()


@pytest.mark.slow(all_but=["flat-three agents-3", "inspection-one agent-1"])
@pytest.mark.parametrize("scenes", [1, 3])
def test_torchrl(world: str, actors: str, scenes: int) -> None:
    env = dune_rl.make(world, scenes, actors=actors, task=TWO_STEPS)
    check_torchrl(env)
    env.close()


# -- the checks themselves -------------------------------------------------------------------------

FAULTS: list[tuple[Callable[[Any], None], type[parallel.Sound]]] = [
    (check_seeding, parallel.NondeterministicAtStepThree),
    (check_seeding, parallel.NondeterministicInSecondEpisode),
    (check_seeding, parallel.DeafToSeeds),
    (check_no_leak, parallel.LeaksOverReset),
    (partial(check_time_limit, limit=parallel.LIMIT), parallel.TimeOutTerminates),
    (partial(check_time_limit, limit=parallel.LIMIT), parallel.EndsOneStepLate),
]
FAULTS_OF_ONE: list[tuple[Callable[[Any], None], type[parallel.Sound]]] = [
    (check_values, parallel.GivesFloat64),
    (check_values, parallel.GivesNaN),
    (check_values, parallel.LeavesItsBounds),
    (check_values, parallel.EarnsNaN),
    (check_kept, parallel.ReusesItsArrays),
    (check_spaces, parallel.MakesNewSpaces),
    (check_spaces, parallel.ChangesSpacesWhenDone),
    (check_spaces, parallel.MovesItsBounds),
    (check_parallel_api, parallel.ForgetsAnInfo),
    (check_parallel_api, parallel.RevivesTheDead),
]


def _name(item: Any) -> str:
    return getattr(item, "func", item).__name__


@pytest.mark.parametrize("check", [check_seeding, check_no_leak])
def test_sound_env_passes(check: Callable[[Any], None]) -> None:
    check(parallel.Sound)


@pytest.mark.parametrize("check", [check_parallel_api, check_values, check_kept, check_spaces])
def test_sound_env_passes_once_made(check: Callable[[Any], None]) -> None:
    check(parallel.Sound())


def test_sound_env_keeps_its_time_limit() -> None:
    check_time_limit(parallel.Sound, parallel.LIMIT)


@pytest.mark.parametrize(("check", "fault"), FAULTS, ids=_name)
def test_check_fails_on_its_fault(check: Callable[[Any], None], fault: type[parallel.Sound]) -> None:
    with pytest.raises(AssertionError):
        check(fault)


@pytest.mark.parametrize(("check", "fault"), FAULTS_OF_ONE, ids=_name)
def test_check_of_one_fails_on_its_fault(check: Callable[[Any], None], fault: type[parallel.Sound]) -> None:
    with pytest.raises((AssertionError, UserWarning)):
        check(fault())


def test_sound_gymnasium_env_passes() -> None:
    check_gymnasium(single.Sound())


@pytest.mark.parametrize(
    "fault", [single.GivesFloat64, single.Nondeterministic, single.ReusesItsArray, single.Unbounded]
)
def test_gymnasium_check_fails_on_its_fault(fault: type[single.Sound]) -> None:
    with pytest.raises((AssertionError, UserWarning)):
        check_gymnasium(fault())


def test_sound_torchrl_env_passes() -> None:
    check_torchrl(batched.Sound())


@pytest.mark.parametrize(
    "fault",
    [
        batched.GivesFloat64,
        batched.GivesNaN,
        batched.LeavesItsBounds,
        batched.GivesMore,
        batched.GivesLess,
        batched.Warns,
    ],
)
def test_torchrl_check_fails_on_its_fault(fault: type[batched.Sound]) -> None:
    with pytest.raises((AssertionError, RuntimeError, UserWarning, KeyError)):
        check_torchrl(fault())
