"""Tracks of what moves in successive LiDAR scans: small objects, each with a Kalman filter."""

from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.planar import length
from dune_rl.sensors.perception.scan_clusters import CLUSTER_COLUMNS, compare_with_past, find_clusters

_MOST_TRACKS = 16
# Standard deviation of accelerations [m/s²], and of the speed of a new track [m/s].
_ACCELERATION_MPS2 = 1.5
_FIRST_SPEED_MPS = 0.8
# A cluster belongs to a track within this, and per metre of range [m].
_GATE_M, _GATE_PER_M = 0.45, 0.06
_KEEP_S = 0.6
# What moves has gone this far since it was first seen, this fast, and faster than twice its error.
_LEAST_WAY_M = 0.08
_SLOWEST_MPS = 0.35
# Columns of a track: x, y, vx, vy [m, m/s, odometry frame], variances of place and speed and their
# covariance, time since it was seen [s], x and y where it began, time since then [s].
TRACK_COLUMNS = 11
# A track's history: of each of so many scans, the latest first, whether it was seen, and the columns of its
# cluster.
HISTORY_STEPS, HISTORY_COLUMNS = 20, 1 + CLUSTER_COLUMNS
# A scan is compared with those of so long ago [s].
_PAST_S = (0.6, 1.0)
# Time in which the odometry takes the goal's reading for its own drift [s], and how far a goal moves at once
# that is a new one [m].
_DRIFT_S, _NEW_GOAL_M = 0.5, 0.5


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
    track[10] += step_s


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
    track[7] = 0.0


@compile_function
def _is_moving(track: Any) -> bool:
    """Whether a track has gone some way, and is faster than its error."""
    speed = length(track[2], track[3])
    way = length(track[0] - track[8], track[1] - track[9])
    result: bool = way > _LEAST_WAY_M and speed > _SLOWEST_MPS and speed > 2.0 * np.sqrt(track[5])
    return result


@compile_function
def _move_pose(pose: Any, twist: Any, step_s: float) -> None:
    """Move a pose (3,) on by a speed and a yaw rate (2,)."""
    pose[2] += 0.5 * twist[1] * step_s
    pose[0] += twist[0] * step_s * np.cos(pose[2])
    pose[1] += twist[0] * step_s * np.sin(pose[2])
    pose[2] += 0.5 * twist[1] * step_s


