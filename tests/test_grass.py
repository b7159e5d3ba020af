"""Tall grass: what beams, pixels and rovers meet in it, against formulae and against slow sums."""

import numpy as np
import pytest
from batches import idle, real_batch
from instruments import moment
from mounted import camera_conf, depth_strip_conf, lidar_3d_conf, lidar_conf
from planted.puppets import puppet_batch
from scenes import Stage, every_backend

from dune_rl.actors.actor import ActorConf
from dune_rl.actors.shapes import figures
from dune_rl.config.compose import compose
from dune_rl.errors import ConfigError
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.air import Air
from dune_rl.rendering.foliage import Foliage
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.picture import Painter, Viewpoint
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import Camera
from dune_rl.sensors.depth_strip import DepthStrip
from dune_rl.sensors.lidar_3d import Lidar3d
from dune_rl.sensors.medium import InGrass
from dune_rl.worlds.appearance import baked
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.grass import Grass, grow
from dune_rl.worlds.inspection import InspectionConf, build_inspection
from dune_rl.worlds.solid_look import solid_look
from dune_rl.worlds.world import World

PLAIN = HeightField(np.zeros((21, 21)), 1.0, (-10.0, -10.0))
FULL = np.ones((80, 80), np.float32)
TALL_M, EXTINCTION, BEAM_EXTINCTION = 0.6, 2.5, 2.0
EVERYWHERE = Foliage(PLAIN, FULL, TALL_M, EXTINCTION, BEAM_EXTINCTION)
# Full grass where x > 2, from 2 cells before it on interpolated.
AHEAD = FULL * (np.arange(80) >= 48)
NOBODY = np.zeros((1, 0, 4))
SMALL = {"name": "flat", "size_m": 20.0, "region_size_m": 6.0}
STANDING = np.array([[0.0, 0.0, 0.125]])
LEVEL = np.eye(3)[None]


def rays(origins, directions):
    directions = np.atleast_2d(np.asarray(directions, float))
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.atleast_2d(np.asarray(origins)).astype(np.float32), directions.astype(np.float32)


def far(count: int, range_m: float = 30.0) -> np.ndarray:
    return np.full(count, range_m, np.float32)


# -- the medium --------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [0.05, 1.0, 4.0])
def test_a_beam_ends_where_its_path_has_the_depth_that_is_asked_for(depth):
    origins, directions = rays([0.0, 0.0, 0.3], [[1, 0, 0], [0.6, -0.8, 0.0]])
    met = EVERYWHERE.beam_ranges(origins, directions, far(2), far(2, depth))
    np.testing.assert_allclose(met, depth / BEAM_EXTINCTION, rtol=1e-5)


def test_what_is_solid_ends_the_path():
    origins, directions = rays([0.0, 0.0, 0.3], [1, 0, 0])
    depth = far(1, 1.0 * BEAM_EXTINCTION)
    assert np.isinf(EVERYWHERE.beam_ranges(origins, directions, far(1, 0.99), depth))
    assert EVERYWHERE.beam_ranges(origins, directions, far(1, 1.01), depth) == pytest.approx(1.0)


@pytest.mark.parametrize("down", [0.2, 1.0])
def test_from_above_the_path_begins_at_the_tips(down):
    origins, directions = rays([0.0, 0.0, 2.0], [1.0, 0.0, -down])
    met = EVERYWHERE.beam_ranges(origins, directions, far(1), far(1, 1.0))
    assert met[0] == pytest.approx((2.0 - TALL_M) / -directions[0, 2] + 1.0 / BEAM_EXTINCTION, abs=0.04)


def test_rays_over_the_tips_pass():
    origins, directions = rays([0.0, 0.0, TALL_M + 0.01], [[1, 0, 0], [1, 0, 0.3], [0, 0, 1]])
    assert (EVERYWHERE.veil(origins, directions, far(3)).passed == 1.0).all()
    assert np.isinf(EVERYWHERE.beam_ranges(origins, directions, far(3), far(3, 1e-3))).all()


def hilly_patches() -> tuple[HeightField, np.ndarray]:
    rng = np.random.default_rng(3)
    terrain = HeightField(rng.uniform(0.0, 0.8, (21, 21)), 1.0, (-10.0, -10.0))
    density = np.clip(rng.normal(-0.2, 0.5, (40, 40)), 0.0, 1.0).astype(np.float32)
    return terrain, density


