"""Fog, dust and the sun's course: against formulae, and out of the way where there is none."""

import numpy as np
import pytest
from scanning import flat_with, lidar_in
from scipy import integrate
from sensor_contexts import context_of, rays_of
from sensors_of_rover_zero import camera_conf
from simulations import act, observation, started_simulation
from states import episode_state, state_of, write

from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import Light, LightConf, tone_map_to_srgb
from dune_rl.rendering.light import srgb_to_linear as decoded
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.rendering.renderer import Renderer, Viewpoint
from dune_rl.rendering.weather import Haze, WeatherConf, sun_position, weather_light
from dune_rl.sensors.camera import Camera
from dune_rl.sensors.lidar import LidarSensor
from dune_rl.sensors.medium import InHaze, effects_of
from dune_rl.worlds.appearance import bake_in_weather, bake_world
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

FOG = WeatherConf(fog_visibility_m=20.0)
CLEAR = WeatherConf()
NOBODY = np.zeros((1, 0, 7))
STANDING = np.array([[0.0, 0.0, 0.125]])
LEVEL = np.eye(3)[None]
RANGE_M = 12.0


def haze_of(weather: WeatherConf) -> Haze:
    haze = Haze.from_weather(weather)
    assert haze is not None
    return haze


# -- light -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("visibility", [5.0, 300.0])
def test_black_things_fade_to_two_percent_of_contrast(visibility):
    for haze in (
        haze_of(WeatherConf(fog_visibility_m=visibility)),
        haze_of(WeatherConf(dust_visibility_m=visibility)),
    ):
        seen = haze.blend_over(np.zeros((1, 3), np.float32), np.array([visibility], np.float32))
        np.testing.assert_allclose(1.0 - seen[0] / haze.colour, 0.02, rtol=1e-3)


def test_fog_and_dust_add_up():
    fog, dust = WeatherConf(fog_visibility_m=40.0), WeatherConf(dust_visibility_m=20.0)
    both = haze_of(WeatherConf(fog_visibility_m=40.0, dust_visibility_m=20.0))
    assert both.extinction == pytest.approx(haze_of(fog).extinction + haze_of(dust).extinction)
    mixed = (haze_of(fog).colour + 2 * haze_of(dust).colour) / 3
    np.testing.assert_allclose(both.colour, mixed, rtol=1e-5)
    assert Haze.from_weather(CLEAR) is None


def test_haze_takes_the_sun_and_covers_the_sky():
    clear, thin, fog = (
        weather_light(weather) for weather in (CLEAR, WeatherConf(fog_visibility_m=5_000.0), FOG)
    )
    plain = Light.from_conf(LightConf())
    for name in ("to_sun", "sun", "zenith", "horizon"):
        np.testing.assert_array_equal(getattr(clear, name), getattr(plain, name))
    assert (clear.sun > thin.sun).all()
    assert (thin.sun > 0.7 * clear.sun).all()
    assert fog.sun.max() < 1e-3
    np.testing.assert_allclose(fog.horizon, haze_of(FOG).colour, atol=1e-5)
    # Grey overhead, where the clear sky is blue.
    assert np.ptp(fog.zenith) < 0.5 * np.ptp(clear.zenith)


@pytest.mark.parametrize(
    ("hour", "bearing", "elevation"),
    [(12.0, -np.pi / 2, np.pi / 4), (9.0, -np.arctan2(np.sin(np.pi / 4), 1.0), np.pi / 6), (6.25, 0.0, 0.0)],
)
def test_the_sun_goes_from_east_over_south(hour, bearing, elevation):
    # At nine the hour angle is 45 degrees: east and up are sin 45° and cos² 45°.
    found = sun_position(hour)
    near = 0.08 if hour == 6.25 else 1e-9
    assert found == pytest.approx((bearing, elevation), abs=near)
    evening = sun_position(24.0 - hour)
    assert evening[1] == pytest.approx(found[1])
    assert np.sin(evening[0]) == pytest.approx(np.sin(found[0]))
    assert np.cos(evening[0]) == pytest.approx(-np.cos(found[0]), abs=1e-9)


