"""Tracks of what moves in successive LiDAR scans: small objects, each with a Kalman filter."""

from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.compiled import compile_function

_MOST_TRACKS = 16
# A cluster ends where the range of neighbouring segments jumps by more than this [m], and per metre.
_JUMP_M = 0.35
_JUMP_PER_M = 0.08
# Larger clusters are walls, banks or hedges.
_LARGEST_M = 0.9
# The centre of what is seen lies behind its surface.
_BEHIND_M = 0.2
# Standard deviations: of a cluster's place, and per metre of range [m]; of accelerations [m/s²].
_PLACE_M = 0.06
_PLACE_PER_M = 0.05
_ACCELERATION_MPS2 = 1.5
_FIRST_SPEED_MPS = 0.8
# A cluster belongs to a track within this, and per metre of range [m].
_GATE_M = 0.45
_GATE_PER_M = 0.06
_KEEP_S = 0.6
_YOUNG_S = 0.3
_SLOWEST_MPS = 0.35
# Columns of a track: x, y, vx, vy [m, m/s, odometry frame], variances of place and speed and their
# covariance, time since it began and since it was seen [s].
_COLUMNS = 9


@compile_function
def _predict(track: Any, step_s: float) -> None:
    """Move a track on by a step."""
    noise = _ACCELERATION_MPS2 * _ACCELERATION_MPS2
    track[0] += track[2] * step_s
    track[1] += track[3] * step_s
    track[4] += 2.0 * step_s * track[6] + step_s * step_s * track[5] + 0.25 * step_s**4 * noise
    track[6] += step_s * track[5] + 0.5 * step_s**3 * noise
    track[5] += step_s * step_s * noise
    track[7] += step_s
    track[8] += step_s


@compile_function
def _correct(track: Any, x: float, y: float, variance: float) -> None:
    """Correct a track by a measured place."""
    total = track[4] + variance
    place, speed = track[4] / total, track[6] / total
    miss_x, miss_y = x - track[0], y - track[1]
    track[0] += place * miss_x
    track[1] += place * miss_y
    track[2] += speed * miss_x
    track[3] += speed * miss_y
    track[5] -= speed * track[6]
    track[6] -= place * track[6]
    track[4] -= place * track[4]
    track[8] = 0.0


@compile_function
def _is_moving(track: Any) -> bool:
    """Whether a track is old enough, and faster than its error."""
    speed = np.hypot(track[2], track[3])
    result: bool = track[7] >= _YOUNG_S and speed > _SLOWEST_MPS and speed > 2.0 * np.sqrt(track[5])
    return result


@compile_function
def find_clusters(ranges: Any, points: Any, sees: Any, found: Any, members: Any) -> int:
    """Small objects before their background in a scan of S segments; returns how many.

    `points` (S, 2) [m] are where segments end, `sees` (S,) whether there is a return. `found` (S, 3) gets the
    middle of each object's points and their mean range, `members` (S,) the object's number or -1.
    """
    segments, count = len(ranges), 0
    members[:] = -1
    for first in range(segments):
        before = (first - 1) % segments
        if not sees[first]:
            continue
        jump = _JUMP_M + _JUMP_PER_M * ranges[first]
        # A cluster begins where what is before it is farther away, or nothing.
        if sees[before] and ranges[before] < ranges[first] + jump:
            continue
        size, last = 1, first
        while size < segments:
            after = (last + 1) % segments
            if not sees[after] or abs(ranges[after] - ranges[last]) > _JUMP_M + _JUMP_PER_M * ranges[last]:
                break
            last, size = after, size + 1
        after = (last + 1) % segments
        if sees[after] and ranges[after] < ranges[last]:
            continue
        width = np.hypot(points[last, 0] - points[first, 0], points[last, 1] - points[first, 1])
        if width > _LARGEST_M or size > segments // 2:
            continue
        x, y, mean = 0.0, 0.0, 0.0
        for step in range(size):
            number = (first + step) % segments
            x += points[number, 0] / size
            y += points[number, 1] / size
            mean += ranges[number] / size
            members[number] = count
        found[count, 0], found[count, 1], found[count, 2] = x, y, mean
        count += 1
    return count


