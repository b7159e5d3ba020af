"""What sensors and pictures make of tall grass."""

import numpy as np
import pytest
from grass_samples import BEAM_EXTINCTION, EVERYWHERE, EXTINCTION, FULL, PLAIN
from people import meshes_of
from poses import seen_at
from sensor_contexts import context_of, rays_of
from sensors_of_rover_zero import camera_conf, depth_strip_conf, lidar_3d_conf
from states import begin, episode_state, write

from dune_rl.bodies.person import PersonConf
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.rendering.renderer import Renderer, Viewpoint
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import Camera
from dune_rl.sensors.depth_strip import DepthStrip
from dune_rl.sensors.lidar_3d import Lidar3d
from dune_rl.sensors.medium import InGrass
from dune_rl.worlds.appearance import bake_world, beam_surface
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.world import World

# Full grass where x > 2, from 2 cells before it on interpolated.
AHEAD = FULL * (np.arange(80) >= 48)
NOBODY = np.zeros((1, 0, 7))
STANDING = np.array([[0.0, 0.0, 0.125]])
LEVEL = np.eye(3)[None]


def standing(episodes, steps, seed: int = 5):
    now = episode_state(episodes, steps, seed)
    write(now.motion.position_w, ..., STANDING)
    return now


def in_grass(beams: int = 2000) -> InGrass:
    yaw = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    directions = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(beams)], axis=1)
    return InGrass(EVERYWHERE, "lidar", directions, (0.0, 0.0, 0.2), 0.1)


@pytest.mark.slow
def test_beams_pass_by_chance_and_path_length():
    seen = in_grass().applied(np.full((2, 2000), 1.5, np.float32), standing([0, 1], 0))
    assert (seen == 1.5).mean() == pytest.approx(np.exp(-1.5 * BEAM_EXTINCTION), abs=0.012)
    assert (seen > 0.5).mean() == pytest.approx(np.exp(-0.5 * BEAM_EXTINCTION), abs=0.025)
    assert seen.min() == np.float32(0.1)


@pytest.mark.slow
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
    conf = lidar_3d_conf(n_rings=8, n_beams=64, range_m=8.0, outputs=("range", "intensity", "segmentation"))
    air = ParticipatingMedia(foliage=world.grass.foliage)
    context = context_of(solid=rays_of(world), surfaces=beam_surface(world), air=air)
    lidar = Lidar3d("lidar_3d", context, conf)
    begin(lidar, np.array([True]), standing([0], 0))
    found = {name.removeprefix("lidar_3d_"): value[0, ..., 0] for name, value in lidar.read().items()}
    green = found["segmentation"] == Segment.VEGETATION
    bare = lidar.scan(STANDING, LEVEL, NOBODY)["lidar_3d_range"][0, ..., 0]
    np.testing.assert_array_equal(green, found["range"] < bare)
    # Half of the beams look back, where there is none.
    assert green[:, 20:44].mean() > 0.5
    assert not green[:, :16].any()
    assert (found["intensity"][green] > 0.0).all()


def camera_in(world: World, air: ParticipatingMedia, actors: tuple[PersonConf, ...] = ()) -> Camera:
    conf = camera_conf(width=16, height=16, range_m=50.0, outputs=("rgb", "depth", "segmentation", "normals"))
    return Camera(conf, bake_world(world, LightConf()), meshes_of(actors), air)


def test_pixels_show_the_grass_that_takes_half_their_light():
    world = ahead_world()
    person = seen_at([[[8.0, -0.26, 0.0, 0.0]]])
    bare = camera_in(world, ParticipatingMedia(), (PersonConf(),)).frames(STANDING, LEVEL, person)
    seen = camera_in(world, ParticipatingMedia(foliage=world.grass.foliage), (PersonConf(),)).frames(
        STANDING, LEVEL, person
    )
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
    static = rays_of(world)
    conf = depth_strip_conf(fov_deg=359.8, columns=32)
    bare, seen = (
        DepthStrip("depth_strip", context_of(solid=static, air=air), conf).depths(STANDING, LEVEL, NOBODY)[0]
        for air in (ParticipatingMedia(), ParticipatingMedia(foliage=world.grass.foliage))
    )
    assert (seen[12:20] < 3.0).all()
    np.testing.assert_array_equal(seen[:6], bare[:6])


def test_a_picture_shows_it():
    world = ahead_world()
    look = bake_world(world, LightConf())
    view = Viewpoint((-1.0, 0.0, 0.8), (3.0, 0.0, 0.5))
    bare, grown = (
        Renderer(look, air).render(view, 80, 60)
        for air in (ParticipatingMedia(), ParticipatingMedia(foliage=world.grass.foliage))
    )
    np.testing.assert_array_equal(Renderer(look).render(view, 80, 60), bare)
    assert (grown[:4] == bare[:4]).all()
    # It stands over the horizon.
    assert (grown[20:30, 20:60] != bare[20:30, 20:60]).all(axis=-1).mean() > 0.8
