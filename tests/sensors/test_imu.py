"""The inertial unit against mechanics worked out by other means."""

from types import SimpleNamespace

import numpy as np
import pytest
from scanning import sensed_speed, turned
from scenes import SUBSTEPS, Drive, Stage, about, every_backend
from sensor_contexts import context_of
from sensors_of_rover_zero import imu_conf
from states import motion_of

from dune_rl.geometry.frames import rotation_matrices
from dune_rl.sensors.imu import ImuConf, ImuSensor

LEVEL = np.eye(3)
ALL = np.array([True])


class Imu:
    """The sensor, given its motion as arrays."""

    def __init__(self, conf: ImuConf, num_rows: int) -> None:
        self._sensor = ImuSensor("imu", context_of(num_rows), conf)

    @property
    def acceleration_b(self) -> np.ndarray:
        return self._sensor.acceleration_b

    def begin(self, mask: np.ndarray, *motion: np.ndarray) -> None:
        self._sensor.begin(mask, moving(*motion), None)

    def measure(self, rotation: np.ndarray, velocity_w: np.ndarray, angular_w: np.ndarray, step_s: float):
        self._sensor._step_s = step_s
        self._sensor.measure(moving(rotation, velocity_w, angular_w), None)
        return self.acceleration_b

    def reading(self, rotation: np.ndarray, angular_b: np.ndarray, roll_pitch_yaw: np.ndarray) -> np.ndarray:
        self._sensor._take(moving(rotation, angular_b, angular_b, angular_b, roll_pitch_yaw))
        return self._sensor.read()["imu"]


def moving(
    rotation: np.ndarray,
    velocity_w: np.ndarray,
    angular_w: np.ndarray,
    angular_b: np.ndarray | None = None,
    angles: np.ndarray | None = None,
) -> SimpleNamespace:
    """A group's state of which the sensor reads the motion alone."""
    rest = np.zeros_like(velocity_w)
    motion = SimpleNamespace(rotation=rotation, velocity_w=velocity_w, angular_w=angular_w)
    motion.angular_b = rest if angular_b is None else angular_b
    motion.roll_pitch_yaw = rest if angles is None else angles
    return SimpleNamespace(motion=motion)


def imu_after(
    *motions: tuple[np.ndarray, np.ndarray, np.ndarray], conf: ImuConf | None = None, step_s=0.05
) -> Imu:
    imu = Imu(conf or imu_conf(), 1)
    first, *others = [tuple(part[None] for part in motion) for motion in motions]
    imu.begin(ALL, *first)
    for motion in others:
        imu.measure(*motion, step_s)
    return imu


def read(imu: Imu, rotation: np.ndarray, angular_b: np.ndarray | None = None) -> np.ndarray:
    angular_b = np.zeros(3) if angular_b is None else angular_b
    return imu.reading(rotation[None], angular_b[None], np.zeros((1, 3)))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "angle"), [([1, 0, 0], 0.0), ([1, 0, 0], 0.4), ([0, 1, 0], -0.3), ([0.6, 0.8, 0], 2.0)]
)
def test_at_rest_it_reads_what_holds_it_up(axis, angle):
    rotation = rotation_matrices(about(axis, angle))
    still = (rotation, np.zeros(3), np.zeros(3))
    force = read(imu_after(still, still), rotation)[:3]
    # Rodrigues' formula, turned back, for (0, 0, 9.81).
    k, up = np.asarray(axis, float), np.array([0.0, 0.0, 9.81])
    expected = up * np.cos(angle) - np.cross(k, up) * np.sin(angle) + k * (k @ up) * (1 - np.cos(angle))
    np.testing.assert_allclose(force, expected, atol=1e-5)


@every_backend
def test_a_resting_rover_reads_gravity_upward(backend):
    drive = Drive(backend)
    imu = Imu(imu_conf(), 1)
    for step in range(20):
        drive.stage.step(SUBSTEPS)
        motion = motion_of(drive.stage.state)
        state = motion.rotation, motion.velocity_w, motion.angular_w
        if step == 0:
            imu.begin(ALL, *state)
        imu.measure(*state, 0.05)
    reading = imu.reading(motion.rotation, motion.angular_b, motion.roll_pitch_yaw)[0]
    np.testing.assert_allclose(reading[:6], [0, 0, 9.81, 0, 0, 0], atol=0.01)
    np.testing.assert_allclose(reading[6:], 0.0, atol=1e-3)


@every_backend
def test_a_falling_rover_reads_nothing(backend):
    stage = Stage(backend)
    stage.place([0.0, 0.0, 6.0], about([0.6, 0.8, 0.0], 0.5))
    imu = Imu(imu_conf(), 1)
    motion = motion_of(stage.state)
    imu.begin(ALL, motion.rotation, motion.velocity_w, motion.angular_w)
    for _ in range(5):
        stage.step(SUBSTEPS)
        motion = motion_of(stage.state)
        imu.measure(motion.rotation, motion.velocity_w, motion.angular_w, 0.05)
        reading = imu.reading(motion.rotation, motion.angular_b, motion.roll_pitch_yaw)[0]
        np.testing.assert_allclose(reading[:3], 0.0, atol=1e-4)


