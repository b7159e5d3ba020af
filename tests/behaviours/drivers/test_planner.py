"""The planner on bodies that obey exactly: round walls, past walkers, out of dead ends."""

from dataclasses import replace

import numpy as np
from drivers import ROVER, DrivenBodies, drive
from yards import yard

from dune_rl.behaviours.drivers.planner import Planner

NOBODY = np.zeros((0, 4))
WALL = (0.0, -2.0, 0.0, 0.4, 16.0)
PERSON_M = 0.25


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


def test_planner_turns_round_rather_than_drive_backwards() -> None:
    bodies = DrivenBodies(yard(), [0.0, 0.0, np.pi], [6.0, 0.0], NOBODY)
    planner = Planner(1)
    planner.bind(bodies.context())
    backwards = 0
    for _ in range(200):
        bodies.move(planner.act(*bodies.state()))
        backwards += bodies.twists[0, 0] < -0.05
    assert backwards < 40
    assert np.hypot(*(bodies.poses[0, :2] - [6.0, 0.0])) < 0.5
