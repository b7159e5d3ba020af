"""Messages of others: what is padded, cut off or not measured."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags: pip install 'dune_rl[ros]'")

from dune_rl.ros.codecs.codec import MessageError
from dune_rl.ros.codecs.pictures import CameraCodec
from dune_rl.ros.codecs.scans import CloudCodec, ScanCodec
from dune_rl.ros.library import message_types
from dune_rl.ros.past_scans import PastScans, PastSource
from dune_rl.ros.transforms import Pose, TransformTree
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.lidar_3d import Lidar3dConf

TYPES = message_types()
LIDAR = LidarConf(n_beams=4, n_segments=4, range_m=10.0, min_range_m=0.1)
SECOND = 1_000_000_000


def _frames(x_m: float) -> TransformTree:
    """A scanner on a robot that has driven `x_m`."""
    frames = TransformTree()
    poses = [("map", "odom", 0.0), ("odom", "base_link", x_m), ("base_link", "laser", 0.0)]
    transforms = [
        TYPES.transform(TYPES.header(0, parent), child, Pose(np.array([x, 0.0, 0.0]), np.eye(3)))
        for parent, child, x in poses
    ]
    frames.add(TYPES.make("tf2_msgs/TFMessage", transforms=transforms), is_static=False)
    return frames


def _scan(ranges: list[float]) -> Any:
    return TYPES.make(
        "sensor_msgs/LaserScan",
        header=TYPES.header(0, "laser"),
        angle_min=-np.pi,
        angle_max=np.pi / 2,
        angle_increment=np.pi / 2,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=10.0,
        ranges=np.array(ranges, np.float32),
        intensities=np.zeros(0, np.float32),
    )


def test_a_scan_and_the_past_one_agree_on_what_was_measured() -> None:
    """0 and NaN are no measurement, inf is far, -inf near: the robot has not moved."""
    scan, frames = _scan([0.0, np.inf, -np.inf, 5.0]), _frames(0.0)
    past = PastScans(PastSource("lidar", LIDAR, 0.4), "odom", "base_link")
    past.add(scan, 0, frames)
    found = past.reading(scan, SECOND, frames)
    np.testing.assert_allclose(found, [10.0, 10.0, 0.1, 5.0], atol=1e-5)
    with pytest.raises(MessageError, match="1 of the 4 segments of lidar have only NaN or 0"):
        ScanCodec("lidar", LIDAR, 0.1).decode("lidar", scan, frames, "base_link")
    whole = _scan([2.0, np.inf, -np.inf, 5.0])
    now = ScanCodec("lidar", LIDAR, 0.1).decode("lidar", whole, frames, "base_link")
    np.testing.assert_allclose(now, [2.0, 10.0, 0.1, 5.0])


def test_what_was_not_measured_leaves_no_phantom_behind_a_robot_that_moves() -> None:
    past = PastScans(PastSource("lidar", LIDAR, 0.4), "odom", "base_link")
    scan = _scan([0.0, np.inf, 0.0, np.nan])
    past.add(scan, 0, _frames(0.0))
    np.testing.assert_allclose(past.reading(scan, SECOND, _frames(0.4)), 10.0)


def _picture(codec: CameraCodec, pixels: np.ndarray, step: int, data: bytes) -> np.ndarray:
    message = TYPES.make(
        "sensor_msgs/Image",
        header=TYPES.header(0, "camera"),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding="rgb8",
        is_bigendian=0,
        step=step,
        data=np.frombuffer(data, np.uint8),
    )
    return codec.decode("camera_rgb", message, _frames(0.0), "base_link")


def test_rows_of_pictures_may_be_padded() -> None:
    conf = CameraConf(width=5, height=4)
    codec = CameraCodec("camera", conf)
    pixels = np.random.default_rng(1).integers(0, 256, (4, 5, 3), np.uint8)
    rows = np.zeros((4, 16), np.uint8)
    rows[:, :15] = pixels.reshape(4, 15)
    np.testing.assert_array_equal(_picture(codec, pixels, 16, rows.tobytes()), pixels)
    # Some drivers leave bytes behind the last row.
    np.testing.assert_array_equal(_picture(codec, pixels, 16, rows.tobytes() + b"end"), pixels)
    for step, data in ((0, b""), (14, rows.tobytes()), (16, rows.tobytes()[:-1])):
        with pytest.raises(MessageError, match=f"in rows of {step}, and needs 4 rows of at least 15"):
            _picture(codec, pixels, step, data)


def _cloud(conf: Lidar3dConf, data: bytes, point_step: int, row_step: int, offset: int = 0) -> np.ndarray:
    field = TYPES.make("sensor_msgs/PointField", name="range", offset=offset, datatype=7, count=1)
    message = TYPES.make(
        "sensor_msgs/PointCloud2",
        header=TYPES.header(0, "laser"),
        height=conf.n_rings,
        width=conf.n_beams,
        fields=[field],
        is_bigendian=False,
        point_step=point_step,
        row_step=row_step,
        data=np.frombuffer(data, np.uint8),
        is_dense=True,
    )
    return CloudCodec("lidar_3d", conf).decode("lidar_3d_range", message, _frames(0.0), "base_link")


def test_rows_of_clouds_may_be_padded() -> None:
    conf = Lidar3dConf(n_rings=2, n_beams=3)
    ranges = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], np.float32)
    rows = np.zeros((2, 20), np.uint8)
    rows[:, :12] = ranges.view(np.uint8)
    np.testing.assert_array_equal(_cloud(conf, rows.tobytes(), 4, 20)[..., 0], ranges)
    for point_step, row_step, offset, message in (
        (0, 0, 0, "its field range lies beyond its points of 0 bytes"),
        (4, 20, 1, "its field range lies beyond its points of 4 bytes"),
        (8, 20, 0, "it has 40 bytes in rows of 20, and needs 2 rows of at least 24"),
        (4, 24, 0, "it has 40 bytes in rows of 24"),
    ):
        with pytest.raises(MessageError, match=message):
            _cloud(conf, rows.tobytes(), point_step, row_step, offset)
