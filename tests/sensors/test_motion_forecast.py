"""A learnt forecast of tracks: its features, its file, and what the sensors make of it."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_worlds import plain
from simulations import put_walkers, simulation_on
from test_perception import SENSORS, WALKER

from dune_rl.core.errors import ConfigError
from dune_rl.env.requests import AgentRequest
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.frames import into_frames, out_of_frames
from dune_rl.sensors.perception.agent_tracks import AgentTracks
from dune_rl.sensors.perception.command_costs import CommandCosts
from dune_rl.sensors.perception.dynamic_window import STEP_S
from dune_rl.sensors.perception.motion_forecast import (
    AHEAD_S,
    FEATURES,
    OUTPUT_SCALES,
    OUTPUTS,
    MotionForecast,
    constant_velocity,
    read_forecast,
    track_features,
)
from dune_rl.sensors.perception.scan_tracks import HISTORY_COLUMNS, HISTORY_STEPS, TRACK_COLUMNS

MakeFile = Callable[..., Path]
SIZES = (FEATURES, 8, 8, 8, OUTPUTS)


@pytest.fixture
def make_file(tmp_path: Path) -> MakeFile:
    """Writes a forecast whose numbers are the last layer's `bias`, whatever it reads."""

    def make(chance: float = 9.0, left_m: float = 0.0, step_s: float = 0.05, **changes: Any) -> Path:
        bias = np.zeros(OUTPUTS, np.float32)
        bias[0] = chance
        # Every place ahead is so far to the left, seen from the robot.
        bias[1:].reshape(-1, 2)[2:, 1] = left_m / OUTPUT_SCALES[2:, 0]
        arrays: dict[str, Any] = {
            "mean": np.zeros(FEATURES, np.float32),
            "scale": np.ones(FEATURES, np.float32),
            "step_s": np.float32(step_s),
        }
        for number, (size, after) in enumerate(itertools.pairwise(SIZES)):
            arrays[f"weight_{number}"] = np.zeros((size, after), np.float32)
            arrays[f"bias_{number}"] = np.zeros(after, np.float32)
        arrays["bias_3"] = bias
        file = tmp_path / f"{chance}_{left_m}_{step_s}.npz"
        np.savez(file, **{name: values for name, values in (arrays | changes).items() if values is not None})
        return file

    return make


def passing_walker(file: Path | str | None, steps: int = 20) -> tuple[VectorSimulation, AgentTracks]:
    """A walker that has passed for `steps` at 1 m/s, from left to right, 3 m ahead of a rover that stands."""
    sensors = {
        **SENSORS,
        "agent_tracks": {"forecast": None if file is None else str(file)},
        "command_costs": {},
    }
    simulation = simulation_on(plain(), sensors=sensors, actors={"walker": {**WALKER, "count": 1}})
    simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (4.0, 0.0))}})
    put_walkers(simulation, [[1.0, 0.7, 0.0, -np.pi / 2]])
    for _ in range(steps):
        simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[1.0, 0.0]]])})
    suite = simulation.group("rover").suite
    assert suite is not None
    tracks = suite.sensors["agent_tracks"]
    assert isinstance(tracks, AgentTracks)
    return simulation, tracks


def test_a_history_has_the_latest_scan_first() -> None:
    simulation, tracks = passing_walker(None)
    tracker = tracks.tracker
    assert tracker.counts[0] == 1
    track, history = tracker.tracks[0, 0], tracker.histories[0, 0]
    seen = history[:, 0] == 1.0
    # It walks by 5 cm a scan, to the right, at a distance of 3 m.
    assert seen[:15].all()
    assert np.diff(history[:15, 2]) == pytest.approx(0.05, abs=0.12)
    assert history[0, 2] - history[14, 2] == pytest.approx(-0.7, abs=0.15)
    assert history[:15, 1] == pytest.approx(3.0, abs=0.15)
    assert (history[:15, 4] >= 1).all() and np.hypot(*(history[0, 1:3] - track[:2])) < 0.15
    assert track[10] == pytest.approx(0.05 * (seen.sum() - 1), abs=0.06)
    simulation.close()


def test_features_know_no_place_and_no_direction_of_the_world() -> None:
    rng = np.random.default_rng(0)
    tracks = rng.normal(size=(6, TRACK_COLUMNS))
    histories = rng.normal(size=(6, HISTORY_STEPS, HISTORY_COLUMNS))
    histories[..., 0] = rng.random((6, HISTORY_STEPS)) < 0.5
    poses = rng.normal(size=(6, 3))
    features, frames = track_features(tracks, histories, poses)
    turn, move = 0.7, np.array([3.0, -2.0])
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    for array, columns in (
        (tracks, slice(0, 2)),
        (tracks, slice(8, 10)),
        (histories, slice(1, 3)),
        (poses, slice(0, 2)),
    ):
        array[..., columns] = array[..., columns] @ turned + move
    tracks[:, 2:4] = tracks[:, 2:4] @ turned
    again, _ = track_features(tracks, histories, poses)
    assert features.shape == (6, FEATURES)
    np.testing.assert_allclose(again, features, atol=1e-5)
    points = rng.normal(size=(6, 4, 2))
    np.testing.assert_allclose(out_of_frames(frames, into_frames(frames, points)), points, atol=1e-9)
    np.testing.assert_allclose(into_frames(frames, frames[:, None, :2]), 0.0, atol=1e-12)


