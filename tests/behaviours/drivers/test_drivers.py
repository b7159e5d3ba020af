"""What holds for both reference drivers: rows do not depend on rows, and a reset begins anew."""

import numpy as np
import pytest
from drivers import DrivenBodies, drive
from yards import yard

from dune_rl.behaviours.drivers.mppi import Mppi
from dune_rl.behaviours.drivers.planner import Planner
from dune_rl.core.errors import ConfigError

NOBODY = np.zeros((0, 4))
WALL = (0.0, -2.0, 0.0, 0.4, 16.0)
POST = np.array([[2.5, 0.05, 0.4]])


@pytest.mark.slow
@pytest.mark.parametrize("driver", [Planner, Mppi])
def test_a_row_does_not_depend_on_the_other_rows(driver) -> None:
    starts = np.array([[-4.0, 0.0, 0.0], [0.0, 3.0, 1.0], [2.0, -4.0, -2.0]])
    goals = np.array([[4.0, 0.0], [-3.0, -3.0], [0.0, 0.0]])
    walkers = np.array([[[0.0, 1.0, 0.3, 0.2]], [[-1.0, 0.0, 0.5, 0.0]], [[1.0, -1.0, 0.0, 0.4]]])
    discs = np.array([[0.0, 0.0, 0.3]])
    together = DrivenBodies(yard(), starts, goals, walkers)
    tracks = drive(driver(3), together, 40, discs)
    for row in range(3):
        alone = DrivenBodies(yard(), starts[row], goals[row], walkers[row])
        np.testing.assert_array_equal(drive(driver(1), alone, 40, discs)[:, 0], tracks[:, row])


@pytest.mark.slow
@pytest.mark.parametrize("driver", [Planner, Mppi])
def test_a_reset_begins_anew(driver) -> None:
    tracks = []
    used = driver(1)
    for other in (used, used, driver(1)):
        bodies = DrivenBodies(yard(WALL), [-4.0, 0.0, 0.0], [4.0, 0.0], [[-2.0, 1.0, 0.2, -0.1]])
        tracks.append(drive(other, bodies, 30, POST))
    np.testing.assert_array_equal(tracks[0], tracks[1])
    np.testing.assert_array_equal(tracks[0], tracks[2])


@pytest.mark.parametrize("driver", [Planner, Mppi])
def test_an_unbound_driver_says_so(driver) -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    with pytest.raises(ConfigError, match="must be bound to the group"):
        driver(1).act(*bodies.state())
