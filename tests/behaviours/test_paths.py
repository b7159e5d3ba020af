"""Smooth paths over the terrain, through way points and at random."""

import numpy as np
import pytest
from yards import BEND, BOXES, hills, points_anywhere, yard

from dune_rl.behaviours.paths.splines import random_paths, spline_path, there_and_back
from dune_rl.core.errors import WorldError
from dune_rl.geometry.frames import wrap_angle


def distance_to_boxes(xy: np.ndarray) -> np.ndarray:
    """By formula, not by the world's grid."""
    nearest = np.full(len(xy), np.inf)
    for x, y, yaw, length, width in BOXES:
        cos, sin = np.cos(yaw), np.sin(yaw)
        offset = (xy - [x, y]) @ np.array([[cos, -sin], [sin, cos]])
        outside = np.maximum(np.abs(offset) - [length / 2, width / 2], 0.0)
        nearest = np.minimum(nearest, np.hypot(*outside.T))
    return nearest


def test_a_path_has_a_pose_every_five_centimetres():
    path = spline_path(BEND, hills())
    spacing = np.hypot(*np.diff(path[:, :2], axis=0).T)
    np.testing.assert_allclose(spacing, 0.05, atol=1e-4)
    assert 0.05 * len(path) > np.hypot(*np.diff(BEND, axis=0).T).sum()


def test_a_path_goes_through_its_way_points():
    path = spline_path(BEND, hills())
    np.testing.assert_allclose(path[0, :2], BEND[0])
    for point in BEND:
        assert np.hypot(*(path[:, :2] - point).T).min() <= 0.05


def test_a_path_is_smooth():
    yaw = np.unwrap(spline_path(BEND, hills())[:, 3])
    assert np.abs(np.diff(yaw)).max() < 0.1
    assert np.ptp(yaw) > 1.0


def test_a_path_keeps_to_the_ground():
    terrain = hills()
    path = spline_path(BEND, terrain)
    np.testing.assert_allclose(path[:, 2], terrain.height(path[:, :2]), atol=1e-12)
    assert np.ptp(path[:, 2]) > 0.2


def test_a_path_faces_its_next_pose_and_repeats_the_last_heading():
    path = spline_path(BEND, hills())
    dx, dy = np.diff(path[:, :2], axis=0).T
    np.testing.assert_allclose(path[:-1, 3], np.arctan2(dy, dx), atol=1e-12)
    assert path[-1, 3] == path[-2, 3]


def test_two_way_points_are_joined_by_a_line():
    path = spline_path(np.array([[0.0, 0.0], [3.0, 4.0]]), hills())
    np.testing.assert_allclose(path[:, 1] * 3, path[:, 0] * 4, atol=1e-9)
    np.testing.assert_allclose(path[:, 3], np.arctan2(4, 3), atol=1e-6)
    assert 99 <= len(path) <= 101


def test_there_and_back_returns_on_its_own_steps_facing_where_it_goes():
    path = spline_path(BEND, hills())
    loop = there_and_back(path)
    assert len(loop) == 2 * len(path) - 2
    np.testing.assert_array_equal(loop[: len(path) - 1], path[:-1])
    np.testing.assert_array_equal(loop[len(path) - 1 :, :3], path[:0:-1, :3])
    after = np.roll(loop, -1, axis=0)
    dx, dy = (after - loop)[:, :2].T
    np.testing.assert_allclose(wrap_angle(loop[:, 3] - np.arctan2(dy, dx)), 0.0, atol=1e-9)


def test_random_paths_keep_clear_of_obstacles():
    world = yard(*BOXES)
    paths = random_paths(world, points_anywhere, np.random.default_rng(3), 30, 0.5, (6.0, 12.0))
    assert len(paths) == 30
    for path in paths:
        # The world's own clearance is a grid's, good to some centimetres.
        assert distance_to_boxes(path[:, :2]).min() > 0.5 - 0.08
        assert 6.0 < 0.05 * len(path) < 12.0 * 1.3
    without = random_paths(yard(), points_anywhere, np.random.default_rng(3), 30, 0.5, (6.0, 12.0))
    assert min(distance_to_boxes(path[:, :2]).min() for path in without) == 0.0


@pytest.mark.parametrize(("fits_in", "draws"), [(5, 200), (200, 200), (1_001, 1_001)])
def test_random_paths_are_drawn_on_until_the_first_fits(fits_in, draws):
    made = []

    def sample(rng, n, radius_m):
        made.append(n)
        # One way in one draw; else a single point, from which no path leads.
        points = np.zeros((n // 3, 3, 2))
        if len(made) == fits_in:
            points[0] = [(-3.0, 0.0), (0.0, 0.5), (4.0, 0.0)]
        return points.reshape(-1, 2)

    paths = random_paths(yard(), sample, np.random.default_rng(3), 5, 0.5, (6.0, 12.0))
    assert (len(made), len(paths)) == (draws, 1)


def test_random_paths_are_refused_after_many_draws_without_any():
    made = []

    def sample(rng, n, radius_m):
        made.append(n)
        return np.zeros((n, 2))

    with pytest.raises(WorldError, match="no path of 6 to 12 m"):
        random_paths(yard(), sample, np.random.default_rng(3), 5, 0.5, (6.0, 12.0))
    assert len(made) == 2_000


def test_random_paths_depend_on_the_generator_alone():
    world = yard(*BOXES)
    first, again, other = (
        random_paths(world, points_anywhere, np.random.default_rng(seed), 5, 0.5, (6.0, 12.0))
        for seed in (3, 3, 4)
    )
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])


def test_no_room_for_a_path_is_an_error_that_says_what_to_change():
    with pytest.raises(
        WorldError, match=r"no path of 100 to 200 m .* take actors=none, shorten actors\.walker\.path"
    ):
        random_paths(yard(), points_anywhere, np.random.default_rng(0), 5, 0.5, (100.0, 200.0))
