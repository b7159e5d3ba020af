"""Conservative test of whether robots can touch anything but ground within a control step.

Reading contacts after every physics step costs about 6 % of a control step;
most of the time this test shows that there cannot be any.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Protocol
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.interface import KinematicCapsule, StaticBody

Array = NDArray[np.float64]

# A robot that may move farther than this within a control step always counts as exposed.
_MARGIN_M = 0.3
# Bounds the acceleration of a robot by its motors and gravity; landings on ground change the direction of a
# velocity and do not increase it.
_MAX_ACCELERATION_MPS2 = 40.0
# Upper bound of the distance below which engines treat two shapes as in contact.
_CONTACT_MARGIN_M = 0.1
_CELL_M, _MOST_CELLS = 0.25, 512
# Triangles with larger bounding boxes are split before they are drawn into the grid.
_LARGE_TRIANGLE_M = 2.0
_MOST_SPLITS = 12


class ObstacleGrid:
    """Grid of positions at which a robot with horizontal reach `reach_m` is near a static obstacle.

    Each triangle is replaced by its bounding box in plan view, at any height.
    """

    def __init__(self, statics: Sequence[StaticBody], reach_m: float) -> None:
        # The reference keeps the id of the statics, which `load_shared_grid` uses as key, from being reused.
        self.statics = statics
        obstacles = [body.vertices[body.faces][..., :2] for body in statics if not body.ground]
        triangles = np.concatenate([np.zeros((0, 3, 2)), *obstacles])
        self._cells = b""
        self._rows = self._columns = 0
        if not len(triangles) or not np.isfinite(reach_m):
            self._is_everywhere = bool(len(triangles))
            return
        self._is_everywhere = False
        triangles = _split_large(triangles)
        low = triangles.min(axis=1) - reach_m - _MARGIN_M - _CONTACT_MARGIN_M
        high = triangles.max(axis=1) + reach_m + _MARGIN_M + _CONTACT_MARGIN_M
        corner, far_corner = low.min(axis=0), high.max(axis=0)
        size = max(_CELL_M, float((far_corner - corner).max()) / _MOST_CELLS)
        self._x, self._y, self._per_m = float(corner[0]), float(corner[1]), 1.0 / size
        first, last = (np.floor((edge - corner) / size).astype(np.int64) for edge in (low, high))
        self._rows, self._columns = (last.max(axis=0) + 1).tolist()
        # Sums over this count the boxes over each cell.
        steps = np.zeros((self._rows + 1, self._columns + 1), np.int64)
        after = last + 1
        np.add.at(steps, (first[:, 0], first[:, 1]), 1)
        np.add.at(steps, (after[:, 0], after[:, 1]), 1)
        np.add.at(steps, (first[:, 0], after[:, 1]), -1)
        np.add.at(steps, (after[:, 0], first[:, 1]), -1)
        covered = steps.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
        self._cells = covered.tobytes()

    def is_near(self, x: float, y: float) -> bool:
        """Whether a robot at (x, y) [m] can touch an obstacle before it has moved by the margin.

        NaN counts as near.
        """
        if not self._rows:
            return self._is_everywhere
        row, column = (x - self._x) * self._per_m, (y - self._y) * self._per_m
        if not (row < self._rows and column < self._columns and row >= 0.0 and column >= 0.0):
            return not (row == row and column == column)
        return self._cells[int(row) * self._columns + int(column)] != 0


def _split_large(triangles: Array) -> Array:
    """Halve triangles (F, 3, 2) at their longest edges until their bounding boxes are small."""
    done = []
    for _ in range(_MOST_SPLITS):
        large = (np.ptp(triangles, axis=1) > _LARGE_TRIANGLE_M).any(axis=1)
        done.append(triangles[~large])
        triangles = triangles[large]
        if not len(triangles):
            break
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        order = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
        # The longest edge is a-b.
        a, b, c = np.moveaxis(np.take_along_axis(triangles, order[..., None], axis=1), 1, 0)
        middle = (a + b) / 2
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate([*done, triangles])


# Scenes with the same statics share a grid, which lives as long as one of them.
_grids: WeakValueDictionary[tuple[int, float], ObstacleGrid] = WeakValueDictionary()


def load_shared_grid(statics: tuple[StaticBody, ...], reach_m: float) -> ObstacleGrid:
    """The grid of `statics` for robots of `reach_m`, built once for all scenes with the same tuple."""
    # Robots of nearly equal reach share a grid.
    reach_m = float(np.ceil(reach_m * 10.0) / 10.0)
    grid = _grids.get((id(statics), reach_m))
    if grid is None:
        _grids[id(statics), reach_m] = grid = ObstacleGrid(statics, reach_m)
    return grid


class GatedRobot(Protocol):
    """What the gate needs to know of a robot."""

    @property
    def reach_m(self) -> float:
        """Largest horizontal distance of any point of the robot from its position, at any joint angles."""
        ...

    @property
    def base_mass_kg(self) -> float:
        """Mass of the base link, on which external forces act."""
        ...

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] and speed [m/s] in all three directions."""
        ...


