"""Position and heading: the true pose, and an error that wanders as a Gauss-Markov process does."""

import numpy as np
import pytest
from scenes import STEP_S, Drive, about, every_backend
from sensor_contexts import context_of
from states import begin, group_state, measure, motion_of, write
from wheels import Measured, reading, within_bounds

from dune_rl.sensors.own_motion import Position, PositionConf
from dune_rl.state import GroupState

EXTENT = (-20.0, 30.0, -10.0, 15.0)
HEIGHTS = (-1.0, 4.0)


def position(conf: PositionConf | None = None, scenes: int = 1, step_s: float = STEP_S) -> Position:
    return Position(
        "position", context_of(scenes, step_s=step_s, extent=EXTENT, heights=HEIGHTS), conf or PositionConf()
    )


def standing(
    places: np.ndarray, step: int = 0, seed: int = 0, first: int = 0, yaw: float | np.ndarray = 0.0
) -> GroupState:
    """Rovers at `places` (M, 3) in the episodes from `first` on, `step` control steps old."""
    places = np.asarray(places, float)
    scenes = len(places)
    states = np.zeros((scenes, 13))
    states[:, :3] = places
    states[:, 3:7] = [about([0, 0, 1], each) for each in np.broadcast_to(yaw, scenes)]
    return group_state(motion_of(states), steps=step, seed=seed, streams=first + np.arange(scenes))


def everywhere(scenes: int) -> np.ndarray:
    return np.ones(scenes, bool)


def errors(conf: PositionConf, scenes: int, steps: int, step_s: float = STEP_S, seed: int = 0) -> np.ndarray:
    """Error of x, y and z [m] of rovers at the origin, (steps + 1, M, 3), episode by episode."""
    sensor, places = position(conf, scenes, step_s), np.zeros((scenes, 3))
    begin(sensor, everywhere(scenes), standing(places, seed=seed))
    found = [sensor.read()["position"][:, :3]]
    for step in range(1, steps + 1):
        measure(sensor, standing(places, step, seed))
        assert within_bounds(sensor)
        found.append(sensor.read()["position"][:, :3])
    return np.array(found)


# -- the true pose ---------------------------------------------------------------------------------


@every_backend
def test_a_driving_rover_s_pose_is_told(backend):
    sensor = position()
    measured = Measured(Drive(backend, yaw=2.5), sensor)
    for number in range(40):
        measured.step(0.8, np.sin(number / 5))
        stage = measured.drive.stage
        np.testing.assert_allclose(reading(sensor), [*stage.position, stage.yaw], rtol=1e-6, atol=1e-6)
    assert np.linalg.norm(stage.position[:2]) > 1.0


def test_each_scene_has_its_own_pose_at_begin_and_after():
    places = np.array([[1.0, 2.0, 0.5], [-3.0, 4.0, 1.0]])
    sensor = position(scenes=2)
    begin(sensor, everywhere(2), standing(places, yaw=np.array([0.3, -3.0])))
    np.testing.assert_allclose(sensor.read()["position"], [[1, 2, 0.5, 0.3], [-3, 4, 1, -3.0]], rtol=1e-6)
    measure(sensor, standing(places + 1.0))
    np.testing.assert_allclose(sensor.read()["position"], [[2, 3, 1.5, 0], [-2, 5, 2, 0]], rtol=1e-6)


def test_outside_its_world_a_rover_is_told_at_the_edge():
    sensor = position(scenes=2)
    begin(sensor, everywhere(2), standing([[-99.0, 99.0, -99.0], [99.0, -99.0, 99.0]]))
    assert within_bounds(sensor)
    np.testing.assert_array_equal(sensor.read()["position"][:, :3], [[-20, 15, -1], [30, -10, 4]])


def test_bounds_are_the_world_s_widened_by_the_drift():
    (low, high) = position().bounds()["position"]
    np.testing.assert_allclose(low, [-20, -10, -1, -np.pi], rtol=1e-6)
    np.testing.assert_allclose(high, [30, 15, 4, np.pi], rtol=1e-6)
    (low, high) = position(PositionConf(drift_horizontal_m=2.0, drift_vertical_m=3.0)).bounds()["position"]
    np.testing.assert_allclose(low[:3], [-28, -18, -13])
    np.testing.assert_allclose(high[:3], [38, 23, 16])


def test_a_half_turn_is_within_bounds_either_way():
    for yaw in (np.pi, -np.pi, np.nextafter(np.pi, 0), np.nextafter(-np.pi, 0)):
        sensor = position()
        begin(sensor, everywhere(1), standing([[0.0, 0.0, 0.0]], yaw=yaw))
        assert within_bounds(sensor)


# -- the wandering error ---------------------------------------------------------------------------


def test_the_error_is_as_wide_as_set_from_the_first_step_to_the_last():
    found = errors(PositionConf(drift_horizontal_m=1.5, drift_vertical_m=3.0, drift_time_s=1.0), 1500, 40)
    for step in (0, 1, 20, 40):
        # Over 1500 episodes the spread is sure to 2 %, the mean to 3 % of it.
        np.testing.assert_allclose(found[step].std(axis=0), [1.5, 1.5, 3.0], rtol=0.08)
        assert np.abs(found[step].mean(axis=0) / [1.5, 1.5, 3.0]).max() < 0.12


