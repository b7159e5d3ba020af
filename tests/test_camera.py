"""Cameras in scenes whose pictures are known: what is where, how far, of what colour, and for whom."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from batches import idle, real_batch
from conformance import check_gymnasium, check_kept, check_parallel_api, check_seeding, check_torchrl
from hypothesis import given, settings
from hypothesis import strategies as st
from moments import moment_at
from mounted import camera_conf
from PIL import Image
from scanning import turned
from scenes import about

import dune_rl
from dune_rl.actors.actor import ActorConf
from dune_rl.actors.shapes import figures
from dune_rl.config.build import build_world
from dune_rl.config.compose import compose
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.baked import Baked
from dune_rl.rendering.light import Light, LightConf
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import Camera, CameraConf, CameraSensor
from dune_rl.sensors.lens import Lens
from dune_rl.worlds.appearance import baked, scenery
from dune_rl.worlds.inspection import InspectionConf
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

EVERYTHING = ("rgb", "grey", "depth", "segmentation", "normals")
STANDING = np.array([0.0, 0.0, 0.125])
LEVEL = np.eye(3)
EYE = np.array([0.2, 0.0, 0.3])
PERSON = ActorConf()
HALF_M = 15.0

# x, y, yaw, length, width and height of a box that stands on the ground.
Box = tuple[float, float, float, float, float, float]
AHEAD: Box = (5.5, 0.0, 0.0, 1.0, 2.0, 1.0)


def standing(name: str, box: Box, colour=(0.6, 0.6, 0.6), **settings) -> Prop:
    x, y, yaw, length, width, height = box
    kind = "box" if settings.get("solid", True) else "water"
    return Prop(name, kind, *upright_box((x, y), yaw, -0.1, height, length, width), colour=colour, **settings)


def plain(*props: Prop) -> World:
    """Level ground, 30 by 30 m, with things on it."""
    ground = HeightField(np.zeros((7, 7)), HALF_M / 3, (-HALF_M, -HALF_M))
    return World("plain", ground, props, region=(-4, 4, -4, 4))


PLAIN = plain()


def with_boxes(*boxes: Box) -> World:
    return plain(*(standing(f"box_{i}", box) for i, box in enumerate(boxes)))


def camera_in(world: World, actors: tuple[ActorConf, ...] = (), light=None, **settings) -> Camera:
    conf = camera_conf(**({"outputs": EVERYTHING, "width": 32, "height": 24} | settings))
    return Camera(conf, baked(world, light or LightConf()), figures(actors))


def look(camera: Camera, position=STANDING, rotation=LEVEL, actors=()) -> dict[str, np.ndarray]:
    """What one camera sees, without the axis of scenes; `actors` are (K, 4)."""
    poses = np.reshape(np.asarray(actors, float), (1, -1, 4))
    frames = camera.frames(np.asarray(position)[None], np.asarray(rotation)[None], poses)
    return {name: frame[0] for name, frame in frames.items()}


# -- scenes worked out by other means -----------------------------------------------------------------


def pinhole_directions(conf: CameraConf) -> np.ndarray:
    """Forward, left and up (height, width, 3) through each pixel's middle, forward being 1."""
    focal_px = conf.width / 2 / np.tan(conf.fov_rad / 2)
    row, column = np.mgrid[0 : conf.height, 0 : conf.width] + 0.5
    across, upward = (conf.width / 2 - column) / focal_px, (conf.height / 2 - row) / focal_px
    return np.stack([np.ones_like(across), across, upward], axis=-1)


def pitched(pitch: float) -> np.ndarray:
    """Nose down by `pitch`."""
    return np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])


def worked_out(conf: CameraConf, position, rotation, boxes: list[Box]) -> dict[str, np.ndarray]:
    """Depth, segments and normals of boxes on a plain, by slabs."""
    axes = rotation @ pitched(conf.pitch_rad)
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