def slow_depths(terrain, density, origins, directions, ranges) -> np.ndarray:
    """Optical depth per unit of extinction, summed over 4,000 points of each ray."""
    share = (np.arange(4000) + 0.5) / 4000
    points = origins + directions[:, None] * (ranges[:, None] * share)[..., None]
    rows, columns = density.shape
    xmin, xmax, ymin, ymax = terrain.extent
    at = np.stack(
        [(points[..., 1] - ymin) / (ymax - ymin) * rows, (points[..., 0] - xmin) / (xmax - xmin) * columns]
    )
    at = np.clip(at - 0.5, 0.0, np.array([rows - 1, columns - 1])[:, None, None])
    low = np.minimum(at.astype(int), [[[rows - 2]], [[columns - 2]]])
    v, u = at - low
    row, column = low
    found = (density[row, column] * (1 - u) + density[row, column + 1] * u) * (1 - v)
    found += (density[row + 1, column] * (1 - u) + density[row + 1, column + 1] * u) * v
    inside = points[..., 2] < terrain.height(points[..., :2]) + TALL_M
    return (found * inside).mean(axis=1) * ranges


def test_leaping_over_what_is_bare_misses_no_patch():
    terrain, density = hilly_patches()
    solid = RayScene(*terrain.mesh())
    rng = np.random.default_rng(4)
    yaw, up = rng.uniform(-np.pi, np.pi, 400), rng.uniform(-0.4, 0.2, 400)
    origins, directions = rays([0.3, -0.2, 1.2], np.stack([np.cos(yaw), np.sin(yaw), up], axis=1))
    ranges = far(400, 12.0)
    solid.shorten(origins, directions, ranges)
    expected = slow_depths(terrain, density, origins, directions, ranges)
    foliage = Foliage(terrain, density, TALL_M, 1.0, 1.0)
    for depth in (0.2, 0.6):
        met = foliage.beam_ranges(origins, directions, ranges, far(400, depth))
        reached = np.isfinite(met)
        # What lies before the beam's end is the depth asked for, and all there is where there is none.
        np.testing.assert_allclose(
            slow_depths(terrain, density, origins, directions, met.clip(max=99.0))[reached], depth, atol=0.08
        )
        assert (expected[~reached] < depth + 0.08).all()
        assert (expected[reached] > depth - 0.08).all()
        assert 40 < reached.sum() < 360
    passed = foliage.veil(origins, directions, ranges).passed
    assert np.abs(-np.log(passed) - expected)[passed > 0.02].mean() < 0.03


@pytest.mark.parametrize("tufts", [False, True])
def test_a_veil_lets_light_pass_by_its_path(tufts):
    origins, directions = rays(
        [0.2, 0.1, 0.2], np.stack([np.ones(64), np.linspace(-1, 1, 64), np.zeros(64)], 1)
    )
    veil = EVERYWHERE.veil(origins, directions, far(64, 0.4), tufts=tufts)
    # Single tufts hide more or less; their mean is that of the whole.
    assert -np.log(veil.passed).mean() == pytest.approx(0.4 * EXTINCTION, rel=0.15 if tufts else 1e-4)
    assert np.ptp(veil.passed) > 0.05 if tufts else np.ptp(veil.passed) < 1e-5
    assert ((veil.distance > 0.0) & (veil.distance < 0.4)).all()
    seen = np.isfinite(veil.range)
    assert ((veil.passed <= 0.5) == seen).all()


def test_a_ray_from_nowhere_meets_nothing():
    origins = np.full((1, 3), np.nan, np.float32)
    veil = EVERYWHERE.veil(origins, np.eye(3, dtype=np.float32), far(3))
    assert (veil.passed == 1.0).all()


# -- where it grows ----------------------------------------------------------------------------------


@pytest.mark.parametrize("cover", [0.05, 0.3, 0.8])
def test_it_covers_the_share_that_is_asked_for(cover):
    grass = grow(PLAIN, (), cover, 0.4, seed=2)
    assert (grass.density > 0.0).mean() == pytest.approx(cover, abs=1e-3)
    assert grass.density.max() <= 1.0
    again, other = (grow(PLAIN, (), cover, 0.4, seed=seed) for seed in (2, 3))
    np.testing.assert_array_equal(again.density, grass.density)
    assert (other.density != grass.density).any()


