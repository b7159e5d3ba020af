"""Large pictures: light and shadow, the rover in them, and where they are taken from."""

from copy import copy
from functools import cache
from pathlib import Path

import gymnasium
import numpy as np
import pybullet
import pytest
from batches import idle, real_batch
from conformance import difference
from hypothesis import given, settings
from hypothesis import strategies as st
from scanning import turned
from scenes import about

import dune_rl
from dune_rl.actors.actor import ActorConf
from dune_rl.env.batch import Batch
from dune_rl.env.motion import Motion
from dune_rl.env.pictures import Pictures
from dune_rl.errors import ConfigError
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.body import Body, Solid
from dune_rl.rendering.light import LightConf, linear
from dune_rl.rendering.picture import Painter, Viewpoint
from dune_rl.rendering.scenery import Segment, Shape
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.robots.visual import RobotVisual
from dune_rl.worlds.appearance import baked
from dune_rl.worlds.props import slab, upright_box
from dune_rl.worlds.world import Prop, World

SIZE = (96, 72)
ROVER_URDF = RoverZero(RoverZeroConf(), 1).body.urdf


def plain(*props: Prop, heights: np.ndarray | None = None) -> World:
    """Ground, 20 by 20 m, level unless told otherwise, with things on it."""
    ground = HeightField(np.zeros((11, 11)) if heights is None else heights, 2.0, (-10.0, -10.0))
    return World("plain", ground, props, region=(-4, 4, -4, 4))


def box(x: float, y: float, length: float, width: float, height: float, **settings) -> Prop:
    kind = "box" if settings.get("solid", True) else "water"
    return Prop("box", kind, *upright_box((x, y), 0.0, -0.1, height, length, width), **settings)


def painter(*props: Prop, **light) -> Painter:
    return Painter(baked(plain(*props), LightConf(**light)))


def block(colour=(0.8, 0.2, 0.2), size=(0.5, 0.5, 1.0)) -> Solid:
    """A box about its own origin."""
    vertices, faces = slab([0.0, 0.0, 0.0], np.eye(3), size)
    albedo = np.tile(linear(np.array(colour)), (len(faces), 1))
    return Solid(Shape(vertices, faces, albedo, np.full(len(faces), Segment.ROBOT, np.uint8)))


def body(x: float, y: float, z: float, **shape) -> Body:
    return Body(block(**shape), np.array([x, y, z]), np.eye(3))


def brightness_at(picture: np.ndarray, view: Viewpoint, point) -> float:
    """Of the pixels round where `point` (3,) appears."""
    height, width = picture.shape[:2]
    towards = np.subtract(point, view.eye)
    towards = towards / np.linalg.norm(towards)
    row, column = np.unravel_index(np.argmax(view.directions(width, height) @ towards), (height, width))
    assert 0 < row < height - 1 and 0 < column < width - 1, "out of the picture"
    return float(picture[row - 1 : row + 2, column - 1 : column + 2].mean())


ABOVE = Viewpoint((0.0, 0.0, 12.0), (0.0, 0.0, 0.0), 0.9)
ASLANT = Viewpoint((-5.0, -3.0, 2.5), (0.0, 0.0, 0.5))


# -- viewpoints ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("view", [ABOVE, ASLANT, Viewpoint((1.0, 2.0, 0.5), (4.0, -2.0, 3.0), 1.4)])
def test_a_viewpoint_looks_at_its_target_and_stands_level(view):
    directions = view.directions(9, 7)
    assert directions.shape == (7, 9, 3) and directions.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=1e-6)
    ahead = np.subtract(view.target, view.eye)
    np.testing.assert_allclose(directions[3, 4], ahead / np.linalg.norm(ahead), atol=1e-6)
    # The middle row runs level from left to right; rows run downward.
    np.testing.assert_allclose(
        directions[3, :, 2], directions[3, 4, 2] * directions[3] @ directions[3, 4], atol=1e-6
    )
    assert (np.cross(directions[3, 4], directions[3, 0])[2] > 0.0) or view is ABOVE
    assert (np.diff(directions[:, 4] @ np.cross(directions[3, 8] - directions[3, 0], ahead)) < 0.0).all()
    across = np.arccos(directions[3, 0] @ directions[3, 8])
    assert np.tan(across / 2) == pytest.approx(8 / 9 * np.tan(view.fov_rad / 2), rel=1e-4)


