"""Shots of a film: they cover it, and the robot is in sight in each of them."""

from itertools import pairwise

import numpy as np
import pytest
from plain_worlds import box, plain

from dune_rl.rendering.light import LightConf
from dune_rl.rendering.renderer import Viewpoint
from dune_rl.reporting.views.shots import plan_shots
from dune_rl.worlds.appearance import bake_world

NOWHERE = Viewpoint((0.0, 0.0, 50.0), (0.0, 0.1, 0.0))
STRAIGHT = np.column_stack([np.linspace(-6.0, 6.0, 200), np.zeros(200), np.full(200, 0.2)])
STILL = np.tile([1.0, 1.0, 0.2], (200, 1))


def nobody(track: np.ndarray) -> np.ndarray:
    return np.zeros((len(track), 0, 2))


@pytest.mark.parametrize("track", [STRAIGHT, STILL, STRAIGHT[:1]])
@pytest.mark.parametrize("props", [[], [box(0.0, -1.5, 8.0, 0.3, 2.0), box(0.0, 1.5, 8.0, 0.3, 2.0)]])
def test_shots_follow_one_another_with_the_robot_in_sight(track, props):
    baked = bake_world(plain(*props), LightConf())
    shots = plan_shots(track, nobody(track), 10.0, baked, 1.2, lambda number: NOWHERE)
    assert shots[0].first == 0 and shots[-1].end == len(track)
    assert all(one.end == other.first for one, other in pairwise(shots))
    assert all(shot.view is not NOWHERE for shot in shots)
    assert len(shots) <= 1 + len(track) // 20
    for shot in shots:
        points = track[shot.first : shot.end] + np.array([0.0, 0.0, 0.15])
        eye = np.asarray(shot.view.eye)
        column, row, depth = shot.view.project(points, 120, 100)
        assert (depth > 1.0).all()
        assert ((column > 0) & (column < 120) & (row > 0) & (row < 100)).all()
        ways = points - eye
        lengths = np.linalg.norm(ways, axis=1)
        free, _ = baked.rays.first_hit(np.tile(eye, (len(ways), 1)), ways / lengths[:, None], 99.0)
        assert (free > lengths - 0.1).all()


def test_a_robot_in_a_shaft_is_seen_from_behind():
    walls = [
        box(*place, *size, 9.0)
        for place, size in (
            ((0.8, 0.0), (0.1, 1.8)),
            ((-0.8, 0.0), (0.1, 1.8)),
            ((0.0, 0.8), (1.8, 0.1)),
            ((0.0, -0.8), (1.8, 0.1)),
        )
    ]
    baked = bake_world(plain(*walls), LightConf())
    inside = np.tile([0.0, 0.0, 0.2], (25, 1))
    shots = plan_shots(inside, nobody(inside), 10.0, baked, 1.2, lambda number: NOWHERE)
    assert [(shot.first, shot.end) for shot in shots] == [(0, 10), (10, 20), (20, 25)]
    assert all(shot.view is NOWHERE for shot in shots)


def test_the_camera_stands_where_others_do_not_cover_the_robot():
    baked = bake_world(plain(), LightConf())
    place = plan_shots(STILL, nobody(STILL), 10.0, baked, 1.2, lambda number: NOWHERE)[0].view.eye
    to_eye = np.subtract(place[:2], STILL[0, :2])
    towards = STILL[0, :2] + 0.7 * to_eye / np.linalg.norm(to_eye)
    # Somebody stands in the way, another is not there.
    others = np.tile([[*towards], [np.nan, np.nan]], (len(STILL), 1, 1))
    moved = plan_shots(STILL, others, 10.0, baked, 1.2, lambda number: NOWHERE)[0].view.eye
    away = np.subtract(moved[:2], STILL[0, :2])
    across = abs(away[0] * to_eye[1] - away[1] * to_eye[0]) / np.linalg.norm(away) / np.linalg.norm(to_eye)
    assert away @ to_eye < 0.0 or across * 0.7 > 0.44
