"""Real devices: what is known of their faults, and the source of each figure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

SensorKind = Literal["imu", "lidar", "camera", "position"]

_G = 9.80665
_DEG = float(np.pi / 180)
# Radius that holds half of the readings (CEP) over the deviation of each axis.
_CEP = float(np.sqrt(2 * np.log(2)))

_BMI055 = "Bosch BMI055, which has the same two dies (comparison table, blog.csdn.net article 103731233)"
_BNO055 = "Bosch BNO055 data sheet BST-BNO055-DS000-14"
_MPU6050 = "InvenSense MPU-6050 product specification PS-MPU-6000A-00 rev. 3.4"
_MTI_1 = "Xsens MTi-1, as tabled in Transactions on Aerospace Research 2023, 10.2478/tar-2023-0022"
_MTI_630 = "Xsens MTi-630, as tabled by JorgeDFR/3d_lidar_slam_benchmark_at_iilab, docs, sensors/imu"
_HMC5883L = "Honeywell HMC5883L data sheet, 'enables 1° to 2° compass heading accuracy', the larger taken"
_START = f"the yaw at the start is a compass's: {_HMC5883L}"
_EUROC = "EuRoC MAV data set, imu0/sensor.yaml, 'VI-Sensor IMU (ADIS16448)'"
_ADIS_DRIVER = "Linux driver drivers/iio/imu/adis16400.c, adis16448"
_RPLIDAR_A1 = "SLAMTEC RPLIDAR A1M8 data sheet, figure 2-1"
_RPLIDAR_A2 = "SLAMTEC RPLIDAR A2M8 data sheet rev. 2.5, introduction"
_RPLIDAR_A3 = "SLAMTEC RPLIDAR A3M1, as tabled in the docs of app4mc-racecar, lidar"
_OS1 = "Ouster OS1 data sheet, optical performance"
_IMX219 = "line of 3448 (IMX219PQH5-C data sheet, table 21) at 182.4 MHz (Linux driver imx219.c), 1232 lines"
_IMX477 = "Raspberry Pi HQ camera measured at gain 1, strollswithmydog.com, 'Pi HQ Cam Sensor Performance'"
_F9 = "u-blox integration manual UBX-20039643, section 2.1.4, real time kinematic"
_D4XX = "Intel, 'BKMs for tuning D4xx': z² * 0.08 / (424 * 0.05), for 848 columns, 90 degrees, 50 mm"


@dataclass(frozen=True)
class SensorPreset:
    """A real device: for each setting of its kind of sensor, by its dotted name, the value and its source.

    A source that begins with "estimate" is no more than that.
    """

    kind: SensorKind
    name: str
    figures: Mapping[str, tuple[Any, str]]

    @property
    def settings(self) -> dict[str, Any]:
        """The settings as plain data."""
        found: dict[str, Any] = {}
        for path, (value, _) in self.figures.items():
            section, _, field = path.rpartition(".")
            (found.setdefault(section, {}) if section else found)[field] = value
        return found


PRESETS: Mapping[str, SensorPreset] = {
    "bno055": SensorPreset(
        "imu",
        "Bosch BNO055, in a fusion mode, where it takes its own offsets off",
        {
            "accelerometer.noise_density": (150e-6 * _G, f"150 µg/√Hz: {_BMI055}"),
            "accelerometer.quantum": (0.01, f"1 m/s² = 100 LSB: {_BNO055}, table 3-33"),
            "gyroscope.noise_density": (0.014 * _DEG, f"0.014 °/s/√Hz: {_BMI055}"),
            "gyroscope.quantum": (_DEG / 16, f"1 °/s = 16 LSB: {_BNO055}, table 3-22"),
            "tilt.bias": (0.5 * _DEG, "estimate: half a degree, constant over an episode"),
            "tilt.quantum": (_DEG / 16, "1° = 16 LSB: angle_scale in BNO055.cpp by 5hel2l2y, os.mbed.com"),
            "heading_from": ("magnetometer", f"absolute orientation, from all three sensors: {_BNO055}"),
            "heading.bias": (2.5 * _DEG, "estimate: the magnetometer's, constant over an episode"),
            "heading.quantum": (_DEG / 16, "1° = 16 LSB: angle_scale in BNO055.cpp by 5hel2l2y, os.mbed.com"),
        },
    ),
    "mpu6050": SensorPreset(
        "imu",
        "InvenSense MPU-6050 at ±16 g and ±2000 °/s, its gyroscope zeroed at rest",
        {
            "accelerometer.noise_density": (400e-6 * _G, f"400 µg/√Hz: {_MPU6050}, section 6.2"),
            "accelerometer.bias": (
                50e-3 * _G / 3,
                f"±50 mg (x, y), three deviations: {_MPU6050}, section 6.2",
            ),
            "accelerometer.quantum": (_G / 2048, f"2048 LSB/g: {_MPU6050}, section 6.2"),
            "gyroscope.noise_density": (0.005 * _DEG, f"0.005 °/s/√Hz: {_MPU6050}, section 6.1"),
            "gyroscope.bias_instability": (
                0.0012 * _DEG,
                "Allan deviation: robotics.stackexchange.com/q/8860",
            ),
            "gyroscope.quantum": (_DEG / 16.4, f"16.4 LSB/(°/s): {_MPU6050}, section 6.1"),
            "tilt.bias": (50e-3 / 3, "the accelerometer's bias over gravity, as levelling by it gives"),
            "heading.bias": (2.0 * _DEG, _START),
        },
    ),
    "xsens_mti_1": SensorPreset(
        "imu",
        "Xsens MTi-1",
        {
            "accelerometer.noise_density": (120e-6 * _G, f"120 µg/√Hz: {_MTI_1}"),
            "accelerometer.bias_instability": (0.03e-3 * _G, f"0.03 mg: {_MTI_1}"),
            "gyroscope.noise_density": (0.007 * _DEG, f"0.007 °/s/√Hz: {_MTI_1}"),
            "gyroscope.bias_instability": (10 * _DEG / 3600, f"10 °/h: {_MTI_1}"),
            "tilt.bias": (0.5 * _DEG, "estimate: half a degree, as levelling by its accelerometer gives"),
            "heading.bias": (2.0 * _DEG, _START),
        },
    ),
    "xsens_mti_630": SensorPreset(
        "imu",
        "Xsens MTi-630",
        {
            "accelerometer.noise_density": (60e-6 * _G, f"60 µg/√Hz: {_MTI_630}"),
            "accelerometer.bias_instability": (15e-6 * _G, f"10 to 15 µg: {_MTI_630}"),
            "gyroscope.noise_density": (0.007 * _DEG, f"0.007 °/s/√Hz: {_MTI_630}"),
            "gyroscope.bias_instability": (8 * _DEG / 3600, f"8, read as °/h, not °/s: {_MTI_630}"),
            "tilt.bias": (0.2 * _DEG, f"0.2° RMS, taken as constant over an episode: {_MTI_630}"),
            "heading_from": ("magnetometer", f"an attitude and heading reference system: {_MTI_630}"),
            "heading.bias": (1.0 * _DEG, f"1° RMS, taken as constant over an episode: {_MTI_630}"),
        },
    ),
    "adis16448": SensorPreset(
        "imu",
        "Analog Devices ADIS16448, as calibrated for a visual-inertial data set",
        {
            "accelerometer.noise_density": (2.0e-3, _EUROC),
            "accelerometer.bias_walk": (3.0e-3, _EUROC),
            "accelerometer.quantum": (_G / 1200, f"1/1200 g: {_ADIS_DRIVER}"),
            "gyroscope.noise_density": (1.6968e-4, _EUROC),
            "gyroscope.bias_walk": (1.9393e-5, _EUROC),
            "gyroscope.quantum": (0.04 * _DEG, f"0.04 °/s: {_ADIS_DRIVER}"),
            "tilt.bias": (0.5 * _DEG, "estimate: half a degree, as levelling by its accelerometer gives"),
            "heading.bias": (2.0 * _DEG, _START),
        },
    ),
    "rplidar_a1": SensorPreset(
        "lidar",
        "SLAMTEC RPLIDAR A1M8",
        {
            "rate_hz": (5.0, f"1 to 10 Hz, typically 5.5, of which 5 divides the usual 20: {_RPLIDAR_A1}"),
            "noise_share": (0.01 / 3, f"resolution < 1 %, as three deviations: {_RPLIDAR_A1}"),
            "half_return_m": (12.0, f"12 m for white objects, taken as where half return: {_RPLIDAR_A1}"),
        },
    ),
    "rplidar_a2m8": SensorPreset(
        "lidar",
        "SLAMTEC RPLIDAR A2M8",
        {
            "rate_hz": (10.0, f"typically 10 Hz: {_RPLIDAR_A2}"),
            "noise_share": (0.01 / 3, "estimate: as the A1M8"),
            "half_return_m": (12.0, f"range of 12 m, taken as where half return: {_RPLIDAR_A2}"),
        },
    ),
    "rplidar_a3": SensorPreset(
        "lidar",
        "SLAMTEC RPLIDAR A3M1 in its outdoor mode",
        {
            "rate_hz": (10.0, f"typically 10 Hz: {_RPLIDAR_A3}"),
            "noise_share": (0.01 / 3, "estimate: as the A1M8"),
            "half_return_m": (20.0, f"20 m for white objects, taken as where half return: {_RPLIDAR_A3}"),
            "reflectance": ((0.16, 1.0), f"black objects to 10 m, white to 25, squared: {_RPLIDAR_A3}"),
        },
    ),
    "hokuyo_utm_30lx": SensorPreset(
        "lidar",
        "Hokuyo UTM-30LX, which scans at 40 Hz: each control step",
        {
            "noise_m": (0.01, "estimate: repeatability of 10 mm, remembered, not read again"),
            "half_return_m": (30.0, "range of 30 m, taken as where half return: BlenSor's generic LIDAR"),
        },
    ),
    "velodyne_vlp16": SensorPreset(
        "lidar",
        "Velodyne VLP-16, one of its rings",
        {
            "rate_hz": (10.0, "up to 20 Hz, of which 10 is usual: NitinJSanket/RoboticsHardware, LIDAR.md"),
            "noise_m": (0.03, "accuracy of 3 cm: NitinJSanket/RoboticsHardware, LIDAR.md"),
            "half_return_m": (100.0, "range of 100 m, taken as where half return: the same table"),
        },
    ),
    "ouster_os1": SensorPreset(
        "lidar",
        "Ouster OS1, one of its rings",
        {
            "rate_hz": (10.0, f"10 to 20 Hz: {_OS1}"),
            "noise_m": (0.015, f"one deviation of 1.5 cm for strong signals: {_OS1}"),
            "quantum_m": (0.012, f"range resolution of 1.2 cm: {_OS1}"),
            "half_return_m": (120.0, f"120 m at 80 % reflectance, taken as where half return: {_OS1}"),
            "reflectance": ((1 / 9, 1.0), f"40 m at 10 % where 120 m at 80 %, squared: {_OS1}"),
        },
    ),
    "dune_paper": SensorPreset(
        "lidar",
        "no part, but what the published simulation has written and switched off",
        {
            "noise_m": (0.05, "the published simulation's code: deviation of 0.05 m"),
            "dropout": (0.05, "the published simulation's code: 5 % to the largest range"),
        },
    ),
    "raspberry_pi_v2": SensorPreset(
        "camera",
        "Raspberry Pi camera module 2 (Sony IMX219), 1640 by 1232 pixels",
        {
            "readout_s": (1232 * 3448 / 182.4e6, _IMX219),
            "shutter_s": (0.01, "estimate: a hundredth of a second"),
            "auto_exposure_s": (0.5, "estimate: half a second"),
            "full_well_e": (4265.0, "estimate: the IMX477's 3400 electrons/µm² on pixels of 1.12 µm"),
            "read_noise_e": (3.0, "estimate: the IMX477's"),
        },
    ),
    "raspberry_pi_hq": SensorPreset(
        "camera",
        "Raspberry Pi high quality camera (Sony IMX477); its time of readout is not known here",
        {
            "shutter_s": (0.01, "estimate: a hundredth of a second"),
            "auto_exposure_s": (0.5, "estimate: half a second"),
            "full_well_e": (8180.0, _IMX477),
            "read_noise_e": (3.0, _IMX477),
        },
    ),
    "realsense_d435": SensorPreset(
        "camera",
        "Intel RealSense D435, its depth; its colours stay as they are",
        {
            "depth_noise_per_m": (0.08 / (424 * 0.05), _D4XX),
            "depth_quantum_m": (0.001, "estimate: the millimetre of its 16-bit depth, as remembered"),
            "depth_near_m": (0.11, "0.11 m: Intel communities, thread 121652"),
            "depth_far_m": (10.0, "estimate: ten metres"),
            "depth_dropout": (0.02, "estimate: one pixel in fifty"),
        },
    ),
    "zed_f9p": SensorPreset(
        "position",
        "u-blox ZED-F9P with corrections from a base station (RTK), beside a compass",
        {
            "rate_hz": (10.0, "up to 20 Hz with RTK, 10 taken: docs.sparkfun.com, RTK firmware, GNSS"),
            "place.noise": (0.01 / _CEP, f"0.01 m + 1 ppm CEP, near the base: {_F9}"),
            "height.noise": (0.02 / _CEP, "estimate: twice the horizontal error"),
            "heading.bias": (2.5 * _DEG, "estimate: a compass's, constant over an episode"),
        },
    ),
}


def find_preset(name: str, kind: SensorKind | None = None) -> SensorPreset:
    """The device called `name`, of this `kind` where one is given; ValueError where there is none."""
    known = [key for key, preset in PRESETS.items() if kind in (None, preset.kind)]
    if name in known:
        return PRESETS[name]
    choices = f"choose {', '.join(known[:-1])} or {known[-1]}"
    if name in PRESETS:
        raise ValueError(f"{name} is a device for {PRESETS[name].kind} sensors; {choices}")
    raise ValueError(f"there is no device {name!r}; {choices}")
