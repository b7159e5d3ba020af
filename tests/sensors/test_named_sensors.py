"""Sensors with names of their own: two of a kind, in settings and on the command line."""

import pickle

import numpy as np
import pytest

import dune_rl
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.sensors.conf import SensorsConf
from dune_rl.sensors.realism.camera import CameraRealismConf

REAR = {"sensor": "camera", "mount_b": [-0.3, 0.0, 0.2], "width": 8, "height": 6}


def test_two_cameras_are_observed_under_their_names():
    sensors = {"enabled": ["camera", "rear", "goal"], "named": {"rear": REAR}}
    env = dune_rl.parallel_env(world="flat", actors="none", sensors=sensors)
    seen, _ = env.reset(seed=1)
    rover = seen["rover_0"]
    assert list(rover) == ["camera_rgb", "rear_rgb", "goal"]
    assert rover["camera_rgb"].shape == (64, 64, 3) and rover["rear_rgb"].shape == (6, 8, 3)
    env.close()


def test_a_second_lidar_has_a_past_scan_of_its_own():
    low = {"sensor": "lidar", "n_beams": 16, "n_segments": 8, "range_m": 5.0, "realism": "dune_paper"}
    sensors = {"enabled": ["lidar", "low", "low_past"], "named": {"low": low}}
    env = dune_rl.parallel_env(world="construction", actors="none", sensors=sensors)
    seen, _ = env.reset(seed=2)
    rover = seen["rover_0"]
    assert rover["lidar"].shape == (32,) and rover["low"].shape == rover["low_past"].shape == (8,)
    assert rover["low"].max() <= 5.0 < rover["lidar"].max()
    env.close()


def test_named_sensors_can_be_set_on_the_command_line():
    words = [
        "sensors.enabled=[rear]",
        "+sensors.named.rear={sensor: camera, width: 8, realism: raspberry_pi_v2}",
    ]
    conf = compose_environment("flat", words).sensors
    rear = conf.named["rear"]
    assert conf.readings() == ["rear_rgb"]
    assert (rear.sensor, rear.width, rear.height) == ("camera", 8, 64)
    assert rear.realism == CameraRealismConf.model_validate("raspberry_pi_v2")


def test_settings_survive_their_dump_and_another_process():
    conf = SensorsConf.model_validate({"enabled": ["rear"], "named": {"rear": REAR}})
    assert SensorsConf.model_validate(conf.model_dump(mode="json")) == conf
    assert pickle.loads(pickle.dumps(conf)) == conf


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ({"enabled": ["lidr"]}, r"sensors\.enabled: there is no sensor 'lidr'; did you mean lidar\?"),
        ({"enabled": ["rear"]}, r"sensors\.enabled: there is no sensor 'rear'; choose lidar, "),
        ({"enabled": ["camera_past"]}, r"there is no sensor 'camera_past'; did you mean camera\?"),
        (
            {"named": {"rear": {"width": 8}}},
            r"sensors\.named\.rear: there is no sensor 'rear'.*choose camera, ",
        ),
        (
            {"named": {"rear": {**REAR, "width": 0}}},
            r"sensors\.named\.rear\.width must be at least 1 \(got 0\)",
        ),
        ({"named": {"rear": {**REAR, "colour": 6}}}, r"sensors\.named\.rear\.colour is not a setting"),
        (
            {"named": {"rear": {**REAR, "mount_b": [0, 0, -1]}}, "enabled": ["rear"]},
            r"rear\.mount_b lies in the",
        ),
        (
            {"named": {"rear": {**REAR, "realism": {"rate_hz": 7}}}},
            r"named\.rear\.realism: rate_hz=7 does not",
        ),
    ],
)
def test_faults_are_told(sensors, message):
    with pytest.raises(ConfigError, match=message):
        dune_rl.parallel_env(world="flat", sensors=sensors)


def test_a_name_that_is_a_kind_takes_its_place():
    conf = SensorsConf.model_validate(
        {"enabled": ["velocity"], "named": {"velocity": {"sensor": "planar_velocity"}}}
    )
    (request,) = conf.requests(0.05)
    assert (request.name, request.kind, request.readings) == ("velocity", "planar_velocity", ("velocity",))
    assert np.array_equal(conf.readings(), ["velocity"])