@pytest.mark.parametrize("pitch", [0.0, 0.2, -0.3, np.pi / 2])
@pytest.mark.parametrize(
    ("x", "y", "yaw", "roll", "nose_down"),
    [(0.0, 0.0, 0.0, 0.0, 0.0), (-1.0, 2.0, 0.7, 0.1, 0.2), (1.5, -2.0, -2.9, -0.3, -0.1)],
)
def test_boxes_stand_in_the_picture_where_geometry_says(x, y, yaw, roll, nose_down, pitch):
    boxes: list[Box] = [AHEAD, (-3.0, 4.0, 0.6, 2.0, 0.3, 0.7), (1.0, 3.0, 0.2, 1.0, 1.0, 1.0)]
    boxes.append((0.0, -6.0, 1.2, 3.0, 3.0, 2.5))
    rotation = turned(yaw) @ pitched(nose_down) @ rotation_matrices(about([1, 0, 0], roll))
    position = np.array([x, y, 0.125])
    camera = camera_in(with_boxes(*boxes), pitch_rad=pitch, fov_rad=1.4)
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
    down = look(camera_in(PLAIN, mount_b=mount, pitch_rad=np.pi / 2))
    np.testing.assert_allclose(down["depth"], 0.125 + mount[2], rtol=1e-5)


def test_a_box_ahead_is_as_deep_as_it_is_far_at_every_pixel():
    found = look(camera_in(with_boxes(AHEAD)))
    box = found["segmentation"][..., 0] == Segment.OBSTACLE
    rows, columns = np.nonzero(box)
    focal_px = 16 / np.tan(1.047 / 2)
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
    conf = {"projection": "fisheye", "fov_rad": 2.6, "width": 33, "height": 33}
    camera = camera_in(with_boxes(AHEAD), **conf)
    found = look(camera)
    row, column = np.mgrid[0:33, 0:33] - 16.0
    angle, turn = np.hypot(row, column) * 2.6 / 33, np.arctan2(-row, -column)
    direction = np.stack([np.cos(angle), np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)], axis=-1)
    box, ground = (found["segmentation"][..., 0] == each for each in (Segment.OBSTACLE, Segment.GROUND))
    assert box[16, 16] and box.sum() > 5
    np.testing.assert_allclose(found["depth"][box, 0], 4.8 / direction[box, 0], rtol=1e-4)
    np.testing.assert_allclose(found["depth"][ground, 0], -0.3 / direction[ground, 2], rtol=1e-4)
    # It sees behind the image plane's edge: the ground beside itself.
    assert ground[-1, 16] and direction[-1, 16, 0] < 0.4


def test_a_camera_s_pitch_is_the_rover_s():
    world = with_boxes(AHEAD)
    tilted = look(camera_in(world, pitch_rad=0.3))
    rotation = pitched(0.3)
    mount = np.array(camera_conf().mount_b)
    leaning = look(camera_in(world), STANDING + mount - rotation @ mount, rotation)
    for name in ("depth", "normals"):
        np.testing.assert_allclose(tilted[name], leaning[name], rtol=1e-4, atol=1e-5)
    upright = look(camera_in(world))
    # Looking down lifts what is seen.
    first = [np.nonzero(seen["segmentation"] == Segment.GROUND)[0].min() for seen in (tilted, upright)]
    assert first[0] < first[1] - 4


# -- actors -------------------------------------------------------------------------------------------


def actor_pixels(found: dict[str, np.ndarray]) -> np.ndarray:
    return found["segmentation"][..., 0] == Segment.ACTOR


@pytest.mark.parametrize(("x", "y", "yaw"), [(4.2, 1.0, 0.0), (3.2, -1.0, 2.0), (6.2, 0.0, -1.0)])
def test_an_actor_is_in_the_right_pixels_at_the_right_depth(x, y, yaw):
    camera = camera_in(PLAIN, (PERSON,), width=64, height=64)
    found = look(camera, actors=[(x, y, 0.0, yaw)])
    rows, columns = np.nonzero(actor_pixels(found))
    focal_px = 32 / np.tan(1.047 / 2)
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