def test_the_hour_moves_the_sun_and_nothing_else():
    weather = WeatherConf(time_of_day_h=17.0, light=LightConf(shadows=False))
    light = weather_light(weather)
    assert light.to_sun[0] < -0.9
    assert not light.shadows
    assert (
        light.sun[2] / light.sun[0]
        < 0.8 * Light.from_conf(LightConf()).sun[2] / Light.from_conf(LightConf()).sun[0]
    )


# -- cameras -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def world() -> World:
    terrain = HeightField(np.zeros((13, 13)), 5.0, (-30.0, -30.0))
    walls = [
        Prop(f"wall {x}", "wall", *upright_box((x, y), 0.0, -0.1, 2.0, 0.2, 3.0), colour=colour)
        for x, y, colour in ((6.0, 2.0, (0.1, 0.1, 0.1)), (15.0, -3.0, (0.5, 0.2, 0.1)))
    ]
    return World("walls", terrain, walls, region=(-4, 4, -4, 4))


OUTPUTS = ("rgb", "grey", "depth", "segmentation", "normals")


def pictures(look, air: ParticipatingMedia) -> dict[str, np.ndarray]:
    camera = Camera(camera_conf(width=24, height=24, outputs=OUTPUTS, range_m=60.0), look, (), air)
    return camera.frames(STANDING, LEVEL, NOBODY)


def test_a_camera_sees_through_haze_by_beer_and_lambert(world):
    haze, look = haze_of(FOG), bake_world(world, LightConf())
    clear, seen = pictures(look, ParticipatingMedia()), pictures(look, ParticipatingMedia(haze))
    for name in ("depth", "segmentation", "normals"):
        np.testing.assert_array_equal(seen[name], clear[name])
    # The depth is along the axis: the range is longer toward the edges.
    across = (np.arange(24) + 0.5 - 12) / 12 * np.tan(np.pi / 6)
    longer = np.sqrt(1.0 + across[:, None] ** 2 + across[None] ** 2)
    ranges = clear["depth"][0, ..., 0] * longer
    passed = np.exp(-3.912 / 20.0 * ranges)[..., None]
    colours = clear["rgb"][0] / 255.0
    # Up to a half in linear light, the screen's bytes tell it without compression.
    dark = (decoded(colours) < 0.5).all(axis=-1) & (clear["depth"][0, ..., 0] < 60.0)
    assert dark.sum() > 150
    expected = (
        tone_map_to_srgb((decoded(colours) * passed + haze.colour * (1.0 - passed)).astype(np.float32))
        * 255.0
    )
    np.testing.assert_allclose(seen["rgb"][0][dark], expected[dark], atol=2.0)
    assert np.abs(seen["rgb"][0][dark].astype(int) - clear["rgb"][0][dark]).mean() > 10.0
    sky = clear["depth"][0, ..., 0] == 60.0
    np.testing.assert_array_equal(seen["rgb"][0][sky], clear["rgb"][0][sky])


def test_the_sky_of_a_weather_has_its_haze(world):
    fog, clear = (
        pictures(bake_in_weather(world, weather), ParticipatingMedia(Haze.from_weather(weather)))["rgb"][
            0, 0, 0
        ].astype(int)
        for weather in (FOG, CLEAR)
    )
    assert np.ptp(fog) < 0.5 * np.ptp(clear)


