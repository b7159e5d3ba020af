"""Metrics of episodes: values of steps reduced in any way, kept when an agent is done, gone with a reset."""

import json
import pickle
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError
from term_states import agents, state_of

import dune_rl
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.metrics.episode import MetricsConf, MetricSet
from dune_rl.metrics.registry import METRICS
from dune_rl.robots.settings import BatteryConf
from dune_rl.state import GroupState

FLAGS = {
    "diverged": "diverged",
    "stuck": "stuck",
    "flipped": "flipped",
    "out_of_world": "out_of_world",
    "timeout": "time_limit",
}
NAMES = (
    "episode",
    "steps",
    "return",
    "success",
    "reached",
    "goals",
    "collisions",
    "time_to_goal",
    "clearance",
    "min_clearance",
    "vertical_roughness",
    "vort",
    "smoothness",
    *FLAGS,
)
REACHED = {"goal_reached": True}


@pytest.fixture(autouse=True)
def _users_terms_go() -> Iterator[None]:
    yield
    METRICS._user_parts.clear()


class Episode:
    """One agent's metrics, fed one step at a time."""

    def __init__(self, conf: MetricsConf | None = None) -> None:
        self.metrics = MetricSet(conf or MetricsConf(), 1)
        self.begin(7)

    def begin(self, number: int) -> None:
        self.metrics.reset(np.array([True]), agents(episode=number))
        self.number, self.steps, self.total = number, 0, 0

    def step(self, reward: float = 0.0, **changes: Any) -> None:
        self.steps += 1
        self.total += changes.get("new", 0)
        group = agents(episode=self.number, step=self.steps, total=self.total, **changes)
        self.metrics.update(state_of(group), group, np.array([reward]))

    def __getitem__(self, name: str) -> float:
        return float(self.metrics.values[0, self.metrics.names.index(name)])


# -- the paper's -----------------------------------------------------------------------------------


def test_columns_are_what_they_were() -> None:
    energy = ("energy_wh", "battery_share", "range_km")
    assert MetricSet(MetricsConf(), 1).names == NAMES
    assert MetricSet(MetricsConf(energy=True), 1).names == (*NAMES, *energy)
    assert compose_environment("flat", ["metrics=paper"]).metrics == MetricsConf()


def test_a_fresh_episode_has_no_values_yet() -> None:
    episode = Episode()
    values = {name: episode[name] for name in NAMES}
    assert values.pop("episode") == 7
    assert np.isnan([values.pop("time_to_goal"), values.pop("vort")]).all()
    assert (values.pop("clearance"), values.pop("min_clearance")) == (12.0, 12.0)
    assert set(values.values()) == {0.0}


def test_return_and_steps_add_up() -> None:
    episode = Episode()
    for reward in (1.0, -0.5, 0.25):
        episode.step(reward)
    assert (episode["return"], episode["steps"]) == (0.75, 3)


def test_clearance_is_the_mean_of_what_lies_within_twelve_metres() -> None:
    episode = Episode()
    for clearance in (np.inf, 2.0, 30.0, 0.0):
        episode.step(clearance=clearance)
    assert episode["clearance"] == pytest.approx((12 + 2 + 12 + 0) / 4)
    assert episode["min_clearance"] == 0.0


def test_vertical_roughness_is_the_mean_size_of_vertical_acceleration() -> None:
    episode = Episode()
    for z in (1.0, -3.0, 0.5):
        episode.step(acceleration_b=(9.0, -9.0, z))
    assert episode["vertical_roughness"] == pytest.approx(1.5)


def test_smoothness_is_the_mean_of_acceleration_and_turning() -> None:
    episode = Episode()
    episode.step(acceleration_b=(3.0, 0.0, 4.0), angular_b=(0.0, 0.6, 0.8))
    episode.step(acceleration_b=(0.0, -2.0, 0.0), angular_b=(0.0, 0.0, -0.5))
    assert episode["smoothness"] == pytest.approx((5 + 1 + 2 + 0.5) / 2)


def test_vort_is_the_mean_speed_on_uneven_ground_alone() -> None:
    episode = Episode()
    episode.step(velocity_w=(1.0, 0.0, 0.0))
    assert np.isnan(episode["vort"])
    half = np.deg2rad(30.0) / 2
    for speed in (0.6, 0.2):
        episode.step(velocity_w=(speed, 0.0, 0.0), quaternion=(np.sin(half), 0.0, 0.0, np.cos(half)))
    episode.step(velocity_w=(1.0, 0.0, 0.0))
    assert episode["vort"] == pytest.approx(0.4)