def test_left_is_left_and_up_is_up():
    camera = camera_in(PLAIN, (PERSON, ActorConf(radius_m=0.1, height_m=0.3)))
    found = look(camera, actors=[(3.0, 0.9, 0.0, 0.0), (3.0, -0.9, 0.0, 0.0)])
    rows, columns = np.nonzero(actor_pixels(found))
    left, right = columns < 16, columns >= 16
    assert left.sum() > 3 * right.sum() > 0
    # The tall one on the left reaches over the horizon, the small one on the right does not.
    assert rows[left].min() < 8 < 11 <= rows[right].min()
    high = look(camera, actors=[(3.0, 0.9, 1.0, 0.0), (3.0, -0.9, 9.0, 0.0)])
    assert np.nonzero(actor_pixels(high))[0].max() < 10


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


@pytest.mark.parametrize("confs", [(PERSON, PERSON), (PERSON, ActorConf(radius_m=0.4, height_m=1.6))])
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
    st.sampled_from([("pinhole", 1.0), ("pinhole", 2.7), ("fisheye", 1.0), ("fisheye", np.pi)]),
    st.floats(-4, 4),
    st.floats(-4, 4),
    st.floats(-2, 2),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_no_pixel_of_an_actor_is_left_out(lens, x, y, z, quaternion):
    conf = {"projection": lens[0], "fov_rad": lens[1], "width": 24, "height": 18}
    camera = camera_in(PLAIN, (PERSON,), **conf)
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    found = look(camera, STANDING, rotation, [(x, y, z, 1.0)])
    nobody = look(camera_in(PLAIN, **conf), STANDING, rotation)
    # Every pixel's ray cast at the actor, instead of those near it.
    figure = figures((PERSON,))[0]
    rays = Lens(camera.conf).directions.reshape(-1, 3) @ rotation.T
    origin = np.tile(camera.origin(STANDING[None], rotation[None]), (len(rays), 1))
    ranges = np.full(len(rays), 100.0, np.float32)
    poses = np.tile([x, y, z, 1.0], (len(rays), 1))
    hit = figure.hits(origin, rays.astype(np.float32), poses, ranges)
    axial = 1.0 if lens[0] == "fisheye" else (rays @ (rotation @ [1.0, 0.0, 0.0]))
    depth = np.where(hit.face >= 0, hit.range * axial, np.inf).reshape(18, 24)
    bare = nobody["depth"][..., 0]
    assert (actor_pixels(found) == (depth < bare)).mean() > 0.995
    np.testing.assert_allclose(found["depth"][..., 0], np.minimum(depth, bare), rtol=1e-3)


def test_feet_beside_the_camera_are_seen_though_their_owner_is_behind():
    # It looks straight down from 0.3 m, and the person's middle is well above it.
    camera = camera_in(PLAIN, (PERSON,), pitch_rad=np.pi / 2, mount_b=(0.0, 0.0, 0.175), height=32)
    rows, _ = np.nonzero(actor_pixels(look(camera, actors=[(0.3, 0.0, 0.0, 0.0)])))
    assert len(rows) > 10
    assert rows.max() < 4


# -- colours ------------------------------------------------------------------------------------------


def test_grey_is_the_luma_of_rgb():
    world = build_world(InspectionConf(seed=3))
    camera = camera_in(world, (PERSON,))
    xy = np.array([-23.0, -23.0])
    position = np.array([*xy, world.terrain.height(xy) + 0.2])
    found = look(camera, position, turned(0.5), [(-21.0, -22.0, position[2] - 0.2, 0.0)])
    expected = np.asarray(Image.fromarray(found["rgb"]).convert("L")).astype(int)
    assert len(np.unique(expected)) > 20
    assert np.abs(found["grey"][..., 0] - expected).max() <= 1
    alone = look(camera_in(world, (PERSON,), outputs=("grey",)), position, turned(0.5), [(99, 99, 0, 0)])
    both = look(camera, position, turned(0.5), [(99, 99, 0, 0)])
    np.testing.assert_array_equal(alone["grey"], both["grey"])


