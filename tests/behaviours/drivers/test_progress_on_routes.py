"""What a driver concludes from how it and others move."""

import numpy as np
import pytest

from dune_rl.behaviours.drivers.planner import ActorMotion
from dune_rl.sensors.perception.stuck_recovery import StuckRecovery

STEP_S = 0.05
NOBODY = np.zeros(1, bool)


def test_who_walks_in_a_circle_has_its_velocity_and_yaw_rate() -> None:
    motion = ActorMotion(1)
    rate, radius = 0.5, 2.0
    for step in range(60):
        angle = rate * step * STEP_S
        place = radius * np.cos(angle), radius * np.sin(angle), 0.0
        poses = np.array([[[*place, angle + np.pi / 2]]])
        found = motion.estimate(poses, np.array([step == 0]), STEP_S, 0.35)
        if step == 0:
            np.testing.assert_array_equal(found[0, 0, 2:5], 0.0)
    x, y, vx, vy, yaw_rate, size = found[0, 0]
    assert np.hypot(vx, vy) == pytest.approx(rate * radius, rel=0.01)
    assert vx * x + vy * y == pytest.approx(0.0, abs=0.05)
    assert yaw_rate == pytest.approx(rate, rel=0.05)
    assert size == 0.35


def test_who_turns_round_goes_straight_on() -> None:
    motion = ActorMotion(1)
    for step in range(20):
        yaw = 0.0 if step < 10 else np.pi
        x = 0.05 * min(step, 18 - step)
        found = motion.estimate(np.array([[[x, 0.0, 0.0, yaw]]]), np.array([step == 0]), STEP_S, 0.35)
    assert found[0, 0, 2] == pytest.approx(-1.0)
    assert found[0, 0, 4] == pytest.approx(0.0, abs=1e-9)


def steps_until(watch: StuckRecovery, speed: float, waits: np.ndarray) -> tuple[int, bool]:
    """After how many steps at one place a body recovers, and whether it found a blockage."""
    watch.reset(np.ones(1, bool))
    for step in range(1, 200):
        blocked = watch.update(np.array([[1.0, 2.0, np.pi / 2]]), waits, 0.6, STEP_S)
        if watch.recovering[0]:
            return step, bool(blocked[0])
        watch.record_command(np.array([speed]))
    return 200, False


def test_a_body_that_does_not_move_as_commanded_is_blocked_ahead_or_behind() -> None:
    watch = StuckRecovery(1)
    steps, blocked = steps_until(watch, 0.8, NOBODY)
    assert blocked and 1.9 < steps * STEP_S < 2.2
    x, y, radius = watch.blocked[0][0]
    assert x == pytest.approx(1.0) and y - radius == pytest.approx(2.3, abs=0.1)
    steps, blocked = steps_until(watch, -0.8, NOBODY)
    assert blocked and watch.blocked[0][0][1] + radius == pytest.approx(1.7, abs=0.1)


def test_a_body_that_commands_nothing_recovers_later_and_one_that_waits_does_not() -> None:
    watch = StuckRecovery(1)
    steps, blocked = steps_until(watch, 0.0, NOBODY)
    assert not blocked and 3.9 < steps * STEP_S < 4.2
    assert steps_until(watch, 0.8, ~NOBODY) == (200, False)
