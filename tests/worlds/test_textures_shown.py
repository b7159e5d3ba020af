"""Textures of imported worlds in pictures and cameras: at their places, upright, in the file's light."""

import re
import warnings

import numpy as np
import pytest
from gazebo import GROUND, sdf
from PIL import Image
from sensors_of_rover_zero import camera_conf
from textured_files import SIGN, quadrants, textured_yard, write_textured_yard
from world_files import ground_height

from dune_rl.core import untrusted_files
from dune_rl.core.untrusted_files import ImportReport, WorldWarning
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf, srgb_to_linear
from dune_rl.rendering.mesh_texture import MeshTexture, TextureSampler
from dune_rl.rendering.renderer import Renderer, Viewpoint
from dune_rl.rendering.weather import WeatherConf
from dune_rl.sensors.camera import Camera
from dune_rl.worlds.appearance import bake_in_weather, bake_world, build_scenery, with_own_sun
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf
from dune_rl.worlds.world import Prop, World

RED, GREEN, BLUE, YELLOW = (
    np.array(colour) / 255.0 for colour in [(220, 40, 40), (40, 180, 60), (40, 70, 210), (230, 200, 40)]
)
# The sun behind who looks along x, without shadows.
BEHIND = LightConf(sun_bearing_deg=180.0, sun_elevation_deg=29.0, shadows=False)
SIGN_FOOT = float(ground_height(np.array(SIGN)))


@pytest.fixture(scope="module", params=["glb", "obj"])
def yard(request, tmp_path_factory):
    path = write_textured_yard(tmp_path_factory.mktemp(request.param), request.param)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return build_mesh(MeshConf(path=str(path)))


def nearest(colour: np.ndarray) -> str:
    """Which of the four hues is meant, whatever the light."""
    hues = {"red": RED, "green": GREEN, "blue": BLUE, "yellow": YELLOW}
    unit = {name: srgb_to_linear(hue) / np.linalg.norm(srgb_to_linear(hue)) for name, hue in hues.items()}
    seen = srgb_to_linear(np.asarray(colour) / 255.0)
    return max(unit, key=lambda name: float(unit[name] @ seen))


@pytest.mark.slow(all_but=["glb"])
def test_a_picture_shows_a_sign_upright_and_the_right_way_round(yard):
    # Seen from lower x, left is greater y.
    view = Viewpoint((-3.0, 0.0, SIGN_FOOT + 1.0), (*SIGN, SIGN_FOOT + 1.0), 0.6)
    found = Renderer(bake_world(yard, BEHIND)).render(view, 64, 48)
    corners = [found[row, column] for row in (18, 30) for column in (20, 44)]
    assert [nearest(colour) for colour in corners] == ["red", "green", "blue", "yellow"]


@pytest.mark.slow
def test_a_camera_shows_it_too(yard):
    conf = camera_conf(outputs=("rgb",), width=64, height=48, fov_deg=34.0, mount_b=(0.0, 0.0, 0.0))
    camera = Camera(conf, bake_world(yard, BEHIND), ())
    # Of two scenes, the first looks away.
    turned = np.stack([np.diag([-1.0, -1.0, 1.0]), np.eye(3)])
    eye = np.tile([-3.0, 0.0, SIGN_FOOT + 1.0], (2, 1))
    away, found = camera.frames(eye, turned, np.zeros((2, 0, 7)))["rgb"]
    corners = [found[row, column] for row in (18, 30) for column in (20, 44)]
    assert [nearest(colour) for colour in corners] == ["red", "green", "blue", "yellow"]
    assert not (away == found).all()