def test_none_is_none():
    assert grow(PLAIN, (), 0.0, 0.4, seed=2) is None
    assert build_inspection(InspectionConf()).grass is None


def test_it_grows_on_nothing_that_stands_or_lies_there():
    world = build_inspection(InspectionConf(seed=1, grass_cover=1.0))
    grass = world.grass
    assert 0.6 < (grass.density > 0.0).mean() < 0.95
    kinds = set()
    rng = np.random.default_rng(0)
    for prop in world.props:
        corners = prop.vertices[prop.faces]
        weights = rng.dirichlet([1.0, 1.0, 1.0], (8, len(corners)))
        points = np.einsum("kfc,fci->kfi", weights, corners).reshape(-1, 3)
        points = points[points[:, 2] > world.terrain.height(points[:, :2])]
        assert (grass.foliage.density_at(points) == 0.0).all(), prop.name
        kinds.add((prop.solid, prop.drivable))
    assert kinds == {(True, False), (True, True), (False, False)}


def test_it_is_no_obstacle():
    bare, grown = (build_flat(FlatConf(size_m=20.0, grass_cover=cover)) for cover in (0.0, 0.9))
    assert grown.clearance([[0.0, 0.0]]) == np.inf
    np.testing.assert_array_equal(grown.solid_mesh().vertices, bare.solid_mesh().vertices)
    without, within = (real_batch({**SMALL, "grass_cover": cover}, 2, seed=4) for cover in (0.0, 0.9))
    np.testing.assert_array_equal(without.motion.position_w, within.motion.position_w)
    np.testing.assert_array_equal(without.goals_w, within.goals_w)
    for batch in (without, within):
        batch.close()


def test_impossible_grass_is_refused():
    for density, height, message in (
        (FULL * 1.5, 0.6, "density must be between 0 and 1"),
        (FULL * np.nan, 0.6, "density must be between 0 and 1"),
        (FULL[0], 0.6, "density must be a grid"),
        (FULL, 0.0, "height_m must be positive, not 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            Grass(PLAIN, density, height)
    with pytest.raises(ConfigError) as caught:
        compose(["+world=inspection", "world.grass_cover=1.5", "world.grass_height_m=0"])
    assert str(caught.value).splitlines() == [
        "world.grass_cover must be at most 1.0 (got 1.5)",
        "world.grass_height_m must be above 0.0 (got 0)",
    ]


# -- what sensors make of it -------------------------------------------------------------------------


def standing(episodes, steps, seed: int = 5):
    now = moment(episodes, steps, seed)
    now.position_w[:] = STANDING
    return now


def in_grass(beams: int = 2000) -> InGrass:
    yaw = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    directions = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(beams)], axis=1)
    return InGrass(EVERYWHERE, "lidar", directions, (0.0, 0.0, 0.2), 0.1)


def test_beams_pass_by_chance_and_path_length():
    seen = in_grass().applied(np.full((2, 2000), 1.5, np.float32), standing([0, 1], 0))
    assert (seen == 1.5).mean() == pytest.approx(np.exp(-1.5 * BEAM_EXTINCTION), abs=0.012)
    assert (seen > 0.5).mean() == pytest.approx(np.exp(-0.5 * BEAM_EXTINCTION), abs=0.025)
    assert seen.min() == np.float32(0.1)


def test_blades_flicker_as_the_moment_says():
    effect, true = in_grass(), np.full((2, 2000), 3.0, np.float32)
    seen = effect.applied(true, standing([4, 9], [1, 5]))
    assert effect.applied(true, standing([4, 9], [1, 5])).tobytes() == seen.tobytes()
    assert effect.applied(true[:1], standing([9], [5])).tobytes() == seen[1].tobytes()
    for other in (standing([9], [6]), standing([8], [5]), standing([9], [5], seed=6)):
        assert not np.array_equal(effect.applied(true[:1], other)[0], seen[1])


def ahead_world() -> World:
    return World("ahead", PLAIN, region=(-4, 4, -4, 4), grass=Grass(PLAIN, AHEAD, 1.0))


