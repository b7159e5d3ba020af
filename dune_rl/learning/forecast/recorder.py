"""Records tracks and what became of them, while a policy drives."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from tensordict import TensorDictBase

from dune_rl.core.errors import ConfigError
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array, Counts, Flags, Floats
from dune_rl.sensors.perception.agent_tracks import AgentTracks
from dune_rl.sensors.perception.motion_forecast import AHEAD_S, into_frames, track_features
from dune_rl.statistics.measures import MetricsRow

# A track is of the nearest body, if its middle is this near [m].
_NEAR_M = 0.6


class TrackSamples(NamedTuple):
    """Of R tracks: `features` (R, F); which are agents (R,), and of which the future is known (R,); `told`
    (R, 2 + A, 2), place, velocity and places ahead of the nearest body in the track's frame.
    """

    features: Floats
    agents: Flags
    followed: Flags
    told: Floats

    def part(self, rows: slice) -> "TrackSamples":
        """Those of some rows."""
        return TrackSamples(self.features[rows], self.agents[rows], self.followed[rows], self.told[rows])


class TrackRecorder:
    """Takes the tracks of a group's sensor `agent_tracks` in each decision, and where all bodies are.

    It is an observer of `evaluate`. `frames` counts the decisions of all robots. Raises ConfigError where the
    group has no such sensor, or nobody moves there.
    """

    def __init__(self, simulation: VectorSimulation) -> None:
        self._simulation, self._group = simulation, simulation.group()
        suite = self._group.suite
        found = [] if suite is None else [s for s in suite.sensors.values() if isinstance(s, AgentTracks)]
        if not found:
            raise ConfigError(
                f"a forecast is of the tracks of the group {self._group.name}, which has no sensor "
                "agent_tracks: add sensors=perception or sensors=perception_3d"
            )
        if len(simulation.groups) < 2 and self._group.count < 2:
            raise ConfigError("a forecast is learnt from agents that move: add some, such as actors=walkers")
        self.tracks = found[0]
        self.frames = 0
        self._steps: list[Array] = []
        self._bodies: list[Array] = []
        self._seen: list[tuple[Counts, Array, Floats, Array, Array]] = []

    def begin(self) -> None:
        """Scenes have been reset."""

    def step(self, after: TensorDictBase) -> None:
        """Take the tracks of this decision."""
        tracker, group = self.tracks.tracker, self._simulation.state.groups[self._group.name]
        rows, numbers = np.nonzero(np.arange(tracker.tracks.shape[1]) < tracker.counts[:, None])
        features, frames = track_features(
            tracker.tracks[rows, numbers], tracker.histories[rows, numbers], tracker.poses[rows]
        )
        motion = group.motion
        poses = np.column_stack([motion.position_w[:, :2], motion.yaw])
        self._steps.append(np.array(group.episode.steps))
        self._bodies.append(np.array(group.neighbours[..., :2]))
        self._seen.append((rows, poses[rows], features, frames, tracker.poses[rows].copy()))
        self.frames += len(poses)

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """Nothing: what is recorded is not of whole episodes."""

    def samples(self) -> TrackSamples:
        """All tracks that were recorded, in the order of time; raises ConfigError if there are none."""
        steps = np.array(self._steps)
        found = [self._sample(index, steps) for index in range(len(steps) - 1) if len(self._seen[index][0])]
        if not found:
            raise ConfigError("no track was seen: run more episodes, among more agents")
        return TrackSamples(*map(np.concatenate, zip(*found, strict=True)))

    def _sample(self, index: int, steps: Array) -> TrackSamples:
        """The tracks of a decision, but for those of episodes that ended with it."""
        step_s = self._simulation.physics.control_step_s
        later = slice(index + 1, index + 2 + round(AHEAD_S[-1] / step_s))
        rows = self._seen[index][0]
        # Times of the decisions after this one; inf from where another episode has begun.
        times = (steps[later][:, rows] - steps[index, rows]) * step_s
        times = np.where(np.minimum.accumulate(times > 0.0, axis=0), times, np.inf)
        goes_on = np.isfinite(times[0])
        times = times[:, goes_on]
        rows, poses, features, frames, odometry = (each[goes_on] for each in self._seen[index])
        apart = _carried(poses, odometry, frames, self._bodies[index][rows])
        distance = np.hypot(apart[..., 0], apart[..., 1])
        nearest = distance.argmin(axis=1)
        agents = distance.min(axis=1) < _NEAR_M
        bodies = np.moveaxis(np.stack(self._bodies[later])[:, rows, nearest], 0, 1)
        here, ways = apart[np.arange(len(rows)), nearest], _carried(poses, odometry, frames, bodies)
        followed = agents & (np.where(np.isfinite(times), times, 0.0).max(axis=0) >= AHEAD_S[-1])
        told = np.zeros((len(rows), 2 + len(AHEAD_S), 2))
        told[:, 0], told[:, 1] = here, (ways[:, 0] - here) / times[0][:, None]
        for track in np.flatnonzero(followed).tolist():
            known = np.isfinite(times[:, track])
            at = np.concatenate([[0.0], times[known, track]])
            way = np.concatenate([here[track : track + 1], ways[track, known]])
            told[track, 2:] = np.column_stack([np.interp(AHEAD_S, at, way[:, axis]) for axis in (0, 1)])
        return TrackSamples(features, agents, followed, told.astype(np.float32))


def _carried(poses: Array, odometry: Array, frames: Array, points: Array) -> Array:
    """World points (R, K, 2) beside robots at `poses` (R, 3), in `frames` in their `odometry` (R, 3)."""
    ways = np.column_stack([poses[:, :2], np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    body = into_frames(ways, points)
    cos, sin = np.cos(odometry[:, 2:3]), np.sin(odometry[:, 2:3])
    x, y = body[..., 0], body[..., 1]
    return into_frames(
        frames, np.stack([odometry[:, :1] + cos * x - sin * y, odometry[:, 1:2] + sin * x + cos * y], axis=-1)
    )
