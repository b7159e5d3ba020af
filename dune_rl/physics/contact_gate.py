"""Conservative test of whether robots can touch anything but ground within a control step.

Reading contacts after every physics step costs about 6 % of a control step;
most of the time this test shows that there cannot be any.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt

from dune_rl.geometry.arrays import Array
from dune_rl.physics import gate_loops
from dune_rl.physics.process import share_by_identity
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.shapes import KinematicShape, StaticBody

# Control steps for which surplus tyres stay active: a change costs about as much as two unneeded tyres in 30.
_DEACTIVATION_DELAY_STEPS = 30

Tyres = frozenset[int]
_NONE: Tyres = frozenset()


class TyreActivation:
    """Decides which tyres of a scene's robots have collision shapes in the next control step.

    Each shape adds a link to a robot's equations of motion: four of them take a sixth of a physics step even
    without obstacles. So a tyre has one only from the control step in which it can touch anything until it
    has been out of reach for a while.

    `active` has the indices of the active tyres of each of `num_robots`.
    """

    def __init__(self, num_robots: int) -> None:
        self.active: list[Tyres] = [_NONE] * num_robots
        self._surplus_steps = [0] * num_robots

    def reset(self) -> None:
        """Deactivate all tyres."""
        self.active = [_NONE] * len(self.active)

    def update(self, needed_tyres: Sequence[Tyres]) -> list[int]:
        """Set `active` for a control step; returns the robots for which it has changed.

        `needed_tyres` are those of each robot that can touch anything: see `ContactGate`.
        """
        changed = []
        for index, needed in enumerate(needed_tyres):
            active = self.active[index]
            if needed == active:
                self._surplus_steps[index] = 0
                continue
            self._surplus_steps[index] += 1
            if needed <= active and self._surplus_steps[index] < _DEACTIVATION_DELAY_STEPS:
                continue
            # Surplus tyres stay active when others are added, which saves a later change.
            self.active[index] = needed if needed <= active else needed | active
            self._surplus_steps[index] = 0
            changed.append(index)
        return changed


_CELL_M = 0.1
_MAX_CELLS = 1_000_000
# Points on surfaces that are computed at once.
_MAX_POINTS = 200_000


class ObstacleMap:
    """Lower bound of the distance, seen from above, from any point to the triangles of static obstacles.

    The bound is less than the distance by at most four cells of `cell_m`, which is 0.1 m, or more where the
    obstacles' bounding box would have more than a million cells.
    """

    def __init__(self, statics: tuple[StaticBody, ...]) -> None:
        # See `share_by_identity`.
        self._statics = statics
        numbers = [number for number, body in enumerate(statics) if not body.ground and len(body.faces)]
        obstacles = [statics[number] for number in numbers]
        corners = [(body.vertices[:, :2].min(axis=0), body.vertices[:, :2].max(axis=0)) for body in obstacles]
        self._numbers = np.array(numbers, np.int64)
        self._boxes = np.array(corners).reshape(-1, 4)
        # What `gate_loops` calls `grid` and `quarters`; without obstacles there are none.
        self.arrays = np.zeros(6), np.zeros(0, np.uint8)
        if not obstacles:
            return
        vertices = np.concatenate([body.vertices[:, :2] for body in obstacles])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        width, depth = high - low
        self.cell_m = max(_CELL_M, float(np.sqrt(width * depth / _MAX_CELLS)))
        columns, rows = (int(size / self.cell_m) + 2 for size in (width, depth))
        free = np.ones((columns, rows), bool)
        for body in obstacles:
            for points in _surface_points(body.vertices[body.faces][..., :2], self.cell_m):
                cells = ((points - low) / self.cell_m).astype(np.int64)
                free[cells[:, 0], cells[:, 1]] = False
        # Query and sample are up to half a cell's diagonal from their cells' centres, and a triangle's point
        # is up to 1/sqrt(3) of the spacing from the nearest sample: two cells together.
        distance = distance_transform_edt(free, sampling=self.cell_m) - 2.0 * self.cell_m
        # In quarters of a cell, rounded down: a byte is enough for the distances that matter.
        quarters = np.clip(4.0 * distance / self.cell_m, 0.0, 255.0).astype(np.uint8)
        grid = np.array([low[0], high[0], low[1], high[1], self.cell_m, rows])
        self.arrays = grid, quarters.reshape(-1)

    def distance(self, x: float, y: float) -> float:
        """Lower bound [m] for a point, whose coordinates must be finite; inf without obstacles."""
        return float(gate_loops.find_distance(*self.arrays, x, y))

    def bodies_near(self, x: float, y: float, distance_m: float) -> list[int]:
        """Numbers, among the statics, of obstacles with bounding boxes within a distance along x and y."""
        found = np.empty(len(self._numbers), np.int64)
        count = gate_loops.find_boxes(self._boxes, x, y, distance_m, found)
        near: list[int] = self._numbers[found[:count]].tolist()
        return near


def _surface_points(triangles: Array, spacing_m: float) -> Iterator[Array]:
    """Points (P, 2) [m] on triangles (F, 3, 2), in batches of bounded size.

    Any point of a triangle is within `spacing_m` / sqrt(3) of one of them. They are in rows along the longest
    edge, and as few as the triangle is narrow: a wall, which has no area seen from above, has two rows.
    """
    edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
    first = edges.argmax(axis=1)[:, None]
    a, b, c = np.moveaxis(
        np.take_along_axis(triangles, ((first + np.arange(3)) % 3)[..., None], axis=1), 1, 0
    )
    (base_x, base_y), (side_x, side_y) = (b - a).T, (c - a).T
    longest = edges.max(axis=1)
    height = np.abs(base_x * side_y - base_y * side_x) / np.maximum(longest, 1e-12)
    # Rows are closer than points in a row, as they become shorter. Powers of two, so that a mesh with
    # triangles of many sizes needs few batches.
    sizes = np.stack([longest, 4.0 * height]) / spacing_m
    counts = 2 ** np.ceil(np.log2(np.maximum(sizes, 1.0))).astype(np.int64)
    for along, up in np.unique(counts, axis=1).T.tolist():
        own = np.flatnonzero((counts == [[along], [up]]).all(axis=0))
        shares = np.linspace(0.0, 1.0, along + 1)
        for part in np.array_split(own, max(1, len(own) * (along + 1) // _MAX_POINTS)):
            rows = max(1, _MAX_POINTS // (len(part) * (along + 1)))
            for low in range(0, up + 1, rows):
                heights = np.arange(low, min(low + rows, up + 1))[:, None] / up
                weights = [(1 - heights) * (1 - shares), (1 - heights) * shares, heights + 0.0 * shares]
                corners = np.stack([a[part], b[part], c[part]], axis=1)
                yield (np.stack([weight.ravel() for weight in weights], axis=1) @ corners).reshape(-1, 2)


# The map of a tuple of statics, computed once for all scenes with the same tuple.
load_shared_map = share_by_identity(ObstacleMap)


# Bounds the acceleration of a robot by its motors and gravity; landings on ground change the direction of a
# velocity and do not increase it.
_MAX_ACCELERATION_MPS2 = 40.0
# Upper bound of the distance below which engines treat two shapes as in contact.
_CONTACT_MARGIN_M = 0.05


class GatedRobot(Protocol):
    """What the gate needs to know of a robot; for `body_state` see `PhysicsRobot`.

    `reach_m` is the largest horizontal distance of any point of the robot, tyres included, from its position,
    at any joint angles. External forces act on the base link, of `base_mass_kg`.
    """

    @property
    def reach_m(self) -> float: ...

    @property
    def base_mass_kg(self) -> float: ...

    def planar_motion(self) -> tuple[float, float, float]:
        """Position x, y [m] of the centre of mass, and speed [m/s] in all three directions."""

    def body_state(self) -> tuple[float, ...]: ...


class ContactGate:
    """Finds the bodies that can have contacts, other than with ground, in the next control step.

    As of the last `find_contacts`, `needed_tyres` are the indices of each robot's tyres that can touch
    anything, in the order of its `RobotBody.tyres`.
    """

    def __init__(
        self,
        statics: tuple[StaticBody, ...],
        kinematics: Sequence[KinematicShape],
        robots: Sequence[RobotBody],
    ) -> None:
        self.obstacles = load_shared_map(statics)
        upright, leaning = ([shape.reach_m(lean) for shape in kinematics] for lean in (0.0, 1.0))
        self._reaches = np.column_stack([upright, np.subtract(leaning, upright)])
        self._moves = np.zeros((len(kinematics), gate_loops.KINEMATIC_COLUMNS))
        most = max((len(body.tyres) for body in robots), default=0)
        self._tyres = np.full((len(robots), most, gate_loops.TYRE_COLUMNS), np.nan)
        for own, body in zip(self._tyres, robots, strict=True):
            for row, tyre in zip(own, body.tyres, strict=False):
                arm, size = math.hypot(*tyre.position_b), math.hypot(tyre.radius_m, tyre.width_m / 2)
                row[:] = *tyre.position_b, arm, size
        self.needed_tyres: list[frozenset[int]] = [frozenset()] * len(robots)
        self._found = np.zeros((len(robots), gate_loops.FOUND_COLUMNS))
        self._found_kinematics = np.zeros(len(kinematics))

    def find_contacts(
        self,
        robots: Sequence[GatedRobot],
        duration_s: float,
        forces: Mapping[int, Sequence[float]],
        old_poses: ArrayLike,
        new_poses: ArrayLike,
    ) -> tuple[list[int], list[bool]]:
        """Indices of the kinematic bodies that robots can touch, and whether each robot can touch anything.

        The step takes `duration_s` [s]. `forces` [N] are the external ones, by index of the robot. The K
        kinematic bodies move from `old_poses` (K, 6: x, y, z [m], yaw, roll, pitch [rad]) to `new_poses`.
        """
        if not robots:
            return [], []
        rows = []
        for index, robot in enumerate(robots):
            acceleration = _MAX_ACCELERATION_MPS2
            if index in forces:
                acceleration += math.hypot(*forces[index]) / robot.base_mass_kg
            x, y, _, qx, qy, qz, qw, *_, wx, wy, wz = robot.body_state()
            motion = robot.planar_motion()
            rows.append((*motion, robot.reach_m, acceleration, x, y, qx, qy, qz, qw, wx, wy, wz))
        old, new = (
            np.asarray(each, float).reshape(-1, gate_loops.POSE_COLUMNS) for each in (old_poses, new_poses)
        )
        gate_loops.measure_moves(old, new, self._reaches, self._moves)
        found, near = self._found, self._found_kinematics
        gate_loops.find_near(
            *self.obstacles.arrays,
            np.array(rows).reshape(-1, gate_loops.ROBOT_COLUMNS),
            self._tyres,
            self._moves,
            duration_s,
            _CONTACT_MARGIN_M,
            found,
            near,
        )
        exposed = []
        for index, (_, _, _, is_exposed, bits) in enumerate(found.tolist()):
            exposed.append(is_exposed != 0.0)
            self.needed_tyres[index] = _of_bits(int(bits))
        return [body for body, is_near in enumerate(near.tolist()) if is_near], exposed

    def statics_near(self, robot: int) -> list[int]:
        """Numbers of the static bodies that a robot can touch, as of `find_contacts`: none of the others."""
        return self.obstacles.bodies_near(*self._found[robot, :3].tolist())


@lru_cache(maxsize=1024)
def _of_bits(bits: int) -> frozenset[int]:
    return frozenset(index for index in range(bits.bit_length()) if bits >> index & 1)
