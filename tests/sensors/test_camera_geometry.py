"""Where things are in a camera's pictures: worked out by other means, and the same."""

import numpy as np
import pytest
from cameras import (
    AHEAD,
    HALF_M,
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
from scanning import turned
from scenes import about
from sensors_of_rover_zero import camera_conf

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import CameraConf


def pitched(pitch: float) -> np.ndarray:
    """Nose down by `pitch`."""
    return np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])


def worked_out(conf: CameraConf, position, rotation, boxes: list[Box]) -> dict[str, np.ndarray]:
    """Depth, segments and normals of boxes on a plain, by slabs."""
    axes = rotation @ pitched(np.deg2rad(conf.pitch_deg))
    origin = position + rotation @ conf.mount_b
    ray = pinhole_directions(conf) @ axes.T
    # Along such rays, which are 1 forward, how far one goes is the depth.
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(ray[..., 2] < 0.0, -origin[2] / ray[..., 2], np.inf)
        at = origin + depth[..., None] * ray
    depth[~(np.abs(at[..., :2]) < HALF_M).all(axis=-1)] = np.inf
    segment = np.where(np.isfinite(depth), Segment.GROUND, Segment.SKY)
    normal = np.where(np.isfinite(depth)[..., None], [0.0, 0.0, 1.0], 0.0)
    for x, y, yaw, length, width, height in boxes:
        into = turned(yaw).T
        start, along = into @ (origin - [x, y, 0.0]), ray @ into.T
        low, high = [-length / 2, -width / 2, -0.1], [length / 2, width / 2, height]
        with np.errstate(divide="ignore"):
            times = np.stack([(np.array(bound) - start) / along for bound in (low, high)])
        entry, leave = times.min(axis=0).max(axis=-1), times.max(axis=0).min(axis=-1)
        met = (entry > 0.0) & (entry < leave) & (entry < depth)
        depth[met], segment[met] = entry[met], Segment.OBSTACLE
        axis = times.min(axis=0).argmax(axis=-1)
        outward = -np.sign(np.take_along_axis(along, axis[..., None], -1)) * np.eye(3)[axis]
        normal[met] = (outward @ into)[met]
    reach = depth * np.linalg.norm(ray, axis=-1)
    unseen = reach >= conf.range_m
    depth[unseen], segment[unseen], normal[unseen] = conf.range_m, Segment.SKY, 0.0
    return {"depth": depth, "segmentation": segment, "normals": normal @ axes}