# -- what is painted ----------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("size", [(96, 72), (33, 50), (1, 1)])
def test_a_picture_has_the_size_asked_for(size, samples):
    picture = painter(box(0.0, 0.0, 1.0, 1.0, 1.0)).paint(ASLANT, *size, samples=samples)
    assert picture.shape == (size[1], size[0], 3)
    assert picture.dtype == np.uint8


def test_a_picture_of_the_same_scene_is_the_same():
    props, bodies = [box(0.0, 0.0, 1.0, 1.0, 1.0)], [body(-1.0, 1.0, 0.5)]
    one, other = painter(*props), Painter(baked(plain(*props), LightConf()))
    first = one.paint(ASLANT, *SIZE, bodies)
    one.paint(ABOVE, *SIZE)
    assert one.paint(ASLANT, *SIZE, bodies).tobytes() == first.tobytes()
    assert other.paint(ASLANT, *SIZE, bodies).tobytes() == first.tobytes()
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 300


def test_a_picture_painted_in_parts_is_the_same(monkeypatch):
    one, bodies = painter(box(0.0, 0.0, 1.0, 1.0, 1.0)), [body(-1.0, 1.0, 0.5)]
    whole = one.paint(ASLANT, *SIZE, bodies)
    monkeypatch.setattr("dune_rl.rendering.picture._RAYS_AT_ONCE", 1000)
    assert one.paint(ASLANT, *SIZE, bodies).tobytes() == whole.tobytes()


@pytest.mark.parametrize("bearing", [0.0, 1.2, 2.6, -2.0])
@pytest.mark.parametrize("moves", [False, True])
def test_a_shadow_falls_on_the_side_away_from_the_sun(bearing, moves):
    # A metre high, under a sun of 45 degrees, a shadow reaches a metre beyond the box.
    light = {"sun_bearing_rad": bearing, "sun_elevation_rad": np.pi / 4}
    props = () if moves else (box(0.0, 0.0, 0.5, 0.5, 1.0),)
    bodies = [body(0.0, 0.0, 0.5)] if moves else []
    picture = painter(*props, **light).paint(ABOVE, *SIZE, bodies)
    bare = painter(**light).paint(ABOVE, *SIZE)
    away = -np.array([np.cos(bearing), np.sin(bearing), 0.0])

    def share(metres: float) -> float:
        """Brightness as a share of the empty ground's."""
        at = metres * away
        return brightness_at(picture, ABOVE, at) / brightness_at(bare, ABOVE, at)

    assert share(0.75) < 0.75
    for lit in (1.8, 2.5, -0.9):
        assert share(lit) == pytest.approx(1.0, abs=0.08)


def test_a_lower_sun_makes_longer_shadows_and_none_are_made_where_none_are_wanted():
    post = box(0.0, 0.0, 0.4, 0.4, 1.0)

    def at_two_metres(**light) -> float:
        picture = painter(post, sun_bearing_rad=np.pi, **light).paint(ABOVE, *SIZE)
        bare = painter(sun_bearing_rad=np.pi, **light).paint(ABOVE, *SIZE)
        return brightness_at(picture, ABOVE, [2.0, 0.0, 0.0]) / brightness_at(bare, ABOVE, [2.0, 0.0, 0.0])

    assert at_two_metres(sun_elevation_rad=0.3) < 0.85
    assert at_two_metres(sun_elevation_rad=0.9) > 0.95
    assert at_two_metres(sun_elevation_rad=0.3, shadows=False) > 0.95


def test_more_samples_agree_in_the_mean_and_smooth_the_edges():
    one = painter(box(0.0, 0.0, 1.0, 1.0, 1.0, colour=(0.9, 0.9, 0.9)))
    rough, smooth = (one.paint(ASLANT, *SIZE, samples=samples).astype(float) for samples in (1, 3))
    np.testing.assert_allclose(rough.mean(axis=(0, 1)), smooth.mean(axis=(0, 1)), atol=1.0)
    assert np.abs(rough - smooth).max() > 20.0
    # The steepest step from pixel to pixel lies on the box's edges.
    assert np.abs(np.diff(smooth, axis=1)).max() < np.abs(np.diff(rough, axis=1)).max()
    fine = one.paint(ASLANT, 3 * SIZE[0], 3 * SIZE[1]).astype(float)
    blocks = fine.reshape(SIZE[1], 3, SIZE[0], 3, 3).mean(axis=(1, 3))
    assert np.abs(blocks - smooth).mean() < 1.0