def test_an_output_does_not_depend_on_the_others():
    world = with_boxes(AHEAD)
    together = look(camera_in(world, (PERSON,)), actors=[(3.0, 0.5, 0.0, 0.0)])
    for name in EVERYTHING:
        alone = look(camera_in(world, (PERSON,), outputs=(name,)), actors=[(3.0, 0.5, 0.0, 0.0)])
        assert list(alone) == [name]
        np.testing.assert_array_equal(alone[name], together[name])


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_a_thing_shows_its_own_colour(channel):
    colour = tuple(0.7 if axis == channel else 0.1 for axis in range(3))
    found = look(camera_in(plain(standing("box", AHEAD, colour))))
    box = found["rgb"][found["segmentation"][..., 0] == Segment.OBSTACLE].astype(int)
    assert (box.argmax(axis=1) == channel).all()
    assert (box[:, channel] > 60).all()


def test_decks_and_water_are_told_apart_from_obstacles():
    lake, bridge = (
        standing("lake", (3.0, -0.8, 0.0, 2.0, 1.0, 0.05), solid=False),
        standing("deck", (3.0, 0.8, 0.0, 2.0, 1.0, 0.05), drivable=True),
    )
    found = look(camera_in(plain(lake, bridge)))["segmentation"][..., 0]
    assert set(np.unique(found)) == {Segment.SKY, Segment.GROUND, Segment.DECK, Segment.WATER}
    assert np.nonzero(found == Segment.DECK)[1].max() < 16 <= np.nonzero(found == Segment.WATER)[1].min()


def test_solar_panels_look_blue_and_the_ground_does_not():
    world = build_world(InspectionConf(seed=3))
    camera = camera_in(world, width=16, height=16, pitch_rad=np.pi / 2, mount_b=(0.0, 0.0, 0.0), fov_rad=0.3)
    panels = [prop for prop in world.props if prop.name.endswith("panel")]
    assert len(panels) == 5
    for panel in panels:
        low, high = panel.vertices.min(axis=0), panel.vertices.max(axis=0)
        found = look(camera, [*(low + high)[:2] / 2, high[2] + 1.0])
        assert (found["segmentation"] == Segment.OBSTACLE).all()
        red, _, blue = found["rgb"].reshape(-1, 3).mean(axis=0)
        assert blue > red + 30
    free = next(xy for xy in np.random.default_rng(0).uniform(-25, 25, (99, 2)) if world.clearance(xy) > 2.0)
    ground = look(camera, [*free, world.terrain.height(free) + 3.0])
    assert (ground["segmentation"] == Segment.GROUND).all()
    red, green, blue = ground["rgb"].reshape(-1, 3).mean(axis=0)
    assert blue < min(red, green)


SUN_BEHIND = {"sun_bearing_rad": np.pi, "sun_elevation_rad": 0.3}
# On the left a high screen keeps the sun, which stands behind the camera, from half of the wall ahead.
WALL: Box = (4.0, 0.0, 0.0, 0.4, 6.0, 1.0)
SCREEN: Box = (-4.0, 4.0, 0.0, 0.2, 8.0, 6.0)


def halves(shadows: bool) -> tuple[float, float, float, float]:
    """Mean brightness of the wall's left and right, and of the ground's, before it."""
    light = LightConf(**SUN_BEHIND, shadows=shadows)
    found = look(camera_in(with_boxes(WALL, SCREEN), light=light))
    middle = np.abs(np.arange(32) - 15.5) > 3
    left = np.arange(32) < 16
    means = []
    for segment in (Segment.OBSTACLE, Segment.GROUND):
        of_it = found["segmentation"][..., 0] == segment
        means += [found["grey"][of_it & middle & side, 0].mean() for side in (left, ~left)]
    return tuple(means)


def test_a_wall_in_shadow_is_darker_than_one_in_the_sun():
    wall_dark, wall_lit, ground_dark, ground_lit = halves(shadows=True)
    assert wall_dark < 0.7 * wall_lit
    assert ground_dark < 0.9 * ground_lit
    *walls, ground_left, ground_right = halves(shadows=False)
    assert walls[0] == pytest.approx(wall_lit, rel=0.05)
    assert walls[1] == pytest.approx(wall_lit, rel=0.02)
    assert ground_left == pytest.approx(ground_right, rel=0.08)


