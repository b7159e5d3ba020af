"""Colours, segments and light in a camera's pictures."""

import numpy as np
import pytest
from cameras import AHEAD, EVERYTHING, PERSON, Box, camera_in, look, plain, standing, with_boxes
from people import meshes_of
from PIL import Image
from scanning import turned
from sensors_of_rover_zero import camera_conf

from dune_rl.config.build import build_world
from dune_rl.rendering.baked_scenery import BakedScenery
from dune_rl.rendering.light import Light, LightConf
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import Camera
from dune_rl.worlds.appearance import build_scenery
from dune_rl.worlds.inspection.build import InspectionConf


@pytest.mark.slow
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


@pytest.mark.slow
def test_solar_panels_look_blue_and_the_ground_does_not():
    world = build_world(InspectionConf(seed=3))
    camera = camera_in(world, width=16, height=16, pitch_deg=90.0, mount_b=(0.0, 0.0, 0.0), fov_deg=17.0)
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


SUN_BEHIND = {"sun_bearing_deg": 180.0, "sun_elevation_deg": 17.0}
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
        light = LightConf(sun_bearing_deg=bearing, sun_elevation_deg=17.0)
        found = look(camera_in(with_boxes(WALL), light=light))
        return found["grey"][found["segmentation"] == Segment.OBSTACLE].mean()

    assert brightness(0.0) < brightness(126.0) < brightness(180.0)


def test_a_lower_sun_is_redder():
    def warmth(elevation: float) -> float:
        light = Light.from_conf(LightConf(sun_bearing_deg=180.0, sun_elevation_deg=elevation))
        camera = Camera(
            camera_conf(width=16, height=12),
            BakedScenery(build_scenery(with_boxes(WALL)), light),
            meshes_of(()),
        )
        red, _, blue = look(camera)["rgb"][6].mean(axis=0)
        return red / blue

    assert warmth(3.0) > 1.2 * warmth(52.0)