def test_goals_are_counted_and_the_first_one_timed() -> None:
    episode = Episode()
    episode.step()
    assert (episode["reached"], episode["goals"], episode["success"]) == (0.0, 0.0, 0.0)
    episode.step(endings=REACHED)
    episode.step()
    episode.step(endings=REACHED)
    assert (episode["reached"], episode["goals"], episode["success"]) == (1.0, 2.0, 1.0)
    assert episode["time_to_goal"] == pytest.approx(0.1)


def test_collisions_add_up_and_spoil_success() -> None:
    episode = Episode()
    episode.step(endings=REACHED)
    episode.step(new=2)
    episode.step(new=1)
    assert (episode["reached"], episode["success"], episode["collisions"]) == (1.0, 0.0, 3.0)


@pytest.mark.parametrize("flag", FLAGS)
def test_the_reason_of_an_end_is_told(flag: str) -> None:
    episode = Episode()
    episode.step()
    episode.step(endings={FLAGS[flag]: True})
    assert {name for name in FLAGS if episode[name]} == {flag}


def test_energy_is_measured_where_it_is_asked_for() -> None:
    episode = Episode(MetricsConf(energy=True))
    assert (episode["energy_wh"], episode["battery_share"]) == (0.0, 0.0)
    assert np.isnan(episode["range_km"])
    battery = BatteryConf(capacity_wh=0.01, idle_w=0.0, efficiency=0.5)
    for _ in range(2):
        episode.step(work_j=9.0, battery=battery, velocity_w=(1.0, 0.0, 0.0))
    # 36 J of 36 J, for 0.1 m.
    got = [episode[name] for name in ("energy_wh", "battery_share", "range_km")]
    assert got == pytest.approx([0.01, 1.0, 1e-4])


# -- reductions ------------------------------------------------------------------------------------


def reduced(given: Sequence[np.ndarray], initial: dict[str, float] | None = None) -> dict[str, np.ndarray]:
    """Values (N,) of a metric that is `given` (N,) in each step, by reduction."""
    rows = len(given[0])

    @dune_rl.register_metric
    def shown(state: Any, group: GroupState) -> np.ndarray:
        return given[group.episode.steps[0]]

    names = ("mean", "sum", "min", "max", "last", "first")
    terms = {name: {"term": "shown", "reduce": name} for name in names}
    for name, value in (initial or {}).items():
        terms[name]["initial"] = value
    metrics = MetricSet(MetricsConf(terms=terms), rows)
    metrics.reset(np.ones(rows, bool), agents(rows))
    for index in range(len(given)):
        group = agents(rows, step=index)
        metrics.update(state_of(group), group, np.zeros(rows))
    return {name: metrics.values[:, metrics.names.index(name)] for name in names}


@given(arrays(float, (5, 3), elements=st.floats(-1e6, 1e6) | st.just(np.nan)))
def test_reductions_are_of_the_steps_that_have_a_value(values: np.ndarray) -> None:
    got = reduced(list(values))
    for row, column in enumerate(values.T):
        some = column[~np.isnan(column)]
        expected = {
            "mean": some.mean() if len(some) else np.nan,
            "sum": some.sum(),
            "min": some.min(initial=np.inf) if len(some) else np.nan,
            "max": some.max(initial=-np.inf) if len(some) else np.nan,
            "last": some[-1] if len(some) else np.nan,
            "first": some[0] if len(some) else np.nan,
        }
        for name, value in expected.items():
            np.testing.assert_allclose(got[name][row], value, rtol=1e-9, atol=1e-9, err_msg=name)


def test_initial_values_stand_until_there_is_one() -> None:
    nothing = [np.array([np.nan])]
    initial = {"mean": 4.0, "min": 2.0, "max": 3.0, "last": 5.0, "first": 6.0}
    assert {name: reduced(nothing, initial)[name][0] for name in initial} == initial
    one = [*nothing, np.array([2.5])]
    assert {name: reduced(one, initial)[name][0] for name in initial} == dict.fromkeys(initial, 2.5)
    more = [*one, np.array([3.5]), np.array([1.5])]
    got = {name: reduced(more, initial)[name][0] for name in initial}
    assert got == {"mean": 2.5, "min": 1.5, "max": 3.5, "last": 1.5, "first": 2.5}


# -- episodes of many agents -----------------------------------------------------------------------


