"""Faults of single beams: noise, drop-out, and light that does not come back."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scanning import flat_with, turned
from sensor_contexts import ScanPair
from sensors_of_rover_zero import lidar_conf
from simulations import started_simulation
from states import begin, episode_state, measure, write
from test_past_scan import STANDING, WALLS

from dune_rl.sensors.lidar import LidarConf, beam_angles
from dune_rl.sensors.realism.lidar import BeamFaults, LidarRealismConf

CONF = lidar_conf()
FINE = lidar_conf(n_beams=1024)
SCENES = 200


def faulty(
    ranges: np.ndarray, lidar: LidarConf = CONF, seed: int = 5, step: int = 3, **settings
) -> np.ndarray:
    """`ranges` (n_beams,) as they are read in 200 episodes, (200, n_beams)."""
    faults = beam_faults(LidarRealismConf(**settings), lidar)
    true = np.tile(np.asarray(ranges, np.float32), (SCENES, 1))
    return faults.applied(true, episode_state(np.arange(SCENES), step, seed))


def beam_faults(conf: LidarRealismConf, lidar: LidarConf = CONF) -> BeamFaults:
    return BeamFaults(conf, (lidar.min_range_m, lidar.range_m), "lidar", beam_angles(lidar))


def round_room(radius: float, lidar: LidarConf = CONF) -> np.ndarray:
    return np.full(lidar.n_beams, radius, np.float32)


def wall_at(distance: float, lidar: LidarConf) -> np.ndarray:
    """Ranges to an endless wall ahead."""
    cosine = np.cos(beam_angles(lidar))
    along = distance / np.maximum(cosine, 1e-6)
    return np.minimum(along, lidar.range_m).astype(np.float32)


@pytest.mark.parametrize("radius", [1.0, 6.0])
def test_noise_is_a_constant_and_a_share_of_the_range(radius):
    seen = faulty(round_room(radius), noise_m=0.05, noise_share=0.02)
    off = seen.astype(float) - radius
    assert off.std() == pytest.approx(0.05 + 0.02 * radius, rel=0.02)
    assert abs(off.mean()) < 0.003
    assert seen.dtype == np.float32
    # Neighbouring beams err apart from each other.
    assert abs((off[:, 1:] * off[:, :-1]).mean()) < 0.05 * off.var()


def test_what_returns_nothing_has_no_noise_and_what_returns_stays_in_range():
    ranges = round_room(11.95)
    ranges[:40], ranges[40:50] = 12.0, 0.1
    seen = faulty(ranges, noise_m=0.2)
    assert (seen[:, :40] == 12.0).all()
    assert seen.min() == np.float32(0.1) and seen.max() == 12.0
    assert (seen[:, 40:50] > 0.1).mean() == pytest.approx(0.5, abs=0.05)


def test_steps_between_ranges():
    seen = faulty(round_room(5.013), noise_m=0.05, quantum_m=0.25)
    assert set(np.unique(seen)) <= {4.75, 5.0, 5.25}
    assert (seen == 5.0).mean() > 0.9


@pytest.mark.parametrize("dropout", [0.05, 0.6, 1.0])
def test_drop_out_reads_the_largest_range(dropout):
    seen = faulty(round_room(3.0), dropout=dropout)
    assert set(np.unique(seen)) <= {3.0, 12.0}
    assert (seen == 12.0).mean() == pytest.approx(dropout, abs=0.01)


@pytest.mark.parametrize(
    ("radius", "share"), [(3.0, 1 - 2.0**-4), (6.0, 0.5), (11.9, 1 - 2 ** -((6 / 11.9) ** 2))]
)
def test_returns_fall_with_the_square_of_the_range(radius, share):
    # A round room is met head-on by every beam.
    seen = faulty(round_room(radius), half_return_m=6.0)
    assert (seen < 12.0).mean() == pytest.approx(share, abs=0.01)


def test_drop_out_and_fall_off_are_independent():
    seen = faulty(round_room(6.0), half_return_m=6.0, dropout=0.5)
    assert (seen < 12.0).mean() == pytest.approx(0.25, abs=0.01)


def test_slanted_walls_return_less():
    lidar = lidar_conf(n_beams=1024, range_m=60.0)
    true = wall_at(3.0, lidar)
    seen = faulty(true, lidar, half_return_m=6.0)
    bearing = beam_angles(lidar)
    for slant in (0.0, 0.8, 1.2):
        beams = np.abs(np.abs(bearing) - slant) < 0.03
        expected = 1 - 2.0 ** -(np.cos(slant) * (6.0 / (3.0 / np.cos(slant))) ** 2)
        assert (seen[:, beams] < 60.0).mean() == pytest.approx(expected, abs=0.025)


def test_a_pole_before_a_wall_counts_as_met_head_on():
    true = wall_at(3.0, FINE)
    true[512] = 2.5
    seen = faulty(true, FINE, half_return_m=2.5)
    assert (seen[:, 512] < 12.0).mean() == pytest.approx(0.5, abs=0.1)


def test_the_last_beam_before_an_edge_counts_as_met_head_on():
    true = round_room(3.0, FINE)
    true[512:768] = 6.0
    seen = faulty(true, FINE, half_return_m=6.0)
    for beam in (512, 767):
        assert (seen[:, beam] < 12.0).mean() == pytest.approx(0.5, abs=0.1)


def test_dark_episodes_see_less():
    share = (faulty(round_room(6.0), half_return_m=6.0, reflectance=(0.25, 1.0)) < 12.0).mean(axis=1)
    dark, bright = 1 - 2.0**-0.25, 0.5
    assert share.min() > dark - 0.15 and share.max() < bright + 0.15
    # The spread over episodes is wider than that of 128 beams of one brightness.
    assert share.std() > 1.5 * np.sqrt(0.33 * 0.67 / 128)
    again = (faulty(round_room(6.0), half_return_m=6.0, reflectance=(0.25, 1.0), step=4) < 12.0).mean(axis=1)
    assert np.corrcoef(share, again)[0, 1] > 0.5


def test_faults_depend_on_the_moment_alone():
    conf = LidarRealismConf(noise_m=0.1, dropout=0.2, half_return_m=6.0)
    faults = beam_faults(conf)
    rng = np.random.default_rng(1)
    true = rng.uniform(0.1, 12.0, (4, 128)).astype(np.float32)
    before = true.copy()
    seen = faults.applied(true, episode_state([4, 9, 2, 7], [1, 5, 0, 2]))
    assert np.array_equal(true, before)
    assert faults.applied(true, episode_state([4, 9, 2, 7], [1, 5, 0, 2])).tobytes() == seen.tobytes()
    assert beam_faults(conf).applied(true[[1]], episode_state([9], [5])).tobytes() == seen[1].tobytes()
    for other in (episode_state([9], [6]), episode_state([8], [5]), episode_state([9], [5], seed=6)):
        assert not np.array_equal(faults.applied(true[[1]], other)[0], seen[1])


@pytest.mark.parametrize("lidar", [lidar_conf(n_beams=1, n_segments=1), lidar_conf(n_beams=2, n_segments=1)])
def test_few_beams_have_faults_too(lidar):
    seen = faulty(np.full(lidar.n_beams, 6.0), lidar, half_return_m=6.0, noise_m=0.01)
    assert (seen < 12.0).mean() == pytest.approx(0.5, abs=0.12)


# -- in the scanner ---------------------------------------------------------------------------------


def scanner(realism: LidarRealismConf | None, delay: int = 2) -> ScanPair:
    return ScanPair(flat_with(*WALLS), CONF.model_copy(update={"realism": realism}), 2, delay)


def standing(episodes, steps):
    now = episode_state(episodes, steps)
    write(now.motion.position_w, ..., STANDING)
    write(now.motion.rotation, ..., turned(0.3))
    return now


def scans(sensor: ScanPair, episodes, steps: int) -> list[dict[str, np.ndarray]]:
    begin(sensor, np.array([True, True]), standing(episodes, 0))
    seen = [sensor.read()]
    for step in range(1, steps):
        measure(sensor, standing(episodes, step))
        seen.append(sensor.read())
    return seen


def test_without_faults_scans_keep_their_bytes():
    plain, off = (
        scans(scanner(None), [0, 1], 4),
        scans(scanner(LidarRealismConf()), [0, 1], 4),
    )
    for one, other in zip(plain, off, strict=True):
        assert all(one[name].tobytes() == other[name].tobytes() for name in ("lidar", "lidar_past"))


def test_the_past_scan_sees_the_noise_of_its_time():
    seen = scans(scanner(LidarRealismConf(noise_m=0.1)), [0, 1], 6)
    for step in range(2, 6):
        # Standing still, the past scan is the scan of then; seen from the same place, to float32.
        np.testing.assert_allclose(seen[step]["lidar_past"], seen[step - 2]["lidar"], atol=1e-4)
        assert np.abs(seen[step]["lidar"] - seen[step - 2]["lidar"]).max() > 0.05


def test_a_neighbour_s_new_episode_changes_nothing():
    conf = LidarRealismConf(noise_m=0.1, dropout=0.1)
    alone = scans(scanner(conf), [3, 4], 5)
    sensor = scanner(conf)
    begin(sensor, np.array([True, True]), standing([3, 4], 0))
    for step in range(1, 4):
        measure(sensor, standing([3, 4], step))
    begin(sensor, np.array([False, True]), standing([3, 6], [3, 0]))
    assert np.array_equal(sensor.read()["lidar"][0], alone[3]["lidar"][0])
    measure(sensor, standing([3, 6], [4, 1]))
    for name in ("lidar", "lidar_past"):
        assert np.array_equal(sensor.read()[name][0], alone[4][name][0])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"noise_m": -0.1}, "noise_m\n.*greater than or equal to 0"),
        ({"dropout": 1.2}, "dropout\n.*less than or equal to 1"),
        ({"half_return_m": 0.0}, "half_return_m\n.*greater than 0"),
        ({"reflectance": (1.0, 0.5)}, r"reflectance must be .* the lower first \(got 1, 0.5\)"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValidationError, match=message):
        LidarRealismConf.model_validate(settings)


@pytest.mark.slow
def test_rings_have_the_same_faults():
    settings: dict[str, Any] = {
        "enabled": ["lidar_3d"],
        "lidar_3d": {"n_rings": 4, "n_beams": 64, "outputs": ["range", "segmentation"]},
    }
    plain = started_simulation("inspection", 2, sensors=settings).observe()
    settings["lidar_3d"]["realism"] = {"noise_m": 0.05, "dropout": 0.3}
    faulty = started_simulation("inspection", 2, sensors=settings).observe()
    true, seen = plain["lidar_3d_range"], faulty["lidar_3d_range"]
    returned = true < 30.0
    lost = returned & (seen >= 30.0)
    assert 0.2 < lost.sum() / returned.sum() < 0.4
    assert (faulty["lidar_3d_segmentation"][lost] == 0).all()
    kept = returned & ~lost
    assert 0.03 < (seen - true)[kept].std() < 0.07
    np.testing.assert_array_equal(faulty["lidar_3d_segmentation"][kept], plain["lidar_3d_segmentation"][kept])
    assert (seen[~returned] >= 30.0).all()
