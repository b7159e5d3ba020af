"""Faults of pictures: shutter, exposure, noise and dirt; and of depth."""

import numpy as np
import pytest
from instruments import ScriptedSensor, limits
from pydantic import ValidationError
from states import begin, episode_state, measure

from dune_rl.rendering.light import srgb_to_linear
from dune_rl.sensors.realism.camera import CameraFaults, CameraRealismConf
from dune_rl.sensors.realism.pipeline import realistic

STEP_S = 0.05
SIZE = (24, 32)
FAR = 50.0


def camera(scenes: int, *outputs: str) -> ScriptedSensor:
    high = {"rgb": (3, 255), "grey": (1, 255), "segmentation": (1, 3)}
    bounds = {
        f"camera_{name}": limits(high[name][1], (*SIZE, high[name][0]), 0, np.uint8)
        for name in outputs
        if name != "depth"
    }
    if "depth" in outputs:
        bounds["camera_depth"] = limits(FAR, (*SIZE, 1), 0.0)
    return ScriptedSensor(bounds, scenes)


def shown(
    told: ScriptedSensor, conf: CameraRealismConf, frames, name: str = "camera_grey", first: int = 0
) -> np.ndarray:
    """Pictures (T, M, ...) of `frames`, each told to all scenes; the episodes are `first` and those after."""
    scenes = len(told.now[name])
    sensor = CameraFaults(told, conf, scenes, STEP_S)
    seen = []
    for step, frame in enumerate(frames):
        told.now[name][:] = frame
        now = episode_state(first + np.arange(scenes), step)
        if step == 0:
            begin(sensor, np.ones(scenes, bool), now)
        else:
            measure(sensor, now)
        seen.append(sensor.read()[name])
    return np.array(seen)


def gradient() -> np.ndarray:
    """Every byte value at least twice, (24, 32, 1)."""
    return (np.arange(SIZE[0] * SIZE[1]) % 256).reshape(*SIZE, 1).astype(np.uint8)


def light(pictures: np.ndarray) -> np.ndarray:
    return srgb_to_linear(pictures / np.float32(255.0)).astype(float)


def test_without_faults_every_byte_stays():
    told = camera(2, "rgb", "depth", "segmentation")
    assert realistic(told, None, 2, STEP_S) is told
    rng = np.random.default_rng(0)
    for name, (_, high) in told.bounds().items():
        told.now[name][:] = rng.uniform(0, high.max(), told.now[name].shape)
    sensor = realistic(told, CameraRealismConf(), 2, STEP_S)
    begin(sensor, np.array([True, True]), episode_state([0, 1], 0))
    for step in (1, 2):
        assert all(seen.tobytes() == told.now[name].tobytes() for name, seen in sensor.read().items())
        told.now["camera_rgb"][:] += 3
        measure(sensor, episode_state([0, 1], step))
    assert sensor.bounds() == told.bounds()


def test_every_byte_has_its_light_and_back():
    # Nearly no dirt: the whole chain runs, and changes nothing.
    conf = CameraRealismConf(dirt=1e-9)
    assert np.array_equal(shown(camera(1, "grey"), conf, [gradient()])[0, 0], gradient())


def test_a_picture_at_rest_is_not_changed_by_its_shutter():
    conf = CameraRealismConf(shutter_s=0.02, readout_s=0.03)
    seen = shown(camera(1, "grey"), conf, [gradient()] * 3)
    assert (seen == gradient()).all()


def test_the_shutter_mixes_light_by_how_long_it_was_open_before_now():
    conf = CameraRealismConf(shutter_s=0.04)
    black, white = np.zeros((*SIZE, 1), np.uint8), np.full((*SIZE, 1), 255, np.uint8)
    seen = light(shown(camera(1, "grey"), conf, [black, black, white, white, black]))
    # Light that rises evenly over a control step has, over the last four fifths, the mean of 0.6.
    np.testing.assert_allclose(seen.mean(axis=(1, 2, 3, 4)), [0.0, 0.0, 0.6, 1.0, 0.4], atol=0.005)


def test_upper_rows_are_older():
    conf = CameraRealismConf(readout_s=0.05)
    black, white = np.zeros((*SIZE, 1), np.uint8), np.full((*SIZE, 1), 255, np.uint8)
    rows = light(shown(camera(1, "grey"), conf, [black, white]))[1, 0, :, :, 0]
    assert (rows == rows[:, :1]).all()
    np.testing.assert_allclose(rows[:, 0], (np.arange(SIZE[0]) + 0.5) / SIZE[0], atol=0.006)


