"""Small objects in a LiDAR's scan that do not rest, by the scan's shape and by earlier scans."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.planar import length

# What earlier scans tell of the place of a return: that nothing was there, or the same return.
_WAS_FREE, _RESTS = 1, 2
# Two returns are at one place within this, and per metre of range [m]; past a place is half as much farther.
_SAME_M, _SAME_PER_M = 0.10, 0.02
# Rays within this angle, or next to each other, may see one place if they are this close there [m].
_BESIDE_RAD, _BESIDE_M = 0.049, 0.25
# An object ends where the range of neighbouring rays jumps by more than this [m], and per metre of range.
_JUMP_M, _JUMP_PER_M = 0.35, 0.08
# Wider ones are walls, banks or hedges.
_WIDEST_M = 0.9
# A person's outline is about a circle of this radius.
_RADIUS_M = 0.25
# A first guess of the centre lies by this share of the radius behind the middle of the returns.
_BEHIND = 0.85
_ROUNDS, _DAMPING = 3, 0.05
# Standard deviation of a centre [m]; and in gaps between two rays, where one ray or more meet the object.
_PLACE_M = 0.02
_ONE_RAY, _MORE_RAYS = 0.5, 0.15
# Columns of an object: centre x, y, standard deviation [m], how many rays meet it, and the share of these
# that meet it where earlier scans saw past.
CLUSTER_COLUMNS = 5


@compile_function
def _is_circle(rays: int, per_rad: float) -> bool:
    """Whether `rays`, `per_rad` of them in a radian, go all the way round."""
    result: bool = per_rad * 2.0 * np.pi < rays + 0.5
    return result


@compile_function
def _jumps(one_m: float, other_m: float) -> bool:
    """Whether neighbouring rays of these ranges [m] meet different objects."""
    result: bool = abs(one_m - other_m) > _JUMP_M + _JUMP_PER_M * min(one_m, other_m)
    return result


@compile_function
def compare_with_past(
    places: Any, sees: Any, scans: Any, poses: Any, first_rad: float, per_rad: float, found: Any
) -> None:
    """What earlier `scans` (L, S) [m] tell of `places` (S, 2) [m], where rays end now.

    `places` and `poses` (L, 3: x, y [m], yaw [rad]), of the LiDAR at each scan, are in the odometry's frame.
    `sees` (S,) tells which rays have a return, `first_rad` is the bearing of the first one in the vehicle's
    frame, `per_rad` the number of rays in a radian. `found` (S,) is 1 where all earlier scans saw past the
    place, 2 where all saw a return about there, and else 0.
    """
    rays = len(sees)
    is_circle = _is_circle(rays, per_rad)
    half_rad = 0.5 * (rays - 1) / per_rad
    beside = max(1, round(_BESIDE_RAD * per_rad))
    for ray in range(rays):
        found[ray] = 0
        if not sees[ray] or not len(scans):
            continue
        free, same = 0, 0
        for past in range(len(scans)):
            right, up = places[ray, 0] - poses[past, 0], places[ray, 1] - poses[past, 1]
            away = length(right, up)
            # From the middle of the view, as a view of more than half a circle would else be cut.
            bearing = np.arctan2(up, right) - poses[past, 2] - first_rad - half_rad
            bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi + half_rad
            middle = np.int64(np.round(bearing * per_rad))
            nearest, miss = np.inf, np.inf
            for number in range(middle - beside, middle + beside + 1):
                if is_circle or 0 <= number < rays:
                    seen = scans[past, number % rays]
                    nearest = min(nearest, seen)
                    if abs(number - middle) * away < per_rad * _BESIDE_M:
                        miss = min(miss, abs(seen - away))
            room = _SAME_M + _SAME_PER_M * away
            if np.isfinite(nearest) and nearest > away + 1.5 * room:
                free += 1
            elif miss < room:
                same += 1
        if free == len(scans):
            found[ray] = _WAS_FREE
        elif same == len(scans):
            found[ray] = _RESTS


@compile_function
def find_clusters(
    ranges: Any, points: Any, sees: Any, was: Any, mount: Any, per_rad: float, found: Any, members: Any
) -> int:
    """Small objects that do not rest, in a scan of S rays from `mount` (2,) [m]; returns how many.

    All is in the vehicle's frame. `ranges` (S,) [m] are those of the rays, `points` (S, 2) [m] where they
    end, `sees` (S,) which have a return, `was` (S,) is by `compare_with_past`. An object stands before its
    background, or where nothing was. `found` (S, columns) gets each one, `members` (S,) the object of
    each ray, or -1.
    """
    rays, count = len(ranges), 0
    is_circle = _is_circle(rays, per_rad)
    members[:] = -1
    for first in range(rays):
        if not sees[first] or was[first] == _RESTS:
            continue
        before = (first - 1) % rays
        is_before = sees[before] and (is_circle or first > 0)
        if is_before and was[before] != _RESTS and not _jumps(ranges[before], ranges[first]):
            continue
        size, last = 1, first
        while size < rays:
            after = (last + 1) % rays
            if after == 0 and not is_circle:
                break
            if not sees[after] or was[after] == _RESTS or _jumps(ranges[last], ranges[after]):
                break
            last, size = after, size + 1
        after = (last + 1) % rays
        width = length(points[last, 0] - points[first, 0], points[last, 1] - points[first, 1])
        if width > _WIDEST_M or size > rays // 2:
            continue
        is_after = sees[after] and (is_circle or after > 0)
        stands_out = not (is_before and ranges[before] < ranges[first])
        stands_out = stands_out and not (is_after and ranges[after] < ranges[last])
        mean, free = 0.0, 0
        for step in range(size):
            ray = (first + step) % rays
            mean += ranges[ray] / size
            free += was[ray] == _WAS_FREE
        if not stands_out and not free:
            continue
        for step in range(size):
            members[(first + step) % rays] = count
        x, y, miss = _fit_circle(points, first, size, mount)
        gap = mean / per_rad
        found[count, 0], found[count, 1] = x, y
        found[count, 2] = _PLACE_M + miss + gap * (_ONE_RAY if size == 1 else _MORE_RAYS)
        found[count, 3], found[count, 4] = size, free / size
        count += 1
    return count


@compile_function
def _fit_circle(points: Any, first: int, size: int, mount: Any) -> Any:
    """Centre of a circle of a person's radius through `size` of the `points` (S, 2), and their root mean
    square distance from it [m]: Gauss and Newton's method, damped so that one point will do.
    """
    x, y = 0.0, 0.0
    for step in range(size):
        ray = (first + step) % len(points)
        x += points[ray, 0] / size
        y += points[ray, 1] / size
    away = max(length(x - mount[0], y - mount[1]), 1e-3)
    x += _BEHIND * _RADIUS_M * (x - mount[0]) / away
    y += _BEHIND * _RADIUS_M * (y - mount[1]) / away
    for turn in range(_ROUNDS + 1):
        xx, xy, yy, to_x, to_y, square = _DAMPING, 0.0, _DAMPING, 0.0, 0.0, 0.0
        for step in range(size):
            ray = (first + step) % len(points)
            right, up = x - points[ray, 0], y - points[ray, 1]
            distance = max(length(right, up), 1e-6)
            right, up, miss = right / distance, up / distance, distance - _RADIUS_M
            xx += right * right
            xy += right * up
            yy += up * up
            to_x -= right * miss
            to_y -= up * miss
            square += miss * miss / size
        if turn < _ROUNDS:
            determinant = xx * yy - xy * xy
            x += (yy * to_x - xy * to_y) / determinant
            y += (xx * to_y - xy * to_x) / determinant
    return x, y, np.sqrt(square)