@every_backend
def test_acceleration_is_the_second_difference_of_true_positions(backend):
    drive = Drive(backend)
    imu = Imu(imu_conf(mount_b=(0.0, 0.0, 0.0)), 1)
    felt, places, speeds = [], [], []
    motion = motion_of(drive.stage.state)
    imu.begin(ALL, motion.rotation, motion.velocity_w, motion.angular_w)
    for step in range(40):
        drive.step(1.0 if step < 20 else -0.5, 0.3)
        motion = motion_of(drive.stage.state)
        acceleration_b = imu.measure(motion.rotation, motion.velocity_w, motion.angular_w, 0.05)
        felt.append(motion.rotation[0] @ acceleration_b[0])
        places.append(motion.position_w[0])
        speeds.append(motion.velocity_w[0])
    # Summed up, accelerations are velocities and those, summed again, the way: no step is lost.
    np.testing.assert_allclose(
        np.cumsum(felt[1:], axis=0) * 0.05, np.array(speeds[1:]) - speeds[0], atol=1e-9
    )
    second = np.diff(places, n=2, axis=0) / 0.05**2
    # Over two steps of even acceleration, a second difference is the mean of the two.
    felt_pairs = (np.array(felt)[1:-1] + np.array(felt)[2:]) / 2
    apart = np.abs(felt_pairs - second)
    assert apart.max() < 1.5
    assert apart.mean() < 0.15
    assert np.abs(felt).max() > 3.0


def test_off_the_axis_it_feels_the_turn():
    # On a turntable: centripetal toward the axis, radius times rate squared.
    rate, radius, step = 2.0, 0.3, 1e-3
    spin = np.array([0.0, 0.0, rate])
    motions = [(turned(rate * step * k), np.zeros(3), spin) for k in (0, 1)]
    imu = imu_after(*motions, conf=imu_conf(mount_b=(radius, 0.0, 0.1)), step_s=step)
    np.testing.assert_allclose(read(imu, motions[1][0])[:3], [-radius * rate**2, 0.0, 9.81], atol=5e-3)


def test_acceleration_is_told_in_the_body_frame():
    rotation = turned(np.pi / 2)
    faster = (rotation, np.array([0.0, 0.1, 0.0]), np.zeros(3))
    imu = imu_after((rotation, np.zeros(3), np.zeros(3)), faster)
    np.testing.assert_allclose(read(imu, rotation)[:3], [2.0, 0.0, 9.81], atol=1e-5)


def test_begin_takes_motion_as_unaccelerated_only_where_told():
    imu = Imu(imu_conf(), 2)
    rotation, still, fast = np.tile(LEVEL, (2, 1, 1)), np.zeros((2, 3)), np.tile([1.0, 0, 0], (2, 1))
    imu.begin(np.array([True, True]), rotation, still, still)
    imu.measure(rotation, fast, still, 0.05)
    imu.begin(np.array([True, False]), rotation, 2 * fast, still)
    np.testing.assert_allclose(imu.acceleration_b, [[0, 0, 0], [20.0, 0, 0]])
    np.testing.assert_allclose(imu.measure(rotation, 2 * fast, still, 0.05), [[0, 0, 0], [20.0, 0, 0]])


def test_gyroscope_attitude_and_ranges():
    conf = imu_conf(acceleration_range_mps2=20.0, angular_range_radps=3.0)
    imu = imu_after(
        (LEVEL, np.zeros(3), np.zeros(3)), (LEVEL, np.array([-50.0, 0, 0.1]), np.zeros(3)), conf=conf
    )
    attitude = np.array([[0.1, -0.2, 3.0]])
    reading = imu.reading(LEVEL[None], np.array([[0.5, -9.0, 4.0]]), attitude)[0]
    np.testing.assert_allclose(reading, [-20.0, 0.0, 11.81, 0.5, -3.0, 3.0, 0.1, -0.2, 3.0], rtol=1e-6)
    assert reading.dtype == np.float32


@every_backend
def test_a_turning_rover_s_gyroscope_tells_its_turn(backend):
    drive = Drive(backend)
    yaws, rates = [], []
    for _ in range(60):
        drive.step(0.0, 0.5)
        motion = motion_of(drive.stage.state)
        yaws.append(motion.roll_pitch_yaw[0, 2])
        rates.append(sensed_speed(motion)[0, 1])
    turned_by = np.unwrap(yaws)[-1] - yaws[9]
    assert np.sum(rates[10:]) * 0.05 == pytest.approx(turned_by, rel=0.05)
    assert turned_by > 2.0
