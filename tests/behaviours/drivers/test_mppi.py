"""The driver mppi on bodies that obey exactly and see posts and walkers."""

from dataclasses import replace

import numpy as np
import pytest
from drivers import LIDAR, ROVER, DrivenBodies, drive
from yards import yard

from dune_rl.behaviours.drivers.mppi import Mppi
from dune_rl.errors import ConfigError

NOBODY = np.zeros((0, 4))
PERSON_M = 0.25
# A post in the middle of the way.
POST = np.array([[2.5, 0.05, 0.4]])


def test_mppi_drives_round_a_post_that_its_lidar_sees() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    track = drive(Mppi(1), bodies, 300, POST)[:, 0]
    assert np.hypot(*(track[-1, :2] - [6.0, 0.0])) < 0.5
    apart = np.hypot(*(track[:, :2] - POST[0, :2]).T) - POST[0, 2]
    assert apart.min() > ROVER.width_m / 2
    # Straight on it would have met the post.
    assert POST[0, 1] < POST[0, 2] + ROVER.width_m / 2


def test_mppi_drives_straight_where_nothing_is() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    track = drive(Mppi(1), bodies, 200, np.zeros((0, 3)))[:, 0]
    length = np.hypot(*np.diff(track[:, :2], axis=0).T).sum()
    assert 5.4 < length < 6.2
    assert np.abs(track[:, 1]).max() < 0.4


def test_mppi_stops_before_a_wall_that_it_cannot_pass() -> None:
    wall = np.array([[2.0, y, 0.2] for y in np.arange(-6.0, 6.1, 0.2)])
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    track = drive(Mppi(1), bodies, 200, wall)[:, 0]
    assert track[:, 0].max() + ROVER.length_m / 2 < 1.8
    assert track[-1, 0] > 0.5


def test_the_seed_of_mppi_is_that_of_its_noise() -> None:
    tracks = []
    for seed in (0, 0, 1):
        bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 1.0], NOBODY)
        tracks.append(drive(Mppi(1, seed=seed), bodies, 10, POST))
    np.testing.assert_array_equal(tracks[0], tracks[1])
    assert np.abs(tracks[0] - tracks[2]).max() > 1e-6


def test_mppi_says_which_reading_it_lacks() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    context = bodies.context(POST)
    readings = bodies.readings(POST)
    del readings["lidar"]
    with pytest.raises(ConfigError, match=r"mppi cannot act for the group rover: .*has no lidar"):
        Mppi(1).bind(replace(context, observe=lambda: readings))