def test_water_reflects_the_sky():
    low = Viewpoint((-9.0, 0.0, 0.5), (0.0, 0.0, 0.3), 0.6)
    brown = (0.25, 0.18, 0.12)
    sheets = [box(0.0, 0.0, 8.0, 8.0, 0.05, colour=brown, solid=solid) for solid in (True, False)]
    dry, wet = (painter(sheet, shadows=False).paint(low, *SIZE)[44, 30:66].mean(axis=0) for sheet in sheets)
    sky = painter().paint(low, *SIZE)[30].mean(axis=0)
    # Looked at aslant it is nearly all sky; from above it is hardly any.
    assert np.linalg.norm(wet - sky) < 0.7 * np.linalg.norm(dry - sky)
    assert wet[2] > wet[0] and dry[2] < dry[0]
    dry, wet = (painter(sheet, shadows=False).paint(ABOVE, 9, 9)[4, 4].astype(float) for sheet in sheets)
    np.testing.assert_allclose(wet, dry, atol=25.0)


def test_a_body_is_where_it_stands_and_hides_behind_walls():
    wall = box(0.0, 0.0, 0.3, 6.0, 2.0)
    # The sun stands behind the eye, so that the shadow falls behind the wall as well.
    view, light = Viewpoint((-6.0, 0.0, 1.0), (0.0, 0.0, 1.0)), {"sun_bearing_rad": np.pi}
    one = painter(wall, **light)
    empty = one.paint(view, *SIZE)
    np.testing.assert_array_equal(one.paint(view, *SIZE, [body(1.5, 0.0, 0.5)]), empty)
    before = one.paint(view, *SIZE, [body(-2.0, 0.0, 1.0)])
    red = before[..., 0].astype(int) - before[..., 1] > 40
    rows, columns = np.nonzero(red)
    # Its front is half a metre wide, a metre high and 3.75 m away.
    focal_px = SIZE[0] / 2 / np.tan(view.fov_rad / 2)
    assert np.ptp(columns) + 1 == pytest.approx(focal_px * 0.5 / 3.75, abs=1.1)
    assert np.ptp(rows) + 1 == pytest.approx(focal_px * 1.0 / 3.75, abs=1.1)
    assert columns.mean() == pytest.approx(SIZE[0] / 2 - 0.5, abs=0.6)
    assert rows.mean() == pytest.approx(SIZE[1] / 2 - 0.5, abs=0.6)
    # Of two, the nearer is seen, whichever comes first.
    blue = body(-3.0, 0.0, 1.0, colour=(0.1, 0.2, 0.8))
    both = [one.paint(view, *SIZE, order) for order in ([blue, body(-2, 0, 1)], [body(-2, 0, 1), blue])]
    np.testing.assert_array_equal(*both)
    assert both[0][36, 48, 2] > both[0][36, 48, 0] + 40


