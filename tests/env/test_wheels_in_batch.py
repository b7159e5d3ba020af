"""From physics to sensors through a batch: wheels are asked for where they are read, and nowhere else."""

import numpy as np
import pytest
from batches import every_engine, idle, real_batch
from planted.puppets import PuppetScene, puppet_batch
from scenes import STEP_S
from wheels import WHEELS, geometry, within_bounds

from dune_rl.env import senses
from dune_rl.env.batch import Batch
from dune_rl.env.motion import Motion
from dune_rl.robots.rover_zero.robot import RoverZero, RoverZeroConf
from dune_rl.robots.skid_steer import SkidSteerConf
from dune_rl.sensors.currents import Currents, CurrentsConf
from dune_rl.sensors.encoders import Encoders, EncodersConf
from dune_rl.sensors.odometry import Odometry, OdometryConf
from dune_rl.sensors.position import Position, PositionConf
from dune_rl.sensors.sensor import Sensor

SCENES = 3


@pytest.fixture
def carried(monkeypatch: pytest.MonkeyPatch) -> list[Sensor]:
    """Sensors that every rover carries beside those of its settings."""
    track_m = SkidSteerConf().effective_track_m
    made: list[Sensor] = [
        Encoders(EncodersConf(), SCENES, WHEELS, STEP_S),
        Odometry(OdometryConf(), EncodersConf(), geometry(track_m), SCENES, WHEELS, STEP_S),
        Currents(CurrentsConf(), SCENES, WHEELS),
        Position(PositionConf(drift_horizontal_m=1.0), (-50, 50, -50, 50), (-1, 1), SCENES, STEP_S),
    ]
    usual = senses.make_sensors
    monkeypatch.setattr(senses, "make_sensors", lambda *args, **kwargs: [*usual(*args, **kwargs), *made])
    return made


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
def test_wheels_reach_the_sensors_that_read_them(carried, engine):
    batch = real_batch(num_scenes=SCENES, physics=engine)
    assert batch.senses.needs_wheels
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


def test_an_episode_more_begins_at_nothing_and_leaves_the_others(carried):
    batch = real_batch(num_scenes=SCENES)
    before = drive(batch, carried, 20)[-1]
    batch.reset(np.array([True, False, False]))
    encoders, odometry, *_ = told(carried)
    assert not encoders[0].any() and not odometry[0].any()
    for old, new in zip(before, told(carried), strict=True):
        np.testing.assert_array_equal(new[1:], old[1:])
        assert (new[0] != old[0]).any()
    batch.close()


def test_a_state_brings_the_sensors_back_bit_for_bit(carried):
    batch = real_batch(num_scenes=SCENES)
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
    assert not batch.senses.needs_wheels


def test_wheels_of_diverged_physics_stay_as_they_were():
    motion = Motion(2, RoverZero(RoverZeroConf(), 2))
    states, drives = np.zeros((2, 13)), np.arange(24.0).reshape(2, 12)
    states[:, 6] = 1.0
    motion.update(states, drives)
    wild, states = drives + 1.0, states.copy()
    states[0, 7] = np.nan
    wild[1, 3] = np.inf
    motion.update(states, wild)
    wheels = motion.moment(np.zeros((2, 0, 4)), 0, np.arange(2), np.zeros(2, np.int64)).wheels
    assert wheels is not None
    np.testing.assert_array_equal(np.hstack([wheels.angle, wheels.speed, wheels.torque]), drives)
    # What decides an episode's end does not depend on who reads wheels.
    np.testing.assert_array_equal(motion.diverged, [True, False])
