"""Collision meshes in DART, whose copies the engine never deletes: those of equal worlds are one."""

import numpy as np

from dune_rl.physics.dart import statics
from dune_rl.physics.dart.statics import load_shared_meshes
from dune_rl.physics.shapes import StaticBody


def _slope(height_m: float) -> tuple[StaticBody, ...]:
    vertices = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, height_m], [4.0, 4.0, height_m]])
    faces = np.array([[0, 1, 2], [1, 3, 2]], np.int32)
    return (StaticBody("ground", vertices, faces, 1.0, True),)


def test_a_world_that_is_made_anew_has_the_meshes_of_before() -> None:
    first = load_shared_meshes(_slope(1.0))
    shape, detector = first.shapes[0], first.detector
    del first
    again, other = load_shared_meshes(_slope(1.0)), load_shared_meshes(_slope(2.0))
    assert again.shapes[0] is shape and again.detector is detector
    assert other.shapes[0] is not shape and other.is_open == [True]


def test_only_the_last_ones_are_kept() -> None:
    for number in range(statics._MOST_KEPT + 5):
        load_shared_meshes(_slope(3.0 + number))
    assert len(statics._kept) == statics._MOST_KEPT
    used = load_shared_meshes(_slope(50.0))
    for number in range(statics._MOST_KEPT + 5):
        load_shared_meshes(_slope(100.0 + number))
    # What a scene uses stays, whatever is kept beside.
    assert len(used.shapes) == 1 and load_shared_meshes(used.statics) is used
