"""The sensor of the way left to the goal, over a map of what the robot has seen."""

from typing import Any, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.compiled import compile_function
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.perception.agent_tracks import AgentTracks
from dune_rl.sensors.perception.local_map import LocalMap
from dune_rl.sensors.perception.low_obstacles import LowObstacles
from dune_rl.sensors.perception.ways import way_left
from dune_rl.sensors.sensor import VectorSensor
from dune_rl.sensors.settings import SensorSettings
from dune_rl.state.state import GroupState, State

# Ways are looked for up to so many cells from the robot and its goal: 6 m.
_MARGIN = 48
# Differences of ways are limited to these [m]: an obstacle costs far more.
_SHORTER_M, _LONGER_M = -4.0, 6.0


class WayLeftConf(SensorSettings):
    """How much farther or nearer the goal is by way of points around the robot, over what it has seen.

    The map of 32 by 32 m is gathered from the LiDAR's scans by odometry; moving objects are no part of it,
    but ways avoid where they have been. Ways also lead round low obstacles, where their sensor is named.
    """

    sensor: Literal["way_left"] = "way_left"
    realism: None = Field(None, description="none of its own: its LiDAR's")
    tracks: str = Field("agent_tracks", description="name of the sensor whose scans and odometry it takes")
    low_obstacles: str | None = Field(
        None, description="name of the sensor whose low obstacles are on the map, too; null: none are"
    )
    directions: int = Field(16, ge=4, le=64, description="points on each circle, the first one behind")
    radii_m: tuple[float, ...] = Field((0.6, 1.2, 2.4), min_length=1, description="of the circles [m]")


class WayLeft(VectorSensor):
    """The reading `name`, (N, radii * directions) [m]: the way left from points around minus that from here.

    Circle after circle, counter-clockwise, the first point straight behind the robot.
    `tracks` and `low_obstacles` are the sensors that it reads.
    """

    def __init__(self, name: str, context: SensorContext, conf: WayLeftConf) -> None:
        size = len(conf.radii_m) * conf.directions
        super().__init__(name, context.num_rows, np.full(size, _SHORTER_M), np.full(size, _LONGER_M))
        tracks = context.sensor_of(conf.tracks)
        if not isinstance(tracks, AgentTracks):
            raise ConfigError(
                f"sensors.{name}.tracks must be the name of a sensor agent_tracks (got {conf.tracks!r})"
            )
        self.tracks = tracks
        low = None if conf.low_obstacles is None else context.sensor_of(conf.low_obstacles)
        if low is not None and not isinstance(low, LowObstacles):
            raise ConfigError(
                f"sensors.{name}.low_obstacles must be the name of a sensor low_obstacles "
                f"(got {conf.low_obstacles!r})"
            )
        self.low_obstacles = low
        angles = np.arange(conf.directions) * (2 * np.pi / conf.directions) - np.pi
        around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        self._points = np.concatenate([radius * around for radius in conf.radii_m])
        self.map = LocalMap(context.num_rows, tracks.bearings, tracks.mount, _MARGIN)

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Begin the maps of the agents in `mask` (N,) anew, for which the ways are straight."""
        self.map.forget(mask)
        goals = self.tracks.goals()
        straight = (
            np.linalg.norm(goals[:, None] - self._points, axis=2) - np.linalg.norm(goals, axis=1)[:, None]
        )
        before = self._reading
        self._store(straight)
        self._reading = np.where(mask[:, None], self._reading, before)

    def measure(self, now: GroupState, state: State) -> None:
        tracks, tracker, goals = self.tracks, self.tracks.tracker, self.tracks.goals()
        low = None if self.low_obstacles is None else self.low_obstacles.map
        movers = tracker.moving, tracker.moving_counts
        self.map.update(tracker.poses, tracks.ranges, tracks.sees, tracks.moves, goals, low, movers)
        found = np.empty((len(goals), len(self._points)), np.float32)
        _ways_around(tracker.poses, self.map.ways, self.map.origins, self._points, found)
        self._store(found)


@compile_function
def _ways_around(poses: Array, ways: Floats, origins: Any, points: Array, found: Floats) -> None:
    """Way left from `points` (P, 2) in the frames of `poses` (N, 3) minus that from there, `found` (N, P)."""
    for row in range(len(poses)):
        x, y = poses[row, 0], poses[row, 1]
        cos, sin = np.cos(poses[row, 2]), np.sin(poses[row, 2])
        here = way_left(ways[row], origins[row], x, y)
        for point in range(len(points)):
            ahead, left = points[point, 0], points[point, 1]
            there = way_left(
                ways[row], origins[row], x + cos * ahead - sin * left, y + sin * ahead + cos * left
            )
            found[row, point] = there - here
