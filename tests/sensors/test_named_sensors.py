"""Sensors with names of their own: two of a kind, in settings and on the command line."""

import pickle

import pytest

import dune_rl
from dune_rl.config.compose import compose_environment
from dune_rl.config.saved import upgrade_saved
from dune_rl.core.errors import ConfigError
from dune_rl.sensors.conf import observed_names, parse_sensors
from dune_rl.sensors.realism.camera import CameraRealismConf
from dune_rl.sensors.realism.pipeline import ImuRealismConf

REAR = {"sensor": "camera", "mount_b": [-0.3, 0.0, 0.2], "width": 8, "height": 6}


def test_two_cameras_are_observed_under_their_names():
    sensors = {"enabled": ["camera", "rear", "goal"], "rear": REAR}
    env = dune_rl.parallel_env(world="flat", actors="none", sensors=sensors)
    seen, _ = env.reset(seed=1)
    rover = seen["rover_0"]
    assert list(rover) == ["camera_rgb", "rear_rgb", "goal"]
    assert rover["camera_rgb"].shape == (64, 64, 3) and rover["rear_rgb"].shape == (6, 8, 3)
    env.close()


def test_a_second_lidar_has_a_past_scan_of_its_own():
    low = {"sensor": "lidar", "n_beams": 16, "n_segments": 8, "range_m": 5.0, "realism": "dune_paper"}
    sensors = {"enabled": ["lidar", "low_past", "low"], "low": low}
    env = dune_rl.parallel_env(world="construction", actors="none", sensors=sensors)
    seen, _ = env.reset(seed=2)
    rover = seen["rover_0"]
    assert list(rover) == ["lidar", "low_past", "low"]
    assert rover["lidar"].shape == (32,) and rover["low"].shape == rover["low_past"].shape == (8,)
    assert rover["low"].max() <= 5.0 < rover["lidar"].max()
    env.close()


def test_a_past_scan_is_the_lidar_s_whether_that_is_observed_or_not():
    found = []
    for names in (["lidar_past"], ["lidar", "lidar_past"]):
        env = dune_rl.parallel_env(world="construction", actors="none", sensors=names)
        env.reset(seed=2)
        for _ in range(3):
            seen, *_ = env.step({"rover_0": env.action_space("rover_0").high})
        assert list(seen["rover_0"]) == names
        found.append(seen["rover_0"]["lidar_past"].tobytes())
        env.close()
    assert found[0] == found[1]


def test_a_sensor_is_added_on_the_command_line():
    words = ["+sensors.rear={sensor: camera, width: 8, realism: raspberry_pi_v2}", "sensors.lidar_past=null"]
    conf = compose_environment("flat", words).sensors
    rear = conf["rear"]
    assert list(conf) == ["lidar", "imu", "goal", "velocity", "rear"]
    assert (rear.sensor, rear.width, rear.height) == ("camera", 8, 64)
    assert rear.realism == CameraRealismConf.model_validate("raspberry_pi_v2")


def test_a_list_chooses_what_is_observed_and_keeps_other_settings():
    conf = compose_environment("flat", ["sensors=[goal,lidar]", "sensors.imu.realism=bno055"]).sensors
    assert observed_names(conf) == ["goal", "lidar"]
    # Robots navigate by the inertial unit; what has no settings of its own is left out.
    assert list(conf) == ["goal", "lidar", "imu"]
    assert not conf["imu"].observed and conf["imu"].realism == ImuRealismConf.model_validate("bno055")


def test_sensors_of_saved_runs_are_read():
    old = {
        "enabled": ["rear", "low_past", "goal"],
        "named": {"rear": {**REAR, "realism": None}, "low": {"sensor": "lidar", "range_m": 5.0}},
        "lidar": {"n_beams": 128},
        "encoders": {"counts_per_turn": 0},
        "camera": {},
        "past_s": 0.25,
        "realism": {"imu": None, "camera": "perfect"},
    }
    saved = upgrade_saved({"sensors": old, "actors": {"walker": {"body": "person", "sensors": old}}})
    assert saved["agents"]["walker"]["sensors"] == saved["sensors"]
    assert upgrade_saved(saved) == saved
    assert parse_sensors(saved["sensors"]) == parse_sensors(
        {
            "rear": REAR,
            "low_past": {"sensor": "lidar_past", "lidar": "low", "past_s": 0.25},
            "goal": {},
            "low": {"sensor": "lidar", "range_m": 5.0, "observed": False},
            "encoders": {"counts_per_turn": 0, "observed": False},
            "camera": {"realism": "perfect", "observed": False},
        }
    )


def test_settings_survive_their_dump_and_another_process():
    conf = parse_sensors({"enabled": ["rear"], "rear": REAR})
    dumped = {name: each.model_dump(mode="json") for name, each in conf.items()}
    assert parse_sensors(dumped) == conf
    assert pickle.loads(pickle.dumps(conf)) == conf


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ({"enabled": ["lidr"]}, r"sensors\.lidr: there is no sensor 'lidr'.*; did you mean lidar\?"),
        ({"enabled": ["rear"]}, r"sensors\.rear: there is no sensor 'rear'.*; choose agent_tracks, "),
        ({"enabled": "rear"}, r"sensors: enabled must be a list of the names of sensors \(got 'rear'\)"),
        ({"enabled": ["camera_past"]}, r"sensors\.camera_past\.lidar must be the name of a LiDAR"),
        ({"enabled": ["low_past"]}, r"sensors: there is no sensor 'low' to read"),
        ({"rear": {"width": 8}}, r"sensors\.rear: there is no sensor 'rear'.*choose agent_tracks, "),
        ({"rear": {**REAR, "width": 0}}, r"sensors\.rear\.width must be at least 1 \(got 0\)"),
        ({"rear": {**REAR, "colour": 6}}, r"sensors\.rear\.colour is not a setting"),
        ({"rear": {**REAR, "mount_b": [0, 0, -1]}}, r"rear\.mount_b lies in the"),
        ({"rear": {**REAR, "realism": {"rate_hz": 7}}}, r"sensors\.rear\.realism: rate_hz=7 does not"),
    ],
)
def test_faults_are_told(sensors, message):
    with pytest.raises(ConfigError, match=message):
        dune_rl.parallel_env(world="flat", sensors=sensors)
