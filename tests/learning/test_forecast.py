"""Motion forecasts are learnt from what tracks became: recording, the fit, and the command."""

import csv
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_worlds import plain
from simulations import environment_conf, put_walkers, simulation_on
from tensordict import TensorDict, TensorDictBase

from dune_rl import evaluate, forecast
from dune_rl.config.build import make_learning_env
from dune_rl.core.errors import ConfigError
from dune_rl.env.requests import AgentRequest
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.learning.evaluation import evaluate as evaluate_episodes
from dune_rl.learning.forecast.fit import fit_forecast, forecast_errors
from dune_rl.learning.forecast.recorder import TrackRecorder, TrackSamples
from dune_rl.learning.policies import built_in_policy
from dune_rl.sensors.perception.motion_forecast import (
    AHEAD_S,
    FEATURES,
    HISTORY_STEPS,
    MotionForecast,
    constant_velocity,
)

Call = Callable[..., int]
SENSORS = {"lidar": {"n_segments": 64}, "velocity": {}, "agent_tracks": {}}
WALKER = {"body": "person", "controller": "external", "count": 1}
AFTER = TensorDict({}, [1])


def recorded(*episodes: int, stops_at: int | None = None, **settings: Any) -> TrackSamples:
    """Of episodes of so many steps: a walker passes from left to right 3 m ahead at 1 m/s, until it stops."""
    simulation = simulation_on(plain(), sensors=SENSORS, actors={"walker": WALKER}, **settings)
    recorder = TrackRecorder(simulation)
    for steps in episodes:
        simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (4.0, 0.0))}})
        put_walkers(simulation, [[1.0, 1.5, 0.0, -np.pi / 2]])
        recorder.begin()
        for step in range(steps):
            speed = 0.0 if stops_at is not None and step >= stops_at else 1.0
            simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[speed, 0.0]]])})
            recorder.step(AFTER)
    samples = recorder.samples()
    simulation.close()
    return samples


def test_tracks_are_told_where_their_agent_went() -> None:
    samples = recorded(70)
    assert samples.agents.all() and samples.features.shape == (len(samples.agents), FEATURES)
    # Of the last 2.5 s nobody knows what became of it.
    assert samples.followed.sum() == pytest.approx(len(samples.agents) - 49, abs=1)
    told = samples.told[samples.followed]
    # In a track's frame it walks to the right, seen from the robot, nearly across the line of sight.
    assert np.abs(told[:, 0]).max() < 0.3
    np.testing.assert_allclose(np.hypot(*told[:, 1].T), 1.0, atol=0.05)
    assert (told[:, 1, 1] < -0.8).all()
    np.testing.assert_allclose(
        told[:, 2:] - told[:, :1], told[:, 1:2] * np.array(AHEAD_S)[:, None], atol=0.06
    )


def test_what_is_told_of_one_who_stops_is_where_it_stopped() -> None:
    samples = recorded(80, stops_at=25)
    told = samples.told[samples.followed]
    ways = np.hypot(*np.moveaxis(told[:, 2:] - told[:, :1], -1, 0))
    assert ways.max() < 1.3 and (np.diff(ways, axis=1) > -1e-3).all()


def test_no_track_is_followed_into_another_episode() -> None:
    long, both = recorded(60), recorded(5, 60)
    # All but the last one of an episode of 5 steps are told how fast their agent is, and nothing later.
    short = both.split(1)[0]
    assert 0 < len(short.agents) <= 4 and not short.followed.any()
    np.testing.assert_allclose(np.hypot(*short.told[:, 1].T), 1.0, atol=0.05)
    assert both.followed.sum() == long.followed.sum()
    assert len(both.split(1)[1].agents) == len(long.agents)


def test_robots_that_rest_are_left_out() -> None:
    conf = environment_conf(
        "flat", sensors=SENSORS, actors=[{}, {}], task={"terminations": {"time_limit": {"max_steps": 70}}}
    )
    env = make_learning_env(conf, 2, 0)
    recorder = TrackRecorder(simulation_in(env))
    counts = []
    step = recorder.step

    def watched(after: TensorDictBase) -> None:
        before = len(recorder._seen)
        step(after)
        counts.append((int(simulation_in(env).resting.sum()), set(recorder._seen[before][0].tolist())))

    recorder.step = watched  # type: ignore[method-assign]
    evaluate_episodes(built_in_policy("random", env), env, 1, 0, observer=recorder)
    env.close()
    # One of the two scenes runs no episode.
    assert {resting for resting, _ in counts} == {1}
    assert set().union(*(rows for _, rows in counts)) == {0}
    assert set(recorder.samples().episodes.tolist()) == {0}


