"""The planner on bodies that obey exactly: round walls, past walkers, out of dead ends."""

from dataclasses import replace

import numpy as np
from drivers import ROVER, DrivenBodies, drive
from yards import yard

from dune_rl.behaviours.drivers.planner import Planner
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.world import World

NOBODY = np.zeros((0, 4))
WALL = (0.0, -2.0, 0.0, 0.4, 16.0)
PERSON_M = 0.25


def corners_of(track: np.ndarray) -> np.ndarray:
    """Corners (T, 4, 2) of the rover on a track (T, 3)."""
    cos, sin = np.cos(track[:, 2]), np.sin(track[:, 2])
    ahead = np.array([1, 1, -1, -1]) * ROVER.length_m / 2
    aside = np.array([1, -1, 1, -1]) * ROVER.width_m / 2
    x = track[:, :1] + cos[:, None] * ahead - sin[:, None] * aside
    y = track[:, 1:2] + sin[:, None] * ahead + cos[:, None] * aside
    return np.stack([x, y], axis=-1)


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


def test_planner_drives_through_a_gap_that_its_footprint_fits() -> None:
    # 0.8 m, with the robot 0.44 m wide and its circle 0.74 m; beside the wall the world ends.
    world = yard((0.0, -5.2, 0.0, 0.4, 9.6), (0.0, 5.2, 0.0, 0.4, 9.6))
    bodies = DrivenBodies(world, [-4.0, 2.0, 0.5], [4.0, -2.0], NOBODY)
    track = drive(Planner(1), bodies, 400)[:, 0]
    assert np.hypot(*(track[-1, :2] - [4.0, -2.0])) < 0.5
    assert np.abs(track[np.abs(track[:, 0]) < 0.2, 1]).max() < 0.45
    assert world.clearance(corners_of(track)).min() > 0.0
    # By the straight line, no farther than the turn to it costs.
    assert np.hypot(*np.diff(track[:, :2], axis=0).T).sum() < 10.0


def test_planner_leaves_a_dead_end() -> None:
    # A pocket, open to the left, between the start in it and the goal behind its end.
    pocket = yard((0.0, 1.5, 0.0, 4.0, 0.3), (0.0, -1.5, 0.0, 4.0, 0.3), (2.0, 0.0, 0.0, 0.3, 3.3))
    bodies = DrivenBodies(pocket, [1.2, 0.0, 0.0], [4.0, 0.0], NOBODY)
    track = drive(Planner(1), bodies, 600)[:, 0]
    assert np.hypot(*(track[-1, :2] - [4.0, 0.0])) < 0.5
    assert track[:, 0].min() < -2.0
    assert pocket.clearance(corners_of(track)).min() > 0.0


def test_planner_drives_round_a_slope_that_is_too_steep() -> None:
    places = np.arange(-10.0, 10.01, 0.5)
    ridge = np.tan(np.deg2rad(35.0)) * np.maximum(2.0 - np.abs(places), 0.0)
    heights = np.where(places[:, None] < 3.0, ridge, 0.0)
    world = World("ridge", HeightField(heights, 0.5, (-10.0, -10.0)), region=(-9, 9, -9, 9))
    bodies = DrivenBodies(world, [-4.9, -0.9, 0.0], [4.9, -0.9], NOBODY)
    track = drive(Planner(1), bodies, 600)[:, 0]
    assert np.hypot(*(track[-1, :2] - [4.9, -0.9])) < 0.5
    # It does not climb: at most the ridge's very end is under it.
    on_it = (np.abs(track[:, 0]) < 2.0) & (track[:, 1] < 3.0)
    assert track[on_it, 1].min(initial=3.0) > 2.5
    assert world.terrain.height(track[:, :2]).max() < 0.3 * ridge.max()


def test_planner_lets_a_walker_pass_who_comes_through_a_gap() -> None:
    world = yard((0.0, -5.3, 0.0, 0.4, 9.6), (0.0, 5.3, 0.0, 0.4, 9.6))
    bodies = DrivenBodies(world, [-2.5, 0.0, 0.0], [4.0, 0.0], [[3.0, 0.0, -0.8, 0.0]])
    planner = Planner(1)
    planner.bind(bodies.context())
    for _ in range(400):
        bodies.move(planner.act(*bodies.state()))
        assert bodies.distances().min() > PERSON_M
    assert np.hypot(*(bodies.poses[0, :2] - [4.0, 0.0])) < 0.5


def test_planner_goes_round_what_its_map_does_not_have() -> None:
    class Blocked(DrivenBodies):
        """Something at (2, 0), of 0.5 m radius, stops the body."""

        def move(self, actions: np.ndarray) -> None:
            before = self.poses.copy()
            super().move(actions)
            if np.hypot(*(self.poses[0, :2] - [2.0, 0.0])) < 0.5 + ROVER.length_m / 2:
                self.poses[0, :2] = before[0, :2]
                self.twists[0, 0] = 0.0

    bodies = Blocked(yard(), [0.0, 0.0, 0.0], [5.0, 0.0], NOBODY)
    track = drive(Planner(1), bodies, 800)[:, 0]
    assert np.hypot(*(track[-1, :2] - [5.0, 0.0])) < 0.5
    assert np.abs(track[:, 1]).max() > 0.5


def test_planner_gets_off_an_obstacle_that_it_touches() -> None:
    # Beside a wall, nearer than its discs, along it.
    world = yard((0.0, 0.4, 0.0, 6.0, 0.3))
    bodies = DrivenBodies(world, [0.0, 0.0, 0.0], [6.0, 2.0], NOBODY)
    assert world.clearance(bodies.poses[:, :2])[0] < 0.25
    track = drive(Planner(1), bodies, 400)[:, 0]
    assert np.hypot(*(track[-1, :2] - [6.0, 2.0])) < 0.5
    assert world.clearance(track[:, :2]).min() > 0.15