def test_a_wall_that_faces_the_sun_is_brighter_than_its_back():
    def brightness(bearing: float) -> float:
        light = LightConf(sun_bearing_rad=bearing, sun_elevation_rad=0.3)
        found = look(camera_in(with_boxes(WALL), light=light))
        return found["grey"][found["segmentation"] == Segment.OBSTACLE].mean()

    assert brightness(0.0) < brightness(2.2) < brightness(np.pi)


def test_a_lower_sun_is_redder():
    def warmth(elevation: float) -> float:
        light = Light.of(LightConf(sun_bearing_rad=np.pi, sun_elevation_rad=elevation))
        camera = Camera(
            camera_conf(width=16, height=12), Baked(scenery(with_boxes(WALL)), light), figures(())
        )
        red, _, blue = look(camera)["rgb"][6].mean(axis=0)
        return red / blue

    assert warmth(0.05) > 1.2 * warmth(0.9)


# -- many scenes --------------------------------------------------------------------------------------


def rough() -> World:
    heights = np.random.default_rng(0).normal(0.0, 0.3, (31, 31))
    props = [
        standing("one", (3.0, 1.0, 0.3, 1.0, 1.0, 1.5), (0.8, 0.2, 0.1)),
        standing("two", (-3.0, -2.0, 1.0, 2.0, 0.3, 1.0), (0.1, 0.2, 0.7)),
        standing("lake", (0.0, 4.0, 0.0, 4.0, 2.0, 0.1), (0.2, 0.4, 0.5), solid=False),
    ]
    return World("rough", HeightField(heights, 1.0, (-15.0, -15.0)), props, region=(-4, 4, -4, 4))


CROWD = (PERSON, ActorConf(radius_m=0.4, height_m=1.6), PERSON)


def poses_in(scenes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    positions = np.column_stack([rng.uniform(-4, 4, (scenes, 2)), rng.uniform(0.3, 1.0, scenes)])
    quaternions = rng.normal(0.0, 0.15, (scenes, 4)) + np.column_stack(
        [np.zeros((scenes, 2)), rng.normal(size=(scenes, 2))]
    )
    rotations = rotation_matrices(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    actors = np.concatenate(
        [rng.uniform(-6, 6, (scenes, 3, 2)), np.zeros((scenes, 3, 1)), rng.uniform(-3, 3, (scenes, 3, 1))],
        axis=-1,
    )
    return positions, rotations, actors


@pytest.mark.parametrize("size", [(16, 16), (21, 13)])
def test_pictures_of_a_batch_are_those_of_single_scenes(size):
    camera = camera_in(rough(), CROWD, width=size[0], height=size[1])
    positions, rotations, actors = poses_in(9)
    together = camera.frames(positions, rotations, actors)
    assert (together["segmentation"] == Segment.ACTOR).any()
    for i in range(9):
        one = slice(i, i + 1)
        alone = camera.frames(positions[one], rotations[one], actors[one])
        for name in EVERYTHING:
            assert alone[name].tobytes() == together[name][one].tobytes()
    assert len({picture.tobytes() for picture in together["rgb"]}) == 9


def digest() -> str:
    camera = camera_in(rough(), CROWD)
    frames = camera.frames(*poses_in(4))
    return hashlib.sha256(b"".join(frame.tobytes() for frame in frames.values())).hexdigest()


def test_another_process_takes_the_same_pictures():
    here = Path(__file__).parent
    environ = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(here), str(here.parent), os.environ.get("PYTHONPATH", "")]),
        "PYTHONHASHSEED": "77",
    }
    command = [sys.executable, "-c", "from test_camera import digest; print(digest())"]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == digest()