def test_the_ground_shows_its_picture_where_it_lies(yard):
    albedo = build_scenery(yard).ground
    source = np.asarray(textured_yard()["Terrain"].visual.material.baseColorTexture, np.float32) / 255.0
    rows, columns = albedo.shape[:2]
    assert rows > 400 and columns > 500
    # Means over the same sixteenths of the ground, its first row being that of the lowest y.
    blocks = [(slice(r * rows // 4, (r + 1) * rows // 4), slice(c * columns // 4, (c + 1) * columns // 4))
              for r in range(4) for c in range(4)]  # fmt: skip
    south_first = srgb_to_linear(source[::-1])
    side = len(source) // 4
    for number, block in enumerate(blocks):
        r, c = divmod(number, 4)
        expected = south_first[r * side : (r + 1) * side, c * side : (c + 1) * side].mean(axis=(0, 1))
        np.testing.assert_allclose(albedo[block].mean(axis=(0, 1)), expected, atol=0.02)
    # And its stones and joints are not blurred away.
    stony = albedo[rows // 8 : rows // 4, : columns // 8, 0]
    assert stony.std() > 0.05


def test_pictures_and_plain_faces_stand_side_by_side():
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    texture = MeshTexture.from_uv(np.asarray(quadrants()), triangle[None], triangle[None, :, :2])
    settings = {"vertices": triangle, "faces": np.array([[0, 1, 2]], np.int32)}
    shown = Prop("a", "sign", **settings, texture=texture)
    coloured = Prop("b", "box", **settings, face_colours=np.array([[0.0, 1.0, 0.0]], np.float32))
    flat = HeightField(np.zeros((3, 3)), 1.0, (-1.0, -1.0))
    look = build_scenery(World("w", flat, [coloured, shown, coloured], region=(0, 1, 0, 1))).props
    np.testing.assert_array_equal(look.texture.picture, [-1, 0, -1])
    np.testing.assert_allclose(look.albedo, [[0, 1, 0], srgb_to_linear([0.6] * 3), [0, 1, 0]], atol=1e-6)
    assert build_scenery(World("w", flat, [coloured], region=(0, 1, 0, 1))).props.texture is None


def square(uv, picture=None) -> TextureSampler:
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]])
    picture = np.asarray(quadrants()) if picture is None else picture
    return TextureSampler(MeshTexture.from_uv(picture, corners, np.asarray(uv, float)[None]))


@pytest.mark.parametrize("smooth", [False, True])
def test_a_skin_is_looked_up_by_place_repeats_and_blurs_with_distance(smooth):
    look = square([[0, 0], [3, 0], [3, 3]])
    points = np.array(
        [[0.05, 0.05, 0], [0.05 + 1 / 3, 0.05, 0], [0.29, 0.29, 0], [0.05, 0.29, 0]], np.float32
    )
    found = look.albedo(np.zeros(4, int), points, 1e-4, smooth=smooth)
    np.testing.assert_allclose(found, srgb_to_linear(np.array([BLUE, BLUE, GREEN, RED])), atol=0.01)
    far = look.albedo(np.zeros(4, int), points, 10.0, smooth=smooth)
    np.testing.assert_allclose(far, np.tile(far[0], (4, 1)), atol=0.01)


@pytest.mark.parametrize(
    "uv",
    [
        [[0, 0], [np.nan, 0], [1, 1]],
        [[0, 0], [np.inf, 0], [1, 1]],
        [[0, 0], [1e30, 0], [1, 1]],
        [[0, 0], [5e4, 0], [1, 1]],
    ],
)
def test_coordinates_beyond_reason_leave_the_plain_colour(uv):
    assert not square(uv).textured.any()


def test_pictures_together_are_held_to_a_size():
    look = square([[0, 0], [1, 0], [1, 1]], np.full((600, 900, 3), 90, np.uint8))
    assert look.textured.all()
    small = TextureSampler(
        MeshTexture.from_uv(np.full((600, 900, 3), 90, np.uint8), np.eye(3)[None], np.zeros((1, 3, 2))),
        most_texels=1000,
    )
    assert len(small._texels) <= 2000
    np.testing.assert_allclose(
        small.albedo(np.zeros(1, int), np.eye(3)[:1], 1e-3), srgb_to_linear(90 / 255.0), atol=1e-3
    )


def test_textures_beyond_the_room_for_them_are_coarse_and_warned_of(monkeypatch):
    monkeypatch.setattr(untrusted_files, "_MOST_TEXELS", 100_000)
    report = ImportReport("w.glb")
    large = np.zeros((300, 300, 3), np.uint8)
    assert report.limit_texture(large).shape == (300, 300, 3)
    assert report.limit_texture(large).shape == (32, 32, 3)
    assert len(report.texts) == 1


