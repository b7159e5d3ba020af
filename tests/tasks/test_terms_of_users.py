"""Reward and termination terms of a user, and the settings of a task."""

import json
import pickle
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from published_tasks import DUNE_CODE, PAPER, begun, with_terms
from pydantic import Field, ValidationError
from term_states import agents, state_of
from typing_extensions import TypeAliasType

import dune_rl
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import RegistryError
from dune_rl.state import GroupState
from dune_rl.tasks.registry import REWARDS, TERMINATIONS
from dune_rl.tasks.task import Task, TaskConf, walking_task


@pytest.fixture
def _users_terms_go() -> Iterator[None]:
    yield
    REWARDS._user_parts.clear()
    TERMINATIONS._user_parts.clear()


def step(task: Task, group: GroupState) -> np.ndarray:
    group = replace(group, endings=task.end(state_of(group), group).by_term)
    return task.reward(state_of(group), group)


# -- terms of a user -------------------------------------------------------------------------------


@pytest.mark.usefixtures("_users_terms_go")
def test_a_registered_reward_is_logged_under_its_name() -> None:
    @dune_rl.register_reward
    def calm(state: Any, group: GroupState, *, top_radps: Annotated[float, Field(gt=0)] = 0.5) -> np.ndarray:
        return np.abs(group.motion.angular_b[:, 2]) < top_radps

    conf = compose_environment("flat", ["+task.rewards.calm.weight=0.25", "actors=none"])
    simulation = make_simulation(conf, 2, seed=0)
    simulation.reset()
    for _ in range(3):
        stepped = simulation.step({"rover": np.zeros((2, 1, 2), np.float32)})
    names, metrics = simulation.metric_names(), simulation.metrics()
    np.testing.assert_allclose(metrics[:, 0, names.index("reward/calm")], 0.75)
    terms = [index for index, name in enumerate(names) if name.startswith("reward/")]
    np.testing.assert_allclose(
        metrics[..., terms].sum(axis=2), metrics[..., names.index("return")], rtol=1e-5
    )
    assert stepped.groups["rover"].reward.shape == (2,)
    simulation.close()


# As numpy's NDArray is from version 2.5 on.
Values = TypeAliasType("Values", NDArray[np.float64])
Number = TypeAliasType("Number", int)


@pytest.mark.usefixtures("_users_terms_go")
def test_a_term_may_say_what_it_returns_by_an_alias() -> None:
    @dune_rl.register_reward
    def still(state: Any, group: GroupState) -> Values:
        return -np.abs(group.motion.velocity_b[:, 0])

    TaskConf.model_validate({"rewards": {"still": {"weight": 1.0}}})
    with pytest.raises(RegistryError, match="says that it returns"):

        @dune_rl.register_reward
        def wrong(state: Any, group: GroupState) -> Number:
            return 1

        TaskConf.model_validate({"rewards": {"wrong": {"weight": 1.0}}})


@pytest.mark.usefixtures("_users_terms_go")
def test_a_registered_reward_may_read_the_joints() -> None:
    @dune_rl.register_reward
    def gentle(state: Any, group: GroupState) -> np.ndarray:
        assert group.motion.joints is not None
        return -np.abs(group.motion.joints.torque).sum(axis=1)

    gentle.needs_joints = True  # type: ignore[attr-defined]
    conf = compose_environment("flat", ["+task.rewards.gentle.weight=1", "actors=none"])
    simulation = make_simulation(conf, 2, seed=0)
    simulation.reset()
    simulation.step({"rover": np.ones((2, 1, 2), np.float32)})
    assert (simulation.metrics()[:, 0, simulation.metric_names().index("reward/gentle")] < 0.0).all()
    simulation.close()


