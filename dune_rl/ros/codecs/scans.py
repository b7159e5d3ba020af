"""LiDARs as messages: LaserScan of a planar one, PointCloud2 of one with rings."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.ros.codecs.codec import (
    Channel,
    MessageError,
    SensorCodec,
    Source,
    Stamp,
    data_rows,
    topic_of,
    yaw_on_base,
)
from dune_rl.ros.transforms import FrameMount, TransformTree
from dune_rl.sensors.beams import bearings
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.lidar_3d import Lidar3dConf
from dune_rl.sensors.sensor import Reading

_SCAN, _CLOUD = "sensor_msgs/LaserScan", "sensor_msgs/PointCloud2"
# Of sensor_msgs/PointField: the number and the size of each NumPy type.
_FIELD_TYPES = {"u1": 2, "f4": 7}
_RANGE = "range"


def measured_ranges(ranges: Floats, conf: LidarConf) -> tuple[Floats, Flags]:
    """The ranges (B,) [m] that the sensor `conf` reads where a LaserScan has these, and which were measured.

    By REP-117, -inf is nearer than can be measured, inf farther, and NaN no measurement. Nor is 0, which many
    drivers write where nothing returns. What lies between it and range_min counts as near, to be safe. What
    was not measured is `range_m`.
    """
    is_measured = (ranges > 0.0) | np.isneginf(ranges)
    farthest, nearest = np.float32(conf.range_m), np.float32(conf.min_range_m)
    found: Floats = np.clip(np.where(is_measured, ranges, farthest), nearest, farthest)
    return found, is_measured


class ScanCodec(SensorCodec):
    """A planar LiDAR: all its beams as a LaserScan, and the nearest return of each segment out of one.

    Where nothing returns, ranges are inf (REP-117); the reading there is `range_m`.
    """

    def __init__(self, name: str, conf: LidarConf, period_s: float) -> None:
        self._name, self._conf, self._period_s = name, conf, period_s
        self._topic, self._frame = topic_of(name, "lidar", "scan"), f"{name}_link"
        self.channels = (Channel(self._topic, _SCAN),)
        self.mounts = (FrameMount.on_base(self._frame, conf.mount_b),)
        self.sources = {name: (Source(self._topic, (_SCAN,)),)}
        angles = bearings(float(np.deg2rad(conf.fov_deg)), conf.n_beams)
        self._first = float(angles[0])
        self._step = float(angles[1] - angles[0]) if conf.n_beams > 1 else float(np.deg2rad(conf.fov_deg))

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        """`readings` have the ranges of all beams, (n_beams,) [m]."""
        conf, ranges = self._conf, readings[self._name]
        seen = np.where(ranges < np.float32(conf.range_m), ranges, np.float32(np.inf)).astype(np.float32)
        yield (
            self._topic,
            stamp.types.make(
                _SCAN,
                header=stamp.header(self._frame),
                angle_min=self._first,
                angle_max=self._first + (conf.n_beams - 1) * self._step,
                angle_increment=self._step,
                # The beams of a scan are cast at once.
                time_increment=0.0,
                scan_time=self._period_s,
                range_min=conf.min_range_m,
                range_max=conf.range_m,
                ranges=seen,
                intensities=np.zeros(0, np.float32),
            ),
        )

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        """The nearest return (n_segments,) [m] of each segment; scans of other LiDARs may have more beams.

        The scanner may be turned about the vertical by its frame.
        """
        conf = self._conf
        ranges = np.asarray(message.ranges, np.float32)
        yaw = yaw_on_base(message.header.frame_id, frames, base)
        angles = yaw + message.angle_min + np.arange(len(ranges)) * message.angle_increment
        if not np.isfinite(angles).all():
            raise MessageError("the angles of its beams are not finite")
        beams = (angles - self._first) / self._step
        if np.isclose(conf.fov_deg, 360.0):
            beams = (beams + 0.5) % conf.n_beams - 0.5
        segment = np.floor((beams + 0.5) * conf.n_segments / conf.n_beams).astype(np.int64)
        inside = (segment >= 0) & (segment < conf.n_segments)
        missed = conf.n_segments - len(np.unique(segment[inside]))
        if missed:
            raise MessageError(
                f"{missed} of the {conf.n_segments} segments of {self._name}, which are of "
                f"{conf.fov_deg:g} degrees, have no beam of its {len(ranges)} over "
                f"{np.rad2deg(abs(message.angle_increment) * len(ranges)):.0f} degrees"
            )
        known, is_known = measured_ranges(ranges, conf)
        blind = conf.n_segments - len(np.unique(segment[inside & is_known]))
        if blind:
            raise MessageError(
                f"{blind} of the {conf.n_segments} segments of {self._name} have only NaN or 0, "
                "no measurement; let the driver write inf where nothing returns (REP-117)"
            )
        found: Floats = np.full(conf.n_segments, conf.range_m, np.float32)
        np.minimum.at(found, segment[inside], known[inside])
        return found


class CloudCodec(SensorCodec):
    """A LiDAR with rings: an organised PointCloud2, a row for each ring, from the highest to the lowest.

    Points are in the LiDAR's frame, NaN where nothing returns. Beside x, y and z there is the field `range`,
    inf where nothing returns, and, where they are measured, `intensity` and `segmentation`.
    """

    def __init__(self, name: str, conf: Lidar3dConf) -> None:
        self._name, self._conf = name, conf
        self._topic, self._frame = topic_of(name, "lidar_3d", "points"), f"{name}_link"
        self.channels = (Channel(self._topic, _CLOUD),)
        self.mounts = (FrameMount.on_base(self._frame, conf.mount_b),)
        self.sources = {f"{name}_{output}": (Source(self._topic, (_CLOUD,)),) for output in conf.outputs}
        self._directions = conf.directions().astype(np.float32)
        self._others = [output for output in conf.outputs if output != _RANGE]
        kinds: dict[str, str] = {
            output: "u1" if output == "segmentation" else "f4" for output in self._others
        }
        # Name, and type, of each field, in the order in which a point has them.
        self._fields: dict[str, str] = {**dict.fromkeys(("x", "y", "z", _RANGE), "f4"), **kinds}
        self._points = np.dtype([(label, f"<{kind}") for label, kind in self._fields.items()])

    def encode(self, stamp: Stamp, readings: Mapping[str, Reading]) -> Iterator[tuple[str, Any]]:
        conf, make = self._conf, stamp.types.make
        ranges = readings[f"{self._name}_{_RANGE}"][..., 0]
        seen = ranges < np.float32(conf.range_m)
        points = np.empty(ranges.shape, self._points)
        along = np.where(seen, ranges, np.float32(np.nan))
        for axis, label in enumerate("xyz"):
            points[label] = along * self._directions[..., axis]
        points[_RANGE] = np.where(seen, ranges, np.float32(np.inf))
        for output in self._others:
            points[output] = readings[f"{self._name}_{output}"][..., 0]
        fields, offset = [], 0
        for label, kind in self._fields.items():
            number = _FIELD_TYPES[kind]
            fields.append(make("sensor_msgs/PointField", name=label, offset=offset, datatype=number, count=1))
            offset += np.dtype(kind).itemsize
        size = self._points.itemsize
        yield (
            self._topic,
            make(
                _CLOUD,
                header=stamp.header(self._frame),
                height=conf.n_rings,
                width=conf.n_beams,
                fields=fields,
                is_bigendian=False,
                point_step=size,
                row_step=size * conf.n_beams,
                data=np.frombuffer(points.tobytes(), np.uint8),
                is_dense=bool(seen.all()),
            ),
        )

    def decode(self, reading: str, message: Any, frames: TransformTree, base: str) -> Reading:
        """The output `reading` (n_rings, n_beams, 1); the cloud must be organised in the policy's rings."""
        conf, output = self._conf, reading.removeprefix(f"{self._name}_")
        size = message.height, message.width
        if size != (conf.n_rings, conf.n_beams):
            raise MessageError(
                f"it has {size[0]} rows of {size[1]} points, and {self._name} has {conf.n_rings} rings of "
                f"{conf.n_beams} beams"
            )
        names = {value: key for key, value in _FIELD_TYPES.items()}
        offsets = {each.name: (each.offset, names.get(each.datatype)) for each in message.fields}
        data = data_rows(message, message.row_step, message.width * message.point_step).tobytes()

        def column(name: str) -> Any:
            offset, kind = offsets.get(name, (0, None))
            if kind is None:
                raise MessageError(
                    f"it has no field {name} of 32-bit floats or bytes; there are {', '.join(offsets)}"
                )
            if offset + np.dtype(kind).itemsize > message.point_step:
                raise MessageError(f"its field {name} lies beyond its points of {message.point_step} bytes")
            layout = np.dtype(
                {
                    "names": [name],
                    "formats": [(">" if message.is_bigendian else "<") + kind],
                    "offsets": [offset],
                    "itemsize": message.point_step,
                }
            )
            return np.frombuffer(data, layout)[name].reshape(*size, 1)

        if output == _RANGE and _RANGE not in offsets:
            axes = [column(axis).astype(np.float64) for axis in "xyz"]
            values = np.sqrt(sum(np.square(axis) for axis in axes)).astype(np.float32)
        else:
            values = column(output)
        if output != _RANGE:
            return np.ascontiguousarray(values, np.uint8 if output == "segmentation" else np.float32)
        farthest, nearest = np.float32(conf.range_m), np.float32(conf.min_range_m)
        found: Floats = np.clip(np.where(np.isnan(values), farthest, values), nearest, farthest)
        return found.astype(np.float32)