@pytest.mark.parametrize("gain", [1.0, 4.0])
def test_noise_is_that_of_counted_electrons(gain):
    conf = CameraRealismConf(full_well_e=1000.0, read_noise_e=10.0, gain=gain)
    for byte in (60, 110):
        grey = np.full((*SIZE, 1), byte, np.uint8)
        seen = light(shown(camera(40, "grey"), conf, [grey]))
        electrons = light(np.array([byte]))[0] * 1000.0
        assert seen.std() == pytest.approx(np.sqrt(electrons + 10.0**2) * gain / 1000.0, rel=0.03)
        assert seen.mean() == pytest.approx(electrons * gain / 1000.0, rel=0.01)


def test_noise_is_new_in_each_pixel_channel_step_and_episode():
    conf = CameraRealismConf(full_well_e=500.0)
    frames = [np.full((*SIZE, 3), 120, np.uint8)] * 2
    seen = shown(camera(2, "rgb"), conf, frames, "camera_rgb").astype(float) - 120.0
    for one, other in (
        (seen[0, 0], seen[1, 0]),
        (seen[0, 0], seen[0, 1]),
        (seen[..., 0], seen[..., 1]),
        (seen[:, :, :-1], seen[:, :, 1:]),
        (seen[:, :, :, :-1], seen[:, :, :, 1:]),
    ):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.07


def test_a_fixed_gain_brightens_until_white():
    seen = shown(camera(1, "grey"), CameraRealismConf(gain=2.0), [gradient()])[0, 0]
    expected = np.minimum(2.0 * light(gradient()), 1.0)
    np.testing.assert_allclose(light(seen), expected, atol=0.005)
    assert (seen == 255).any()


def test_automatic_exposure_begins_settled_and_follows_with_its_time():
    conf = CameraRealismConf(auto_exposure_s=0.5)
    dark, bright = np.full((*SIZE, 1), 60, np.uint8), np.full((*SIZE, 1), 150, np.uint8)
    means = light(shown(camera(1, "grey"), conf, [dark] * 2 + [bright] * 60)).mean(axis=(1, 2, 3, 4))
    np.testing.assert_allclose(means[:2], 0.18, atol=0.005)
    assert means[2] > 0.6
    # One time constant after the change, the logarithm of the error has fallen to 1/e.
    wrong = np.log(light(np.array([150]))[0] / light(np.array([60]))[0])
    assert np.log(means[11] / 0.18) == pytest.approx(wrong / np.e, rel=0.05)
    assert means[-1] == pytest.approx(0.18, abs=0.005)
    # Night stays night.
    night = light(shown(camera(1, "grey"), conf, [np.full((*SIZE, 1), 5, np.uint8)])).mean()
    assert night == pytest.approx(8.0 * light(np.array([5]))[0], rel=0.1)


