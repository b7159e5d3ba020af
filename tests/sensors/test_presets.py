"""Parts by name, what differs from them, and settings that none can have."""

import pytest
from pydantic import ValidationError

from dune_rl.sensors.realism.camera import CameraRealismConf
from dune_rl.sensors.realism.lidar import LidarRealismConf
from dune_rl.sensors.realism.pipeline import ImuRealismConf, PositionRealismConf, SpeedRealismConf
from dune_rl.sensors.realism.presets import PRESETS, find_preset

KINDS = {
    "imu": ImuRealismConf,
    "lidar": LidarRealismConf,
    "camera": CameraRealismConf,
    "position": PositionRealismConf,
}


@pytest.mark.parametrize(
    ("settings", "place"),
    [
        ({"gyroscope": {"noise_density": -0.1}}, "gyroscope.noise_density\n.*greater than or equal to 0"),
        ({"heading": {"bias": float("nan")}}, "heading.bias\n.*finite"),
        ({"tilt": {"bias_correlation_s": 0.0}}, "tilt.bias_correlation_s\n.*greater than 0"),
        ({"rate_hz": 0.0}, "rate_hz\n.*greater than 0"),
        ({"latency_s": 3.0}, "latency_s\n.*less than or equal to 2"),
        ({"sigma": 1.0}, "sigma\n.*not permitted"),
    ],
)
def test_settings_out_of_range_are_refused(settings, place):
    with pytest.raises(ValidationError, match=place):
        ImuRealismConf.model_validate(settings)


def test_a_word_stands_for_a_part_and_settings_beside_it_differ_from_it():
    plain = ImuRealismConf.model_validate("mpu6050")
    assert plain == ImuRealismConf.model_validate({"preset": "mpu6050"})
    assert plain.accelerometer.noise_density == pytest.approx(400e-6 * 9.80665)
    changed = ImuRealismConf.model_validate(
        {"preset": "mpu6050", "rate_hz": 10, "accelerometer": {"bias": 0.0}}
    )
    assert changed.rate_hz == 10 and changed.accelerometer.bias == 0.0
    assert changed.accelerometer.noise_density == plain.accelerometer.noise_density
    assert changed.gyroscope == plain.gyroscope
    assert ImuRealismConf.model_validate(changed.model_dump()) == changed


@pytest.mark.parametrize(
    ("conf", "word", "message"),
    [
        (ImuRealismConf, "bno05", "there is no device 'bno05'; choose bno055, mpu6050, .* or adis16448"),
        (ImuRealismConf, "rplidar_a1", "rplidar_a1 is a device for lidar sensors; choose bno055"),
        (LidarRealismConf, "bno055", "bno055 is a device for imu sensors; choose rplidar_a1"),
        (SpeedRealismConf, "bno055", "no devices are known here"),
    ],
)
def test_an_unknown_part_is_refused_with_those_there_are(conf, word, message):
    with pytest.raises(ValidationError, match=message):
        conf.model_validate(word)
    if conf.kind:
        with pytest.raises(ValueError, match=message):
            find_preset(word, conf.kind)


@pytest.mark.parametrize("name", PRESETS)
def test_every_part_is_valid_and_each_of_its_figures_has_a_source(name):
    part = find_preset(name)
    conf = KINDS[part.kind].model_validate(name)
    assert conf.preset == name
    assert conf.steps(0.05)
    assert all(len(source) > 15 for _, source in part.figures.values())
