"""The reference drivers on bodies that obey exactly: round walls, past walkers, the same for any scenes."""

from dataclasses import replace

import numpy as np
import pytest
from drivers import ROVER, DrivenBodies
from yards import yard

from dune_rl.behaviours.drivers.mppi import Mppi
from dune_rl.behaviours.drivers.planner import Planner
from dune_rl.errors import ConfigError

NOBODY = np.zeros((0, 4))
WALL = (0.0, -2.0, 0.0, 0.4, 16.0)
PERSON_M = 0.25
# A post in the middle of the way.
POST = np.array([[2.5, 0.05, 0.4]])


def drive(driver, bodies: DrivenBodies, steps: int, discs: np.ndarray | None = None) -> np.ndarray:
    """Poses (steps + 1, N, 3) under a driver until all have arrived."""
    driver.bind(bodies.context(discs))
    _, group = bodies.state()
    driver.reset(np.ones(len(bodies.poses), bool), group)
    poses = [bodies.poses.copy()]
    for _ in range(steps):
        bodies.move(driver.act(*bodies.state()))
        poses.append(bodies.poses.copy())
        if (np.hypot(*(bodies.goals - bodies.poses[:, :2]).T) < 0.5).all():
            break
    return np.array(poses)


def test_planner_drives_round_a_wall_and_touches_nothing() -> None:
    world = yard(WALL)
    bodies = DrivenBodies(world, [-4.0, 0.0, np.pi], [4.0, 0.0], NOBODY)
    track = drive(Planner(1), bodies, 600)[:, 0]
    assert np.hypot(*(track[-1, :2] - [4.0, 0.0])) < 0.5
    assert world.clearance(track[:, :2]).min() > ROVER.width_m / 2
    # The shortest way is 14.6 m long (the thread round the wall's end); turning and room cost some more.
    length = np.hypot(*np.diff(track[:, :2], axis=0).T).sum()
    assert 14.0 < length < 18.0
    # At 1 m/s: it neither dawdles nor stops.
    assert len(track) * 0.05 < 22.0


def test_planner_avoids_a_walker_who_crosses_its_way() -> None:
    # Both would be at (3, 0) after 3 s.
    walker = [[3.0, -3.0, 0.0, 1.0]]
    straight = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], walker)
    avoiding = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], walker)
    apart = []
    for _ in range(100):
        straight.move(np.array([[1.0, 0.0]]))
        apart.append(straight.distances().min())
    assert min(apart) < PERSON_M
    planner = Planner(1)
    planner.bind(avoiding.context())
    apart = []
    for _ in range(240):
        avoiding.move(planner.act(*avoiding.state()))
        apart.append(avoiding.distances().min())
    assert min(apart) > PERSON_M
    assert np.hypot(*(avoiding.poses[0, :2] - [6.0, 0.0])) < 0.5


def test_planner_backs_out_of_the_way_of_a_walker_who_comes_at_it_in_a_corridor() -> None:
    world = yard((0.0, 1.0, 0.0, 16.0, 0.2), (0.0, -1.0, 0.0, 16.0, 0.2))
    bodies = DrivenBodies(world, [0.0, 0.0, 0.0], [6.0, 0.0], [[4.0, 0.0, -0.5, 0.0]])
    planner = Planner(1, actor_radius_m=0.6)
    planner.bind(bodies.context())
    for _ in range(200):
        bodies.move(planner.act(*bodies.state()))
        assert bodies.distances().min() > PERSON_M
    # The walker is at x = -1 by now.
    assert bodies.poses[0, 0] < -1.0 - PERSON_M - ROVER.length_m / 2


def test_planner_follows_a_goal_that_changes() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    planner = Planner(1)
    drive(planner, bodies, 20)
    bodies.goals = np.array([[0.0, 6.0]])
    for _ in range(250):
        bodies.move(planner.act(*bodies.state()))
    assert np.hypot(*(bodies.poses[0, :2] - [0.0, 6.0])) < 0.5


def test_planner_keeps_to_its_speed_and_to_its_smallest_circle() -> None:
    car = replace(ROVER, turning_radius_m=1.5)
    bodies = DrivenBodies(yard(), [0.0, 0.0, np.pi / 2], [6.0, 0.0], NOBODY, car)
    planner = Planner(1, speed_mps=0.5)
    planner.bind(bodies.context())
    for _ in range(320):
        bodies.move(planner.act(*bodies.state()))
        speed, turn = bodies.twists[0]
        assert abs(speed) <= 0.5 + 1e-9 and abs(turn) <= abs(speed) / 1.5 + 1e-9
    assert np.hypot(*(bodies.poses[0, :2] - [6.0, 0.0])) < 0.5


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


@pytest.mark.parametrize("driver", [Planner, Mppi])
def test_a_reset_begins_anew(driver) -> None:
    tracks = []
    used = driver(1)
    for other in (used, used, driver(1)):
        bodies = DrivenBodies(yard(WALL), [-4.0, 0.0, 0.0], [4.0, 0.0], [[-2.0, 1.0, 0.2, -0.1]])
        tracks.append(drive(other, bodies, 30, POST))
    np.testing.assert_array_equal(tracks[0], tracks[1])
    np.testing.assert_array_equal(tracks[0], tracks[2])


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


@pytest.mark.parametrize("driver", [Planner, Mppi])
def test_an_unbound_driver_says_so(driver) -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [6.0, 0.0], NOBODY)
    with pytest.raises(ConfigError, match="must be bound to the group"):
        driver(1).act(*bodies.state())


def test_planner_turns_round_rather_than_drive_backwards() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, np.pi], [6.0, 0.0], NOBODY)
    planner = Planner(1)
    planner.bind(bodies.context())
    backwards = 0
    for _ in range(200):
        bodies.move(planner.act(*bodies.state()))
        backwards += bodies.twists[0, 0] < -0.05
        assert bodies.twists[0, 0] >= -0.4 - 1e-9
    assert backwards < 40
    assert np.hypot(*(bodies.poses[0, :2] - [6.0, 0.0])) < 0.5