def test_agents_that_are_done_keep_their_values() -> None:
    metrics, rng = MetricSet(MetricsConf(), 3), np.random.default_rng(0)
    metrics.reset(np.ones(3, bool), agents(3))

    def step(number: int, done: Any) -> None:
        group = agents(
            3,
            step=number,
            done=done,
            clearance=rng.uniform(0.0, 3.0, 3),
            acceleration_b=rng.normal(size=(3, 3)),
            quaternion=(0.5, 0.5, 0.5, 0.5),
            velocity_w=rng.normal(size=(3, 3)),
            total=number,
            new=1,
            endings={"goal_reached": number > 2, "stuck": number > 3},
        )
        metrics.update(state_of(group), group, rng.normal(size=3))

    for number in (1, 2, 3):
        step(number, False)
    before = metrics.values
    for number in (4, 5):
        step(number, [False, True, False])
    assert metrics.values[1].tobytes() == before[1].tobytes()
    assert (metrics.values[[0, 2], 1] == 5.0).all()
    assert (metrics.values[[0, 2]] != before[[0, 2]]).any(axis=1).all()


def test_a_new_episode_forgets_the_last() -> None:
    episode, fresh = Episode(), Episode()
    for _ in range(3):
        episode.step(1.0, clearance=0.1, acceleration_b=(1, 1, 1), new=1, endings={**REACHED, "stuck": True})
    episode.begin(7)
    for one in (episode, fresh):
        one.step(0.5, clearance=2.0, velocity_w=(0.3, 0.0, 0.0), angular_b=(0.0, 0.0, 1.0))
    assert episode.metrics.values.tobytes() == fresh.metrics.values.tobytes()


def test_a_reset_leaves_other_agents_alone() -> None:
    metrics = MetricSet(MetricsConf(), 2)
    metrics.reset(np.ones(2, bool), agents(2, episode=[0, 1]))
    group = agents(2, clearance=3.0)
    metrics.update(state_of(group), group, np.array([5.0, 5.0]))
    before = metrics.values
    metrics.reset(np.array([False, True]), agents(2, episode=[2, 3]))
    assert metrics.values[0].tobytes() == before[0].tobytes()
    assert metrics.values[1, :3].tolist() == [3.0, 0.0, 0.0]


def test_no_terms_are_metrics_still() -> None:
    episode = Episode(MetricsConf(terms={}))
    episode.step(2.0)
    assert episode.metrics.names == ("episode", "steps", "return")
    assert episode.metrics.values.tolist() == [[7.0, 1.0, 2.0]]


# -- settings, and terms of a user -----------------------------------------------------------------


def test_a_registered_metric_is_a_column_of_its_name() -> None:
    @dune_rl.register_metric
    def turning(state: Any, group: GroupState, *, gain: float = 1.0) -> np.ndarray:
        return gain * np.ones(len(group.done))

    words = ["+metrics.terms.turning={reduce: sum, gain: 0.5}", "actors=none"]
    simulation = make_simulation(compose_environment("flat", words), 2, seed=0)
    simulation.reset()
    for _ in range(3):
        simulation.step({"rover": np.zeros((2, 1, 2), np.float32)})
    column = simulation.metric_names().index("turning")
    np.testing.assert_allclose(simulation.metrics()[..., column], 1.5)
    simulation.close()


def test_settings_survive_json_and_pickle() -> None:
    conf = MetricsConf(energy=True)
    assert MetricsConf.model_validate(json.loads(conf.model_dump_json())) == conf
    assert pickle.loads(pickle.dumps(conf)) == conf


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"terms": {"return": {"term": "clearance"}}}, r"terms\.return: another metric has this name"),
        ({"terms": {"energy_wh": {}}, "energy": True}, r"terms\.energy_wh: another metric"),
        ({"terms": {"reward/goal": {"term": "clearance"}}}, r"terms\.reward/goal: another metric"),
        ({"terms": {"clearence": {}}}, r"no metric 'clearence'.*did you mean clearance\?"),
        ({"terms": {"clearance": {"reduce": "median"}}}, r"reduce\n  Input should be 'mean'"),
        ({"terms": {"vort": {"uneven_tilt_deg": -1.0}}}, r"uneven_tilt_deg\n.*greater than or equal to 0"),
    ],
)
def test_faults_are_named(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        MetricsConf(**settings)


def test_an_error_in_a_term_says_which() -> None:
    @dune_rl.register_metric("odd")
    def odd(state: Any, group: GroupState) -> np.ndarray:
        raise ZeroDivisionError("no progress")

    episode = Episode(MetricsConf(terms={"odd_one": {"term": "odd", "reduce": "sum"}}))
    with pytest.raises(ZeroDivisionError, match="no progress") as caught:
        episode.step()
    assert caught.value.__notes__ == ["in the metric term 'odd_one'"]
