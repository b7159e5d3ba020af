"""The scan of a moment ago out of scans and frames, for policies that read `lidar_past`."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Floats
from dune_rl.ros.codecs.codec import MessageError
from dune_rl.ros.codecs.scans import measured_ranges
from dune_rl.ros.times import NS_PER_S
from dune_rl.ros.transforms import Pose, TransformTree
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.past_scan import PastScan
from dune_rl.sensors.sensor import Reading


@dataclass(frozen=True)
class PastSource:
    """What a past scan follows from: the name of a LiDAR, its settings, and the scan's age [s]."""

    lidar: str
    conf: LidarConf
    past_s: float


class PastScans:
    """Where the beams of scans ended [m] in the frame `odom`, and how that looks from the present pose.

    The reading is that of the policy's sensor `lidar_past`, from the scans of the reading `lidar`.
    """

    def __init__(self, source: PastSource, odom: str, base: str) -> None:
        self.lidar = source.lidar
        self._conf, self._past_ns = source.conf, round(source.past_s * NS_PER_S)
        self._odom, self._base = odom, base
        self._past = PastScan(source.conf, 1, 0)
        # Times and end points, the oldest first.
        self._ends: list[tuple[int, Floats]] = []

    def add(self, message: Any, time_ns: int, frames: TransformTree) -> None:
        """Keep a LaserScan that arrived at a time, when the robot was where `frames` say."""
        origin, rotation = self._pose(message.header.frame_id, frames)
        ranges, _ = measured_ranges(np.asarray(message.ranges, np.float32), self._conf)
        angles = message.angle_min + np.arange(len(ranges)) * message.angle_increment
        ahead = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=-1)
        seen = ranges < np.float32(self._conf.range_m)
        ends = origin + (ranges[seen, None] * ahead[seen]) @ rotation.T
        self._ends.append((time_ns, ends.astype(np.float32)))

    def reading(self, message: Any, time_ns: int, frames: TransformTree) -> Reading:
        """The past scan (n_segments,) [m] at a time, from where the latest scan `message` was measured."""
        if not self._ends:
            raise MessageError("there is no earlier scan yet")
        while len(self._ends) > 1 and self._ends[1][0] <= time_ns - self._past_ns:
            self._ends.pop(0)
        origin = self._pose(message.header.frame_id, frames).position
        rotation = self._pose(self._base, frames).rotation
        return self._past.nearest(self._ends[0][1][None], origin[None], rotation[None])[0]

    def forget(self) -> None:
        """Drop all scans."""
        self._ends.clear()

    def _pose(self, frame: str, frames: TransformTree) -> Pose:
        pose = frames.pose(frame, self._odom)
        if pose is None:
            raise MessageError(
                f"its frame {frame!r} has no transform to {self._odom!r} in /tf, by which the past scan is "
                "carried along; record that, or give base=FRAME"
            )
        return pose
