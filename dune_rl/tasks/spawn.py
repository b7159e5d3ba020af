"""Start poses and goals of robots, sampled from the free space of a world."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from dune_rl.core.errors import WorldError
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.worlds.passage import FreeSpace, water_depth
from dune_rl.worlds.world import Rectangle, World

_GOAL_TRIES = 16


class SpawnConf(Settings):
    """Settings of starts and goals: `source` is the registered source, and what follows is for its `Spawner`.

    `region` is "world" for the world's own rectangle, "anywhere" for all of the
    world, or a rectangle (xmin, xmax, ymin, ymax) [m].
    """

    source: str = "region"
    region: Literal["world", "anywhere"] | Rectangle = "world"
    max_slope_deg: float = Field(default=25.0, gt=0.0, le=60.0, description="steepest ground to cross")
    margin_m: float = Field(default=0.1, ge=0.0, le=5.0, description="room beside the footprint")
    passage_m: float | None = Field(
        default=None, gt=0.0, le=100.0, description="least width of ways to goals; null: the footprint's"
    )
    min_goal_distance_m: float = Field(default=2.0, ge=0.0, le=1000.0)
    max_goal_distance_m: float | None = Field(
        default=None, gt=0.0, description="from start to goal where the region has such goals; null: any"
    )
    anywhere_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="of episodes with starts and goals anywhere in the world"
    )
    robots_apart_m: float = Field(default=0.5, ge=0.0, le=100.0, description="room between footprints")
    max_water_m: float = Field(default=0.1, ge=0.0, le=100.0, description="deepest water at starts and goals")

    @model_validator(mode="after")
    def _has_room(self) -> "SpawnConf":
        if self.max_goal_distance_m is not None and self.max_goal_distance_m <= self.min_goal_distance_m:
            raise ValueError(
                f"max_goal_distance_m={self.max_goal_distance_m:g} must be above "
                f"min_goal_distance_m={self.min_goal_distance_m:g}"
            )
        if not isinstance(self.region, str):
            xmin, xmax, ymin, ymax = self.region
            if xmin >= xmax or ymin >= ymax:
                raise ValueError(f"region must be (xmin, xmax, ymin, ymax) with min < max, not {self.region}")
        return self


@dataclass(frozen=True)
class Placement:
    """A spawn position and yaw, and a goal, in the world frame [m, rad]."""

    x: float
    y: float
    yaw: float
    goal_x: float
    goal_y: float


@dataclass(frozen=True)
class SpawnedBody:
    """Who starts somewhere, in words for errors: `name` of the body, and what ground it `needs` beside room.

    `settings` is the path of its group's settings, such as `actors.traffic`; empty for robots that have the
    environment's.
    """

    name: str = "robot"
    needs: str = ""
    settings: str = ""

    @property
    def spawn(self) -> str:
        """The path of the group's settings of starts and goals."""
        return f"{self.settings}.task.spawn" if self.settings else "task.spawn"

    @property
    def fewer(self) -> str:
        """What to do for fewer of them."""
        return f"Lower {self.settings}.count" if self.settings else "Have fewer robots"


_ROBOT = SpawnedBody()


