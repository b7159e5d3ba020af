"""Actors in a camera's pictures: in the right pixels, whole, and hidden by what is nearer."""

import numpy as np
import pytest
from cameras import (
    PERSON,
    PLAIN,
    STANDING,
    Box,
    actor_pixels,
    camera_in,
    look,
    pinhole_directions,
    with_boxes,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from people import meshes_of

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.frames import rotation_from_yaw, rotation_matrices
from dune_rl.sensors.lens import Lens

EYE = np.array([0.2, 0.0, 0.3])


@pytest.mark.parametrize(("x", "y", "yaw"), [(4.2, 1.0, 0.0), (3.2, -1.0, 2.0), (6.2, 0.0, -1.0)])
def test_an_actor_is_in_the_right_pixels_at_the_right_depth(x, y, yaw):
    camera = camera_in(PLAIN, (PERSON,), width=64, height=64)
    found = look(camera, actors=[(x, y, 0.0, yaw)])
    rows, columns = np.nonzero(actor_pixels(found))
    focal_px = 32 / np.tan(np.deg2rad(60.0) / 2)
    ahead = x - EYE[0]
    # The left edge of the silhouette is a tangent to the circle.
    bearing, half = np.arctan2(y, ahead), np.arcsin(0.25 / np.hypot(ahead, y))
    left, right = (32 - focal_px * np.tan(bearing + side * half) for side in (1, -1))
    assert columns.min() == pytest.approx(left, abs=0.8)
    assert columns.max() + 1 == pytest.approx(right, abs=0.8)
    assert rows.min() == pytest.approx(32 - focal_px * 1.45 / ahead, abs=1.0)
    assert rows.max() + 1 == pytest.approx(32 + focal_px * 0.3 / ahead, abs=1.5)
    middle = round((left + right) / 2 - 0.5)
    depth = found["depth"][32, middle, 0]
    assert depth == pytest.approx(ahead - 0.25 * np.cos(bearing), abs=0.01)
    normal = found["normals"][32, middle]
    # Twenty-four sides stand for the circle.
    assert normal @ [-np.cos(bearing), -np.sin(bearing), 0.0] > np.cos(np.pi / 12)
    assert found["depth"][actor_pixels(found)].max() < ahead + 0.3
    assert (found["rgb"][32, middle] != look(camera, actors=[(x, y, 0.0, yaw + 9)])["rgb"][0, 0]).any()


def test_clothes_are_seen_at_their_height():
    # Orange over dark blue: red outweighs blue in the jacket, and blue red in the trousers.
    camera = camera_in(PLAIN, (PERSON,), width=64, height=64)
    found = look(camera, actors=[(3.2, 0.0, 0.0, 0.0)])
    heights = 0.3 + 2.75 * pinhole_directions(camera.conf)[..., 32, 2]
    column = found["rgb"][:, 32].astype(int)
    for low, high, redder in ((0.2, 0.7, False), (1.27, 1.4, True)):
        rows = (heights > low) & (heights < high)
        assert rows.any() and ((column[rows, 0] > column[rows, 2]) == redder).all()


def test_walls_hide_actors_and_actors_walls():
    wall: Box = (4.5, 0.0, 0.0, 0.2, 4.0, 2.5)
    camera = camera_in(with_boxes(wall), (PERSON,))
    empty = look(camera_in(with_boxes(wall)))
    behind = look(camera, actors=[(6.0, 0.0, 0.0, 0.0)])
    for name, seen in behind.items():
        np.testing.assert_array_equal(seen, empty[name])
    before = look(camera, actors=[(2.0, 0.0, 0.0, 0.0)])
    assert actor_pixels(before)[12, 16]
    # Half of a person looks out from behind the wall's edge.
    aside = look(camera, actors=[(6.0, -2.6, 0.0, 0.0)])
    out = look(camera_in(PLAIN, (PERSON,)), actors=[(6.0, -2.6, 0.0, 0.0)])
    assert 0 < actor_pixels(aside).sum() < actor_pixels(out).sum()


@pytest.mark.parametrize("confs", [(PERSON, PERSON), (PERSON, PersonConf(radius_m=0.4, height_m=1.6))])
@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_actors_in_line_the_nearer_is_seen(confs, swapped):
    camera = camera_in(PLAIN, confs)
    places = [(3.0, 0.0, 0.0, 0.0), (4.0, 0.1, 0.0, 1.0)]
    order = places[::-1] if swapped else places
    both = look(camera, actors=order)
    away = (-5.0, 0.0, 0.0, 0.0)
    one, other = (look(camera, actors=alone) for alone in ([order[0], away], [away, order[1]]))
    # Of the two alone, the nearer at each pixel.
    nearer = one["depth"] <= other["depth"]
    assert actor_pixels(one).any() and actor_pixels(other).any()
    assert (actor_pixels(one) & actor_pixels(other)).any()
    for name in ("rgb", "grey", "depth", "segmentation", "normals"):
        np.testing.assert_array_equal(both[name], np.where(nearer, one[name], other[name]))


def test_actors_out_of_the_picture_or_out_of_range_are_not_drawn():
    camera = camera_in(PLAIN, (PERSON,), range_m=6.0)
    nobody = look(camera_in(PLAIN, range_m=6.0))
    for x, y in ((-2.0, 0.0), (0.2, 1.5), (0.2, -1.5), (7.0, 0.0)):
        for name, seen in look(camera, actors=[(x, y, 0.0, 0.0)]).items():
            np.testing.assert_array_equal(seen, nobody[name])
    assert actor_pixels(look(camera, actors=[(5.9, 0.0, 0.0, 0.0)])).any()


@settings(max_examples=60)
@given(
    st.sampled_from([("pinhole", 57.0), ("pinhole", 155.0), ("fisheye", 57.0), ("fisheye", 180.0)]),
    st.floats(-4, 4),
    st.floats(-4, 4),
    st.floats(-2, 2),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_no_pixel_of_an_actor_is_left_out(lens, x, y, z, quaternion):
    conf = {"projection": lens[0], "fov_deg": lens[1], "width": 24, "height": 18}
    camera = camera_in(PLAIN, (PERSON,), **conf)
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    found = look(camera, STANDING, rotation, [(x, y, z, 1.0)])
    nobody = look(camera_in(PLAIN, **conf), STANDING, rotation)
    # Every pixel's ray cast at the actor, instead of those near it.
    mesh = meshes_of((PERSON,))[0]
    rays = Lens(camera.conf).directions.reshape(-1, 3) @ rotation.T
    turned = rotation_from_yaw(np.array(1.0))
    local = (camera.origin(STANDING[None], rotation[None]) - [x, y, z]) @ turned
    ranges = np.full(len(rays), 100.0, np.float32)
    hit = mesh.frame(0).rays.hits(local.astype(np.float32), (rays @ turned).astype(np.float32), ranges)
    axial = 1.0 if lens[0] == "fisheye" else (rays @ (rotation @ [1.0, 0.0, 0.0]))
    depth = np.where(hit.face >= 0, hit.range * axial, np.inf).reshape(18, 24)
    bare = nobody["depth"][..., 0]
    assert (actor_pixels(found) == (depth < bare)).mean() > 0.995
    np.testing.assert_allclose(found["depth"][..., 0], np.minimum(depth, bare), rtol=1e-3)


def test_feet_beside_the_camera_are_seen_though_their_owner_is_behind():
    # It looks straight down from 0.3 m, and the person's middle is well above it.
    camera = camera_in(PLAIN, (PERSON,), pitch_deg=90.0, mount_b=(0.0, 0.0, 0.175), height=32)
    rows, _ = np.nonzero(actor_pixels(look(camera, actors=[(0.3, 0.0, 0.0, 0.0)])))
    assert len(rows) > 10
    assert rows.max() < 4
