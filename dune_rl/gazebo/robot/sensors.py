"""A robot's sensors as those of Gazebo."""

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from trimesh.transformations import euler_matrix

from dune_rl.gazebo.elements import add, words
from dune_rl.geometry.arrays import Array
from dune_rl.sensors.beams import bearings
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.imu import ImuConf
from dune_rl.sensors.lidar import LidarConf, ScannerConf
from dune_rl.sensors.lidar_3d import Lidar3dConf
from dune_rl.sensors.realism.noise import NoiseConf
from dune_rl.sensors.sensor import mount_position
from dune_rl.sensors.settings import SensorSettings

_NEAREST_M = 0.02


@dataclass(frozen=True, eq=False)
class MountedSensor:
    """The <sensor> called `name`, at `pose` (4, 4) on the base link."""

    name: str
    element: Element
    pose: Array


def make_sensors(
    sensors: Mapping[str, SensorSettings], step_s: float
) -> tuple[list[MountedSensor], list[str]]:
    """The sensors that Gazebo has, read every control step of `step_s` or slower, and names of the others."""
    found, others = [], []
    for name, conf in sensors.items():
        every, _ = conf.steps(step_s)
        period_s = every * step_s
        pitch_rad = 0.0
        match conf:
            case LidarConf():
                rings = np.deg2rad(conf.rings_deg or (0.0,))
                element = _lidar(name, conf, conf.n_beams, rings, period_s)
            case Lidar3dConf():
                rings = np.linspace(conf.lowest_elevation_deg, conf.highest_elevation_deg, conf.n_rings)
                element = _lidar(name, conf, conf.n_beams, np.deg2rad(rings), period_s)
            case CameraConf(projection="pinhole") if {"rgb", "grey", "depth"} & {*conf.outputs}:
                pitch_rad = float(np.deg2rad(conf.pitch_deg or 0.0))
                element = _camera(name, conf, period_s)
            case ImuConf():
                element = _imu(name, conf, period_s)
            case _:
                others.append(name)
                continue
        pose = euler_matrix(0.0, pitch_rad, 0.0)
        pose[:3, 3] = mount_position(getattr(conf, "mount_b", None))
        found.append(MountedSensor(name, element, pose))
    return found, others


def _sensor(name: str, kind: str, period_s: float) -> Element:
    element = Element("sensor", name=name, type=kind)
    add(element, "always_on", True)
    add(element, "update_rate", words([1.0 / period_s]))
    return element


def _lidar(name: str, conf: ScannerConf, beams: int, elevations: Array, period_s: float) -> Element:
    """A LiDAR; rings at other than even distances are spread evenly between the outermost."""
    element = _sensor(name, "gpu_lidar", period_s)
    add(element, "visualize", True)
    lidar = add(element, "lidar")
    scan = add(lidar, "scan")
    angles = bearings(float(np.deg2rad(conf.fov_deg)), beams)
    for tag, values in (("horizontal", angles), ("vertical", elevations)):
        holder = add(scan, tag)
        add(holder, "samples", len(values))
        add(holder, "resolution", 1)
        add(holder, "min_angle", words(values[:1]))
        add(holder, "max_angle", words(values[-1:]))
    limits = add(lidar, "range")
    add(limits, "min", words([max(conf.min_range_m, _NEAREST_M)]))
    add(limits, "max", words([conf.range_m]))
    add(limits, "resolution", words([0.0 if conf.realism is None else conf.realism.quantum_m]))
    if conf.realism is not None and (conf.realism.noise_m or conf.realism.noise_share):
        noise = add(lidar, "noise")
        add(noise, "type", "gaussian")
        add(noise, "mean", 0)
        # One for all ranges: that of half the largest.
        add(noise, "stddev", words([conf.realism.noise_m + conf.realism.noise_share * conf.range_m / 2]))
    return element


def _camera(name: str, conf: CameraConf, period_s: float) -> Element:
    coloured, deep = bool({"rgb", "grey"} & {*conf.outputs}), "depth" in conf.outputs
    kind = "rgbd_camera" if coloured and deep else "depth_camera" if deep else "camera"
    element = _sensor(name, kind, period_s)
    camera = add(element, "camera")
    add(camera, "horizontal_fov", words([np.deg2rad(conf.fov_deg)]))
    image = add(camera, "image")
    add(image, "width", conf.width)
    add(image, "height", conf.height)
    add(image, "format", "R8G8B8" if "rgb" in conf.outputs or deep else "L8")
    clip = add(camera, "clip")
    add(clip, "near", words([_NEAREST_M]))
    add(clip, "far", words([conf.range_m]))
    return element


def _imu(name: str, conf: ImuConf, period_s: float) -> Element:
    element = _sensor(name, "imu", period_s)
    imu, realism = add(element, "imu"), conf.realism
    if realism is not None:
        for tag, noise in (
            ("angular_velocity", realism.gyroscope),
            ("linear_acceleration", realism.accelerometer),
        ):
            holder = add(imu, tag)
            for axis in "xyz":
                _add_noise(add(holder, axis), noise, period_s)
    return element


def _add_noise(parent: Element, conf: NoiseConf, period_s: float) -> None:
    noise = add(parent, "noise", type="gaussian")
    add(noise, "mean", 0)
    add(noise, "stddev", words([np.hypot(conf.noise_density / np.sqrt(period_s), conf.noise)]))
    add(noise, "bias_mean", 0)
    add(noise, "bias_stddev", words([conf.bias]))