@pytest.mark.parametrize("lag", [1, 10, 20, 40])
def test_the_error_fades_to_a_share_of_1_e_in_its_time(lag):
    # A time of one second is twenty steps.
    found = errors(PositionConf(drift_horizontal_m=1.0, drift_vertical_m=1.0, drift_time_s=1.0), 500, 80)
    early, late = found[:-lag], found[lag:]
    alike = (early * late).mean() / found.var()
    assert alike == pytest.approx(np.exp(-lag / 20), abs=0.04)


def test_axes_and_episodes_err_apart():
    found = errors(PositionConf(drift_horizontal_m=1.0, drift_vertical_m=1.0, drift_time_s=0.1), 400, 50)
    alike = np.corrcoef(found.reshape(-1, 3).T) - np.eye(3)
    assert np.abs(alike).max() < 0.06
    between = np.corrcoef(found[:, :2].transpose(1, 0, 2).reshape(2, -1))[0, 1]
    assert abs(between) < 0.35


def test_the_step_s_length_changes_the_rate_and_not_the_spread():
    conf = PositionConf(drift_horizontal_m=1.0, drift_vertical_m=1.0, drift_time_s=1.0)
    slow, fast = (errors(conf, 1000, 5, step_s)[5] for step_s in (0.01, 5.0))
    assert slow.std() == pytest.approx(fast.std(), rel=0.05)


def test_only_the_axes_that_drift_err():
    across = errors(PositionConf(drift_vertical_m=2.0), 3, 5)
    np.testing.assert_array_equal(across[..., :2], 0.0)
    assert (across[..., 2] != 0.0).all()
    along = errors(PositionConf(drift_horizontal_m=2.0), 3, 5)
    np.testing.assert_array_equal(along[..., 2], 0.0)
    assert (along[..., :2] != 0.0).all()


DRIFTING = PositionConf(drift_horizontal_m=2.0, drift_vertical_m=2.0)


def test_equal_seeds_err_alike_and_others_do_not():
    first = errors(DRIFTING, 3, 10)
    np.testing.assert_array_equal(errors(DRIFTING, 3, 10), first)
    assert (errors(DRIFTING, 3, 10, seed=1) != first).all()


def test_an_episode_s_error_does_not_depend_on_its_neighbours():
    alone, beside = position(DRIFTING), position(DRIFTING, scenes=3)
    nowhere = np.zeros((3, 3))
    begin(alone, everywhere(1), standing(nowhere[:1], first=2))
    begin(beside, everywhere(3), standing(nowhere))
    np.testing.assert_array_equal(reading(alone), reading(beside, 2))
    for step in range(1, 6):
        measure(alone, standing(nowhere[:1], step, first=2))
        measure(beside, standing(nowhere, step))
        np.testing.assert_array_equal(reading(alone), reading(beside, 2))
        # Others that begin anew leave it as it is.
        now = standing(nowhere, step)
        begun = np.array([True, False, False])
        write(now.episode.steps, begun, 0)
        begin(beside, begun, now)
        np.testing.assert_array_equal(reading(alone), reading(beside, 2))


def test_begin_draws_anew_only_where_told_and_an_episode_repeats_itself():
    sensor, nowhere = position(DRIFTING, scenes=2), np.zeros((2, 3))
    begin(sensor, everywhere(2), standing(nowhere))
    first = sensor.read()["position"]
    for step in range(1, 4):
        measure(sensor, standing(nowhere, step))
    later = sensor.read()["position"]
    now = standing(nowhere, 3)
    write(now.episode.steps, 0, 0)
    begin(sensor, np.array([True, False]), now)
    np.testing.assert_array_equal(sensor.read()["position"], [first[0], later[1]])


def test_readings_are_the_asker_s_own():
    sensor = position()
    begin(sensor, everywhere(1), standing([[1.0, 2.0, 3.0]]))
    sensor.read()["position"][:] = 9.0
    sensor.bounds()["position"][0][:] = 9.0
    np.testing.assert_array_equal(reading(sensor), [1, 2, 3, 0])
    assert sensor.bounds()["position"][0].max() < 0.0


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "value", "told"),
    [
        ("drift_horizontal_m", -0.1, "greater than or equal to 0"),
        ("drift_vertical_m", float("inf"), "finite"),
        ("drift_time_s", 0.0, "greater than 0"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(setting, value, told):
    with pytest.raises(ValueError, match=rf"{setting}\n.*{told}"):
        PositionConf(**{setting: value})


@pytest.mark.parametrize(
    ("extent", "heights"),
    [
        ((1.0, -1.0, -1.0, 1.0), HEIGHTS),
        (EXTENT, (4.0, -1.0)),
        (EXTENT, (float("nan"), 1.0)),
        ((-np.inf, np.inf, -1.0, 1.0), HEIGHTS),
    ],
)
def test_a_world_without_an_inside_is_refused(extent, heights):
    with pytest.raises(ValueError, match=r"extent .* and heights .* \(xmin, xmax, ymin, ymax\)"):
        Position("position", context_of(extent=extent, heights=heights), PositionConf())