def test_rings_tell_grass_from_ground():
    world = ahead_world()
    solid = world.solid_mesh()
    conf = lidar_3d_conf(n_rings=8, n_beams=64, range_m=8.0, outputs=("range", "intensity", "segmentation"))
    lidar = Lidar3d(
        conf,
        RayScene(solid.vertices, solid.faces),
        solid_look(world),
        (),
        1,
        Air(foliage=world.grass.foliage),
    )
    lidar.begin(np.array([True]), standing([0], 0))
    found = {name.removeprefix("lidar_3d_"): value[0, ..., 0] for name, value in lidar.read().items()}
    green = found["segmentation"] == Segment.VEGETATION
    bare = lidar.scan(STANDING, LEVEL, NOBODY)["lidar_3d_range"][0, ..., 0]
    np.testing.assert_array_equal(green, found["range"] < bare)
    # Half of the beams look back, where there is none.
    assert green[:, 20:44].mean() > 0.5
    assert not green[:, :16].any()
    assert (found["intensity"][green] > 0.0).all()


def camera_in(world: World, air: Air, actors: tuple[ActorConf, ...] = ()) -> Camera:
    conf = camera_conf(width=16, height=16, range_m=50.0, outputs=("rgb", "depth", "segmentation", "normals"))
    return Camera(conf, baked(world, LightConf()), figures(actors), air)


def test_pixels_show_the_grass_that_takes_half_their_light():
    world = ahead_world()
    person = np.array([[[8.0, -0.26, 0.0, 0.0]]])
    bare = camera_in(world, Air(), (ActorConf(),)).frames(STANDING, LEVEL, person)
    seen = camera_in(world, Air(foliage=world.grass.foliage), (ActorConf(),)).frames(STANDING, LEVEL, person)
    level = (0, 7, 8, 0)
    assert bare["segmentation"][level] == Segment.ACTOR
    assert seen["segmentation"][level] == Segment.VEGETATION
    # Grass begins within a cell before x = 2; half the light is gone ln 2 / extinction later.
    assert seen["depth"][level] == pytest.approx(2.0 - 0.2 + np.log(2) / EXTINCTION, abs=0.25)
    green = seen["segmentation"] == Segment.VEGETATION
    assert (seen["depth"][green] <= bare["depth"][green]).all()
    untouched = (seen["depth"] == bare["depth"]) & ~green
    np.testing.assert_array_equal(seen["segmentation"][untouched], bare["segmentation"][untouched])
    np.testing.assert_array_equal(seen["normals"], bare["normals"])
    greener = [
        float((2.0 * each[..., 1] - each[..., 0] - each[..., 2]).mean())
        for each in (bare["rgb"][green[..., 0]].astype(float), seen["rgb"][green[..., 0]].astype(float))
    ]
    assert greener[1] > greener[0] + 10.0
    # High up there is sky as before.
    np.testing.assert_array_equal(seen["rgb"][0, 0], bare["rgb"][0, 0])


def test_a_depth_strip_ends_in_it():
    world = ahead_world()
    solid = world.solid_mesh()
    static = RayScene(solid.vertices, solid.faces)
    conf = depth_strip_conf(fov_rad=6.28, columns=32)
    bare, seen = (
        DepthStrip(conf, static, (), 1, air).depths(STANDING, LEVEL, NOBODY)[0]
        for air in (Air(), Air(foliage=world.grass.foliage))
    )
    assert (seen[12:20] < 3.0).all()
    np.testing.assert_array_equal(seen[:6], bare[:6])


def test_a_picture_shows_it():
    world = ahead_world()
    look = baked(world, LightConf())
    view = Viewpoint((-1.0, 0.0, 0.8), (3.0, 0.0, 0.5))
    bare, grown = (
        Painter(look, air).paint(view, 80, 60) for air in (Air(), Air(foliage=world.grass.foliage))
    )
    np.testing.assert_array_equal(Painter(look).paint(view, 80, 60), bare)
    assert (grown[:4] == bare[:4]).all()
    # It stands over the horizon.
    assert (grown[20:30, 20:60] != bare[20:30, 20:60]).all(axis=-1).mean() > 0.8


