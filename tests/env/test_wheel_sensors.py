"""From physics to sensors on wheels: joints are read where something needs them, and nowhere else."""

import numpy as np
import pytest
from scripted_physics import ScriptedRobot, scripted_simulation
from simulations import act, every_engine, motion_of_group, started_simulation
from wheels import WHEELS, within_bounds

from dune_rl.env.simulation import VectorSimulation
from dune_rl.sensors.sensor import Sensor

SCENES = 3
ON_WHEELS = {
    "enabled": ["encoders", "odometry", "currents", "position"],
    "position": {"drift_horizontal_m": 1.0},
}


def with_wheel_sensors(**settings: object) -> tuple[VectorSimulation, list[Sensor]]:
    simulation = started_simulation(num_scenes=SCENES, sensors=ON_WHEELS, **settings)
    return simulation, list(simulation.group().suite.sensors.values())


def readings(sensors: list[Sensor]) -> list[np.ndarray]:
    return [value for sensor in sensors for value in sensor.read().values()]


def drive(simulation: VectorSimulation, sensors: list[Sensor], steps: int) -> list[list[np.ndarray]]:
    rng = np.random.default_rng(simulation.steps.sum())
    found = []
    for _ in range(steps):
        act(simulation, rng.uniform([0.2, -1.0], [1.0, 1.0], (SCENES, 2)))
        assert all(within_bounds(sensor) for sensor in sensors)
        found.append(readings(sensors))
    return found


@pytest.mark.slow
@every_engine
def test_wheels_reach_the_sensors_that_read_them(engine: str) -> None:
    simulation, sensors = with_wheel_sensors(physics=engine)
    assert simulation.group().suite.needs_joints
    encoders, odometry, currents, _ = readings(sensors)
    assert not encoders.any() and not odometry.any()
    start = motion_of_group(simulation).position_w.copy()
    for _ in range(40):
        act(simulation, [0.5, 0.0])
    encoders, odometry, currents, _ = readings(sensors)
    way = np.linalg.norm((motion_of_group(simulation).position_w - start)[:, :2], axis=1)
    assert way.min() > 0.8
    np.testing.assert_allclose(odometry[:, 0], way, rtol=0.02)
    np.testing.assert_allclose(encoders[:, WHEELS:] * 0.125, 0.5, rtol=0.05)
    assert np.abs(currents).max() > 0.0
    simulation.close()


def test_an_episode_more_begins_at_nothing_and_leaves_the_others() -> None:
    simulation, sensors = with_wheel_sensors()
    before = drive(simulation, sensors, 20)[-1]
    simulation.reset(np.array([True, False, False]))
    encoders, odometry, *_ = readings(sensors)
    assert not encoders[0].any() and not odometry[0].any()
    for old, new in zip(before, readings(sensors), strict=True):
        np.testing.assert_array_equal(new[1:], old[1:])
        assert (new[0] != old[0]).any()
    simulation.close()


def test_a_state_brings_the_sensors_back_bit_for_bit() -> None:
    simulation, sensors = with_wheel_sensors()
    drive(simulation, sensors, 15)
    simulation.reset(np.array([False, True, False]))
    drive(simulation, sensors, 5)
    saved, here = simulation.save_state(), readings(sensors)
    ahead = drive(simulation, sensors, 10)
    simulation.restore(saved)
    for old, new in zip(here, readings(sensors), strict=True):
        np.testing.assert_array_equal(new, old)
    for old, new in zip(ahead, drive(simulation, sensors, 10), strict=True):
        for one, other in zip(old, new, strict=True):
            np.testing.assert_array_equal(other, one)
    simulation.close()


def test_joints_are_read_only_where_something_needs_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(robot: ScriptedRobot) -> tuple[float, ...]:
        raise AssertionError("nothing needs the joints")

    monkeypatch.setattr(ScriptedRobot, "drive_state", refuse)
    simulation, _ = scripted_simulation(num_scenes=2)
    act(simulation)
    simulation.reset()
    assert not simulation.group().suite.needs_joints
    assert motion_of_group(simulation).joints is None
