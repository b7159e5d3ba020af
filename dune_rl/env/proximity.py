"""Distances between agents, and from agents to obstacles, at one control step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.frames import POSE_COLUMNS
from dune_rl.state.state import GroundQueries, Motion


@dataclass(frozen=True)
class Outline:
    """The shape of a group's bodies in plan view: a rectangle or a disc, centred at the origin.

    `points_b` (P, 2) [m] sample the outline of a rectangle of `half_size` (2,) [m]. A disc has one point, its
    centre, and `radius_m`, which is 0 for a rectangle.
    """

    points_b: Array
    half_size: Array
    radius_m: float = 0.0

    @classmethod
    def disc(cls, radius_m: float) -> "Outline":
        """A disc of `radius_m`."""
        return cls(np.zeros((1, 2)), np.zeros(2), radius_m)

    @property
    def reach_m(self) -> float:
        """Radius [m] of a disc about the origin that holds the outline."""
        return self.radius_m or float(np.hypot(*self.half_size))


@dataclass(frozen=True)
class GroupLayout:
    """The constant data of a group in each scene.

    `index` is the group's number, `count` its number of agents G. `neighbours` (G, K) has each agent's
    neighbours, as indices of the moving bodies of a scene in the order of body numbers.
    """

    index: int
    count: int
    outline: Outline
    neighbours: NDArray[np.int64]


class Proximity:
    """Distances of agents of M scenes from static obstacles and from each other, at one control step.

    `layouts` and `motions` are in the order of the groups; `movers` are the indices of the groups in the
    order of body numbers.
    """

    def __init__(
        self,
        ground: GroundQueries,
        layouts: Mapping[str, GroupLayout],
        movers: Sequence[int],
        motions: Sequence[Motion],
    ) -> None:
        self._ground, self._layouts, self._movers, self._motions = ground, layouts, movers, motions
        self._each = tuple(layouts.values())
        self._gaps: dict[tuple[int, int], Array] = {}

    def neighbours(self, group: str) -> Array:
        """Poses (N, K, 7) of the other moving bodies of each agent's scene: see `GroupState.neighbours`."""
        layout = self._layouts[group]
        columns = layout.neighbours
        poses = self._poses
        if layout.count == 1:
            return _without(poses, layout)
        return poses[:, columns].reshape(-1, columns.shape[1], POSE_COLUMNS)

    @cached_property
    def _poses(self) -> Array:
        """Poses (M, T, 7) of all moving bodies of each scene."""
        parts = []
        for index in self._movers:
            motion = self._motions[index]
            poses = np.empty((len(motion.position_w), POSE_COLUMNS))
            poses[:, :3], poses[:, 3] = motion.position_w, motion.yaw
            poses[:, 4:6], poses[:, 6] = motion.roll_pitch_yaw[:, :2], motion.frames
            parts.append(poses.reshape(-1, self._each[index].count, POSE_COLUMNS))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def clearance(self, group: str) -> Array:
        """Distance [m], (N,), of each agent's outline from the nearest obstacle or other agent.

        inf where there is neither; negative where discs overlap.
        """
        layout = self._layouts[group]
        index, outline, count = layout.index, layout.outline, layout.count
        points = self._points(index)
        by_scene = points.reshape(-1, count * points.shape[1], 2)
        nearest = self._ground.clearance(by_scene).reshape(len(points), -1).min(axis=1) - outline.radius_m
        for other in self._each:
            if other is not layout or count > 1:
                nearest = np.minimum(nearest, self._gap(index, other.index, points))
        return nearest

    def gap(self, group: str, other: str) -> Array:
        """Distance [m], (N,), of each agent's outline from the nearest agent of `other`, itself left out.

        inf where there is none; negative where discs overlap, 0 where rectangles do.
        """
        layout = self._layouts[group]
        points = self._points(layout.index)
        if group == other and layout.count == 1:
            return np.full(len(points), np.inf)
        return self._gap(layout.index, self._layouts[other].index, points).copy()

    def _gap(self, group: int, other: int, points: Array) -> Array:
        if (group, other) not in self._gaps:
            self._gaps[group, other] = self._from_group(group, other, points)
        return self._gaps[group, other]

    def _from_group(self, group: int, other: int, points: Array) -> Array:
        """Distance [m], (N,), of each agent of `group` from the nearest of `other` that is not itself."""
        count = self._each[group].count
        disc, round_other = self._each[group].outline.radius_m, self._each[other].outline.radius_m
        if round_other:
            centres = self._by_agent(self._motions[other].position_w[:, :2], group, other)
            apart = self._from_outline(group, centres) - round_other - disc
        else:
            apart = self._from_others_outline(group, other, points) - disc
            if not disc:
                theirs = self._by_agent(self._points(other), group, other)
                rows, members, around = theirs.shape[:3]
                mine = self._from_outline(group, theirs.reshape(rows, members * around, 2))
                apart = np.minimum(apart, mine.reshape(rows, members, around).min(axis=2))
        if group == other:
            own = np.arange(len(apart)) % count
            apart[np.arange(len(apart)), own] = np.inf
        return apart.min(axis=1)

    def _from_others_outline(self, group: int, other: int, points: Array) -> Array:
        """Distance [m], (N, H), of the points of `group`'s outlines from each of the H outlines of
        `other`.
        """
        count, number = self._each[group].count, self._each[other].count
        scenes = len(points) // count
        mine = points.reshape(scenes, count * points.shape[1], 2)
        mine = np.repeat(mine, number, axis=0)
        apart = self._from_outline(other, mine).reshape(scenes, number, count, -1).min(axis=3)
        return np.moveaxis(apart, 1, 2).reshape(-1, number)

    def _by_agent(self, values: Array, group: int, other: int) -> Array:
        """`values` (M * H, ...) of another group's agents for each agent of `group`: (N, H, ...)."""
        by_scene = values.reshape(-1, self._each[other].count, *values.shape[1:])
        count = self._each[group].count
        return by_scene if count == 1 else np.repeat(by_scene, count, axis=0)

    def _points(self, group: int) -> Array:
        """Sample points (N, P, 2) [m] of each outline, world frame."""
        motion, outline = self._motions[group], self._each[group].outline
        position = motion.position_w[:, None, :2]
        if outline.radius_m:
            return position
        found = np.empty((len(position), len(outline.points_b), 2))
        _place_points(outline.points_b, motion.position_w, motion.rotation, found)
        return found

    def _from_outline(self, group: int, points_w: Array) -> Array:
        """Distance [m], (N, K), of points (N, K, 2) from each agent's rectangle (0 inside) or disc centre."""
        motion, outline = self._motions[group], self._each[group].outline
        apart = np.empty(points_w.shape[:2])
        _measure_from_outlines(points_w, motion.position_w, motion.yaw, outline.half_size, apart)
        return apart