def test_dirt_stays_for_an_episode_and_is_elsewhere_in_the_next():
    conf = CameraRealismConf(dirt=0.9)
    half = np.zeros((*SIZE, 1), np.uint8)
    half[: SIZE[0] // 2] = 255
    seen = shown(camera(3, "grey"), conf, [half, half, 255 - half])
    assert np.array_equal(seen[0], seen[1])
    # A smudge draws both halves toward the mean, so bright pixels fall and dark ones rise, alike.
    smudge = 1.0 - light(seen[0])[:, : SIZE[0] // 2]
    assert smudge.max() > 0.1 and smudge.min() < 0.01
    np.testing.assert_allclose(light(seen[2])[:, : SIZE[0] // 2], smudge, atol=0.01)
    assert not np.array_equal(seen[0, 0], seen[0, 1])
    # A picture of one colour shows no smudges: they scatter, they do not glow.
    even = np.full((*SIZE, 1), 90, np.uint8)
    assert (shown(camera(3, "grey"), conf, [even]) == even).all()


def test_segments_stay_as_they_are_and_outputs_are_independent():
    told = camera(1, "rgb", "grey", "segmentation")
    sensor = CameraFaults(told, CameraRealismConf(full_well_e=100.0, dirt=0.5), 1, STEP_S)
    for name in told.now:
        told.now[name][:] = 100 if name != "camera_segmentation" else 2
    begin(sensor, np.array([True]), episode_state([0], 0))
    seen = sensor.read()
    assert (seen["camera_segmentation"] == 2).all()
    grey, red = (seen[name][0, ..., 0].astype(float) for name in ("camera_grey", "camera_rgb"))
    assert abs(np.corrcoef(grey.ravel(), red.ravel())[0, 1]) < 0.15


# -- depth ------------------------------------------------------------------------------------------


def depth_of(metres: float, scenes: int = 20, **settings) -> np.ndarray:
    frame = np.full((*SIZE, 1), metres, np.float32)
    return shown(camera(scenes, "depth"), CameraRealismConf(**settings), [frame], "camera_depth")[0]


@pytest.mark.parametrize("metres", [1.0, 4.0])
def test_depth_noise_grows_with_the_square(metres):
    seen = depth_of(metres, depth_noise_per_m=0.004)
    assert (seen.astype(float) - metres).std() == pytest.approx(0.004 * metres**2, rel=0.02)
    assert seen.dtype == np.float32


def test_depth_is_lost_at_random_too_near_and_too_far():
    seen = depth_of(2.0, depth_dropout=0.3)
    assert set(np.unique(seen)) == {2.0, FAR} and (seen == FAR).mean() == pytest.approx(0.3, abs=0.02)
    limits_m = {"depth_near_m": 0.3, "depth_far_m": 10.0, "depth_noise_per_m": 1e-4}
    assert (depth_of(0.29, **limits_m) == FAR).all() and (depth_of(0.31, **limits_m) < 1.0).all()
    assert (depth_of(10.1, **limits_m) == FAR).all() and (depth_of(9.9, **limits_m) < 11.0).all()


def test_depth_keeps_to_its_range_and_steps():
    assert (depth_of(FAR, depth_noise_per_m=0.1) == FAR).all()
    noisy = depth_of(40.0, depth_noise_per_m=1.0)
    assert noisy.min() == 0.0 and noisy.max() == FAR
    assert set(np.unique(depth_of(3.1, depth_quantum_m=0.25, depth_noise_per_m=0.01))) <= {
        2.75,
        3.0,
        3.25,
        3.5,
    }


# -- episodes ---------------------------------------------------------------------------------------

EVERYTHING = CameraRealismConf(
    rate_hz=10.0,
    latency_s=0.05,
    shutter_s=0.01,
    readout_s=0.03,
    auto_exposure_s=0.3,
    full_well_e=2000.0,
    read_noise_e=4.0,
    dirt=0.6,
    depth_noise_per_m=0.01,
    depth_dropout=0.1,
)


def play(sensor, told: ScriptedSensor, row: int, episode: int, steps: int, beside: int = 0) -> bytes:
    """An episode in scene `row`, all that it shows, while the other scene's goes on from `beside`."""
    episodes, at = np.array([900, 900]), np.array([beside, beside])
    seen = b""
    for step in range(steps):
        rng = np.random.default_rng(step)
        episodes[row], at[row] = episode, step
        for name, now in told.now.items():
            now[row] = rng.uniform(0, 40 if name == "camera_depth" else 255, now.shape[1:])
        if step == 0:
            begin(sensor, np.arange(2) == row, episode_state(episodes, at))
        else:
            at[1 - row] += 1
            measure(sensor, episode_state(episodes, at))
        seen += b"".join(reading[row].tobytes() for reading in sensor.read().values())
    return seen


def test_an_episode_repeats_itself_wherever_and_whenever_it_is_played():
    told = camera(2, "rgb", "depth")
    sensor = realistic(told, EVERYTHING, 2, STEP_S)
    begin(sensor, np.array([True, True]), episode_state([900, 900], 0))
    first = play(sensor, told, 0, 7, 9)
    other = play(sensor, told, 1, 8, 5, beside=8)
    assert play(sensor, told, 1, 7, 9, beside=20) == first
    assert play(sensor, told, 1, 8, 9, beside=40)[: len(other)] == other
    assert first[: len(other)] != other


def test_a_neighbour_s_new_episode_changes_nothing():
    told = camera(2, "rgb", "depth")
    sensor = CameraFaults(told, EVERYTHING, 2, STEP_S)
    told.now["camera_rgb"][:] = 80
    begin(sensor, np.array([True, True]), episode_state([0, 1], 0))
    told.now["camera_rgb"][:] = 200
    measure(sensor, episode_state([0, 1], 1))
    before = sensor.read()
    begin(sensor, np.array([False, True]), episode_state([0, 2], [1, 0]))
    after = sensor.read()
    assert all(np.array_equal(before[name][0], after[name][0]) for name in before)
    assert not np.array_equal(before["camera_rgb"][1], after["camera_rgb"][1])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"shutter_s": -0.01}, "shutter_s\n.*greater than or equal to 0"),
        ({"gain": 0.0}, "gain\n.*greater than 0"),
        ({"dirt": 2.0}, "dirt\n.*less than or equal to 1"),
        ({"read_noise_e": 3.0}, "read_noise_e is counted in electrons: give full_well_e"),
        (
            {"depth_near_m": 2.0, "depth_far_m": 1.0},
            r"depth_far_m \(1\) must be more than depth_near_m \(2\)",
        ),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValidationError, match=message):
        CameraRealismConf.model_validate(settings)


def test_a_picture_must_be_taken_within_a_control_step():
    with pytest.raises(ValueError, match=r"shutter_s \+ readout_s \(0.06\) must be at most .* 0.05 s"):
        realistic(camera(1, "grey"), CameraRealismConf(shutter_s=0.02, readout_s=0.04), 1, STEP_S)
