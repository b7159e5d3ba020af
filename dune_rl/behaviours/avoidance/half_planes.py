"""The velocity nearest to a wanted one within a disc and half-planes, by linear programs in two dimensions.

Half-planes are rows (x, y, dx, dy): a point of the border, and its unit direction; velocities to the left of
it are permitted. The method is that of van den Berg, Guy, Lin & Manocha (2011), section 5: half-planes are
added one after another (de Berg et al., Computational Geometry, chapter 4), and where none fits all, the
velocity is the one that violates those of the agents least.
"""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

_PARALLEL = 1e-9


@compile_function
def _cross(a: Any, b: Any) -> float:
    return a[0] * b[1] - a[1] * b[0]


@compile_function
def _move_on_border(planes: Any, number: int, limit: float, aim: Any, is_direction: bool, found: Any) -> bool:
    """Set `found` (2,) to the best velocity on the border of a half-plane within those before it.

    The best is the one nearest to `aim`, or farthest along it. False where there is none: `found` stays.
    """
    x, y, dx, dy = planes[number]
    middle = x * dx + y * dy
    spread = middle * middle + limit * limit - (x * x + y * y)
    if spread < 0.0:
        return False
    first, last = -middle - np.sqrt(spread), -middle + np.sqrt(spread)
    for other in range(number):
        px, py, ex, ey = planes[other]
        slant = dx * ey - dy * ex
        beyond = ex * (y - py) - ey * (x - px)
        if abs(slant) <= _PARALLEL:
            if beyond < 0.0:
                return False
            continue
        place = beyond / slant
        if slant >= 0.0:
            last = min(last, place)
        else:
            first = max(first, place)
        if first > last:
            return False
    if is_direction:
        place = last if aim[0] * dx + aim[1] * dy > 0.0 else first
    else:
        place = min(max(dx * (aim[0] - x) + dy * (aim[1] - y), first), last)
    found[0], found[1] = x + place * dx, y + place * dy
    return True


@compile_function
def _fit_all(planes: Any, count: int, limit: float, aim: Any, is_direction: bool, found: Any) -> int:
    """Set `found` (2,) to the best velocity in the half-planes; the number of the first that fails."""
    length = np.hypot(aim[0], aim[1])
    scale = 1.0
    if is_direction or length > limit:
        scale = limit / length if length > 0.0 else 0.0
    found[0], found[1] = aim[0] * scale, aim[1] * scale
    for number in range(count):
        x, y, dx, dy = planes[number]
        if dx * (y - found[1]) - dy * (x - found[0]) > 0.0 and not _move_on_border(
            planes, number, limit, aim, is_direction, found
        ):
            return number
    return count


@compile_function
def fit_velocity(
    planes: Any, hard: int, count: int, limit: float, wanted: Any, work: Any, found: Any
) -> None:
    """Set `found` (2,) to the velocity nearest to `wanted`, at most `limit` fast, in `planes` (P, 4).

    The first `hard` of the `count` half-planes hold in any case, the others as well as they can together.
    `work` (P, 4) is overwritten.
    """
    failed = _fit_all(planes, count, limit, wanted, False, found)
    violation = 0.0
    aim, candidate = np.empty(2), np.empty(2)
    for number in range(failed, count):
        x, y, dx, dy = planes[number]
        if dx * (y - found[1]) - dy * (x - found[0]) <= violation:
            continue
        kept = 0
        for other in range(hard):
            work[kept] = planes[other]
            kept += 1
        # Where this plane is violated as much as another one: the border between the two.
        for other in range(hard, number):
            px, py, ex, ey = planes[other]
            slant = dx * ey - dy * ex
            if abs(slant) <= _PARALLEL:
                if dx * ex + dy * ey > 0.0:
                    continue
                work[kept, 0], work[kept, 1] = (x + px) / 2, (y + py) / 2
            else:
                place = (ex * (y - py) - ey * (x - px)) / slant
                work[kept, 0], work[kept, 1] = x + place * dx, y + place * dy
            length = np.hypot(ex - dx, ey - dy)
            if length <= _PARALLEL:
                continue
            work[kept, 2], work[kept, 3] = (ex - dx) / length, (ey - dy) / length
            kept += 1
        aim[0], aim[1] = -dy, dx
        if _fit_all(work, kept, limit, aim, True, candidate) == kept:
            found[0], found[1] = candidate[0], candidate[1]
        violation = dx * (y - found[1]) - dy * (x - found[0])