def test_clear_air_keeps_the_bytes(world):
    look = bake_in_weather(world, CLEAR)
    assert look is bake_world(world, LightConf())
    plain = Camera(camera_conf(width=24, height=24, outputs=OUTPUTS, range_m=60.0), look, ())
    for name, picture in plain.frames(STANDING, LEVEL, NOBODY).items():
        np.testing.assert_array_equal(picture, pictures(look, ParticipatingMedia())[name])
    view = Viewpoint((0.0, 0.0, 1.0), (10.0, 0.0, 0.8))
    np.testing.assert_array_equal(
        Renderer(look).render(view, 48, 32), Renderer(look, ParticipatingMedia()).render(view, 48, 32)
    )
    assert effects_of(ParticipatingMedia(), "lidar", np.eye(3), (0.0, 0.0, 0.0), (0.1, 12.0)) == []


def test_large_pictures_fade(world):
    view = Viewpoint((0.0, 0.0, 1.0), (10.0, 0.0, 0.8))
    contrast = []
    for visibility in (None, 200.0, 15.0):
        weather = WeatherConf(fog_visibility_m=visibility)
        picture = Renderer(
            bake_in_weather(world, weather), ParticipatingMedia(Haze.from_weather(weather))
        ).render(view, 48, 32)
        contrast.append(float(picture.std()))
    assert contrast[0] > contrast[1] > contrast[2] > 0.0
    assert contrast[2] < 0.5 * contrast[0]


# -- LiDAR -------------------------------------------------------------------------------------------


def in_haze(visibility: float = 20.0, range_m: float = RANGE_M) -> InHaze:
    return InHaze(haze_of(WeatherConf(fog_visibility_m=visibility)).extinction, "lidar", range_m, 0.1)


def test_the_share_of_returns_is_that_of_photons_there_and_back():
    ranges = np.array([0.2, 2.0, 6.0, 11.9], np.float32)
    photons = (RANGE_M / ranges) ** 2
    left = photons * np.exp(-2 * 3.912 / 20.0 * ranges)
    expected = (1 - 0.5**left) / (1 - 0.5**photons)
    np.testing.assert_allclose(in_haze().return_share(ranges), expected, rtol=1e-4)
    assert (np.diff(in_haze().return_share(ranges)) <= 0.0).all()
    assert (in_haze(10.0).return_share(ranges) <= in_haze(20.0).return_share(ranges)).all()
    np.testing.assert_allclose(in_haze(1e6).return_share(ranges), 1.0, atol=1e-3)


@pytest.mark.parametrize("true", [3.0, 8.0])
def test_returns_are_lost_and_invented_as_often_as_the_model_says(true):
    effect, count = in_haze(), 40_000
    seen = effect.applied(np.full((1, count), true, np.float32), episode_state([0], [0]))[0]
    extinction = 3.912 / 20.0

    def rate(r):
        return 0.8 * extinction * np.exp(-2 * extinction * r) * 0.5 / r**2

    def invented(to):
        return 1.0 - np.exp(-integrate.quad(rate, 0.5, to)[0])

    false = seen < true
    assert false.mean() == pytest.approx(invented(true), abs=0.005)
    assert (seen < 1.0).mean() == pytest.approx(invented(1.0), abs=0.005)
    kept = float(effect.return_share(np.array([true], np.float32))[0])
    assert (seen == np.float32(true)).sum() / (~false).sum() == pytest.approx(kept, abs=0.01)
    assert set(seen[~false]) == {np.float32(true), np.float32(RANGE_M)}
    assert seen.min() >= 0.5


def test_where_nothing_returns_haze_may():
    seen = in_haze().applied(np.full((1, 20_000), RANGE_M, np.float32), episode_state([0], [0]))
    assert 0.02 < (seen < RANGE_M).mean() < 0.3
    thin = in_haze(2000.0).applied(np.full((1, 20_000), RANGE_M, np.float32), episode_state([0], [0]))
    assert (thin < RANGE_M).mean() < 0.01


