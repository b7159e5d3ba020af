"""Angles that were in radians: the same angles in degrees, wherever they are set."""

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from dune_rl.config.compose import compose, compose_environment, compose_evaluation
from dune_rl.config.migration import migrated
from dune_rl.config.renaming import RENAMED
from dune_rl.config.schema import EnvConf
from dune_rl.core.errors import ConfigError, DuneWarning
from dune_rl.env.distributions import Choice, LogUniform, Normal, Uniform
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.sensors.conf import SensorsConf
from dune_rl.sensors.lidar import LidarConf, beam_angles
from dune_rl.worlds.appearance import with_own_sun
from dune_rl.worlds.flat import FlatConf, build_flat

FLAT = build_flat(FlatConf())


def in_radians(settings: Any) -> Any:
    """Settings with their angles as runs had them that were saved before."""
    if isinstance(settings, list):
        return [in_radians(each) for each in settings]
    if not isinstance(settings, dict):
        return settings
    old = {new: each.old for each in (*RENAMED["sensors"], *RENAMED["weather"]) for new in each.new}
    names = {new.rpartition(".")[2]: name.rpartition(".")[2] for new, name in old.items()}
    return {
        names.get(key, key): math.radians(value) if key in names and value is not None else in_radians(value)
        for key, value in settings.items()
    }


# -- saved runs ---------------------------------------------------------------------------------------


def test_a_saved_run_keeps_the_angles_of_all_its_groups() -> None:
    rear = {"sensor": "camera", "mount_b": [-0.3, 0.0, 0.2], "fov_deg": 90.0, "pitch_deg": 10.0}
    own = {"enabled": ["rear", "depth_strip"], "named": {"rear": rear}, "depth_strip": {"fov_deg": 100.0}}
    settings = {
        "sensors": {"lidar": {"fov_deg": 270.0}, "lidar_3d": {"highest_elevation_deg": 22.5}},
        "weather": {"light": {"sun_bearing_deg": -30.0}},
        "actors": {"scout": {"body": "rover_zero", "controller": "external", "sensors": own}},
    }
    conf = compose_environment("flat", (), settings)
    saved = conf.model_dump(mode="json")
    old = in_radians(saved)
    scouts = old["actors"]["scout"]["sensors"]
    assert scouts["named"]["rear"]["pitch_rad"] == pytest.approx(0.17453, abs=1e-5)
    assert scouts["depth_strip"].keys() >= {"fov_rad", "lowest_elevation_rad"}
    assert EnvConf.model_validate(migrated(old)) == conf
    assert migrated(saved) == saved
    agents = {"scout": old["actors"]["scout"]}
    assert migrated({"agents": agents}) == {"agents": {"scout": saved["actors"]["scout"]}}


def test_whole_circles_and_right_angles_are_whole() -> None:
    old = {
        "sensors": {
            "lidar": {"fov_rad": 6.283185307179586},
            "lidar_3d": {"lowest_elevation_rad": -1.5707963267948966, "highest_elevation_rad": 0.262},
            "camera": {"fov_rad": 3.141592653589793, "projection": "fisheye", "pitch_rad": None},
        }
    }
    sensors = SensorsConf.model_validate(migrated(old)["sensors"])
    assert sensors.lidar == LidarConf()
    assert (sensors.lidar_3d.lowest_elevation_deg, sensors.camera.fov_deg) == (-90.0, 180.0)
    assert sensors.lidar_3d.highest_elevation_deg == pytest.approx(math.degrees(0.262))
    assert sensors.camera.pitch_deg is None


def test_a_whole_circle_has_the_beams_that_it_had() -> None:
    expected = np.linspace(-np.pi, np.pi, 128, endpoint=False)
    assert beam_angles(LidarConf()).tobytes() == expected.tobytes()


def test_the_former_default_sun_gives_way_to_a_world_s_own() -> None:
    world = build_flat(FlatConf())
    world.light = LightConf(sun_bearing_deg=10.0)
    for old in ({}, {"sun_bearing_rad": 2.2, "sun_elevation_rad": 0.75}):
        weather = WeatherConf.model_validate(migrated({"weather": {"light": old}})["weather"])
        assert with_own_sun(world, weather).light == world.light
    chosen = WeatherConf.model_validate(migrated({"weather": {"light": {"sun_bearing_rad": 2.1}}})["weather"])
    assert with_own_sun(world, chosen) is chosen