def test_actors_that_are_not_there_change_nothing():
    positions, rotations, actors = poses_in(3)
    seen = camera_in(rough()).frames(positions, rotations, actors[:, :0])
    away = actors.copy()
    away[..., 0] += 500.0
    for name, frame in camera_in(rough(), CROWD).frames(positions, rotations, away).items():
        np.testing.assert_array_equal(frame, seen[name])


@settings(max_examples=50)
@given(
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(-2, 3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-1, 1), st.floats(-4, 4)),
    st.sampled_from(["pinhole", "fisheye"]),
)
def test_whatever_the_pose_readings_are_within_their_bounds(x, y, z, quaternion, actor, projection):
    camera = camera_in(ROUGH, (PERSON,), width=12, height=9, range_m=8.0, projection=projection)
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    found = look(camera, [x, y, z], rotation, [actor])
    for name, (low, high) in CameraSensor(camera, 1).bounds().items():
        frame = found[name.removeprefix("camera_")]
        assert frame.dtype == low.dtype == high.dtype
        assert frame.shape == low.shape == high.shape
        assert (frame >= low).all() and (frame <= high).all()
    length = np.linalg.norm(found["normals"], axis=-1)
    seen = found["depth"][..., 0] < 8.0
    np.testing.assert_allclose(length, seen, atol=1e-3)
    np.testing.assert_array_equal(seen, found["segmentation"][..., 0] != Segment.SKY)


ROUGH = rough()


# -- the sensor ---------------------------------------------------------------------------------------


def sensor_of(scenes: int) -> CameraSensor:
    return CameraSensor(camera_in(ROUGH, (PERSON,), width=8, height=6), scenes)


def at(scenes: int, x: float) -> object:
    """A moment of rovers side by side, `x` m ahead, each with an actor before it."""
    places = np.column_stack([np.full(scenes, x), np.arange(scenes) - 1.0, np.full(scenes, 0.6)])
    actors = np.concatenate([places + np.array([2.0, 0.0, -0.6]), np.zeros((scenes, 1))], axis=1)
    return moment_at(places, np.zeros(scenes), actors[:, None])


def test_an_episode_s_beginning_leaves_the_other_scenes_their_pictures():
    sensor = sensor_of(3)
    sensor.begin(np.array([True, True, True]), at(3, 0.0))
    first = sensor.read()
    sensor.begin(np.array([False, True, False]), at(3, 1.0))
    second = sensor.read()
    sensor.measure(at(3, 1.0))
    third = sensor.read()
    assert list(first) == [f"camera_{name}" for name in EVERYTHING]
    for name in ("camera_rgb", "camera_depth"):
        np.testing.assert_array_equal(second[name][[0, 2]], first[name][[0, 2]])
        np.testing.assert_array_equal(second[name][1], third[name][1])
        assert all((third[name][i] != first[name][i]).any() for i in range(3))


def test_no_episode_s_beginning_changes_nothing():
    sensor = sensor_of(2)
    sensor.begin(np.array([True, True]), at(2, 0.0))
    before = sensor.read()
    sensor.begin(np.array([False, False]), at(2, 2.0))
    assert all((sensor.read()[name] == before[name]).all() for name in before)


def test_a_reading_is_the_reader_s_own():
    sensor = sensor_of(2)
    sensor.begin(np.array([True, True]), at(2, 0.0))
    kept = sensor.read()
    copies = {name: value.copy() for name, value in kept.items()}
    for value in sensor.read().values():
        value[:] = 0
    for name, value in sensor.read().items():
        np.testing.assert_array_equal(value, copies[name])
    sensor.measure(at(2, 1.0))
    for name, value in kept.items():
        np.testing.assert_array_equal(value, copies[name])


