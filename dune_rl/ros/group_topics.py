"""What is the same for all agents of a group that are recorded: codecs, timing of sensors, and names."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from dune_rl.env.agent_group import AgentGroup
from dune_rl.geometry.arrays import Array
from dune_rl.ros.codecs.choice import make_codec
from dune_rl.ros.codecs.codec import SensorCodec
from dune_rl.ros.transforms import FrameMount
from dune_rl.ros.velocity_commands import twist_of_action
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.sensor import Reading
from dune_rl.sensors.wheels import OdometryConf

ODOMETRY = "odometry"


@dataclass(frozen=True)
class ReadingTiming:
    """When a sensor's readings are taken and arrive, in control steps: see `RealismConf.steps`."""

    every: int = 1
    delay: int = 0

    def taken(self, steps: int) -> int:
        """The step in which the reading was taken that a robot has after `steps`; at first the start."""
        return max((steps - self.delay) // self.every * self.every, 0)

    def is_seen(self, repeat: int) -> bool:
        """Whether readings are taken in steps after which an action is decided, which are every `repeat`."""
        if self.every == 1:
            return self.delay % repeat == 0
        return self.every % repeat == 0


class Sensed(NamedTuple):
    """The latest `readings` (N, ...) of a group's agents, and the ranges (N, n_beams) of all beams that their
    planar LiDARs have measured just now, by name.
    """

    readings: Mapping[str, Reading]
    scans: Mapping[str, Reading]


class GroupTopics:
    """The topics of a group's agents: `codecs` and `timing` by sensor, and the fixed frames `mounts`.

    A LiDAR or an odometry of which too little is known where an action is held for several control steps is
    written as an array. `has_odometry` says whether the robots' own dead reckoning gives the frame odom.
    """

    def __init__(self, group: AgentGroup, step_s: float, repeat: int) -> None:
        self.group = group
        self.codecs: dict[str, SensorCodec] = {}
        self.timing: dict[str, ReadingTiming] = {}
        # Of planar LiDARs, whose beams are more than their readings.
        self.scanners: dict[str, Any] = {}
        suite = group.suite
        for name, conf in {} if suite is None else suite.settings.items():
            if suite is None or not conf.observed:
                continue
            timing = ReadingTiming(*conf.steps(step_s))
            needs_past = isinstance(conf, LidarConf | OdometryConf)
            is_known = repeat == 1 or timing == ReadingTiming()
            # Agents that come do so in any control step.
            is_known |= timing.is_seen(repeat) and group.presence is None
            standard = is_known or not needs_past
            bounds = suite.sensors[name].bounds()
            self.codecs[name] = make_codec(name, conf, bounds, step_s=step_s, standard=standard)
            self.timing[name] = timing
            if isinstance(conf, LidarConf) and standard:
                self.scanners[name] = suite.without_timing(name)
        self.has_odometry = ODOMETRY in self.codecs and any(
            channel.topic == "odom" for channel in self.codecs[ODOMETRY].channels
        )
        self.has_goal = group.task is not None or suite is not None
        # For joint_states; no sensor may read them otherwise.
        group.body.reads_joints = True

    @property
    def mounts(self) -> tuple[FrameMount, ...]:
        """The fixed frames of all sensors."""
        return tuple(mount for codec in self.codecs.values() for mount in codec.mounts)

    def sense(self) -> Sensed:
        """What the group's agents sense now."""
        return Sensed(self.group.observe(), {name: scanner.ranges for name, scanner in self.scanners.items()})

    def twist(self, action: Array) -> tuple[float, float] | None:
        """Speed [m/s] and yaw rate [rad/s] of an action; None for one that is no speed and heading."""
        if not self.group.has_speed_and_heading:
            return None
        return twist_of_action(self.group.body.vehicle(), action)

    def joint_names(self, row: int, count: int) -> list[str]:
        """Names of the motors' joints, which a robot's joints begin with."""
        return list(self.group.body.joint_angles(row))[:count]
