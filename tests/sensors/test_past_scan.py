"""The scan of a moment ago, carried into the present frame."""

import numpy as np
import pytest
from poses import seen_at
from scanning import flat_with, lidar_in, turned
from sensors_of_rover_zero import lidar_conf

from dune_rl.bodies.person import PersonConf
from dune_rl.sensors.lidar import Lidar
from dune_rl.sensors.past_scan import PastScan

CONF = lidar_conf()
STANDING = np.array([0.0, 0.0, 0.125])
NOBODY = np.zeros((1, 0, 7))
ALL = np.array([True])
# Walls on three sides, at 4, 3 and 5 m.
WALLS = [(4.0, 0.0, 0.0, 0.2, 12.0), (0.0, 3.0, 0.0, 12.0, 0.2), (0.0, -5.0, 0.0, 12.0, 0.2)]


def sensed(lidar: Lidar, position: np.ndarray, rotation: np.ndarray, actors: np.ndarray = NOBODY):
    """Segments, end points, and origin of a scan."""
    ranges = lidar.ranges(position[None], rotation[None], actors)
    origin = lidar.origin(position[None], rotation[None])
    return lidar.segments(ranges)[0], ends_of(lidar, origin, rotation[None], ranges), origin


def ends_of(lidar: Lidar, origin: np.ndarray, rotation: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    ends = np.empty((*ranges.shape, 3), np.float32)
    lidar.store_ends(origin, rotation, ranges, ends)
    return ends


def test_end_points_lie_on_what_was_hit():
    lidar = lidar_in(flat_with(*WALLS))
    _, ends, _ = sensed(lidar, STANDING, turned(0.4))
    # The beams are 0.049 rad apart, the first at -pi; these three point along x, y and -y.
    ahead = ends[0, [round((bearing - 0.4 + np.pi) / (2 * np.pi / 128)) for bearing in (0.0, 1.57, -1.57)]]
    assert ahead[0, 0] == pytest.approx(3.9, abs=1e-3)
    assert ahead[1, 1] == pytest.approx(2.9, abs=1e-3)
    assert ahead[2, 1] == pytest.approx(-4.9, abs=1e-3)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -3.0])
def test_from_the_same_place_the_past_scan_is_the_present_one(yaw):
    lidar = lidar_in(flat_with(*WALLS))
    now, ends, origin = sensed(lidar, STANDING, turned(yaw))
    past = PastScan(CONF, 1, 3)
    past.restart(ALL, ends)
    np.testing.assert_allclose(past.seen_from(origin, turned(yaw)[None])[0], now, atol=1e-4)


def test_a_turn_and_a_drive_leave_walls_where_they_are():
    lidar = lidar_in(flat_with(*WALLS))
    past = PastScan(CONF, 1, 1)
    past.restart(ALL, sensed(lidar, STANDING, turned(0.3))[1])
    later, rotation = STANDING + np.array([0.3, 0.2, 0.0]), turned(-0.6)
    now, ends, origin = sensed(lidar, later, rotation)
    past.advance()[:] = ends
    carried = past.seen_from(origin, rotation[None])[0]
    # A beam at a wall's end may fall into the next segment; elsewhere half a beam's slant is left.
    assert (np.abs(carried - now) < 0.25).mean() > 0.85
    # As it was, the scan would differ by a wall's distance in many directions.
    before = sensed(lidar, STANDING, turned(0.3))[0]
    assert (np.abs(before - now) < 0.25).mean() < 0.6


def test_what_moved_is_where_it_was():
    walker = PersonConf(radius_m=0.3)
    lidar = lidar_in(flat_with(), (walker,))
    past = PastScan(CONF, 1, 1)
    past.restart(ALL, sensed(lidar, STANDING, np.eye(3), seen_at([[[3.0, 0.0, 0.0, 0.0]]]))[1])
    now, ends, origin = sensed(lidar, STANDING, np.eye(3), seen_at([[[3.0, 2.0, 0.0, 0.0]]]))
    past.advance()[:] = ends
    carried = past.seen_from(origin, np.eye(3)[None])[0]
    # Segment 16 begins straight ahead, and 2 m aside at 3 m is 0.59 rad: three segments on.
    assert carried[15:17].min() == pytest.approx(3.0 - 0.3 - CONF.mount_b[0], abs=0.02)
    assert now[15:17].min() == 12.0
    assert now[18:20].min() < 3.5
    assert carried[18:20].min() == 12.0


def test_it_is_as_old_as_asked_for_and_no_older_than_its_episode():
    lidar = lidar_in(flat_with(), (PersonConf(),))
    two = PastScan(CONF, 2, 3)
    rotation = np.stack([np.eye(3)] * 2)
    position = np.stack([STANDING] * 2)

    def look(step: int) -> tuple[np.ndarray, np.ndarray]:
        walkers = seen_at([[[2.0 + step, 0.0, 0.0, 0.0]]] * 2)
        origin = lidar.origin(position, rotation)
        return ends_of(lidar, origin, rotation, lidar.ranges(position, rotation, walkers)), origin

    two.restart(np.array([True, True]), look(0)[0])
    nearest = []
    for step in range(1, 7):
        ends, origin = look(step)
        two.advance()[:] = ends
        if step == 4:
            two.restart(np.array([False, True]), ends)
        nearest.append(two.seen_from(origin, rotation).min(axis=1))
    steps = np.round(np.array(nearest) - nearest[0][0])
    np.testing.assert_array_equal(steps[:, 0], [0, 0, 0, 1, 2, 3])
    np.testing.assert_array_equal(steps[:, 1], [0, 0, 0, 4, 4, 4])


def test_half_a_circle_does_not_wrap_round():
    conf = lidar_conf(n_beams=64, n_segments=16, fov_deg=180.0)
    lidar = lidar_in(flat_with(*WALLS), conf=conf)
    past = PastScan(conf, 1, 1)
    past.restart(ALL, sensed(lidar, STANDING, turned(0.0))[1])
    # After a right angle to the right, what was ahead lies to the left, and what was on the left nowhere.
    origin = lidar.origin(STANDING[None], turned(-np.pi / 2)[None])
    carried = past.seen_from(origin, turned(-np.pi / 2)[None])[0]
    assert (carried[:7] == 12.0).all()
    assert (carried[9:] < 12.0).all()
