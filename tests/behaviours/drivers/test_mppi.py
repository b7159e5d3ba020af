"""The driver mppi on bodies that obey exactly and see posts and walkers."""

from dataclasses import replace

import numpy as np
import pytest
from drivers import LIDAR, ROVER, DrivenBodies, drive
from yards import yard

from dune_rl.behaviours.drivers.context import DriverContext
from dune_rl.behaviours.drivers.mppi import Mppi
from dune_rl.core.errors import ConfigError

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


def test_mppi_finds_its_way_round_a_wall() -> None:
    wall = np.array([[2.0, y, 0.2] for y in np.arange(-3.0, 3.1, 0.2)])
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    track = drive(Mppi(1), bodies, 800, wall)[:, 0]
    assert np.hypot(*(track[-1, :2] - [6.0, 0.0])) < 0.5
    apart = np.hypot(*np.moveaxis(track[:, None, :2] - wall[:, :2], -1, 0)) - 0.2
    assert apart.min() > ROVER.width_m / 2


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


def drive_among(bodies: DrivenBodies, walls: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Track (T, 3) and distances from walkers (T, K) of mppi among posts, its walkers seen as discs."""

    def readings() -> dict[str, np.ndarray]:
        people = np.column_stack([bodies.walkers[0, :, :2], np.full(bodies.walkers.shape[1], PERSON_M)])
        return bodies.readings(np.concatenate([walls, people]))

    mppi = Mppi(1)
    mppi.bind(DriverContext("rover", bodies.vehicle, LIDAR, readings))
    track, apart = [], []
    for _ in range(steps):
        bodies.move(mppi.act(*bodies.state()))
        track.append(bodies.poses[0].copy())
        apart.append(bodies.distances()[0])
        if np.hypot(*(bodies.goals - bodies.poses[:, :2]).T)[0] < 0.5:
            break
    return np.array(track), np.array(apart)


@pytest.mark.parametrize("velocity", [(0.0, 0.9), (-0.6, 0.6), (-0.9, 0.0)])
def test_mppi_keeps_clear_of_a_walker_whom_straight_on_it_would_meet(velocity: tuple[float, float]) -> None:
    # Both would be at (3, 0) after 3 s.
    start = np.array([3.0, 0.0]) - 3.0 * np.array(velocity)
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [7.0, 0.0], [[*start, *velocity]])
    track, apart = drive_among(bodies, np.zeros((0, 3)), 400)
    assert apart.min() > PERSON_M
    assert np.hypot(*(track[-1, :2] - [7.0, 0.0])) < 0.5


def test_mppi_drives_round_where_somebody_has_walked() -> None:
    sides = []
    for walks in (False, True):
        bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
        walker = np.array([3.0, -0.9, PERSON_M])

        def readings(bodies: DrivenBodies = bodies, walker: np.ndarray = walker) -> dict[str, np.ndarray]:
            return bodies.readings(walker[None])

        mppi = Mppi(1)
        mppi.bind(DriverContext("rover", bodies.vehicle, LIDAR, readings))
        # Somebody walks from the right to the left, and goes away.
        for y in np.linspace(-0.9, 0.9, 40):
            walker[1] = y if walks else 100.0
            mppi.act(*bodies.state())
        walker[1] = 100.0
        for _ in range(400):
            bodies.move(mppi.act(*bodies.state()))
            if bodies.poses[0, 0] >= 3.0:
                break
        assert bodies.poses[0, 0] >= 3.0
        sides.append(abs(bodies.poses[0, 1]))
    assert sides[0] < 0.4 and sides[1] > 0.7


def test_mppi_leaves_a_dead_end_that_it_remembers() -> None:
    along = np.arange(-0.5, 2.6, 0.15)
    ends = np.arange(-1.3, 1.4, 0.15)
    pocket = np.concatenate(
        [
            np.column_stack([along, np.full(len(along), side), np.full(len(along), 0.1)])
            for side in (-1.3, 1.3)
        ]
        + [np.column_stack([np.full(len(ends), 2.5), ends, np.full(len(ends), 0.1)])]
    )
    bodies = DrivenBodies(yard(), [1.0, 0.0, 0.0], [5.0, 0.0], NOBODY)
    bodies.walkers = np.zeros((1, 0, 4))
    track, _ = drive_among(bodies, pocket, 1200)
    assert np.hypot(*(track[-1, :2] - [5.0, 0.0])) < 0.5
    assert track[:, 0].min() < -0.5
    apart = np.hypot(*np.moveaxis(track[:, None, :2] - pocket[:, :2], -1, 0)) - 0.1
    assert apart.min() > ROVER.width_m / 2


def test_mppi_turns_round_for_a_goal_behind_it() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, np.pi], [6.0, 0.0], NOBODY)
    bodies.walkers = np.zeros((1, 0, 4))
    start = bodies.poses[0].copy()
    track, _ = drive_among(bodies, np.zeros((0, 3)), 300)
    steps = np.diff(np.concatenate([start[None], track])[:, :2], axis=0)
    forward = (steps * np.stack([np.cos(track[:, 2]), np.sin(track[:, 2])], axis=1)).sum(axis=1)
    assert np.hypot(*(track[-1, :2] - [6.0, 0.0])) < 0.5
    assert -forward[forward < 0.0].sum() < 1.0
