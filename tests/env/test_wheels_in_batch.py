"""From physics to sensors through a batch: wheels are asked for where they are read, and nowhere else."""

import numpy as np
from batches import every_engine, idle, real_batch
from dune_rl.env.batch import Batch
from dune_rl.env.motion import Motion
from planted.puppets import PuppetScene, puppet_batch
from wheels import WHEELS, within_bounds

from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.sensors.sensor import Sensor

SCENES = 3


ON_WHEELS = {
    "enabled": ["encoders", "odometry", "currents", "position"],
    "position": {"drift_horizontal_m": 1.0},
}


def batch_on_wheels(**settings) -> tuple[Batch, list[Sensor]]:
    batch = real_batch(num_scenes=SCENES, sensors=ON_WHEELS, **settings)
    return batch, list(batch.senses.sensors.values())


def told(sensors: list[Sensor]) -> list[np.ndarray]:
    return [value for sensor in sensors for value in sensor.read().values()]


def drive(batch: Batch, sensors: list[Sensor], steps: int) -> list[list[np.ndarray]]:
    rng = np.random.default_rng(batch.steps.sum())
    found = []
    for _ in range(steps):
        batch.step(rng.uniform([0.2, -1.0], [1.0, 1.0], (SCENES, 2)).astype(np.float32))
        assert all(within_bounds(sensor) for sensor in sensors)
        found.append(told(sensors))
    return found


@every_engine
def test_wheels_reach_the_sensors_that_read_them(engine):
    batch, carried = batch_on_wheels(physics=engine)
    assert batch.senses.needs_joints
    encoders, odometry, currents, _ = told(carried)
    assert not encoders.any() and not odometry.any()
    start = batch.motion.position_w.copy()
    for _ in range(40):
        batch.step(np.tile(np.float32([0.5, 0.0]), (SCENES, 1)))
    encoders, odometry, currents, _ = told(carried)
    way = np.linalg.norm((batch.motion.position_w - start)[:, :2], axis=1)
    assert way.min() > 0.8
    np.testing.assert_allclose(odometry[:, 0], way, rtol=0.02)
    np.testing.assert_allclose(encoders[:, WHEELS:] * 0.125, 0.5, rtol=0.05)
    assert np.abs(currents).max() > 0.0
    batch.close()


def test_an_episode_more_begins_at_nothing_and_leaves_the_others():
    batch, carried = batch_on_wheels()
    before = drive(batch, carried, 20)[-1]
    batch.reset(np.array([True, False, False]))
    encoders, odometry, *_ = told(carried)
    assert not encoders[0].any() and not odometry[0].any()
    for old, new in zip(before, told(carried), strict=True):
        np.testing.assert_array_equal(new[1:], old[1:])
        assert (new[0] != old[0]).any()
    batch.close()


def test_a_state_brings_the_sensors_back_bit_for_bit():
    batch, carried = batch_on_wheels()
    drive(batch, carried, 15)
    batch.reset(np.array([False, True, False]))
    drive(batch, carried, 5)
    state, here = batch.state(), told(carried)
    ahead = drive(batch, carried, 10)
    batch.restore(state)
    for old, new in zip(here, told(carried), strict=True):
        np.testing.assert_array_equal(new, old)
    for old, new in zip(ahead, drive(batch, carried, 10), strict=True):
        for one, other in zip(old, new, strict=True):
            np.testing.assert_array_equal(other, one)
    batch.close()


def test_physics_is_asked_of_wheels_only_where_they_are_read(monkeypatch):
    def refuse(puppet: PuppetScene) -> tuple[float, ...]:
        raise AssertionError("nobody reads wheels")

    monkeypatch.setattr(PuppetScene, "drive_state", refuse)
    batch, _ = puppet_batch(num_scenes=2)
    batch.step(idle(batch))
    batch.reset()
    assert not batch.senses.needs_joints


def test_wheels_of_diverged_physics_stay_as_they_were():
    motion = Motion(2, RoverZero(RoverZeroConf(), 2))
    states, drives = np.zeros((2, 13)), np.arange(24.0).reshape(2, 12)
    states[:, 6] = 1.0
    motion.update(states, drives)
    wild, states = drives + 1.0, states.copy()
    states[0, 7] = np.nan
    wild[1, 3] = np.inf
    motion.update(states, wild)
    wheels = motion.true_motion(np.zeros((2, 3))).joints
    assert wheels is not None
    np.testing.assert_array_equal(np.hstack([wheels.angle, wheels.speed, wheels.torque]), drives)
    # What decides an episode's end does not depend on who reads wheels.
    np.testing.assert_array_equal(motion.diverged, [True, False])
