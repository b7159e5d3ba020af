"""Cameras as messages: Image and CameraInfo of each of their outputs."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dune_rl.ros.codecs.codec import Channel, MessageError, SensorCodec, Source, Stamp, data_rows
from dune_rl.ros.transforms import OPTICAL, FrameMount, Pose, TransformTree
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.lens import Lens
from dune_rl.sensors.sensor import Reading

_IMAGE, _INFO = "sensor_msgs/Image", "sensor_msgs/CameraInfo"
# Encoding, type and channels of each output.
_ENCODINGS: Mapping[str, tuple[str, type, int]] = {
    "rgb": ("rgb8", np.uint8, 3),
    "grey": ("mono8", np.uint8, 1),
    "segmentation": ("mono8", np.uint8, 1),
    "depth": ("32FC1", np.float32, 1),
    "normals": ("32FC3", np.float32, 3),
}
# Of other cameras: the order of the channels.
_ALSO_READ: Mapping[str, Mapping[str, slice]] = {"rgb": {"bgr8": slice(None, None, -1)}}
_DEPTH_MM = "16UC1"


class CameraCodec(SensorCodec):
    """A camera: `NAME/OUTPUT/image_raw` and `NAME/OUTPUT/camera_info` of each output.

    The frame is optical: x right, y down, z forward. Depth is in metres, inf where nothing is seen (REP-118).
    """

    def __init__(self, name: str, conf: CameraConf) -> None:
        self._name, self._conf = name, conf
        link, self._frame = f"{name}_link", f"{name}_optical_frame"
        pitch = float(np.deg2rad(conf.pitch_deg or 0.0))
        self.mounts = (
            FrameMount.on_base(link, conf.mount_b, pitch),
            FrameMount(link, self._frame, Pose(np.zeros(3), OPTICAL)),
        )
        self.channels = tuple(
            Channel(f"{name}/{output}/{topic}", kind)
            for output in conf.outputs
            for topic, kind in (("image_raw", _IMAGE), ("camera_info", _INFO))
        )
        self.sources = {
            f"{name}_{output}": (Source(f"{name}/{output}/image_raw", (_IMAGE,)),) for output in conf.outputs
        }
        self._info = _intrinsics(conf)

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        conf, make = self._conf, stamp.types.make
        for output in conf.outputs:
            encoding, dtype, channels = _ENCODINGS[output]
            values = readings[f"{self._name}_{output}"]
            if output == "depth":
                values = np.where(values < np.float32(conf.range_m), values, np.float32(np.inf))
            header = stamp.header(self._frame)
            yield (
                f"{self._name}/{output}/image_raw",
                make(
                    _IMAGE,
                    header=header,
                    height=conf.height,
                    width=conf.width,
                    encoding=encoding,
                    is_bigendian=0,
                    step=conf.width * channels * np.dtype(dtype).itemsize,
                    data=np.frombuffer(np.ascontiguousarray(values, dtype).tobytes(), np.uint8),
                ),
            )
            region = make(
                "sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
            )
            yield (
                f"{self._name}/{output}/camera_info",
                make(_INFO, header=header, **self._info, binning_x=0, binning_y=0, roi=region),
            )

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        """The picture `reading` (height, width, channels); it must be of the policy's size and encoding."""
        conf, output = self._conf, reading.removeprefix(f"{self._name}_")
        encoding, dtype, channels = _ENCODINGS[output]
        if (message.height, message.width) != (conf.height, conf.width):
            raise MessageError(
                f"it has {message.width} by {message.height} pixels, and {self._name} has {conf.width} by "
                f"{conf.height}; scale the pictures"
            )
        order = slice(None)
        if message.encoding in _ALSO_READ.get(output, {}):
            order = _ALSO_READ[output][message.encoding]
        elif output == "depth" and message.encoding == _DEPTH_MM:
            dtype = np.uint16
        elif message.encoding != encoding:
            raise MessageError(f"its encoding is {message.encoding!r}, and {reading} needs {encoding!r}")
        stored = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
        rows = data_rows(message, message.step, conf.width * channels * stored.itemsize)
        values = np.frombuffer(rows.tobytes(), stored).reshape(conf.height, conf.width, channels)[..., order]
        if output != "depth":
            return np.ascontiguousarray(values, _ENCODINGS[output][1])
        metres = values.astype(np.float32)
        if message.encoding == _DEPTH_MM:
            # 0 is no measurement there.
            metres = np.where(values == 0, np.float32(np.nan), metres / np.float32(1000.0))
        farthest = np.float32(conf.range_m)
        return np.clip(np.where(np.isnan(metres), farthest, metres), np.float32(0.0), farthest)


def _intrinsics(conf: CameraConf) -> dict[str, Any]:
    """Size, distortion and matrices of a CameraInfo, whose pixels' centres are at whole numbers."""
    focal = Lens(conf).focal_px
    # The middle of the picture is half a pixel from the middle of its first pixel.
    x, y = conf.width / 2 - 0.5, conf.height / 2 - 0.5
    is_pinhole = conf.projection == "pinhole"
    given = np.zeros(5 if is_pinhole else 4)
    given[: len(conf.distortion)] = conf.distortion
    return {
        "height": conf.height,
        "width": conf.width,
        "distortion_model": "plumb_bob" if is_pinhole else "equidistant",
        "d": given,
        "k": np.array([focal, 0.0, x, 0.0, focal, y, 0.0, 0.0, 1.0]),
        "r": np.eye(3).reshape(-1),
        "p": np.array([focal, 0.0, x, 0.0, 0.0, focal, y, 0.0, 0.0, 0.0, 1.0, 0.0]),
    }