# -- what people write --------------------------------------------------------------------------------


def test_older_names_on_the_command_line() -> None:
    words = [
        "sensors.camera.fov_rad=1.0471975511965976",
        "sensors.named={rear: {sensor: camera, pitch_rad: 0.5235987755982988}}",
        "weather.light.sun_elevation_rad=0.5235987755982988",
        "actors={scout: {body: rover_zero, controller: go_to_goal, sensors: {lidar: {fov_rad: 2.0}}}}",
    ]
    with pytest.warns(DuneWarning) as told:
        conf = compose(["+world=flat", *words])
    assert [str(each.message) for each in told] == [
        "sensors.camera.fov_rad is now sensors.camera.fov_deg",
        "sensors.named.rear.pitch_rad is now sensors.named.rear.pitch_deg",
        "weather.light.sun_elevation_rad is now weather.light.sun_elevation_deg",
        "actors.scout.sensors.lidar.fov_rad is now actors.scout.sensors.lidar.fov_deg",
    ]
    assert (conf.sensors.camera.fov_deg, conf.weather.light.sun_elevation_deg) == (60.0, 30.0)
    assert conf.sensors.named["rear"].pitch_deg == 30.0  # type: ignore[attr-defined]
    scout = conf.actors["scout"].sensors
    assert scout is not None
    assert scout.lidar.fov_deg == pytest.approx(math.degrees(2.0))
    # What the group leaves out is that of the environment.
    assert scout.camera == conf.sensors.camera


def test_older_names_in_python_leave_what_was_given_as_it_was() -> None:
    actors = {"scout": {"body": "rover_zero", "sensors": {"depth_strip": {"fov_rad": 1.0}}}}
    with pytest.warns(DuneWarning, match=r"actors\.scout\.sensors\.depth_strip\.fov_rad is now"):
        conf = compose_environment("flat", (), {"actors": actors})
    assert conf.actors["scout"].sensors.depth_strip.fov_deg == pytest.approx(57.29578)  # type: ignore[union-attr]
    assert actors == {"scout": {"body": "rover_zero", "sensors": {"depth_strip": {"fov_rad": 1.0}}}}


def test_older_names_in_files_of_settings(tmp_path: Path) -> None:
    (tmp_path / "sensors").mkdir()
    option = {
        "defaults": ["default", "_self_"],
        "lidar": {"fov_rad": math.pi},
        "named": {"rear": {"sensor": "camera", "fov_rad": 1.0}},
    }
    (tmp_path / "sensors" / "mine.yaml").write_text(yaml.safe_dump(option))
    for words in (["sensors=mine"], ["actors={scout: {body: rover_zero, sensors: mine}}"]):
        with pytest.warns(DuneWarning) as told:
            conf = compose_environment("flat", words, config_dirs=[str(tmp_path)])
        assert [str(each.message) for each in told] == [
            "sensors.lidar.fov_rad is now sensors.lidar.fov_deg",
            "sensors.named.rear.fov_rad is now sensors.named.rear.fov_deg",
        ]
        sensors = conf.actors["scout"].sensors if "scout" in conf.actors else conf.sensors
        assert sensors is not None
        assert sensors.lidar.fov_deg == 180.0
        assert sensors.named["rear"].fov_deg == pytest.approx(57.29578)  # type: ignore[attr-defined]
    # What a group changes of it counts more, and the kind of a named sensor is known from the file.
    change = "{lidar: {fov_rad: 1.0}, named: {rear: {fov_rad: 2.0}}, name: mine}"
    with pytest.warns(DuneWarning) as told:
        conf = compose_environment(
            "flat",
            [f"actors={{scout: {{body: rover_zero, sensors: {change}}}}}"],
            config_dirs=[str(tmp_path)],
        )
    path = "actors.scout.sensors.named.rear.fov"
    assert f"{path}_rad is now {path}_deg" in [str(each.message) for each in told]
    scout = conf.actors["scout"].sensors
    assert scout is not None
    assert scout.lidar.fov_deg == pytest.approx(57.29578)
    assert scout.named["rear"].fov_deg == pytest.approx(114.59156)  # type: ignore[attr-defined]


def test_the_overrides_of_a_saved_run_may_have_older_names() -> None:
    saved = compose_environment("flat").model_dump(mode="json")
    with pytest.warns(DuneWarning, match=r"sensors\.lidar\.fov_rad is now"):
        conf = compose_evaluation(["policy=random", f"sensors.lidar.fov_rad={math.pi / 2}"], (), saved)
    assert conf.sensors.lidar.fov_deg == 90.0