class Spawner:
    """Samples start poses and goals that a disc of `footprint_radius_m` can move between.

    All are in one connected part of the free space: the part that covers most of the region. With
    `passage_m` ways through it may be narrower than the disc. `is_passable`, of points (..., 2), tells where
    else they cannot be. Raises WorldError, which names the setting of `body` to change, where the world has
    none.
    """

    def __init__(
        self,
        world: World,
        conf: SpawnConf,
        footprint_radius_m: float,
        is_passable: Callable[[World, Array], Flags] | None = None,
        body: SpawnedBody = _ROBOT,
    ) -> None:
        self._is_passable, self._body = is_passable, body
        self._world = world
        self._conf = conf
        self._footprint_radius_m = footprint_radius_m
        self._max_slope = np.deg2rad(conf.max_slope_deg)
        self.region: Rectangle = self._resolve_region()
        self._points_by_radius: dict[float, Array] = {}
        self._most_goal_distance_m = np.inf if conf.max_goal_distance_m is None else conf.max_goal_distance_m
        # Whether some of the region is too deep below water, so that points must be looked at one by one.
        self._is_wet = False
        passage = (
            footprint_radius_m if conf.passage_m is None else min(footprint_radius_m, conf.passage_m / 2)
        )
        # Kept with the world, which other environments may be in, such as that of the evaluation.
        self.free_space = world.memoize(
            ("free space", passage, conf.max_slope_deg), lambda: FreeSpace(world, passage, conf.max_slope_deg)
        )
        # Centres (K, 2) [m] of the cells that starts and goals are drawn from.
        self._part, self.cells = self._largest_part(self.free_space, footprint_radius_m + conf.margin_m)
        self._starts = self._with_goal_in_reach()

    def _resolve_region(self) -> Rectangle:
        region = self._conf.region
        if region == "anywhere":
            return self._world.extent
        if region == "world":
            return self._world.region
        assert not isinstance(region, str)
        extent = self._world.extent
        if region[0] < extent[0] or region[1] > extent[1] or region[2] < extent[2] or region[3] > extent[3]:
            raise WorldError(
                f"{self._body.spawn}.region {_rectangle(region)} reaches outside the world "
                f"{self._world.name!r}, which covers {_rectangle(extent)}: choose a rectangle within that."
            )
        return region

    @property
    def _where(self) -> str:
        """The region and the world, as errors begin with them."""
        return f"{self._body.spawn}.region {_rectangle(self.region)} of the world {self._world.name!r}"

    def _in_region(self, free: FreeSpace) -> Flags:
        # Whole cells, so that a point moved about within its cell stays in the region.
        half = free.cell_m / 2 - 1e-9
        xmin, xmax, ymin, ymax = self.region
        in_x = (free.x - half >= xmin) & (free.x + half <= xmax)
        in_y = (free.y - half >= ymin) & (free.y + half <= ymax)
        return in_y[:, None] & in_x

    def _largest_part(self, free: FreeSpace, clearance_m: float) -> tuple[int, Array]:
        in_region = self._in_region(free)
        usable = in_region & free.traversable & (free.clearance >= clearance_m)
        if not usable.any():
            raise WorldError(self._why_none(free, in_region, clearance_m))
        passable = self._passable(free.centres(usable))
        self._is_wet = self._is_passable is None and not passable.all()
        usable[np.nonzero(usable)] = passable
        if not usable.any():
            raise WorldError(self._why_impassable())
        part = int(np.bincount(free.components[usable]).argmax())
        return part, free.centres(usable & (free.components == part))

    def _why_none(self, free: FreeSpace, in_region: Flags, clearance_m: float) -> str:
        where, spawn = self._where, self._body.spawn
        if not in_region.any():
            return f"{where} is smaller than one cell of {free.cell_m:.2f} m: widen {spawn}.region."
        if not free.inside.any():
            xmin, xmax, ymin, ymax = self._world.extent
            return (
                f"the world {self._world.name!r} is {xmax - xmin:.3g} by {ymax - ymin:.3g} m, and starts and "
                "goals keep 1 m from its edge, so that it has no room for them: take a larger world, or "
                "another unit of its file (world.unit_m)."
            )
        if not (in_region & free.inside).any():
            return f"{where} lies within 1 m of the world's edge: move or widen {spawn}.region."
        if free.steep[in_region].all():
            return (
                f"{where} is steeper than {spawn}.max_slope_deg={self._conf.max_slope_deg:g} everywhere: "
                f"raise it, or choose another {spawn}.region."
            )
        return (
            f"{where} has no ground under {self._conf.max_slope_deg:g} degrees with {clearance_m:.2f} m of "
            f"clearance (footprint {self._footprint_radius_m:.2f} m, "
            f"{spawn}.margin_m={self._conf.margin_m:g}; "
            f"there is {free.clearance[in_region].max():.2f} m at most).\n"
            f"Lower {spawn}.margin_m, raise {spawn}.max_slope_deg, or choose another {spawn}.region, a "
            "smaller body or another world."
        )

    def _why_impassable(self) -> str:
        where, spawn = self._where, self._body.spawn
        if self._is_passable is None:
            return (
                f"{where} is all below more than {spawn}.max_water_m={self._conf.max_water_m:g} m of water: "
                f"raise it, or choose another {spawn}.region or another world."
            )
        return (
            f"{where} has no ground that this body can be on: all is too steep, too rough, below water or "
            f"below roofs. Choose another {spawn}.region, another world, or another body."
        )

    def _with_goal_in_reach(self) -> Array:
        # The cell farthest from anywhere is outermost in some direction; 64 directions find it to 0.1 %.
        bearings = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
        # Cells are in rows, of which only the ends can be outermost.
        starts = np.flatnonzero(np.diff(self.cells[:, 1], prepend=np.inf))
        ends = self.cells[np.concatenate([starts, np.append(starts[1:], len(self.cells)) - 1])]
        outermost = ends[np.unique((directions @ ends.T).argmax(axis=1))]
        reach = self._conf.min_goal_distance_m
        # Hardly a cell is near to the first one, so that the others are for few.
        near = np.arange(len(self.cells))
        for point in outermost:
            near = near[np.hypot(*(self.cells[near] - point).T) < reach]
        if len(near) == len(self.cells):
            across = max(float(np.hypot(*(self.cells - point).T).max()) for point in outermost)
            raise WorldError(
                f"{self._body.spawn}.min_goal_distance_m={reach:g} is more than the {across:.2f} m "
                f"across the free part of {self._body.spawn}.region {_rectangle(self.region)}: "
                "lower it, or widen the region."
            )
        return np.delete(self.cells, near, axis=0)

    @cached_property
    def _farthest_m(self) -> float:
        """The largest distance of a goal, at most the diagonal of the rectangle round all cells [m]."""
        return min(self._most_goal_distance_m, float(np.hypot(*np.ptp(self.cells, axis=0))))

    def eased(self, difficulty: float) -> "Spawner":
        """The same with goals nearer to starts; `difficulty` in [0, 1], of which 1 changes nothing.

        The largest distance of goals rises from the smallest one, and the size of two cells, linearly.
        """
        if difficulty >= 1.0:
            return self
        least = self._conf.min_goal_distance_m + 2 * self.free_space.cell_m
        eased = copy(self)
        eased._most_goal_distance_m = least + difficulty * max(0.0, self._farthest_m - least)
        return eased

    def sample(
        self, rng: np.random.Generator, taken: Sequence[Placement] = (), apart_m: Sequence[float] = ()
    ) -> Placement:
        """A start and a goal at least `min_goal_distance_m` from it, drawn from `rng` alone.

        The start is at least `apart_m` from the start of each `taken` placement,
        and the goal from its goal. Raises WorldError where no place is left.
        """
        starts = self._near(self._starts, [(one.x, one.y) for one in taken], apart_m)
        near = self._near(self.cells, [(one.goal_x, one.goal_y) for one in taken], apart_m)
        cell = self._starts[_left_over(starts, rng.integers(len(self._starts) - len(starts)))]
        draws = _left_over(near, rng.integers(len(self.cells) - len(near), size=_GOAL_TRIES))
        yaw = rng.uniform(-np.pi, np.pi)
        moves = rng.uniform(-0.5, 0.5, (2, 2)) * self.free_space.cell_m
        goals = self.cells[draws]
        far = np.flatnonzero(self._far(goals, cell))
        if not len(far):
            goals = np.delete(self.cells, near, axis=0)
            far = self._far_or_nearest(goals, cell, len(taken))
            far = far[rng.integers(len(far), size=1)]
        centres = np.stack([cell, goals[far[0]]])
        points = np.where(self._fits(centres + moves)[:, None], centres + moves, centres)
        if not self._far(points[1], points[0]):
            points = centres
        return Placement(
            float(points[0, 0]), float(points[0, 1]), float(yaw), float(points[1, 0]), float(points[1, 1])
        )

    def sample_goal(
        self, rng: np.random.Generator, start: Array, taken: Array, apart_m: Array
    ) -> tuple[float, float]:
        """A goal at least `min_goal_distance_m` from `start` (2,) and `apart_m` (K,) from `taken` (K, 2).

        It is drawn from `rng` alone. Where the region has no such place, it is the place with the smallest
        shortfall: a running episode must go on.
        """
        centres = self.cells[rng.integers(len(self.cells), size=_GOAL_TRIES)]
        moved = centres + rng.uniform(-0.5, 0.5, centres.shape) * self.free_space.cell_m
        choice = rng.uniform()
        for goals in (np.where(self._fits(moved)[:, None], moved, centres), self.cells):
            excess = self._excess(goals, start, taken, apart_m)
            enough = goals[excess >= 0.0]
            if len(enough):
                x, y = enough[int(choice * len(enough))].tolist()
                return x, y
        x, y = self.cells[excess.argmax()].tolist()
        return x, y

    def _excess(self, goals: Array, start: Array, taken: Array, apart_m: Array) -> Array:
        """By how much each of `goals` (P, 2) exceeds the least of its distances that must be [m], (P,)."""
        points = np.concatenate([start[None], taken])
        needed = np.concatenate([[self._conf.min_goal_distance_m], apart_m])
        offset = goals[:, None] - points
        distance = np.hypot(offset[..., 0], offset[..., 1])
        excess: Array = (distance - needed).min(axis=1)
        near: Array = np.minimum(excess, self._most_goal_distance_m - distance[:, 0])
        return near

    def _near(self, cells: Array, points: Sequence[tuple[float, float]], apart_m: Sequence[float]) -> Counts:
        """Sorted indices of the `cells` within `apart_m` of one of `points`; raises WorldError if all are."""
        found = [np.zeros(0, np.int64)]
        for (x, y), apart in zip(points, apart_m, strict=True):
            # From anywhere in a cell. They are in rows of rising y.
            reach = apart + self.free_space.cell_m / np.sqrt(2)
            first, last = np.searchsorted(cells[:, 1], (y - reach, y + reach))
            rows = cells[first:last]
            found.append(first + np.flatnonzero(np.hypot(rows[:, 0] - x, rows[:, 1] - y) < reach))
        near = np.unique(np.concatenate(found))
        if len(near) == len(cells):
            raise WorldError(self._too_full(len(points)))
        return near

    def why_not(self, x: float, y: float) -> str:
        """Why a robot cannot be at a point, in words that follow it; empty where it can."""
        xmin, xmax, ymin, ymax = self._world.extent
        if not (xmin <= x <= xmax and ymin <= y <= ymax):
            return f"is outside the world, which covers {_rectangle(self._world.extent)}"
        xy = np.array([x, y])
        clearance = float(self._world.clearance(xy))
        if clearance < self._footprint_radius_m:
            return (
                f"is {clearance:.2f} m from an obstacle, and the robot needs {self._footprint_radius_m:.2f} m"
            )
        slope = float(np.rad2deg(self._world.terrain.slope(xy)))
        if slope > self._conf.max_slope_deg:
            return f"is on a slope of {slope:.0f} degrees, above {self._body.spawn}.max_slope_deg"
        if self._is_passable is None and not self._is_shallow(xy):
            depth = float(water_depth(self._world, xy))
            return f"is in water that is {depth:.2f} m deep, above {self._body.spawn}.max_water_m"
        return ""

    def _too_full(self, others: int) -> str:
        body, xmin, xmax, ymin, ymax = self._body, *self.region
        suitable_m2 = len(self.cells) * self.free_space.cell_m**2
        least = self._footprint_radius_m + self._conf.margin_m
        is_all = self.region == self._world.extent
        return (
            f"{self._where} has no room for another {body.name} beside {others} other agents: "
            f"{suitable_m2:.0f} of its {(xmax - xmin) * (ymax - ymin):.0f} m² suit it ({least:.2f} m of "
            f"clearance, slopes up to {self._conf.max_slope_deg:g} degrees{body.needs}).\n"
            f"{body.fewer}, {'take a larger world' if is_all else f'widen {body.spawn}.region'}, lower "
            f"{body.spawn}.robots_apart_m, or choose a smaller body."
        )

    def _far(self, goals: Array, start: Array) -> Flags:
        away = goals - start
        distance = np.hypot(away[..., 0], away[..., 1])
        far: Flags = (distance >= self._conf.min_goal_distance_m) & (distance <= self._most_goal_distance_m)
        return far

    def _far_or_nearest(self, cells: Array, start: Array, others: int) -> Counts:
        """Indices of the `cells` (K, 2) that are as far from `start` as goals are; else of the nearest one
        that is far enough. Raises WorldError if none is.
        """
        distance = np.hypot(*(cells - start).T)
        enough = distance >= self._conf.min_goal_distance_m
        if not enough.any():
            raise WorldError(self._too_full(others))
        found = np.flatnonzero(enough & (distance <= self._most_goal_distance_m))
        return found if len(found) else np.array([np.where(enough, distance, np.inf).argmin()])

    def _fits(self, xy: Array) -> Flags:
        clear = self._world.clearance(xy) >= self._footprint_radius_m + self._conf.margin_m
        gentle: Flags = self._world.terrain.slope(xy) <= self._max_slope
        fits = gentle & clear
        return fits & self._passable(xy) if self._is_wet or self._is_passable is not None else fits

    def _passable(self, xy: Array) -> Flags:
        if self._is_passable is not None:
            return self._is_passable(self._world, xy)
        return self._is_shallow(xy)

    def _is_shallow(self, xy: Array) -> Flags:
        shallow: Flags = water_depth(self._world, xy) <= self._conf.max_water_m
        return shallow

    def sample_points(self, rng: np.random.Generator, n: int, radius_m: float) -> Array:
        """Points (n, 2) [m] of the same part with `radius_m` of clearance, connected at that clearance.

        Raises WorldError where the region has none.
        """
        cells = self._points_by_radius.get(radius_m)
        if cells is None:
            cells = self._points_by_radius[radius_m] = self._cells_with(radius_m)
        return cells[rng.integers(len(cells), size=n)]

    def _cells_with(self, radius_m: float) -> Array:
        free = FreeSpace(self._world, max(radius_m, self._footprint_radius_m), self._conf.max_slope_deg)
        usable = self._in_region(free) & free.traversable & (self.free_space.components == self._part)
        if not usable.any():
            raise WorldError(
                f"{self._where} has no free point with {radius_m:.2f} m of clearance for actors: take "
                f"actors=none, make them smaller, or choose another {self._body.spawn}.region."
            )
        part = np.bincount(free.components[usable]).argmax()
        return free.centres(usable & (free.components == part))


def _rectangle(region: Rectangle) -> str:
    return "({:g}, {:g}, {:g}, {:g})".format(*region)


def _left_over(removed: Counts, numbers: ArrayLike) -> Counts:
    """Indices of the entries with these `numbers` among those that the sorted indices `removed` leave."""
    before = np.searchsorted(removed - np.arange(len(removed)), numbers, side="right")
    return np.asarray(numbers) + before