@compile_function
def _hold_to_goal(pose: Any, goal: Any, place: Any, share: float) -> None:
    """Move a pose (3,) by a share of how far its goal (2,), in its frame, has left its `place` (2,) [m].

    A body that slips sideways measures it by nothing else. The pose's yaw must be as exact as the goal's
    bearing: an error of theirs moves the pose by its sine times the distance. NaN is no place yet.
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x = pose[0] + cos * goal[0] - sin * goal[1]
    y = pose[1] + sin * goal[0] + cos * goal[1]
    if not length(x - place[0], y - place[1]) < _NEW_GOAL_M:
        place[0], place[1] = x, y
    pose[0] += share * (place[0] - x)
    pose[1] += share * (place[1] - y)


@compile_function
def _remember(entry: Any, clusters: Any, number: int) -> None:
    """Fill the latest entry of a history with a cluster; zeros where its `number` is -1."""
    entry[:] = 0.0
    if number >= 0:
        entry[0] = 1.0
        entry[1:] = clusters[number]


@compile_function
def _match(
    clusters: Any, found: int, pose: Any, step_s: float, tracks: Any, histories: Any, count: int, taken: Any
) -> int:  # fmt: skip
    """Move the tracks (T, columns) of a row on, with their histories (T, steps, columns), correct them by the
    `found` clusters, drop what was not seen for long, and begin new ones; how many there are. `taken` (S,)
    gets the track of each cluster, or -1; the body's `pose` (3,) gives the distance that the gate grows with.
    """
    taken[:found] = -1
    kept = 0
    for index in range(count):
        track, history = tracks[index], histories[index]
        _predict(track, step_s)
        away = length(track[0] - pose[0], track[1] - pose[1])
        nearest, chosen = _GATE_M + _GATE_PER_M * away, -1
        for number in range(found):
            apart = length(clusters[number, 0] - track[0], clusters[number, 1] - track[1])
            if taken[number] < 0 and apart < nearest:
                nearest, chosen = apart, number
        if chosen >= 0:
            _correct(track, clusters[chosen, 0], clusters[chosen, 1], clusters[chosen, 2] ** 2)
        if track[7] <= _KEEP_S:
            if chosen >= 0:
                taken[chosen] = kept
            tracks[kept] = track
            for before in range(len(history) - 1, 0, -1):
                histories[kept, before] = history[before - 1]
            _remember(histories[kept, 0], clusters, chosen)
            kept += 1
    for number in range(found):
        if taken[number] >= 0 or kept == _MOST_TRACKS:
            continue
        new = tracks[kept]
        new[:] = 0.0
        new[0], new[1] = clusters[number, 0], clusters[number, 1]
        new[8], new[9] = new[0], new[1]
        new[4], new[5] = clusters[number, 2] ** 2, _FIRST_SPEED_MPS**2
        histories[kept] = 0.0
        _remember(histories[kept, 0], clusters, number)
        taken[number] = kept
        kept += 1
    return kept


@compile_function
def track_scans(
    ranges: Any, points: Any, sees: Any, twists: Any, goals: Any, goal_places: Any, step_s: float, rays: Any,
    mount: Any, poses: Any, past: Any, tracks: Any, histories: Any, counts: Any, moving: Any,
    moving_counts: Any, velocities: Any,
) -> None:  # fmt: skip
    """Update the tracks of N rows by a scan each.

    `ranges` (N, S) [m], `points` (N, S, 2) [m] and `sees` (N, S) are of the scan, `rays` is (bearing of the
    first one [rad], rays per radian). `twists` (N, 2: speed, yaw rate) move the `poses` (N, 3) of the
    odometry by a step, and `goals` (N, 2) [m], in the vehicles' frames, hold them to where these were, in
    `goal_places` (N, 2). `past` is (earlier scans (N, L, S), their poses (N, L, 3), how many there were (N,),
    how many scans ago those are that count). `tracks` (N, T, columns) and `histories` (N, T, steps, columns)
    are changed, `counts` of them in a row. `moving` (N, T, 4: x, y, velocity) and `velocities` (N, S, 2), of
    the rays, are those of what moves, in the vehicles' frames.
    """
    size = ranges.shape[1]
    scans, scan_poses, taken_scans, lags = past
    clusters, places = np.empty((size, CLUSTER_COLUMNS)), np.empty((size, 2))
    members, taken, was = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.int64)
    old_scans, old_poses = np.empty((len(lags), size)), np.empty((len(lags), 3))
    for row in range(len(ranges)):
        pose = poses[row]
        _move_pose(pose, twists[row], step_s)
        if not np.isnan(goals[row, 0]):
            _hold_to_goal(pose, goals[row], goal_places[row], min(step_s / _DRIFT_S, 1.0))
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        for ray in range(size):
            places[ray, 0] = pose[0] + cos * points[row, ray, 0] - sin * points[row, ray, 1]
            places[ray, 1] = pose[1] + sin * points[row, ray, 0] + cos * points[row, ray, 1]
        there = taken_scans[row] >= lags.max()
        for number in range(len(lags)):
            slot = (taken_scans[row] - lags[number]) % scans.shape[1]
            old_scans[number], old_poses[number] = scans[row, slot], scan_poses[row, slot]
        known = len(lags) if there else 0
        compare_with_past(places, sees[row], old_scans[:known], old_poses[:known], rays[0], rays[1], was)
        slot = taken_scans[row] % scans.shape[1]
        scans[row, slot] = ranges[row]
        scan_poses[row, slot, 0] = pose[0] + cos * mount[0] - sin * mount[1]
        scan_poses[row, slot, 1] = pose[1] + sin * mount[0] + cos * mount[1]
        scan_poses[row, slot, 2] = pose[2]
        taken_scans[row] += 1
        found = find_clusters(ranges[row], points[row], sees[row], was, mount, rays[1], clusters, members)
        for number in range(found):
            x, y = clusters[number, 0], clusters[number, 1]
            clusters[number, 0] = pose[0] + cos * x - sin * y
            clusters[number, 1] = pose[1] + sin * x + cos * y
        counts[row] = _match(clusters, found, pose, step_s, tracks[row], histories[row], counts[row], taken)
        count = 0
        for index in range(counts[row]):
            track = tracks[row, index]
            if _is_moving(track):
                right, up = track[0] - pose[0], track[1] - pose[1]
                moving[row, count, 0], moving[row, count, 1] = cos * right + sin * up, cos * up - sin * right
                moving[row, count, 2] = cos * track[2] + sin * track[3]
                moving[row, count, 3] = cos * track[3] - sin * track[2]
                count += 1
        moving_counts[row] = count
        for ray in range(size):
            velocities[row, ray, 0], velocities[row, ray, 1] = 0.0, 0.0
            if members[ray] >= 0 and taken[members[ray]] >= 0:
                track = tracks[row, taken[members[ray]]]
                if _is_moving(track):
                    velocities[row, ray, 0] = cos * track[2] + sin * track[3]
                    velocities[row, ray, 1] = cos * track[3] - sin * track[2]


class ScanTracker:
    """Finds what moves in the LiDAR scans of N bodies, by their scans, speeds and the goal's place alone.

    `bearings` (S,) [rad] are those of the scan's rays, evenly spaced, and `mount` (2,) [m] where it is, in
    the vehicles' frames.
    """

    def __init__(self, num_rows: int, bearings: Array, mount: Array) -> None:
        rays = len(bearings)
        # Of the odometry: x, y [m] and yaw [rad].
        self.poses = np.zeros((num_rows, 3))
        self._goal_places = np.full((num_rows, 2), np.nan)
        # The first `counts` of a row are tracks of now; their columns are those of TRACK_COLUMNS above.
        self.tracks = np.zeros((num_rows, _MOST_TRACKS, TRACK_COLUMNS))
        self.histories = np.zeros((num_rows, _MOST_TRACKS, HISTORY_STEPS, HISTORY_COLUMNS))
        self.counts = np.zeros(num_rows, np.int64)
        # Of what moves, in the vehicles' frames (N, T, 4: x, y, velocity); a row has `moving_counts` of them.
        self.moving = np.zeros((num_rows, _MOST_TRACKS, 4))
        self.moving_counts = np.zeros(num_rows, np.int64)
        self.velocities = np.zeros((num_rows, rays, 2))
        # Of the latest scan: where rays end, in the vehicles' frames, and which have a return.
        self.points, self.sees = np.zeros((num_rows, rays, 2)), np.zeros((num_rows, rays), bool)
        self._ahead = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
        self._mount = np.ascontiguousarray(mount[:2], np.float64)
        apart = float(bearings[1] - bearings[0]) if rays > 1 else 2.0 * np.pi
        self._rays = float(bearings[0]), 1.0 / apart
        self._lags = np.zeros(0, np.int64)
        self._scans, self._scan_poses = np.zeros((num_rows, 0, rays), np.float32), np.zeros((num_rows, 0, 3))
        self._taken = np.zeros(num_rows, np.int64)

    def forget(self, mask: Flags) -> None:
        """Forget the tracks of the rows in `mask` (N,)."""
        self.counts[mask] = self._taken[mask] = self.moving_counts[mask] = 0
        self.velocities[mask] = self.poses[mask] = 0.0
        self._goal_places[mask] = np.nan

    def update(self, ranges: Array, sees: Flags, twists: Array, goals: Array, step_s: float) -> None:
        """Take a scan: `ranges` (N, S) [m] and which rays have a return, and the readings of speed and yaw
        rate (N, 2) after the last step, and of the goal (N, 2) [m] in the vehicles' frames, NaN where it is
        no measure of the odometry.
        """
        lags = np.maximum(np.round(np.array(_PAST_S) / step_s), 1).astype(np.int64)
        if not np.array_equal(lags, self._lags):
            self._lags = lags
            shape = len(ranges), int(lags.max())
            self._scans = np.zeros((*shape, ranges.shape[1]), np.float32)
            self._scan_poses = np.zeros((*shape, 3))
            self._taken[:] = 0
        self.points, self.sees = ranges[:, :, None] * self._ahead + self._mount, sees
        track_scans(
            ranges, self.points, sees, twists, goals, self._goal_places, step_s, self._rays, self._mount,
            self.poses, (self._scans, self._scan_poses, self._taken, self._lags), self.tracks,
            self.histories, self.counts, self.moving, self.moving_counts, self.velocities,
        )  # fmt: skip
