"""Records tracks and what became of them, while a policy drives."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from tensordict import TensorDictBase

from dune_rl.core.errors import ConfigError
from dune_rl.env.scene_manager import scene_rows
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array, Counts, Flags, Floats
from dune_rl.geometry.frames import frames_of_poses, into_frames, out_of_frames
from dune_rl.sensors.perception.agent_tracks import AgentTracks
from dune_rl.sensors.perception.motion_forecast import AHEAD_S, track_features
from dune_rl.statistics.measures import MetricsRow

# A track is of the nearest body, if its middle is this near [m].
_NEAR_M = 0.6
# Who is faster than this has not walked, but left the scene [m/s].
_FASTEST_MPS = 15.0


class TrackSamples(NamedTuple):
    """Of R tracks: `features` (R, F); which are agents (R,), and of which the future is known (R,); `told`
    (R, 2 + A, 2), place, velocity and places ahead of the nearest body in the track's frame; and the numbers
    of their episodes (R,).
    """

    features: Floats
    agents: Flags
    followed: Flags
    told: Floats
    episodes: Counts

    def split(self, first: int) -> tuple["TrackSamples", "TrackSamples"]:
        """Those of the episodes before `first`, and the others."""
        return self.chosen(self.episodes < first), self.chosen(self.episodes >= first)

    def chosen(self, rows: Flags) -> "TrackSamples":
        """Those of the tracks in `rows` (R,)."""
        return TrackSamples(
            self.features[rows], self.agents[rows], self.followed[rows], self.told[rows], self.episodes[rows]
        )


class TrackRecorder:
    """Takes the tracks of a group's sensor `agent_tracks` in each decision, and where all bodies are.

    It is an observer of `evaluate`. Raises ConfigError where the first external group has no such sensor, or
    nobody moves beside it.
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
        self._tracker = found[0].tracker
        # Of each decision: numbers of the episodes (N,) and their steps, places of bodies (N, K, 2), and of
        # R tracks their rows, robots' poses, features, frames and odometry.
        self._episodes: list[Counts] = []
        self._steps: list[Counts] = []
        self._bodies: list[Array] = []
        self._seen: list[tuple[Counts, Array, Floats, Array, Array]] = []

    def begin(self) -> None:
        """Scenes have been reset."""

    def step(self, after: TensorDictBase) -> None:
        """Take the tracks of this decision, but for those of robots that rest or are not there."""
        tracker, group = self._tracker, self._simulation.state.groups[self._group.name]
        is_there = ~scene_rows(self._simulation.resting, self._group.count)
        if group.absent is not None:
            is_there = is_there & ~group.absent
        there = np.arange(tracker.tracks.shape[1]) < tracker.counts[:, None]
        rows, numbers = np.nonzero(there & is_there[:, None])
        features, frames = track_features(
            tracker.tracks[rows, numbers], tracker.histories[rows, numbers], tracker.poses[rows]
        )
        motion = group.motion
        poses = np.column_stack([motion.position_w[:, :2], motion.yaw])
        # Where a robot rests its episode is over, while scripted agents go on.
        self._episodes.append(np.where(is_there, group.episode.ids, -1))
        self._steps.append(np.array(group.episode.steps))
        self._bodies.append(np.array(group.neighbours[..., :2]))
        self._seen.append((rows, poses[rows], features, frames, tracker.poses[rows].copy()))

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        """Nothing: what is recorded is not of whole episodes."""

    def samples(self) -> TrackSamples:
        """All tracks that were recorded, in the order of time; raises ConfigError if there are none."""
        steps, episodes = np.array(self._steps), np.array(self._episodes)
        found = [
            self._sample(index, steps, episodes)
            for index in range(len(steps) - 1)
            if len(self._seen[index][0])
        ]
        if not found:
            raise ConfigError("no track was seen: run more episodes, among more agents")
        return TrackSamples(*map(np.concatenate, zip(*found, strict=True)))

    def _sample(self, index: int, steps: Counts, episodes: Counts) -> TrackSamples:
        """The tracks of a decision, but for those of episodes that ended with it, or bodies that left."""
        physics, rows = self._simulation.physics, self._seen[index][0]
        decision_s = physics.control_step_s * physics.action_repeat
        later = slice(index + 1, index + 2 + round(AHEAD_S[-1] / decision_s))
        times = (steps[later][:, rows] - steps[index, rows]) * physics.control_step_s
        goes_on = np.logical_and.accumulate(episodes[later][:, rows] == episodes[index, rows], axis=0)
        rows, poses, features, frames, odometry = self._seen[index]
        apart = _carried(poses, odometry, frames, self._bodies[index][rows])
        distance = np.hypot(apart[..., 0], apart[..., 1])
        nearest = distance.argmin(axis=1)
        agents = distance.min(axis=1) < _NEAR_M
        bodies = np.moveaxis(np.stack(self._bodies[later])[:, rows, nearest], 0, 1)
        here, ways = apart[np.arange(len(rows)), nearest], _carried(poses, odometry, frames, bodies)
        moved = np.diff(np.concatenate([here[:, None], ways], axis=1), axis=1)
        speeds = np.hypot(moved[..., 0], moved[..., 1]).T / decision_s
        goes_on &= np.logical_and.accumulate(speeds < _FASTEST_MPS, axis=0)
        known = goes_on[0]
        followed = agents & (np.where(goes_on, times, 0.0).max(axis=0) >= AHEAD_S[-1])
        told: Any = np.zeros((len(rows), 2 + len(AHEAD_S), 2))
        told[:, 0] = here
        told[known, 1] = (ways[known, 0] - here[known]) / times[0, known, None]
        for track in np.flatnonzero(followed).tolist():
            at = np.concatenate([[0.0], times[goes_on[:, track], track]])
            way = np.concatenate([here[track : track + 1], ways[track, goes_on[:, track]]])
            told[track, 2:] = np.column_stack([np.interp(AHEAD_S, at, way[:, axis]) for axis in (0, 1)])
        told = told.astype(np.float32)
        return TrackSamples(features, agents, followed, told, episodes[index, rows]).chosen(known)


def _carried(poses: Array, odometry: Array, frames: Array, points: Array) -> Array:
    """World points (R, K, 2) beside robots at `poses` (R, 3), in `frames` in their `odometry` (R, 3)."""
    body = into_frames(frames_of_poses(poses), points)
    return into_frames(frames, out_of_frames(frames_of_poses(odometry), body))