class ContactGate:
    """Finds the bodies that can have contacts, other than with ground, in the next control step."""

    def __init__(self, statics: tuple[StaticBody, ...], kinematics: Sequence[KinematicCapsule]) -> None:
        self._statics = statics
        self._rooms_m = [body.radius_m + _CONTACT_MARGIN_M for body in kinematics]
        self._grids: dict[float, ObstacleGrid] = {}
        # Bound of each robot's motion in the next control step, as of `find_contacts`.
        self.motions_m: list[float] = []

    def find_contacts(
        self,
        robots: Sequence[GatedRobot],
        duration_s: float,
        forces: Mapping[int, Sequence[float]],
        old_poses: Sequence[Sequence[float]],
        new_poses: Sequence[Sequence[float]],
    ) -> tuple[list[int], list[bool]]:
        """Indices of the kinematic bodies that robots can touch, and whether each robot can touch anything.

        The step takes `duration_s` [s]. `forces` [N] are the external ones, by index of the robot. The K
        kinematic bodies move from `old_poses` (x, y, ...) [m] to `new_poses`.
        """
        places = [robot.planar_motion() for robot in robots]
        reaches = [robot.reach_m for robot in robots]
        exposed, motions = [], []
        for index, (x, y, speed) in enumerate(places):
            acceleration = _MAX_ACCELERATION_MPS2
            if index in forces:
                acceleration += math.hypot(*forces[index]) / robots[index].base_mass_kg
            motion = (speed + acceleration * duration_s / 2) * duration_s
            motions.append(motion)
            # Written so that NaN, which compares false, counts as exposed.
            exposed.append(not motion <= _MARGIN_M or self._grid(reaches[index]).is_near(x, y))
        for one, other in combinations(range(len(robots)), 2):
            reach = reaches[one] + reaches[other] + motions[one] + motions[other] + _CONTACT_MARGIN_M
            (x, y, _), (other_x, other_y, _) = places[one], places[other]
            if not (abs(x - other_x) > reach or abs(y - other_y) > reach):
                exposed[one] = exposed[other] = True
        self.motions_m = motions
        near = []
        for body, (old, new, room) in enumerate(zip(old_poses, new_poses, self._rooms_m, strict=True)):
            (x, y, *_), step = new, abs(new[0] - old[0]) + abs(new[1] - old[1])
            is_near = False
            for index, (robot_x, robot_y, _) in enumerate(places):
                reach = reaches[index] + motions[index] + room + step
                if not (abs(x - robot_x) > reach or abs(y - robot_y) > reach):
                    is_near = exposed[index] = True
            if is_near:
                near.append(body)
        return near, exposed

    def _grid(self, reach_m: float) -> ObstacleGrid:
        grid = self._grids.get(reach_m)
        if grid is None:
            grid = self._grids[reach_m] = load_shared_grid(self._statics, reach_m)
        return grid