def agree(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    same = found["segmentation"][..., 0] == expected["segmentation"]
    # A ray along an edge may go either way.
    assert (~same).sum() <= 1
    np.testing.assert_allclose(found["depth"][same, 0], expected["depth"][same], rtol=1e-4)
    np.testing.assert_allclose(found["normals"][same], expected["normals"][same], atol=1e-5)


@pytest.mark.slow(all_but=["0.0-0.0-0.0-0.0-0.0-11.0"])
@pytest.mark.parametrize("pitch_deg", [0.0, 11.0, -17.0, 90.0])
@pytest.mark.parametrize(
    ("x", "y", "yaw", "roll", "nose_down"),
    [(0.0, 0.0, 0.0, 0.0, 0.0), (-1.0, 2.0, 0.7, 0.1, 0.2), (1.5, -2.0, -2.9, -0.3, -0.1)],
)
def test_boxes_stand_in_the_picture_where_geometry_says(x, y, yaw, roll, nose_down, pitch_deg):
    boxes: list[Box] = [AHEAD, (-3.0, 4.0, 0.6, 2.0, 0.3, 0.7), (1.0, 3.0, 0.2, 1.0, 1.0, 1.0)]
    boxes.append((0.0, -6.0, 1.2, 3.0, 3.0, 2.5))
    rotation = turned(yaw) @ pitched(nose_down) @ rotation_matrices(about([1, 0, 0], roll))
    position = np.array([x, y, 0.125])
    camera = camera_in(with_boxes(*boxes), pitch_deg=pitch_deg, fov_deg=80.0)
    found = look(camera, position, rotation)
    expected = worked_out(camera.conf, position, rotation, boxes)
    agree(found, expected)
    assert (expected["segmentation"] != Segment.SKY).sum() > 50


@pytest.mark.parametrize("mount", [(0.2, 0.0, 0.175), (0.0, 0.5, 1.0), (-0.4, -0.3, 2.0)])
def test_a_camera_looks_from_its_mount(mount):
    rotation = turned(0.4) @ pitched(0.15)
    camera = camera_in(with_boxes(AHEAD), mount_b=mount)
    np.testing.assert_allclose(
        camera.origin(STANDING[None], rotation[None])[0], STANDING + rotation @ mount, atol=1e-12
    )
    agree(look(camera, STANDING, rotation), worked_out(camera.conf, STANDING, rotation, [AHEAD]))
    # Straight down, every pixel is as deep as the mount is high.
    down = look(camera_in(PLAIN, mount_b=mount, pitch_deg=90.0))
    np.testing.assert_allclose(down["depth"], 0.125 + mount[2], rtol=1e-5)


def test_a_box_ahead_is_as_deep_as_it_is_far_at_every_pixel():
    found = look(camera_in(with_boxes(AHEAD)))
    box = found["segmentation"][..., 0] == Segment.OBSTACLE
    rows, columns = np.nonzero(box)
    focal_px = 16 / np.tan(np.deg2rad(60.0) / 2)
    # Its front is 4.8 m ahead, 1 m to either side, from 0.3 m below the camera to 0.7 m above.
    aside, above, below = (focal_px * reach / 4.8 for reach in (1.0, 0.7, 0.3))
    assert (columns.min(), columns.max()) == (round(16 - aside), round(16 + aside) - 1)
    assert (rows.min(), rows.max()) == (round(12 - above), round(12 + below) - 1)
    np.testing.assert_allclose(found["depth"][box], 4.8, rtol=1e-5)
    np.testing.assert_allclose(found["normals"][box], np.tile([-1.0, 0.0, 0.0], (box.sum(), 1)), atol=1e-6)
    assert (found["segmentation"][0] == Segment.SKY).all()
    assert (found["segmentation"][-1] == Segment.GROUND).all()
    np.testing.assert_allclose(found["normals"][-1], np.tile([0.0, 0.0, 1.0], (32, 1)), atol=1e-6)


def test_where_nothing_is_seen_all_outputs_say_so():
    found = look(camera_in(with_boxes(AHEAD), range_m=4.0))
    nothing = found["segmentation"][..., 0] == Segment.SKY
    # Neither the box, 4.8 m away, nor any ground behind it is within reach.
    assert set(np.unique(found["segmentation"])) == {Segment.SKY, Segment.GROUND}
    assert nothing[:13].all() and not nothing[-1].any()
    assert (found["depth"][nothing] == np.float32(4.0)).all()
    assert (found["depth"][~nothing] < 4.0).all()
    assert (found["normals"][nothing] == 0.0).all()
    sky = found["rgb"][0].astype(int)
    assert (sky[:, 2] > sky[:, 0]).all()


def test_a_fisheye_s_depth_is_the_range():
    conf = {"projection": "fisheye", "fov_deg": 150.0, "width": 33, "height": 33}
    camera = camera_in(with_boxes(AHEAD), **conf)
    found = look(camera)
    row, column = np.mgrid[0:33, 0:33] - 16.0
    angle, turn = np.hypot(row, column) * np.deg2rad(150.0) / 33, np.arctan2(-row, -column)
    direction = np.stack([np.cos(angle), np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)], axis=-1)
    box, ground = (found["segmentation"][..., 0] == each for each in (Segment.OBSTACLE, Segment.GROUND))
    assert box[16, 16] and box.sum() > 5
    np.testing.assert_allclose(found["depth"][box, 0], 4.8 / direction[box, 0], rtol=1e-4)
    np.testing.assert_allclose(found["depth"][ground, 0], -0.3 / direction[ground, 2], rtol=1e-4)
    # It sees behind the image plane's edge: the ground beside itself.
    assert ground[-1, 16] and direction[-1, 16, 0] < 0.4


def test_a_camera_s_pitch_is_the_rover_s():
    world = with_boxes(AHEAD)
    tilted = look(camera_in(world, pitch_deg=17.0))
    rotation = pitched(np.deg2rad(17.0))
    mount = np.array(camera_conf().mount_b)
    leaning = look(camera_in(world), STANDING + mount - rotation @ mount, rotation)
    for name in ("depth", "normals"):
        np.testing.assert_allclose(tilted[name], leaning[name], rtol=1e-4, atol=1e-5)
    upright = look(camera_in(world))
    # Looking down lifts what is seen.
    first = [np.nonzero(seen["segmentation"] == Segment.GROUND)[0].min() for seen in (tilted, upright)]
    assert first[0] < first[1] - 4


def test_left_is_left_and_up_is_up():
    camera = camera_in(PLAIN, (PERSON, PersonConf(radius_m=0.1, height_m=0.3)))
    found = look(camera, actors=[(3.0, 0.9, 0.0, 0.0), (3.0, -0.9, 0.0, 0.0)])
    rows, columns = np.nonzero(actor_pixels(found))
    left, right = columns < 16, columns >= 16
    assert left.sum() > 3 * right.sum() > 0
    # The tall one on the left reaches over the horizon, the small one on the right does not.
    assert rows[left].min() < 8 < 11 <= rows[right].min()
    high = look(camera, actors=[(3.0, 0.9, 1.0, 0.0), (3.0, -0.9, 9.0, 0.0)])
    assert np.nonzero(actor_pixels(high))[0].max() < 10