def test_the_robots_of_groups_and_lists_too() -> None:
    words = [
        "robots=[{name: rover_zero, mounts: {camera_pitch_rad: 0.2}}]",
        "actors={scout: {body: {name: rover_zero, mounts: {camera_pitch_rad: 0.1}}}}",
    ]
    with pytest.warns(DuneWarning) as told:
        conf = compose_environment("flat", words)
    assert [str(each.message) for each in told] == [
        "robots.0.mounts.camera_pitch_rad is now robots.0.mounts.camera_pitch_deg",
        "actors.scout.body.mounts.camera_pitch_rad is now actors.scout.body.mounts.camera_pitch_deg",
    ]
    bodies = {group.name: group.body for group in conf.groups}
    assert bodies["rover"].mounts.camera_pitch_deg == pytest.approx(math.degrees(0.2))  # type: ignore[union-attr]
    assert bodies["scout"].mounts.camera_pitch_deg == pytest.approx(math.degrees(0.1))  # type: ignore[union-attr]


@pytest.mark.filterwarnings("ignore::dune_rl.core.errors.DuneWarning")
def test_faults_in_them_are_told_of_the_new_name() -> None:
    words = ["sensors.lidar.fov_rad=7", "sensors.camera.fov_rad=wide", "sensors.named={imu: {fov_rad: 1}}"]
    with pytest.raises(ConfigError) as caught:
        compose(["+world=flat", *words])
    lines = str(caught.value).splitlines()
    assert lines[0].startswith("sensors.named.imu.fov_rad is not a setting")
    assert lines[1] == "sensors.lidar.fov_deg must be at most 360.0 (got 401.070456592)"
    assert lines[2] == "sensors.camera.fov_deg must be a number (got 'wide')"


# -- what is drawn ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ([-1.0, 2.0], Uniform(low=-57.295779513, high=114.591559026)),
        ([0.0, 1.0, 2.0], Choice(values=(0.0, 57.295779513, 114.591559026))),
        ({"name": "uniform", "low": -math.pi, "high": math.pi}, Uniform(low=-180.0, high=180.0)),
        ({"name": "log_uniform", "low": math.pi / 6, "high": math.pi}, LogUniform(low=30.0, high=180.0)),
        (
            {"name": "normal", "mean": math.pi / 2, "deviation": math.pi / 18, "low": 0.0, "high": math.pi},
            Normal(mean=90.0, deviation=10.0, low=0.0, high=180.0),
        ),
        ({"name": "choice", "values": [math.pi / 4]}, Choice(values=(45.0,))),
        (None, None),
    ],
)
def test_every_number_of_a_distribution_becomes_degrees(old: Any, new: Any) -> None:
    with pytest.warns(DuneWarning, match=r"randomisation\.sun_bearing_rad is now randomisation\.sun_bearing"):
        conf = compose_environment(
            "flat", ["randomisation=worlds"], {"randomisation": {"world_seed": None, "sun_bearing_rad": old}}
        )
    assert conf.randomisation.sun_bearing_deg == new


def test_one_number_of_a_distribution_changes_alone() -> None:
    words = ["randomisation=worlds", "randomisation.world_seed=null"]
    with pytest.warns(DuneWarning, match=r"randomisation\.sun_elevation_rad is now"):
        conf = compose_environment("flat", [*words, f"randomisation.sun_elevation_rad.high={math.pi / 3}"])
    assert conf.randomisation.sun_elevation_deg == Uniform(low=14.0, high=60.0)


def test_an_older_run_s_seed_keeps_its_suns() -> None:
    old = {"sun_bearing_rad": {"name": "uniform", "low": -2.0, "high": 2.0}, "friction": [0.5, 1.5]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        conf = RandomisationConf.model_validate(migrated({"randomisation": old})["randomisation"])
    randomizer = DomainRandomizer(FlatConf(), WeatherConf(), conf, lambda _: FLAT)
    drawn = [dict(zip(randomizer.names, randomizer.draw(3, episode), strict=True)) for episode in range(3)]
    # As they were drawn in radians.
    expected = [-1.7755365337416786, -1.0998335036208027, -0.015683946771946733]
    assert [values["sun_bearing_deg"] for values in drawn] == pytest.approx(np.rad2deg(expected), abs=1e-6)
