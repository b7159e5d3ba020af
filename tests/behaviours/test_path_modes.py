"""Paths that are closed, walked once, or with pauses."""

import numpy as np
import pytest
from pydantic import ValidationError
from yards import points_anywhere, yard

from dune_rl.behaviours.paths.follower import PathConf, PathFollower
from dune_rl.behaviours.paths.splines import SPACING_M, spline_loop, spline_path, way_point_stations
from dune_rl.geometry.shared_per_scene import SharedPerScene

SQUARE = ((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0))
STEP_S = 0.05
SPEED = 1.0


def walked(conf: PathConf, duration_s: float, scenes: int = 3) -> np.ndarray:
    """Poses (T, M, 4) of one walker in each scene, with those at the start."""
    world = yard()
    follower = PathFollower(conf, 1, 0.25, SharedPerScene([world] * scenes), speed_mps=SPEED)
    follower.find_paths(world, points_anywhere, np.random.default_rng(0))
    poses = [
        np.concatenate(
            [
                follower.reset(scene, np.random.default_rng(scene), np.array([[50.0, 50.0]]))
                for scene in range(scenes)
            ]
        )
    ]
    poses += [follower.advance(SPEED * STEP_S) for _ in range(round(duration_s / STEP_S))]
    return np.array(poses)


def speeds(poses: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(poses[..., :2], axis=0), axis=-1) / STEP_S


def test_way_points_are_at_their_stations() -> None:
    terrain, points = yard().terrain, np.array(SQUARE)
    for closed, path in ((False, spline_path(points, terrain)), (True, spline_loop(points, terrain))):
        at = way_point_stations(points, closed=closed)
        np.testing.assert_allclose(path[at, :2], points, atol=SPACING_M)
        assert (np.diff(at) > 0).all()


def test_a_loop_goes_round_and_round_in_one_direction() -> None:
    poses = walked(PathConf(waypoints=SQUARE, mode="loop"), 60.0)
    np.testing.assert_allclose(speeds(poses), SPEED, rtol=0.02)
    turned = np.unwrap(np.arctan2(poses[..., 1], poses[..., 0]), axis=0)
    assert (np.diff(turned, axis=0) > 0.0).all() and (turned[-1] - turned[0] > 2 * np.pi).all()
    steps = np.diff(poses[..., :2], axis=0)
    course = np.arctan2(steps[..., 1], steps[..., 0])
    assert np.abs(np.angle(np.exp(1j * (course - poses[:-1, :, 3])))).max() < 0.1


@pytest.mark.slow
def test_a_day_of_steps_on_a_closed_path_ends_where_a_round_does() -> None:
    # A step is as long as the spacing of the path, so that whole rounds are whole numbers of steps.
    assert SPEED * STEP_S == SPACING_M
    world, conf = yard(), PathConf(waypoints=SQUARE, mode="loop")
    round_steps, day_steps = len(spline_loop(np.array(SQUARE), world.terrain)), round(24 * 3600 / STEP_S)
    follower = PathFollower(conf, 1, 0.25, SharedPerScene([world]), speed_mps=SPEED)
    follower.find_paths(world, points_anywhere, np.random.default_rng(0))
    follower.reset(0, np.random.default_rng(0), np.array([[50.0, 50.0]]))
    for step in range(1, day_steps + 1):
        pose = follower.advance(STEP_S)
        if step == day_steps % round_steps:
            expected = pose.copy()
    # Each of the additions rounds by half the spacing of floats at 86,400 m, at most.
    rounding_m = day_steps * np.spacing(24 * 3600 * SPEED) / 2
    assert rounding_m < 2e-5
    np.testing.assert_allclose(pose[:, :3], expected[:, :3], rtol=0.0, atol=rounding_m)


def test_a_path_once_begins_at_its_beginning_and_ends_at_its_end() -> None:
    poses = walked(PathConf(waypoints=SQUARE, mode="once"), 60.0)
    np.testing.assert_allclose(poses[0, :, :2], [SQUARE[0]] * 3, atol=1e-9)
    np.testing.assert_allclose(poses[-1, :, :2], [SQUARE[-1]] * 3, atol=SPACING_M)
    found = speeds(poses)
    assert (np.abs(found - SPEED) < 0.02).sum() > 3 * 400 and (found[-20:] < 1e-9).all()


@pytest.mark.parametrize("mode", ["once", "loop", "back_and_forth"])
def test_pauses_are_at_the_way_points_for_as_long_as_set(mode: str) -> None:
    poses = walked(PathConf(waypoints=SQUARE, mode=mode, pauses_s=1.5), 50.0, scenes=1)[:, 0]
    stands = speeds(poses) < 1e-9
    if mode == "once":
        stands[np.flatnonzero(~stands)[-1] + 1 :] = False
    starts = np.flatnonzero(np.diff(stands.astype(int)) == 1) + 1
    ends = np.flatnonzero(np.diff(stands.astype(int)) == -1) + 1
    lengths = [int(ends[ends > start].min()) - int(start) for start in starts if (ends > start).any()]
    assert len(lengths) >= 2
    np.testing.assert_allclose(np.array(lengths) * STEP_S, 1.5, atol=1.01 * STEP_S)
    apart = np.linalg.norm(poses[starts][:, None, :2] - np.array(SQUARE), axis=-1).min(axis=1)
    assert apart.max() < 2 * SPACING_M


def test_a_loop_needs_way_points() -> None:
    with pytest.raises(ValidationError, match="mode=loop needs three waypoints or more"):
        PathConf(mode="loop")
    with pytest.raises(ValidationError, match="leave the last out"):
        PathConf(mode="loop", waypoints=(*SQUARE, SQUARE[0]))