# -- what it does to rovers --------------------------------------------------------------------------


@every_backend
def test_a_push_accelerates_for_one_step(backend):
    stage = Stage(backend)
    stage.place([0.0, 0.0, 5.0])
    stage.scene.push([22.0, -11.0, 0.0])
    stage.step(10)
    # Its wheels hang below the chassis' centre by nothing, so that 11 kg move as one.
    np.testing.assert_allclose(stage.velocity[:2], [22 / 11 * 0.05, -0.05], rtol=0.02)
    before = stage.velocity[:2].copy()
    stage.step(10)
    np.testing.assert_allclose(stage.velocity[:2], before, atol=1e-3)
    stage.scene.push([22.0, 0.0, 0.0])
    stage.place([0.0, 0.0, 5.0])
    stage.step(10)
    np.testing.assert_allclose(stage.velocity[:2], 0.0, atol=1e-9)


@every_backend
def test_a_push_of_nothing_keeps_the_bytes(backend):
    states = []
    for push in (False, True):
        stage = Stage(backend)
        stage.place()
        for _ in range(5):
            if push:
                stage.scene.push([0.0, 0.0, 0.0])
            stage.step(10, 4.0)
        states.append(stage.state.tobytes())
    assert states[0] == states[1]


def test_the_force_is_against_the_motion_and_by_what_stands_in_grass():
    cover = {"name": "flat", "grass_cover": 1.0, "grass_height_m": 2.0}
    batch, (puppet,) = puppet_batch(world=cover)
    grass = batch.world.grass
    dense = np.unravel_index(grass.density.argmax(), grass.density.shape)
    xmin, _, ymin, _ = batch.world.extent
    x, y = (-xmin) * (2 * dense[1] + 1) / grass.density.shape[1], (-ymin) * (2 * dense[0] + 1) / 400
    puppet.put(xmin + x, ymin + y)
    puppet.state[7:10] = 0.5, -0.3, 0.1
    batch.step(idle(batch))
    batch.step(idle(batch))
    # The first push comes from where the rover had been put at the start, at rest.
    np.testing.assert_allclose(puppet.pushes[-1], -20.0 * np.array([0.5, -0.3, 0.1]), rtol=1e-4)
    puppet.state[2] = 0.125 + 2.0 - 0.127
    batch.step(idle(batch))
    batch.step(idle(batch))
    np.testing.assert_allclose(puppet.pushes[-1], -10.0 * np.array([0.5, -0.3, 0.1]), rtol=1e-3)
    bare, (other,) = puppet_batch()
    bare.step(idle(bare))
    assert other.pushes == []


def test_driving_through_it_takes_torque_and_costs_speed():
    drive = {"drive": {"max_torque_nm": 0.25}}
    speeds, torques = {}, {}
    for strong in (True, False):
        for cover in (0.0, 1.0):
            world = {**SMALL, "grass_cover": cover}
            settings = {} if strong else {"robot": drive}
            batch = real_batch(world, 1, sensors=["imu", "goal"], **settings)
            for _ in range(40):
                batch.step(np.array([[0.8, 0.0]], np.float32))
            speeds[strong, cover] = np.hypot(*batch.motion.velocity_w[0, :2])
            torques[strong, cover] = np.sum(batch._scenes[0].drive_state()[8:])
            batch.close()
    # Strong drives hold their speed, at the cost of what the grass takes; weak ones do not.
    assert speeds[True, 1.0] > 0.7
    assert torques[True, 1.0] > torques[True, 0.0] + 0.3
    assert 0.2 < speeds[False, 1.0] < speeds[False, 0.0] - 0.05


def test_scenes_in_grass_are_independent_and_repeat():
    settings = {"sensors": ["lidar", "camera", "imu", "goal"]}
    world = {**SMALL, "grass_cover": 0.5}
    seen = []
    for scenes in (1, 2):
        batch = real_batch(world, scenes, seed=3, **settings)
        for _ in range(3):
            batch.step(np.tile(np.array([[0.5, 0.2]], np.float32), (scenes, 1)))
        seen.append({name: value[0].tobytes() for name, value in batch.observe().items()})
        batch.close()
    assert seen[0] == seen[1]
    assert lidar_conf().n_segments * 4 == len(seen[0]["lidar"])
