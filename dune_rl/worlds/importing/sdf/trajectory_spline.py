"""The spline on which Gazebo moves an actor between its way-points, as way-points that lie closer."""

import numpy as np

from dune_rl.geometry.arrays import Array

# Where the spline is farther than this from the line between two way-points, points of it are added.
_STRAY_M = 0.02
_MOST_PARTS = 64
# Gazebo takes a trajectory whose ends are as close as this for a closed one.
_CLOSED_M = 1e-3


def add_spline_points(times: Array, poses: Array, tension: float = 0.0) -> tuple[Array, Array]:
    """The way-points `times` (T,) and `poses` (T, 4), and points of Gazebo's spline between them.

    Gazebo moves actors on a cubic Hermite spline over the number of the way-point: the tangent of each is
    half the way from the one before to the one behind, times 1 - `tension` (Catmull-Rom with 0), and time
    passes evenly between two. Lines between the points of the result are within 2 cm of it. Yaw stays linear.
    """
    if len(times) < 2:
        return times, poses
    points = poses[:, :3]
    tangents = _tangents(points, 1.0 - tension)
    legs = np.diff(points, axis=0)
    # How far both ends of a leg pull the spline away from its even line.
    pull = np.maximum(
        np.linalg.norm(tangents[:-1] - legs, axis=1), np.linalg.norm(tangents[1:] - legs, axis=1)
    )
    # A leg strays from its line by at most a quarter of its pull. Its second derivative is at most six times
    # the pull, and n parts stray by an eighth of that over n squared.
    parts = np.ceil(np.sqrt(0.75 * pull / _STRAY_M)).clip(1, _MOST_PARTS).astype(int)
    parts[0.25 * pull <= _STRAY_M] = 1
    before = np.repeat(np.arange(len(legs)), parts)
    share = (np.arange(len(before)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[before]
    u = share[:, None]
    found = np.empty((len(before), 4))
    found[:, :3] = (
        (2 * u**3 - 3 * u**2 + 1) * points[before]
        + (u**3 - 2 * u**2 + u) * tangents[before]
        + (3 * u**2 - 2 * u**3) * points[before + 1]
        + (u**3 - u**2) * tangents[before + 1]
    )
    found[:, 3] = poses[before, 3] + share * (poses[before + 1, 3] - poses[before, 3])
    at = times[before] + share * (times[before + 1] - times[before])
    return np.append(at, times[-1]), np.concatenate([found, poses[-1:]])


def _tangents(points: Array, strength: float) -> Array:
    """The tangents (T, 3) of the spline at `points` (T, 3)."""
    if np.abs(points[-1] - points[0]).max() <= _CLOSED_M:
        padded = np.concatenate([points[-2:-1], points, points[1:2]])
    else:
        padded = np.concatenate([points[:1], points, points[-1:]])
    return 0.5 * strength * (padded[2:] - padded[:-2])
