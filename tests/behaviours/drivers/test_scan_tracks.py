"""Tracks of discs that a LiDAR sees, beside where they truly are."""

import numpy as np
import pytest
from drivers import LIDAR, DrivenBodies
from yards import yard

from dune_rl.sensors.lidar import LidarConf, beam_angles
from dune_rl.sensors.perception.scan_clusters import compare_with_past, find_clusters
from dune_rl.sensors.perception.scan_tracks import ScanTracker

STEP_S = 0.05
BEARINGS = beam_angles(LIDAR).reshape(LIDAR.n_segments, -1).mean(axis=1)
MOUNT = np.zeros(2)
NO_GOAL = np.full((1, 2), np.nan)


def track(bodies: DrivenBodies, discs: np.ndarray, velocity: np.ndarray, action: np.ndarray, steps: int):
    """The tracker after `steps`, in which `discs` (D, 3) move with `velocity` (D, 2); and the discs."""
    tracker = ScanTracker(1, BEARINGS, MOUNT)
    for _ in range(steps):
        readings = bodies.readings(discs)
        ranges = readings["lidar"].astype(float)
        twists = readings["velocity"].astype(float)
        sees = ranges < LIDAR.range_m - 1e-3
        tracker.update(ranges, sees, twists, NO_GOAL, STEP_S)
        last = discs
        bodies.move(action)
        discs = discs + np.column_stack([velocity * STEP_S, np.zeros(len(discs))])
    return tracker, last


def test_a_walker_has_its_place_and_velocity() -> None:
    walker = np.array([[3.0, -1.5, 0.25]])
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [8.0, 0.0], np.zeros((0, 4)))
    tracker, discs = track(bodies, walker, np.array([[0.0, 1.0]]), np.zeros((1, 2)), 50)
    assert tracker.moving_counts[0] == 1
    x, y, vx, vy = tracker.moving[0, 0]
    assert np.hypot(x - discs[0, 0], y - discs[0, 1]) < 0.3
    assert np.hypot(vx, vy - 1.0) < 0.35
    # The segments that see it have its velocity, the others none.
    moves = tracker.velocities[0].any(axis=1)
    assert moves.any() and np.abs(np.rad2deg(BEARINGS[moves])).max() < 40.0


def test_a_walker_is_seen_from_a_moving_body_too() -> None:
    walker = np.array([[5.0, -1.0, 0.25]])
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [8.0, 0.0], np.zeros((0, 4)))
    start = bodies.poses.copy()
    tracker, _ = track(bodies, walker, np.array([[0.0, 0.8]]), np.array([[0.8, 0.0]]), 40)
    _, _, vx, vy = tracker.moving[0, 0]
    assert tracker.moving_counts[0] == 1 and np.hypot(vx, vy - 0.8) < 0.35
    assert bodies.poses[0, 0] > start[0, 0] + 1.5


def test_posts_do_not_move_however_the_body_turns() -> None:
    posts = np.array([[2.5, 0.5, 0.2], [-1.5, 2.0, 0.1], [0.0, -3.0, 0.3]])
    bodies = DrivenBodies(yard(), [0.0, 0.0, 0.0], [8.0, 0.0], np.zeros((0, 4)))
    wrong = 0
    tracker = ScanTracker(1, BEARINGS, MOUNT)
    for step in range(200):
        readings = bodies.readings(posts)
        ranges, twists = readings["lidar"].astype(float), readings["velocity"].astype(float)
        sees = ranges < LIDAR.range_m - 1e-3
        tracker.update(ranges, sees, twists, NO_GOAL, STEP_S)
        wrong += int(tracker.moving_counts[0])
        bodies.move(np.array([[0.2, 0.5 * np.sin(0.05 * step)]]))
    # Segments are wide: a jump between two of them may pass for motion for a moment.
    assert wrong < 30


def test_a_slip_that_no_speed_reading_shows_is_known_by_the_goal() -> None:
    """A body slips to its left at 0.1 m/s, then its goal is another one."""
    nothing, still = np.full((1, len(BEARINGS)), LIDAR.range_m), np.zeros((1, 2))
    with_goal, without = (ScanTracker(1, BEARINGS, MOUNT) for _ in range(2))
    for step in range(200):
        left = 0.1 * step * STEP_S
        goal = np.array([[5.0, -2.0 - left]]) if step < 150 else np.array([[-3.0, 4.0 - left]])
        with_goal.update(nothing, nothing < 1.0, still, goal, STEP_S)
        without.update(nothing, nothing < 1.0, still, NO_GOAL, STEP_S)
    assert with_goal.poses[0, :2] == pytest.approx([0.0, left], abs=0.12)
    assert without.poses[0, :2] == pytest.approx([0.0, 0.0], abs=1e-9)


FINE = np.arange(128) * (2 * np.pi / 128) - np.pi
RANGE_M = 12.0


