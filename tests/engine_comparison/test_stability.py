"""Fault counts of random driving: none without faults, none for a fall, and every planted fault."""

import numpy as np
import pytest
from planted.engines import KickedRobot, RaisedRobot, TeleportedRobot, UnchangedRobot, tampered
from simulations import every_engine

from dune_rl.commands.engines import recording
from dune_rl.commands.engines.stability import FaultCounts, SpeedLimit, count_faults
from dune_rl.robots.rover_zero import RoverZero

MASSES_KG = {"rover_zero": RoverZero.description.mass_kg, "hyperdog": 5.0}
every_robot = pytest.mark.parametrize("robot", MASSES_KG)


def drive(monkeypatch, kind: type[UnchangedRobot], world: str, engine: str, robot: str) -> FaultCounts:
    """The faults of ten seconds of random driving."""
    planted = tampered(kind, recording.scene_maker, MASSES_KG[robot])
    monkeypatch.setattr(recording, "scene_maker", planted)
    return count_faults(world, engine, robot, minutes=1 / 6, scenes=2, seed=0)


@pytest.mark.slow(all_but=["rover_zero-dart"])
@every_engine
@every_robot
def test_driving_on_flat_ground_is_sound(monkeypatch, engine, robot):
    found = drive(monkeypatch, UnchangedRobot, "flat", engine, robot)
    assert (found.nan, found.fallen, found.jumps, found.diverged) == (0, 0, 0, 0)
    assert 0.2 < found.fastest_mps < 1.4


@pytest.mark.slow(all_but=["flat-rover_zero-dart", "flat-rover_zero-bullet", "slope-rover_zero-bullet"])
@every_engine
@every_robot
@pytest.mark.parametrize("world", ["flat", "slope"])
def test_a_fall_is_no_jump_however_fast(monkeypatch, engine, robot, world):
    found = drive(monkeypatch, RaisedRobot, world, engine, robot)
    assert found.fastest_mps > 6.0
    assert (found.fallen, found.jumps, found.diverged) == (0, 0, 0)


@pytest.mark.slow(all_but=["KickedRobot-rover_zero-bullet", "TeleportedRobot-rover_zero-dart"])
@every_engine
@every_robot
@pytest.mark.parametrize("kind", [KickedRobot, TeleportedRobot])
def test_a_kick_from_nowhere_and_a_leap_are_jumps(monkeypatch, engine, robot, kind):
    found = drive(monkeypatch, kind, "flat", engine, robot)
    # Five seconds a scene: one a second, but for the first.
    assert found.jumps >= 8
    assert found.fastest_mps > 2.0


def possible(speeds, work_j=0.0, drop_m=0.0) -> np.ndarray:
    """Largest possible speeds after steps with `speeds` before them, of a robot of 2 kg and 1 m/s."""
    limits = SpeedLimit(1.0, 2.0, np.array([speeds[0]]))
    rest = np.array([work_j]), np.array([drop_m])
    return np.array([limits.update(*rest, np.array([speed]))[0] for speed in [*speeds[1:], 0.0]])


def test_what_is_possible_follows_from_work_and_height():
    np.testing.assert_allclose(possible([0.5]), 1.0)
    np.testing.assert_allclose(possible([3.0]), 3.0)
    np.testing.assert_allclose(possible([0.5], work_j=3.0), 2.0)
    np.testing.assert_allclose(possible([4.0], drop_m=0.5), np.sqrt(16 + 9.81))
    np.testing.assert_allclose(possible([4.0], drop_m=-0.5), np.sqrt(16 - 9.81))
    # Uphill it cannot come to less than it can be told.
    np.testing.assert_allclose(possible([2.0], drop_m=-5.0), 1.0)


def test_speed_from_nowhere_is_not_believed_and_speed_lost_is_lost():
    # By a quarter more in each step, none of which is half too fast by itself.
    np.testing.assert_allclose(possible([1.0, 1.25, 1.56, 1.95]), 1.0)
    # Springs may give back what it had a step before.
    np.testing.assert_allclose(possible([3.0, 2.0, 0.1, 0.1]), [3.0, 3.0, 2.0, 1.0])


def test_after_a_new_start_its_speed_is_believed():
    limits = SpeedLimit(1.0, 2.0, np.array([0.0, 3.0]))
    limits.restart(np.array([True, False]), np.array([5.0, 9.0]))
    np.testing.assert_allclose(limits.update(np.zeros(2), np.zeros(2), np.zeros(2)), [5.0, 3.0])