@compile_function
def track_scans(
    ranges: Any, points: Any, sees: Any, twists: Any, step_s: float, poses: Any, tracks: Any, counts: Any,
    moving: Any, moving_counts: Any, velocities: Any,
) -> None:  # fmt: skip
    """Update the tracks of N rows by a scan each.

    `twists` (N, 2: speed, yaw rate) move the `poses` (N, 3) of the odometry by a step. `tracks`
    (N, T, columns), of which a row has `counts`, are changed. `moving` (N, T, 4: x, y, velocity) and
    `velocities` (N, S, 2), of the segments, are those of what moves, in the vehicles' frames.
    """
    segments = ranges.shape[1]
    clusters = np.empty((segments, 3))
    members = np.empty(segments, np.int64)
    taken = np.empty(segments, np.int64)
    for row in range(len(ranges)):
        pose = poses[row]
        pose[2] += 0.5 * twists[row, 1] * step_s
        pose[0] += twists[row, 0] * step_s * np.cos(pose[2])
        pose[1] += twists[row, 0] * step_s * np.sin(pose[2])
        pose[2] += 0.5 * twists[row, 1] * step_s
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        found = find_clusters(ranges[row], points[row], sees[row], clusters, members)
        taken[:found] = -1
        for number in range(found):
            # Into the odometry's frame, and to the object's centre.
            x, y, mean = clusters[number, 0], clusters[number, 1], clusters[number, 2]
            behind = 1.0 + _BEHIND_M / max(mean, 0.1)
            clusters[number, 0] = pose[0] + behind * (cos * x - sin * y)
            clusters[number, 1] = pose[1] + behind * (sin * x + cos * y)
        kept = 0
        for index in range(counts[row]):
            track = tracks[row, index]
            _predict(track, step_s)
            nearest, chosen = np.inf, -1
            for number in range(found):
                apart = np.hypot(clusters[number, 0] - track[0], clusters[number, 1] - track[1])
                gate = _GATE_M + _GATE_PER_M * clusters[number, 2]
                if taken[number] < 0 and apart < gate and apart < nearest:
                    nearest, chosen = apart, number
            if chosen >= 0:
                spread = _PLACE_M + _PLACE_PER_M * clusters[chosen, 2]
                _correct(track, clusters[chosen, 0], clusters[chosen, 1], spread * spread)
            if track[8] <= _KEEP_S:
                if chosen >= 0:
                    taken[chosen] = kept
                tracks[row, kept] = track
                kept += 1
        for number in range(found):
            if taken[number] >= 0 or kept == _MOST_TRACKS:
                continue
            spread = _PLACE_M + _PLACE_PER_M * clusters[number, 2]
            new = tracks[row, kept]
            new[:] = 0.0
            new[0], new[1] = clusters[number, 0], clusters[number, 1]
            new[4], new[5] = spread * spread, _FIRST_SPEED_MPS * _FIRST_SPEED_MPS
            taken[number] = kept
            kept += 1
        counts[row] = kept
        count = 0
        for index in range(kept):
            track = tracks[row, index]
            if not _is_moving(track):
                continue
            away_x, away_y = track[0] - pose[0], track[1] - pose[1]
            moving[row, count, 0] = cos * away_x + sin * away_y
            moving[row, count, 1] = cos * away_y - sin * away_x
            moving[row, count, 2] = cos * track[2] + sin * track[3]
            moving[row, count, 3] = cos * track[3] - sin * track[2]
            count += 1
        moving_counts[row] = count
        for segment in range(segments):
            velocities[row, segment, 0], velocities[row, segment, 1] = 0.0, 0.0
            if members[segment] < 0 or taken[members[segment]] < 0:
                continue
            track = tracks[row, taken[members[segment]]]
            if _is_moving(track):
                velocities[row, segment, 0] = cos * track[2] + sin * track[3]
                velocities[row, segment, 1] = cos * track[3] - sin * track[2]


class ScanTracker:
    """Finds what moves in the LiDAR scans of N bodies, by their scans and speed readings alone."""

    def __init__(self, num_rows: int, segments: int) -> None:
        # Of the odometry: x, y [m] and yaw [rad].
        self.poses = np.zeros((num_rows, 3))
        self._tracks = np.zeros((num_rows, _MOST_TRACKS, _COLUMNS))
        self._counts = np.zeros(num_rows, np.int64)
        # Of what moves, in the vehicles' frames (N, T, 4: x, y, velocity); a row has `moving_counts` of them.
        self.moving = np.zeros((num_rows, _MOST_TRACKS, 4))
        self.moving_counts = np.zeros(num_rows, np.int64)
        self.velocities = np.zeros((num_rows, segments, 2))

    def forget(self, mask: Flags) -> None:
        """Forget the tracks of the rows in `mask` (N,)."""
        self._counts[mask] = 0
        self.poses[mask] = 0.0

    def update(self, ranges: Array, points: Array, sees: Flags, twists: Array, step_s: float) -> None:
        """Take a scan: `ranges` (N, S) [m], where its segments end (N, S, 2) in the vehicles' frames and
        which of them have a return; and the readings of speed and yaw rate (N, 2) after the last step.
        """
        track_scans(
            ranges, points, sees, twists, step_s, self.poses, self._tracks, self._counts, self.moving,
            self.moving_counts, self.velocities,
        )  # fmt: skip