@compile_function
def _place_points(points_b: Any, position: Any, rotation: Any, found: Any) -> None:
    """Points (P, 2) of an outline on bodies at `position` (N, 3), turned by `rotation`: `found` (N, P, 2)."""
    for row in range(len(position)):
        for point in range(len(points_b)):
            x, y = points_b[point]
            for axis in range(2):
                turned = rotation[row, axis, 0] * x + rotation[row, axis, 1] * y
                found[row, point, axis] = position[row, axis] + turned


@compile_function
def _measure_from_outlines(points: Any, position: Any, yaw: Any, half_size: Any, found: Any) -> None:
    """Distances `found` (N, K) of points (N, K, 2) from rectangles of `half_size` (2,), 0 inside.

    The rectangles are centred at `position` (N, 3) and turned by `yaw` (N,) [rad].
    """
    for row in range(len(points)):
        cos, sin = np.cos(yaw[row]), np.sin(yaw[row])
        for point in range(points.shape[1]):
            x = points[row, point, 0] - position[row, 0]
            y = points[row, point, 1] - position[row, 1]
            ahead = abs(cos * x + sin * y) - half_size[0]
            aside = abs(cos * y - sin * x) - half_size[1]
            found[row, point] = np.hypot(max(ahead, 0.0), max(aside, 0.0))


def _without(poses: Array, layout: GroupLayout) -> Array:
    """`poses` (M, T, 7) without those of the single agent of a group, (M, T - 1, 7)."""
    columns = layout.neighbours[0]
    # Slices, which copy nothing, if the agent is the first or the last of the bodies.
    if not len(columns) or columns[0] == 1:
        return poses[:, 1:]
    return poses[:, :-1] if columns[-1] == len(columns) - 1 else poses[:, columns]