@pytest.mark.slow
def test_agents_that_leave_are_not_followed_away() -> None:
    conf = environment_conf(
        "flat",
        sensors=SENSORS,
        actors=[{"presence": {"arrive_s": [0.0, 1.0], "stay_s": [2.0, 4.0]}}] * 4,
        task={"terminations": {"time_limit": {"max_steps": 200}}},
    )
    env = make_learning_env(conf, 4, 0)
    recorder = TrackRecorder(simulation_in(env))
    evaluate_episodes(built_in_policy("go_to_goal", env), env, 4, 0, observer=recorder)
    samples = recorder.samples()
    env.close()
    assert samples.followed.any()
    # They walk at 1 m/s; what is gone is far away.
    assert np.hypot(*samples.told[samples.agents, 1].T).max() < 3.0
    assert np.hypot(*np.moveaxis(samples.told[samples.followed], -1, 0)).max() < 4.0


def made_up(count: int, seed: int) -> TrackSamples:
    """Half are agents, told by one feature, that are where constant velocity and another feature tell."""
    rng = np.random.default_rng(seed)
    features = np.zeros((count, FEATURES), np.float32)
    features[:, 6 * HISTORY_STEPS : 6 * HISTORY_STEPS + 2] = rng.uniform(-1, 1, (count, 2))
    features[:, :2] = rng.uniform(-1, 1, (count, 2))
    agents = features[:, 0] > 0.0
    told = constant_velocity(features)
    told[:, 2:, 1] += features[:, 1:2]
    return TrackSamples(features, agents, agents.copy(), told, np.zeros(count, np.int64))


@pytest.mark.slow
def test_a_fit_learns_what_constant_velocity_does_not_know() -> None:
    weights = fit_forecast(made_up(2_000, 0), 400, 128, 0)
    unseen = made_up(500, 1)
    chances, told = MotionForecast(weights).predict(unseen.features)
    assert ((chances > 0.5) == unseen.agents).mean() > 0.9
    rows = {row["measure"]: row for row in forecast_errors(unseen, chances, told, 0.5)}
    assert rows["tracks"]["forecast"] == 500
    error = rows["error of place in 1 s [m], median"]
    assert error["constant velocity"] == pytest.approx(0.5, abs=0.1)
    assert error["forecast"] < 0.4 * error["constant velocity"]
    # Here velocities are constant velocity's own.
    assert rows["error of velocity [m/s], median"]["constant velocity"] == 0.0


def test_a_fit_repeats_and_leaves_random_states_alone() -> None:
    import torch

    samples = made_up(1_000, 0)
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    first, again = (fit_forecast(samples, 20, 32, 3) for _ in range(2))
    assert torch.equal(torch.rand(1), expected)
    other = fit_forecast(samples, 20, 32, 4)
    for name, values in first.items():
        assert values.tobytes() == again[name].tobytes()
    assert any(values.tobytes() != other[name].tobytes() for name, values in first.items())


def test_too_few_tracks_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"50 tracks, .* too few for a forecast: run more episodes"):
        fit_forecast(made_up(50, 0), 10, 8, 0)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"sensors": {"lidar": {}, "velocity": {}}, "actors": {"walker": WALKER}}, "no sensor agent_tracks"),
        ({"sensors": SENSORS}, "add some, such as actors=walkers"),
    ],
)
def test_where_nothing_can_be_recorded_it_says_why(settings: dict[str, Any], said: str) -> None:
    simulation = simulation_on(plain(), **settings)
    with pytest.raises(ConfigError, match=said):
        TrackRecorder(simulation)
    simulation.close()


TINY = (
    "+world=flat",
    "randomisation.world_seed=null",
    "actors.walker.count=8",
    "policy=random",
    "episodes=4",
    "scenes=4",
    "updates=20",
    "task.terminations.time_limit.max_steps=400",
)


@pytest.mark.slow
def test_the_command_writes_a_forecast_that_evaluations_use(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(forecast.main, *TINY, "out=made") == 0
    assert "constant velocity" in (shown := capsys.readouterr().out) and "made/forecast.npz" in shown
    rows = list(csv.DictReader((folder / "made" / "errors.csv").read_text().splitlines()))
    assert int(rows[0]["forecast"]) > 0 and "place in 2.5 s" in rows[-1]["measure"]
    assert (folder / "made" / "config.yaml").exists()
    words = ("policy=dwa", "+world=flat", "sensors=perception_3d", "+sensors.command_costs={}", "episodes=1")
    steps = "task.terminations.time_limit.max_steps=20"
    assert call(evaluate.main, *words, steps, "sensors.agent_tracks.forecast=made", "out=e") == 0
    provenance = json.loads((folder / "e" / "provenance.json").read_text())
    weights = (folder / "made" / "forecast.npz").read_bytes()
    assert provenance["forecasts"] == {"made": hashlib.sha256(weights).hexdigest()}
    with np.load(folder / "made" / "forecast.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    np.savez(folder / "made" / "forecast.npz", **(arrays | {"bias_3": 2.0 * arrays["bias_3"]}))
    assert call(evaluate.main, "verify=e") == 2
    assert "another forecast than that now in made; evaluate again" in capsys.readouterr().err
    assert call(evaluate.main, *words, steps, "sensors.agent_tracks.forecast=other.npz", "out=f") == 2
    assert "there is no forecast 'other.npz' (choose persons), nor a folder" in capsys.readouterr().err
    assert call(forecast.main, *TINY, "out=made") == 2
    assert "made is not empty" in capsys.readouterr().err