def test_without_anything_learnt_it_is_constant_velocity(make_file: MakeFile) -> None:
    features = np.random.default_rng(0).normal(size=(5, FEATURES)).astype(np.float32)
    chances, told = read_forecast(str(make_file(chance=2.0)), 0.05).predict(features)
    np.testing.assert_allclose(chances, 1.0 / (1.0 + np.exp(-2.0)), rtol=1e-5)
    np.testing.assert_allclose(told, constant_velocity(features))
    np.testing.assert_allclose(told[:, 2:], told[:, 1:2] * np.array(AHEAD_S)[:, None], rtol=1e-5)


def test_tracks_are_agents_by_their_chance(make_file: MakeFile) -> None:
    for chance, seen in ((9.0, 1), (-9.0, 0)):
        simulation, tracks = passing_walker(make_file(chance=chance))
        assert tracks.tracker.counts[0] == 1 and tracks.tracker.moving_counts[0] == seen
        assert bool(simulation.observe("rover")["agent_tracks"].any()) == bool(seen)
        assert bool(tracks.moving_beams.any()) == bool(seen)
        simulation.close()


def test_beams_at_an_agent_have_its_velocity(make_file: MakeFile) -> None:
    simulation, tracks = passing_walker(make_file())
    beams = np.flatnonzero(tracks.moving_beams[0])
    assert 2 <= len(beams) <= 12
    assert tracks.beams[0, beams] == pytest.approx(2.8, abs=0.3)
    np.testing.assert_allclose(tracks.tracker.velocities[0, beams], [[0.0, -1.0]] * len(beams), atol=0.4)
    simulation.close()


def test_the_look_ahead_takes_the_places_of_the_forecast(make_file: MakeFile) -> None:
    places = {}
    for left_m in (0.0, 2.0):
        simulation, tracks = passing_walker(make_file(left_m=left_m))
        suite = simulation.group("rover").suite
        assert suite is not None
        costs = suite.sensors["command_costs"]
        assert isinstance(costs, CommandCosts)
        assert tracks.places_ahead is not None
        situation = costs.situation
        # Between now and the first time ahead, and at the times ahead.
        for number, time in enumerate(AHEAD_S):
            step = round(time / STEP_S) - 1
            np.testing.assert_allclose(
                situation.places[0, step, 0], tracks.places_ahead[0, 0, number], atol=1e-9
            )
        middle = (situation.actors[0, 0, :2] + tracks.places_ahead[0, 0, 0]) / 2
        between = (situation.places[0, 1, 0] + situation.places[0, 2, 0]) / 2
        np.testing.assert_allclose(between, middle, atol=1e-9)
        places[left_m] = situation.places[0, round(AHEAD_S[0] / STEP_S) - 1, 0]
        simulation.close()
    # The walker is nearly straight ahead of the rover, which has not turned.
    np.testing.assert_allclose(places[2.0] - places[0.0], [0.0, 2.0], atol=0.3)


def test_the_forecast_of_the_package_knows_a_walker_by_its_way() -> None:
    simulation, tracks = passing_walker("persons")
    assert tracks.tracker.moving_counts[0] == 1
    x, y, velocity_x, velocity_y = tracks.tracker.moving[0, 0]
    assert (x, velocity_x, velocity_y) == pytest.approx((3.0, 0.0, -1.0), abs=0.4)
    assert tracks.places_ahead is not None
    # In half a second it goes on as before, nearly.
    np.testing.assert_allclose(tracks.places_ahead[0, 0, 0], (x, y - 0.5), atol=0.3)
    simulation.close()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"weight_2": None}, "has no sound weight_2"),
        ({"bias_1": np.full(8, np.nan, np.float32)}, "has no sound bias_1"),
        ({"weight_0": np.zeros((FEATURES + 1, 8), np.float32)}, "has no sound weight_0"),
        ({"step_s": None}, "has no sound step_s"),
        ({"scale": np.zeros(FEATURES, np.float32)}, "has no sound scale"),
        ({"bias_0": np.array(1.0, np.float32)}, "has no sound"),
        ({"bias_0": np.array(["a"] * 8)}, "is no whole file of arrays"),
    ],
)
def test_a_file_without_sound_arrays_is_refused(
    make_file: MakeFile, changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        read_forecast(str(make_file(**changes)), 0.05)


def test_other_files_are_refused(make_file: MakeFile, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"every 0\.05 s, and these come every 0\.1 s"):
        read_forecast(str(make_file()), 0.1)
    with pytest.raises(ConfigError, match=r"there is no forecast 'person'.*persons"):
        read_forecast("person", 0.05)
    whole = make_file().read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) // 3] ^= 1
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "objects.npz", mean=np.array([{}], object))
    (tmp_path / "text").write_text("no arrays")
    (tmp_path / "half").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "damaged").write_bytes(damaged)
    for name in ("array.npy", "objects.npz", "text", "half", "damaged"):
        with pytest.raises(ConfigError, match="cannot be read as a forecast"):
            read_forecast(str(tmp_path / name), 0.05)


def test_a_folder_stands_for_its_forecast(make_file: MakeFile, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    make_file().rename(tmp_path / "mine" / "forecast.npz")
    assert isinstance(read_forecast(str(tmp_path / "mine"), 0.05), MotionForecast)
    with pytest.raises(ConfigError, match="there is no forecast"):
        read_forecast(str(tmp_path), 0.05)


def test_nothing_is_told_where_nothing_is_tracked(make_file: MakeFile) -> None:
    forecast = read_forecast(str(make_file()), 0.05)
    assert isinstance(forecast, MotionForecast)
    nothing = np.zeros((0, TRACK_COLUMNS)), np.zeros((0, HISTORY_STEPS, HISTORY_COLUMNS)), np.zeros((0, 3))
    chances, told = forecast.predict(track_features(*nothing)[0])
    assert chances.shape == (0,) and told.shape == (0, 2 + len(AHEAD_S), 2)