@pytest.mark.slow(all_but=["*1"])
@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (lambda data: b"", "it is no picture"),
        (lambda data: data[: len(data) // 2], "it is no picture"),
        (lambda data: data[:60] + bytes(len(data) - 60), "it is no picture"),
    ],
)
def test_a_damaged_texture_is_a_warning_and_the_rest_is_shown(tmp_path, spoilt, said):
    path = write_textured_yard(tmp_path, "obj")
    paving = tmp_path / "paving.png"
    paving.write_bytes(spoilt(paving.read_bytes()))
    with pytest.warns(WorldWarning, match=said) as caught:
        world = build_mesh(MeshConf(path=str(path)))
    assert len([w for w in caught if re.search("paving", str(w.message))]) == 1
    assert world.picture is None
    assert build_scenery(world).props.texture is not None


def test_transparent_and_sixteen_bit_pictures_have_sound_colours():
    cut = np.zeros((8, 8, 4), np.uint8)
    cut[:4] = (60, 160, 40, 255)
    np.testing.assert_array_equal(
        untrusted_files.downscale_image(Image.fromarray(cut)), np.tile((60, 160, 40), (8, 8, 1))
    )
    grey = Image.fromarray(np.full((8, 8), 40_000, np.uint16))
    assert set(untrusted_files.downscale_image(grey).ravel().tolist()) == {40_000 >> 8}


SUN = '<light name="sun" type="directional"><direction>{}</direction><diffuse>{}</diffuse></light>'


def in_sun(folder, direction="-1 0 -1", colour="1 0.5 0.25 1"):
    (folder / "w.sdf").write_text(sdf(GROUND, SUN.format(direction, colour)))
    return build_sdf(SdfConf(path=str(folder / "w.sdf")))


def test_a_file_s_sun_shines_unless_the_weather_says_where_its_own_is(tmp_path):
    world = in_sun(tmp_path)
    light = bake_in_weather(world, WeatherConf()).light
    np.testing.assert_allclose(light.to_sun, [0.5**0.5, 0.0, 0.5**0.5], atol=1e-6)
    plain = bake_world(world, LightConf(sun_bearing_deg=0.0, sun_elevation_deg=45.0)).light
    np.testing.assert_allclose(light.sun, plain.sun * [1.0, 0.5, 0.25], rtol=1e-5)
    fog = with_own_sun(world, WeatherConf(fog_visibility_m=20.0))
    assert fog.light == world.light
    for own in (WeatherConf(time_of_day_h=9.0), WeatherConf(light=BEHIND)):
        assert with_own_sun(world, own) is own
    with pytest.warns(WorldWarning, match="is no colour of a light"):
        assert in_sun(tmp_path, colour="bright").light.sun_colour == (1.0, 1.0, 1.0)


def test_a_height_map_s_picture_is_laid_in_tiles_from_the_north_west(tmp_path):
    np.save(tmp_path / "h.npy", np.linspace(0.0, 1.0, 41 * 41).reshape(41, 41))
    quadrants().save(tmp_path / "four.png")
    shape = (
        "<heightmap><uri>h.npy</uri><size>20 20 1</size>"
        "<texture><diffuse>four.png</diffuse><size>{}</size></texture></heightmap>"
    )
    text = '<model name="m"><static>1</static><link name="l"><collision name="c"><geometry>{}</geometry>'
    text = sdf(text.format(shape) + "</collision></link></model>")

    def hues(size: float) -> list[str]:
        (tmp_path / "w.sdf").write_text(text.format(size))
        albedo = build_scenery(build_sdf(SdfConf(path=str(tmp_path / "w.sdf")))).ground
        n = len(albedo)
        encoded = np.sqrt(albedo) * 255
        return [nearest(encoded[r * n // 8, c * n // 8]) for r in (7, 5, 3, 1) for c in (1, 3, 5, 7)]

    whole = ["red", "red", "green", "green"] * 2 + ["blue", "blue", "yellow", "yellow"] * 2
    assert hues(20) == whole
    assert hues(10) == (["red", "green"] * 2 + ["blue", "yellow"] * 2) * 2
    with pytest.warns(WorldWarning, match="<size> of a <texture> is 0 m"):
        assert len(set(hues(0))) == 1
