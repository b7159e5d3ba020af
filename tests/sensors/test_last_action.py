"""The reading "last_action"."""

import numpy as np
import pytest
from simulations import act, started_simulation


def test_the_last_action_is_relative_to_its_bounds_and_zero_at_the_start() -> None:
    simulation = started_simulation(num_scenes=2, sensors={"last_action": {}})
    low, high = simulation.group("rover").action_bounds
    assert not simulation.observe("rover")["last_action"].any()
    act(simulation, [low, high])
    assert simulation.observe("rover")["last_action"][:, 0].tolist() == [[-1.0, -1.0], [1.0, 1.0]]
    # Beyond the bounds it is limited; the middle is 0.
    act(simulation, [0.5 * (low + high), 2.0 * high])
    found = simulation.observe("rover")["last_action"][:, 0]
    assert found == pytest.approx(np.array([[0.0, 0.0], [1.0, 1.0]]), abs=1e-6)
    simulation.reset(np.array([False, True]))
    act(simulation, [high, high])
    simulation.reset(np.array([True, False]))
    assert simulation.observe("rover")["last_action"][:, 0].tolist() == [[0.0, 0.0], [1.0, 1.0]]
    simulation.close()


def test_a_held_action_is_the_last_action() -> None:
    simulation = started_simulation(sensors={"last_action": {}}, physics={"action_repeat": 4})
    _, high = simulation.group("rover").action_bounds
    simulation.advance({"rover": high.reshape(1, 1, 2)})
    assert simulation.observe("rover")["last_action"].ravel().tolist() == [1.0, 1.0]
    simulation.close()