@settings(max_examples=60)
@given(
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.lists(st.floats(-3, 3), min_size=3, max_size=3),
)
def test_no_ray_and_no_shadow_of_a_body_is_left_out(position, quaternion, eye):
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    one = Body(BLOCK, np.array(position), rotation)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(300, 3))
    # Half of them toward it.
    directions[::2] = one.centre - eye + rng.normal(0.0, 0.5, (150, 3))
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    start = np.asarray(eye, np.float32)
    hit = one.hits(np.tile(start, (300, 1)), directions, np.full(300, 99.0, np.float32))
    assert set(np.flatnonzero(hit.face >= 0)) <= set(one.rays_near(start, directions))
    met = np.flatnonzero(hit.face >= 0)
    corners = (one.shape.vertices @ rotation.T)[one.shape.faces[hit.face[met]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(hit.normal[met], normals, atol=1e-4)
    # The same lines as sunbeams, each to its own point.
    points = (one.centre + rng.normal(0.0, 1.5, (300, 3))).astype(np.float32)
    to_sun = directions[0]
    blocked = one.blocks(points, np.tile(to_sun, (300, 1)))
    assert set(np.flatnonzero(blocked)) <= set(one.points_in_shadow_of(points, to_sun))


BLOCK = block(size=(0.5, 0.7, 1.0))


# -- the rover from behind ----------------------------------------------------------------------------


def pictures_in(world: World, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Pictures:
    """Of a rover that stands at (`x`, `y`) in `world`, alone."""
    batch = copy(flat_batch())
    batch.world, batch.motion = world, Motion(1, batch.robot)
    batch.goals_w = np.array([[3.0, 0.0]])
    stand(batch, x, y, yaw)
    return Pictures(batch)


@cache
def flat_batch() -> Batch:
    """One rover alone; its physics is over, since nothing moves in a picture."""
    batch = real_batch("flat", sensors=["goal"])
    batch.close()
    return batch


def stand(batch: Batch, x: float, y: float, yaw: float) -> None:
    z = float(batch.world.terrain.height([x, y])) + 0.125
    batch.motion.set_row(0, (x, y, z, *about([0, 0, 1], yaw), *[0.0] * 6))
    batch.motion.begin(np.array([True]))


def eye_behind(pictures: Pictures, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Where the picture from behind is taken from, (3,)."""
    views: list[Viewpoint] = []
    with monkeypatch.context() as patch:
        patch.setattr(pictures, "seen", lambda view, *_: views.append(view))
        pictures.from_behind()
    return np.array(views[0].eye)


def in_sight(pictures: Pictures, eye: np.ndarray, position: np.ndarray) -> bool:
    """Whether nothing stands between `eye` and what is a little over the rover."""
    rays = baked(pictures._batch.world, LightConf()).rays
    towards = eye - position
    length = float(np.linalg.norm(towards))
    return bool(rays.first_hit(position[None], (towards / length)[None], length)[0][0] >= length - 1e-4)


def test_the_view_from_behind_shows_the_rover_in_the_middle(monkeypatch):
    pictures = pictures_in(plain(), 1.0, -2.0, 0.8)
    picture = pictures.from_behind(0, *SIZE)
    monkeypatch.setattr(pictures, "bodies", lambda scene: [])
    changed = (picture != pictures.from_behind(0, *SIZE)).any(axis=-1)
    rows, columns = np.nonzero(changed)
    assert changed.sum() > 200
    assert abs(np.median(columns) - SIZE[0] / 2) < SIZE[0] / 8
    assert np.median(rows) > SIZE[1] / 2
    # The top plate is orange.
    red, _, blue = picture[changed].astype(int).T
    assert (red - blue > 60).sum() > 30


@pytest.mark.parametrize("yaw", [0.0, 2.0, -1.3])
def test_the_view_is_from_behind_and_above_and_looks_ahead(yaw, monkeypatch):
    eye = eye_behind(pictures_in(plain(), 1.0, -2.0, yaw), monkeypatch)
    back = turned(yaw).T @ (eye - [1.0, -2.0, 0.125])
    assert back[0] < -2.0 and abs(back[1]) < 1e-6 and back[2] > 1.0


@pytest.mark.parametrize(
    "behind_m",
    [
        0.4,
        0.8,
        1.2,
        2.0,
        2.7,
        4.0,
    ],
)
def test_the_view_is_never_from_behind_a_wall(behind_m, monkeypatch):
    pictures = pictures_in(plain(box(-behind_m - 0.1, 0.0, 0.2, 6.0, 3.0)))
    eye = eye_behind(pictures, monkeypatch)
    assert eye[0] > -behind_m
    assert in_sight(pictures, eye, np.array([0.0, 0.0, 0.575]))
    if behind_m > 3.0:
        np.testing.assert_allclose(eye, eye_behind(pictures_in(plain()), monkeypatch))


def test_the_view_is_never_from_inside_the_ground(monkeypatch):
    rng = np.random.default_rng(3)
    world = plain(heights=rng.normal(0.0, 0.8, (11, 11)))
    pictures, nearest = pictures_in(world), []
    for x, y, yaw in rng.uniform([-8, -8, -3], [8, 8, 3], (200, 3)):
        stand(pictures._batch, x, y, yaw)
        eye = eye_behind(pictures, monkeypatch)
        nearest.append(eye[2] - float(world.terrain.height(eye[:2])))
    assert min(nearest) > 0.3
    # Some of them had to give way.
    assert min(nearest) < 0.5


def test_a_scene_shows_the_rover_its_actors_and_the_goal():
    walk = ActorConf(waypoints=((-3.0, 3.0), (3.0, 3.0)))
    batch = real_batch("flat", 2, actors=[walk.model_dump()], sensors=["goal"])
    batch.step(idle(batch))
    pictures = Pictures(batch)
    for scene in (0, 1):
        *rover, actor, flag = pictures.bodies(scene)
        assert len(rover) == 5
        np.testing.assert_allclose(rover[0].position, batch.motion.position_w[scene])
        np.testing.assert_allclose(rover[0].rotation, batch.motion.rotation[scene])
        x, y, z, yaw = batch.actors.poses[scene, 0]
        np.testing.assert_allclose(actor.position, [x, y, z])
        np.testing.assert_allclose(actor.rotation, turned(yaw), atol=1e-12)
        np.testing.assert_allclose(flag.position, [*batch.goals_w[scene], 0.0])
        view = Viewpoint((x - 3.0, y, 1.0), (x, y, 1.0))
        orange = pictures.seen(view, scene, *SIZE)[30:42, 46:50].reshape(-1, 3).astype(int)
        assert ((orange[:, 0] - orange[:, 2]) > 60).any()
        assert (pictures.from_behind(scene, *SIZE) != pictures.from_behind(1 - scene, *SIZE)).any()
    batch.close()


def test_the_place_is_seen_whole_from_above():
    pictures = pictures_in(plain(box(4.0, 4.0, 3.0, 3.0, 3.0, colour=(0.9, 0.1, 0.1))))
    seen = pictures.of_the_place(0, *SIZE, samples=1)
    assert seen.shape == (72, 96, 3) and seen.dtype == np.uint8
    red = seen[..., 0].astype(int) - seen[..., 1] > 40
    assert red.sum() > 20
    # From the other side the box lies on the other hand.
    other = pictures.of_the_place(0, *SIZE, samples=1, bearing_rad=-2.3 + np.pi)
    assert (other != seen).any()
    row = np.nonzero(other[..., 0].astype(int) - other[..., 1] > 40)[0].mean()
    assert np.nonzero(red)[0].mean() < row - 5
    assert seen[0, :, 2].mean() > seen[0, :, 0].mean()
    assert pictures.of_the_place(0, *SIZE).shape == (72, 96, 3)


# -- render -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [dune_rl.parallel_env, dune_rl.gym_env])
def test_render_gives_a_picture_where_it_was_asked_for(make):
    env, blind = (make("flat", sensors=["goal"], render_mode=mode) for mode in ("rgb_array", None))
    for each in (env, blind):
        each.reset(seed=1)
    first = env.render()
    assert first.shape == (480, 640, 3) and first.dtype == np.uint8
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 1000
    assert blind.render() is None
    assert (env.render_mode, blind.render_mode) == ("rgb_array", None)
    env.reset(seed=2)
    assert (env.render() != first).any()
    # Looking changes nothing.
    env.reset(seed=1)
    np.testing.assert_array_equal(env.render(), first)
    action = np.array([1.0, 0.3], np.float32)
    given = action if make is dune_rl.gym_env else {"rover_0": action}
    for _ in range(3):
        assert difference(list(env.step(given)), list(blind.step(given))) is None
        env.render()
    env.close()
    blind.close()


@pytest.mark.parametrize("make", [dune_rl.parallel_env, dune_rl.gym_env])
def test_an_unknown_way_to_render_is_refused_in_words(make):
    with pytest.raises(ConfigError) as refused:
        make("flat", render_mode="human")
    assert str(refused.value) == "render_mode must be 'rgb_array' or None (got 'human')"


def test_gymnasium_s_own_wrappers_can_render():
    env = gymnasium.make("dune_rl/Flat-v0", render_mode="rgb_array", physics={"control_hz": 10})
    env.reset(seed=0)
    assert env.render().shape == (480, 640, 3)
    assert env.unwrapped.metadata["render_fps"] == 10
    env.close()


# -- the robot's own shape ----------------------------------------------------------------------------

# Two bent joints in a row, off their links' middles, and every shape that can be drawn.
CRANE = """<?xml version="1.0"?>
<robot name="crane">
  <material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
  <link name="mast">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><geometry><box size="0.2 0.4 0.6"/></geometry>
      <material name="red"/></visual>
  </link>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0 0 0.5"/><geometry><cylinder radius="0.1" length="1.0"/></geometry>
      <material name="green"><color rgba="0.1 0.7 0.2 1"/></material></visual>
  </link>
  <link name="hook">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><sphere radius="0.15"/></geometry></visual>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="arm"/><child link="hook"/><origin xyz="0 0.1 1" rpy="0.3 0.2 -0.9"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <joint name="shoulder" type="continuous">
    <parent link="mast"/><child link="arm"/><origin xyz="0.2 0 0.6" rpy="1.1 -0.7 2.0"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""


@pytest.fixture(params=["rover", "crane"])
def urdf(request, tmp_path: Path) -> Path:
    if request.param == "rover":
        return ROVER_URDF
    path = tmp_path / "crane.urdf"
    path.write_text(CRANE)
    return path


def test_links_are_where_pybullet_has_them(urdf):
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    position = np.array([1.0, -2.0, 0.5])
    client = pybullet.connect(pybullet.DIRECT)
    try:
        robot = pybullet.loadURDF(str(urdf), position.tolist(), quaternion.tolist(), physicsClientId=client)
        joints, poses = {}, {-1: (position, rotation_matrices(quaternion))}
        for index in range(pybullet.getNumJoints(robot, physicsClientId=client)):
            name = pybullet.getJointInfo(robot, index, physicsClientId=client)[1].decode()
            joints[name] = rng.uniform(-2.0, 2.0)
            pybullet.resetJointState(robot, index, joints[name], physicsClientId=client)
        for index in range(len(joints)):
            state = pybullet.getLinkState(robot, index, computeForwardKinematics=True, physicsClientId=client)
            poses[index] = np.array(state[4]), rotation_matrices(np.array(state[5]))
        shapes = pybullet.getVisualShapeData(robot, physicsClientId=client)
    finally:
        pybullet.disconnect(client)
    found = RobotVisual(urdf).bodies(position, rotation_matrices(quaternion), joints)
    assert len(found) == len(poses)
    for where, turn in poses.values():
        nearest = min(found, key=lambda each: np.linalg.norm(each.position - where))
        np.testing.assert_allclose(nearest.position, where, atol=1e-5)
        np.testing.assert_allclose(nearest.rotation, turn, atol=1e-5)
        link = next(i for i, (at, _) in poses.items() if at is where)
        _same_shape(nearest, [shape for shape in shapes if shape[1] == link])


def _same_shape(drawn: Body, shapes: list[tuple]) -> None:
    """The drawn link is as large as PyBullet's visual shapes say, in its own frame, and of their colours."""
    if any(shape[2] == pybullet.GEOM_MESH for shape in shapes):
        # PyBullet tells the scale of a mesh, and no size.
        return
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for _, _, kind, size, _, at, turn, _, *_ in shapes:
        half = {
            pybullet.GEOM_BOX: np.array(size) / 2,
            pybullet.GEOM_CYLINDER: np.array([size[1], size[1], size[0] / 2]),
            pybullet.GEOM_SPHERE: np.full(3, size[0]),
        }[kind]
        axes = rotation_matrices(np.array(turn))
        if kind == pybullet.GEOM_BOX:
            reach = np.abs(axes) @ half
        elif kind == pybullet.GEOM_SPHERE:
            reach = half
        else:
            reach = np.hypot(*(np.abs(axes[:, k]) * half[k] for k in (0, 1))) + np.abs(axes[:, 2]) * half[2]
        low, high = np.minimum(low, np.array(at) - reach), np.maximum(high, np.array(at) + reach)
    vertices = drawn.shape.vertices
    # Round things are drawn with flat sides.
    np.testing.assert_allclose(vertices.min(axis=0), low, atol=2e-3)
    np.testing.assert_allclose(vertices.max(axis=0), high, atol=2e-3)
    # What has no colour is grey here and white there.
    colours = {tuple(np.round(linear(np.array(shape[7][:3])), 4)) for shape in shapes}
    drawn_in = {tuple(np.round(colour, 4)) for colour in drawn.shape.albedo.astype(float)}
    if (1.0, 1.0, 1.0) not in colours:
        np.testing.assert_allclose(sorted(drawn_in), sorted(colours), atol=2e-4)


def test_joint_angles_turn_the_wheels_and_nothing_else():
    visual = RobotVisual(ROVER_URDF)
    still = visual.bodies(np.zeros(3), np.eye(3))
    turned_by = visual.bodies(np.zeros(3), np.eye(3), {"front_left_wheel_joint": 0.7})
    moved = [not np.allclose(a.rotation, b.rotation) for a, b in zip(still, turned_by, strict=True)]
    assert sum(moved) == 1
    wheel = turned_by[moved.index(True)]
    np.testing.assert_allclose(wheel.position, [0.1415, 0.18, 0.0])
    np.testing.assert_allclose(wheel.rotation, rotation_matrices(about([0, 1, 0], 0.7)), atol=1e-9)
    for one, other in zip(still, turned_by, strict=True):
        np.testing.assert_allclose(one.position, other.position)


def test_shapes_that_cannot_be_drawn_are_refused_in_words(tmp_path: Path):
    path = tmp_path / "robot.urdf"
    path.write_text(CRANE.replace('<sphere radius="0.15"/>', '<capsule radius="0.1" length="1"/>'))
    with pytest.raises(
        ValueError, match=r"a visual <capsule> cannot be drawn; use box, cylinder, sphere or mesh"
    ):
        RobotVisual(path)
