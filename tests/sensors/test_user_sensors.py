"""A user's sensor: a function of the state, or a class, by decorator."""

import pickle
from collections.abc import Iterator
from typing import Annotated

import numpy as np
import pytest
from pydantic import Field
from states import episode_state, group_state, measure, resting, write

import dune_rl
from dune_rl.core.errors import ConfigError, RegistryError
from dune_rl.sensors.conf import parse_sensors
from dune_rl.sensors.registry import SENSORS, FunctionSensor, ReadingBounds


@pytest.fixture(autouse=True)
def _forget_users() -> Iterator[None]:
    before = dict(SENSORS._user_parts)
    yield
    SENSORS._user_parts.clear()
    SENSORS._user_parts.update(before)


@dune_rl.sensor_bounds(low=(0.0, -5.0), high=(3.0, 5.0), size=2)
def slope(state, group, *, scale: Annotated[float, Field(gt=0.0)] = 2.0) -> np.ndarray:
    """Tilt [rad] and x [m], scaled."""
    return np.column_stack([group.motion.tilt, scale * group.motion.position_w[:, 0]])


class Counter:
    """Control steps since the episode began, up to `limit`, one column for each `column`."""

    def __init__(self, name, context, *, limit: int = 9, columns: int = 1) -> None:
        self._name, self._limit = name, limit
        self._count = np.zeros((context.num_rows, columns), np.float32)

    def bounds(self):
        low = np.zeros(self._count.shape[1], np.float32)
        return {self._name: (low, low + self._limit)}

    def begin(self, mask, now, state):
        self._count[mask] = 0.0

    def measure(self, now, state):
        self._count = np.minimum(self._count + 1.0, np.float32(self._limit))

    def read(self):
        return {self._name: self._count.copy()}


def test_a_function_and_a_class_are_observed_beside_ours():
    dune_rl.register_sensor(slope)
    dune_rl.register_sensor("steps")(Counter)
    own = {
        "steeper": {"sensor": "slope", "scale": 100.0},
        "steps": {"columns": 3, "realism": {"latency_s": 0.1}},
    }
    sensors = {"enabled": ["goal", "slope", "steeper", "steps"], **own}
    env = dune_rl.parallel_env(world="flat", actors="none", sensors=sensors)
    env.reset(seed=1)
    for _ in range(4):
        seen, *_ = env.step({"rover_0": np.zeros(2, np.float32)})
    rover = seen["rover_0"]
    assert list(rover) == ["goal", "slope", "steeper", "steps"]
    assert env.observation_space("rover_0").contains(rover)
    assert abs(rover["slope"][1]) <= 5.0 and abs(rover["steeper"][1]) == 5.0
    # Four steps have been made, and a reading of two steps ago arrives.
    np.testing.assert_array_equal(rover["steps"], [2.0, 2.0, 2.0])
    env.close()


def test_settings_of_a_user_s_sensor_are_checked_and_survive():
    dune_rl.register_sensor(slope)
    conf = parse_sensors({"slope": {"scale": 3.0}})
    assert conf["slope"].scale == 3.0
    assert parse_sensors({"slope": conf["slope"].model_dump(mode="json")}) == conf
    assert pickle.loads(pickle.dumps(conf)) == conf
    for sensors, message in (
        ({"slope": {"scale": -1.0}}, r"sensors\.slope\.scale must be above 0\.0 \(got -1\.0\)"),
        ({"slope": {"scal": 1.0}}, r"sensors\.slope\.scal is not a setting"),
        (
            {"mine": {"sensor": "slop"}},
            r"sensors\.mine: there is no sensor 'slop'.*did you mean slope",
        ),
    ):
        with pytest.raises(ConfigError, match=message):
            dune_rl.parallel_env(world="flat", sensors=sensors)


def test_what_must_be_set_is_asked_for():
    @dune_rl.register_sensor
    @dune_rl.sensor_bounds(low=0.0, high=1.0)
    def share(state, group, *, whole: float) -> np.ndarray:
        return group.motion.tilt / whole

    with pytest.raises(ConfigError, match=r"sensors\.share\.whole is missing; give it a value"):
        dune_rl.parallel_env(world="flat", sensors={"enabled": ["share"]})


def test_a_function_without_bounds_is_refused():
    with pytest.raises(
        RegistryError, match=r"whose values have no bounds: write @dune_rl\.sensor_bounds\(low="
    ):
        dune_rl.register_sensor("bare")(lambda state, group: np.zeros(1))


def test_names_of_ours_are_taken_and_each_is_there():
    with pytest.raises(RegistryError, match="cannot be the sensor 'lidar', which dune_rl has"):
        dune_rl.register_sensor("lidar")(slope)
    for name in SENSORS.own:
        assert SENSORS.settings_class(name).model_fields["sensor"].default == name


# -- the adapter ---------------------------------------------------------------------------------------


def test_a_function_s_values_are_clipped_to_its_bounds():
    sensor = FunctionSensor("slope", slope, 2, slope.sensor_bounds, {"scale": 2.0}, "the sensor")
    now = episode_state([0, 1], 0)
    write(now.motion.position_w, (slice(None), 0), (1.0, 9.0))
    measure(sensor, now)
    np.testing.assert_array_equal(sensor.read()["slope"], np.float32([[0, 2], [0, 5]]))
    low, high = sensor.bounds()["slope"]
    assert low.dtype == high.dtype == np.float32
    np.testing.assert_array_equal([low, high], [[0, -5], [3, 5]])


def test_a_function_of_one_number_may_leave_the_axis_out():
    sensor = FunctionSensor(
        "height", lambda state, group: group.motion.position_w[:, 2], 3, ReadingBounds(-1, 1), {}, ""
    )
    measure(sensor, group_state(resting(3)))
    assert sensor.read()["height"].shape == (3, 1)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (
            lambda state, group: np.zeros((3, 2)),
            r"^mine, which must return an array of shape \(2, 2\).*\(3, 2\)",
        ),
        (lambda state, group: np.array([[0.0, np.nan]] * 2), r"^mine, which returned NaN"),
    ],
)
def test_what_no_reading_can_be_is_refused(function, message):
    sensor = FunctionSensor("reading", function, 2, ReadingBounds(0.0, 1.0, 2), {}, "mine")
    with pytest.raises(RegistryError, match=message):
        measure(sensor, group_state(resting(2)))


def test_bounds_the_wrong_way_round_are_refused():
    with pytest.raises(RegistryError, match=r"mine, whose low 1.0 must be at most its high 0.0"):
        FunctionSensor("reading", slope, 1, ReadingBounds(1.0, 0.0, 2), {}, "mine")