def test_a_rover_s_camera_sees_what_lies_before_the_rover():
    walk = {"waypoints": ((2.5, -5.0), (2.5, 5.0)), "speed_mps": 3.0}
    batch = real_batch("flat", 6, actors=[walk], sensors=SEEING)
    seen, unseen = 0, 0
    for _ in range(25):
        batch.step(idle(batch))
        offset = batch.actors.poses[:, 0, :2] - batch.motion.position_w[:, :2]
        bearing, apart = batch.motion.bearing(batch.actors.poses[:, 0, :2]), np.hypot(*offset.T)
        there = (batch.observe()["camera_segmentation"] == Segment.ACTOR).any(axis=(1, 2, 3))
        ahead, aside = (np.abs(bearing) < 0.4) & (apart < 5.0), (np.abs(bearing) > 1.0) & (apart > 1.0)
        assert there[ahead].all()
        assert not there[aside].any()
        seen, unseen = seen + ahead.sum(), unseen + aside.sum()
    batch.close()
    assert seen > 5 and unseen > 5


# -- environments -------------------------------------------------------------------------------------

SEEING = {
    "enabled": ["camera", "goal"],
    "camera": {"width": 16, "height": 12, "outputs": ["rgb", "depth", "segmentation"]},
}
SHORT = {"termination": {"max_steps": 6}}


@pytest.fixture(scope="module")
def parallel():
    env = dune_rl.parallel_env("flat", sensors=SEEING, task=SHORT, actors="walkers")
    yield env
    env.close()


def test_the_pettingzoo_environment_with_a_camera_keeps_the_rules(parallel):
    check_parallel_api(parallel, 20)
    check_kept(parallel, 8)
    space = parallel.observation_space("rover_0")
    assert set(space) == {"camera_rgb", "camera_depth", "camera_segmentation", "goal"}
    assert space["camera_rgb"] == gymnasium.spaces.Box(0, 255, (12, 16, 3), np.uint8)
    assert space["camera_depth"] == gymnasium.spaces.Box(0.0, 100.0, (12, 16, 1), np.float32)
    observed = parallel.reset(seed=2)[0]["rover_0"]
    assert space.contains(observed)
    assert observed["camera_rgb"].dtype == observed["camera_segmentation"].dtype == np.uint8
    assert np.ptp(observed["camera_rgb"]) > 50


def test_equal_seeds_take_equal_pictures():
    check_seeding(lambda: dune_rl.parallel_env("flat", sensors=SEEING, task=SHORT), 14)


def test_the_gymnasium_environment_with_a_camera_keeps_the_rules():
    env = gymnasium.make("dune_rl/Flat-v0", sensors=SEEING, task=SHORT).unwrapped
    check_gymnasium(env)
    assert env.observation_space["camera_rgb"].dtype == np.uint8
    env.close()


@pytest.mark.parametrize("scenes", [1, 3])
def test_the_torchrl_environment_with_a_camera_keeps_the_rules(scenes):
    env = dune_rl.make("flat", scenes, sensors=SEEING, task={"termination": {"max_steps": 2}})
    check_torchrl(env)
    spec = env.observation_spec["camera_rgb"]
    assert str(spec.dtype) == "torch.uint8"
    assert spec.shape == (scenes, 12, 16, 3)
    assert (int(spec.low.min()), int(spec.high.max())) == (0, 255)
    env.close()


def test_a_list_of_sensors_is_short_for_those_enabled():
    short, long = (
        compose(["+world=flat", f"{name}=[camera,lidar]"]).sensors for name in ("sensors", "sensors.enabled")
    )
    assert short == long
    assert short.enabled == ("camera", "lidar")
    envs = [
        dune_rl.parallel_env("flat", **words)
        for words in (
            {"sensors": ["camera", "goal"]},
            {"sensors": {"enabled": ["camera", "goal"]}},
            {"overrides": ["sensors=[camera,goal]"]},
        )
    ]
    spaces = [env.observation_space("rover_0") for env in envs]
    assert list(spaces[0]) == ["camera_rgb", "goal"]
    assert spaces[0]["camera_rgb"].shape == (64, 64, 3)
    first, *others = (env.reset(seed=3)[0]["rover_0"] for env in envs)
    for space, other in zip(spaces[1:], others, strict=True):
        assert space == spaces[0]
        assert all(other[name].tobytes() == first[name].tobytes() for name in first)
    for env in envs:
        env.close()