def test_haze_depends_on_the_moment_alone():
    effect = in_haze(10.0)
    true = np.random.default_rng(1).uniform(0.1, 12.0, (4, 128)).astype(np.float32)
    before = true.copy()
    seen = effect.applied(true, episode_state([4, 9, 2, 7], [1, 5, 0, 2]))
    np.testing.assert_array_equal(true, before)
    assert effect.applied(true, episode_state([4, 9, 2, 7], [1, 5, 0, 2])).tobytes() == seen.tobytes()
    assert effect.applied(true[[1]], episode_state([9], [5])).tobytes() == seen[1].tobytes()
    for other in (episode_state([9], [6]), episode_state([8], [5]), episode_state([9], [5], seed=6)):
        assert not np.array_equal(effect.applied(true[[1]], other)[0], seen[1])


def test_a_scan_in_fog_passes_the_same_gate_as_faults():
    walls = flat_with((4.0, 0.0, 0.0, 0.2, 8.0), (-6.0, 0.0, 0.0, 0.2, 8.0))
    lidar = lidar_in(walls)
    air = ParticipatingMedia(haze_of(WeatherConf(fog_visibility_m=10.0)))
    sensor = LidarSensor("lidar", context_of(solid=rays_of(walls), air=air), lidar.conf)
    now = episode_state([3], [7])
    write(now.motion.position_w, ..., STANDING)
    sensor.measure(now, state_of(now))
    true = lidar.ranges(now.motion.position_w, now.motion.rotation, now.neighbours)
    np.testing.assert_array_equal(sensor.read()["lidar"], lidar.segments(in_haze(10.0).applied(true, now)))
    assert (sensor.read()["lidar"] != lidar.segments(true)).any()


# -- environments ------------------------------------------------------------------------------------


def test_weather_reaches_every_sensor_and_repeats():
    seen = {}
    for weather, scenes in (("clear", 1), ("fog", 1), ("fog", 2)):
        batch = started_simulation(
            {"name": "flat", "size_m": 20.0, "region_size_m": 6.0},
            scenes,
            seed=3,
            weather={"fog_visibility_m": 5.0 if weather == "fog" else None},
            sensors=["lidar", "lidar_3d", "camera", "depth_strip", "imu", "goal"],
        )
        for _ in range(3):
            act(batch, [0.5, 0.2])
        seen[weather, scenes] = {name: value[0].tobytes() for name, value in observation(batch).items()}
        batch.close()
    assert seen["fog", 1] == seen["fog", 2]
    changed = {name for name, value in seen["fog", 1].items() if value != seen["clear", 1][name]}
    assert changed == {"lidar", "lidar_3d_range", "camera_rgb"}


def test_settings_saved_before_there_was_weather_have_none():
    saved = compose(Conf, ["+world=inspection"]).model_dump(mode="json")
    del saved["weather"], saved["world"]["grass_cover"], saved["world"]["grass_height_m"]
    found = compose(EvaluateConf, ["checkpoint=x"], (), saved)
    assert (found.weather, found.world.grass_cover) == (CLEAR, 0.0)
    assert compose(EvaluateConf, ["checkpoint=x", "weather=fog"], (), saved).weather.fog_visibility_m == 50.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("weather.fog_visibility_m=0", "weather.fog_visibility_m must be above 0.0 (got 0)"),
        ("weather.dust_visibility_m=-3", "weather.dust_visibility_m must be above 0.0 (got -3)"),
        ("weather.fog_colour=[1,1,2]", "weather.fog_colour.2 must be at most 1.0 (got 2)"),
        ("weather.time_of_day_h=3", "weather.time_of_day_h must be at least 6.25 (got 3)"),
        (
            "weather.light.sun_elevation_deg=0",
            "weather.light.sun_elevation_deg must be at least 1.0 (got 0)",
        ),
        ("weather=hail", "there is no weather 'hail'; choose clear, dusk, dust or fog"),
    ],
)
def test_impossible_weather_is_refused(word, message):
    with pytest.raises(ConfigError) as caught:
        compose(Conf, ["+world=flat", word])
    assert str(caught.value) == message