def scan_of_disc_before_wall(disc: np.ndarray, wall_x: float) -> np.ndarray:
    """Ranges (1, 128) [m] from the origin: a disc (x, y, radius) before a wall across the x axis."""
    ahead = np.cos(FINE)
    wall = np.where(ahead > 1e-6, wall_x / np.maximum(ahead, 1e-6), RANGE_M)
    along = disc[0] * np.cos(FINE) + disc[1] * np.sin(FINE)
    half = disc[2] ** 2 - (disc[0] ** 2 + disc[1] ** 2 - along**2)
    hits = np.where((half > 0) & (along > 0), along - np.sqrt(np.maximum(half, 0.0)), RANGE_M)
    return np.minimum(np.minimum(wall, hits), RANGE_M)[None]


@pytest.mark.parametrize("wall_x", [11.0, 3.4])
def test_a_person_is_tracked_to_some_centimetres_also_right_before_a_wall(wall_x: float) -> None:
    tracker = ScanTracker(1, FINE, MOUNT)
    person, still = np.array([3.0, -1.5, 0.25]), np.zeros((1, 2))
    for _ in range(50):
        ranges = scan_of_disc_before_wall(person, wall_x)
        tracker.update(ranges, ranges < RANGE_M - 1e-3, still, NO_GOAL, STEP_S)
        seen = person.copy()
        person[1] += STEP_S
    assert tracker.moving_counts[0] == 1
    x, y, vx, vy = tracker.moving[0, 0]
    assert np.hypot(x - seen[0], y - seen[1]) < 0.1
    assert np.hypot(vx, vy - 1.0) < 0.2


def test_a_person_who_stops_rests_after_a_second() -> None:
    tracker = ScanTracker(1, FINE, MOUNT)
    person, still = np.array([3.0, -1.0, 0.25]), np.zeros((1, 2))
    moved = []
    for step in range(70):
        ranges = scan_of_disc_before_wall(person, 11.0)
        tracker.update(ranges, ranges < RANGE_M - 1e-3, still, NO_GOAL, STEP_S)
        moved.append(int(tracker.moving_counts[0]))
        person[1] += STEP_S if step < 30 else 0.0
    assert moved[25] == 1 and moved[-1] == 0


@pytest.mark.parametrize("fov_deg", [90.0, 180.0, 270.0, 360.0])
@pytest.mark.parametrize("turn_radps", [0.0, 1.0])
def test_what_rests_is_known_to_in_every_field_of_view(fov_deg: float, turn_radps: float) -> None:
    """Walls all round, seen from a body that stands or turns, with its LiDAR before its middle."""
    bearings, mount = beam_angles(LidarConf(n_beams=128, fov_deg=fov_deg)), np.array([0.2, 0.0])
    rays = bearings[0], 1.0 / (bearings[1] - bearings[0])

    def scan(yaw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pose = np.array([0.2 * np.cos(yaw), 0.2 * np.sin(yaw), yaw])
        ahead = np.stack([np.cos(bearings + yaw), np.sin(bearings + yaw)], -1)
        # A square of 8 by 8 m.
        reach = np.where(ahead > 0, 4.0 - pose[:2], 4.0 + pose[:2]) / np.maximum(np.abs(ahead), 1e-9)
        ranges = reach.min(axis=1)
        return ranges, pose[:2] + ranges[:, None] * ahead, pose

    now, places, _ = scan(0.0)
    pasts = [scan(-turn_radps * lag) for lag in (0.6, 1.0)]
    found = np.empty(len(bearings), np.int64)
    sees = np.ones(len(bearings), bool)
    scans, poses = np.stack([past[0] for past in pasts]), np.stack([past[2] for past in pasts])
    compare_with_past(places, sees, scans, poses, *rays, found)
    # Nothing was where the walls are; what came into view since then is not known.
    assert not (found == 1).any()
    share = 1.0 if fov_deg == 360.0 else 1.0 - np.rad2deg(turn_radps) / fov_deg
    assert np.mean(found == 2) > share - 0.05
    members = np.empty(len(bearings), np.int64)
    objects = np.empty((len(bearings), 3))
    assert find_clusters(now, places, sees, found, mount, rays[1], objects, members) <= 1


@pytest.mark.parametrize("n_beams", [512, 1024])
def test_what_rests_is_known_by_fine_scans_too(n_beams: int) -> None:
    """Walls of a room of 10 m, where the yaw of the odometry is off by 0.07 rad, which is many rays."""
    bearings = beam_angles(LidarConf(n_beams=n_beams))
    ahead = np.stack([np.cos(bearings), np.sin(bearings)], -1)
    ranges = 5.0 / np.abs(ahead).max(axis=1)
    found = np.empty(n_beams, np.int64)
    rays = bearings[0], 1.0 / (bearings[1] - bearings[0])
    past = np.array([[0.0, 0.0, 0.07]])
    compare_with_past(ranges[:, None] * ahead, np.ones(n_beams, bool), ranges[None], past, *rays, found)
    assert (found == 2).mean() > 0.95
    assert not (found == 1).any()