@pytest.mark.usefixtures("_users_terms_go")
def test_a_registered_termination_ends_and_may_be_rewarded() -> None:
    @dune_rl.register_termination("too_fast")
    class TooFast:
        def __init__(self, num_rows: int, *, steps: int = 2) -> None:
            self.steps, self.limit = np.zeros(num_rows), steps

        def reset(self, mask: np.ndarray, group: GroupState) -> None:
            self.steps[mask] = 0

        def __call__(self, state: Any, group: GroupState) -> np.ndarray:
            self.steps += group.motion.velocity_b[:, 0] > 1.0
            return self.steps >= self.limit

    conf = TaskConf(
        terminations={"too_fast": {"steps": 2}},
        rewards={"fine": {"term": "ended_by", "termination": "too_fast", "weight": -3.0}},
    )
    group = agents(2, velocity_b=[[1.5, 0, 0], [0.5, 0, 0]])
    task = begun(conf, group)
    assert [step(task, group).tolist() for _ in range(2)] == [[0.0, 0.0], [-3.0, 0.0]]
    assert task.end(state_of(group), group).terminated.tolist() == [True, False]


@pytest.mark.usefixtures("_users_terms_go")
def test_a_term_of_the_wrong_shape_is_named() -> None:
    @dune_rl.register_reward
    def lonely(state: Any, group: GroupState) -> np.ndarray:
        return np.zeros(3)

    group = agents(2)
    with pytest.raises(RegistryError, match=r"lonely.*\(2,\).*\(3,\)"):
        step(begun(TaskConf(rewards={"lonely": {}}), group), group)


@pytest.mark.usefixtures("_users_terms_go")
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_reward_that_is_no_number_is_named(value: float) -> None:
    @dune_rl.register_reward
    def broken(state: Any, group: GroupState) -> np.ndarray:
        return np.array([0.0, value])

    group = agents(2)
    with pytest.raises(RegistryError, match=rf"reward term 'mine' of the group 'rover' is {value}: let it"):
        step(begun(TaskConf(rewards={"progress": {}, "mine": {"term": "broken"}}), group), group)


# -- settings --------------------------------------------------------------------------------------


def test_settings_survive_json_and_pickle() -> None:
    for conf in (PAPER, DUNE_CODE, walking_task()):
        assert TaskConf.model_validate(json.loads(conf.model_dump_json())) == conf
        assert pickle.loads(pickle.dumps(conf)) == conf
        assert hash(
            pickle.loads(pickle.dumps(conf.rewards["progress" if len(conf.rewards) == 2 else "goal"]))
        )


@pytest.mark.parametrize(
    ("rewards", "terminations", "said"),
    [
        ({"distance": {"sclae": 1.0}}, {}, r"rewards\.distance\.sclae\n  Extra inputs"),
        ({"distanc": {}}, {}, r"no reward 'distanc'.*did you mean distance\?"),
        ({"distance": {"heading_limit_deg": 181.0}}, {}, r"heading_limit_deg\n.*less than or equal to 180"),
        ({"goal": {"unless": ["gaol"]}}, {}, r"rewards\.goal\.unless names no other reward: 'gaol'"),
        ({"goal": {"unless": ["goal"]}}, {}, r"rewards\.goal\.unless names no other reward: 'goal'"),
        ({"goal": {"termination": "lost"}}, {}, r"rewards\.goal\.termination names no termination: 'lost'"),
        ({}, {"diverged": {"term": "time_limit"}}, r"terminations\.diverged is built in"),
        ({}, {"time_limit": {"renew": True}}, r"terminations\.time_limit cannot both truncate and renew"),
        ({}, {"goal_reached": {"distance_m": 0.0}}, r"greater than 0"),
        ({}, {"time_limit": {"max_steps": 0}}, r"greater than or equal to 1"),
        ({}, {"flipped": {"angle_deg": 181.0}}, r"less than or equal to 180"),
    ],
)
def test_faults_are_named(rewards: dict[str, Any], terminations: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        with_terms(TaskConf(), rewards=rewards, terminations=terminations)


def test_a_reward_that_pays_nothing_may_name_a_termination_that_is_not_there() -> None:
    kept = {name: {} for name in ("goal_reached", "time_limit")}
    assert list(TaskConf(terminations=kept).terminations) == list(kept)
