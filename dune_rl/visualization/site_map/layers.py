"""What a map of a site shows, as arrays: ground, slopes, things, where episodes start, and figures."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.scenery import Segment
from dune_rl.seeding import stream
from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.worlds.free_space import FreeSpace
from dune_rl.worlds.world import Prop, Rectangle, World

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SLOPE_CLASSES = 5
# From the north-west, half-way up: the sheet-maker's light, by which hills do not look like hollows.
_LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)])
_STEPS_M = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_MOST_CONTOURS = 12
_LEAST_RELIEF_M = 0.03
_LEAST_AREA_M2 = 1e-6
_SAMPLE_TRIES = 60


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground at the centres of `x` (columns,) and `y` (rows,) [m]: arrays are (rows, columns).

    `height` [m], `slope` [rad], and `shade`: light from the north-west, 1 on level ground.
    """

    x: Array
    y: Array
    height: Array
    slope: Array
    shade: Array

    @classmethod
    def of(cls, terrain: HeightField, rectangle: Rectangle, columns: int, rows: int) -> "Ground":
        """`rectangle` (xmin, xmax, ymin, ymax) [m] in `columns` by `rows` cells."""
        xmin, xmax, ymin, ymax = rectangle
        x = xmin + (np.arange(columns) + 0.5) * (xmax - xmin) / columns
        y = ymin + (np.arange(rows) + 0.5) * (ymax - ymin) / rows
        height, normal = terrain.height_and_normal(np.stack(np.meshgrid(x, y), axis=-1))
        slope = np.arccos(np.minimum(normal[..., 2], 1.0))
        # Gentle ground is shaded as if it were steeper, up to four times, or nothing would show.
        steeper = float(np.clip(np.tan(np.deg2rad(18.0)) / max(np.tan(np.quantile(slope, 0.9)), 1e-6), 1, 4))
        raised = normal * [steeper, steeper, 1.0]
        lit = raised @ _LIGHT / np.linalg.norm(raised, axis=-1)
        return cls(x, y, height, slope, np.maximum(lit, 0.0) / _LIGHT[2])

    @property
    def points(self) -> Array:
        """The centres (rows, columns, 2) [m]."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)


def slope_edges(max_slope_deg: float) -> Array:
    """The limits (SLOPE_CLASSES + 1,) [degrees] of the classes that a robot may cross, gentlest first."""
    return np.linspace(0.0, max_slope_deg, SLOPE_CLASSES + 1)


def slope_class(slope: Array, max_slope_deg: float) -> NDArray[np.int64]:
    """The class of slopes [rad], 0 for the gentlest; SLOPE_CLASSES where they are steeper than allowed."""
    inner = np.deg2rad(slope_edges(max_slope_deg)[1:])
    # A slope of just the limit may be crossed, as the spawner has it.
    return np.searchsorted(inner, slope, side="left")


def contour_levels(height: Array) -> Array:
    """Round heights [m], at most `_MOST_CONTOURS`, between the lowest and the highest; none on a plane."""
    low, high = float(height.min()), float(height.max())
    if high - low < _LEAST_RELIEF_M:
        return np.zeros(0)
    step = next((step for step in _STEPS_M if (high - low) / step <= _MOST_CONTOURS), _STEPS_M[-1])
    levels = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    return levels[(levels > low) & (levels < high)]


@dataclass(frozen=True, eq=False)
class Things:
    """All things of a kind as seen from above: `triangles` (T, 3, 2) [m]."""

    kind: str
    triangles: Array
    drivable: bool


def things(world: World, most_kinds: int) -> list[Things]:
    """Solid props by kind: first what can be driven on, then obstacles, those of the largest area first.

    The last of more than `most_kinds` kinds of obstacles are put together as "other".
    """
    groups: dict[tuple[bool, str], list[Prop]] = {}
    for prop in world.props:
        if prop.solid:
            groups.setdefault((prop.drivable, prop.kind), []).append(prop)
    found = [_seen_from_above(kind, drivable, props) for (drivable, kind), props in groups.items()]
    found.sort(key=lambda each: (not each.drivable, -_area(each.triangles)))
    obstacles = [each for each in found if not each.drivable]
    if len(obstacles) > most_kinds:
        kept, rest = obstacles[: most_kinds - 1], obstacles[most_kinds - 1 :]
        triangles = np.concatenate([each.triangles for each in rest])
        obstacles = [*kept, Things("other", triangles, drivable=False)]
    return [*(each for each in found if each.drivable), *obstacles]


def _seen_from_above(kind: str, drivable: bool, props: Sequence[Prop]) -> Things:
    triangles = np.concatenate([prop.vertices[prop.faces, :2] for prop in props])
    # Upright faces are lines from above, within the outline of the others.
    flat = _areas(triangles) > _LEAST_AREA_M2
    return Things(kind, triangles[flat], drivable)


def _areas(triangles: Array) -> Array:
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def _area(triangles: Array) -> float:
    return float(_areas(triangles).sum())


def over_ground(props: Iterable[Prop], ground: Ground) -> Flags:
    """Where `props`, seen from above, hide the ground, (rows, columns)."""
    covered = np.zeros(ground.height.shape, bool)
    meshes = [(prop.vertices, prop.faces) for prop in props if len(prop.faces)]
    if not meshes:
        return covered
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes[:-1])])
    vertices = np.concatenate([vertices for vertices, _ in meshes])
    faces = np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=True)])
    top = float(vertices[:, 2].max()) + 1.0
    room = top - float(ground.height.min()) + 1.0
    origins = np.concatenate([ground.points, np.full((*covered.shape, 1), top)], axis=-1).reshape(-1, 3)
    down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    hit, _ = RayScene(vertices, faces).first_hit(origins, down, room)
    hit = hit.reshape(covered.shape)
    return (hit < room) & (top - hit > ground.height)


def water(world: World) -> list[Prop]:
    """Props that are water."""
    return [prop for prop in world.props if prop.segment_class == Segment.WATER]


def greenery(world: World) -> list[Prop]:
    """Crowns of trees and bushes, which a robot does not meet."""
    return [prop for prop in world.props if prop.segment_class == Segment.VEGETATION and not prop.solid]


def spawn_mask(spawner: Spawner) -> Flags:
    """The cells of the spawner's free space, (rows, columns), in which starts and goals lie."""
    free = spawner.free_space
    cells = np.rint((spawner.cells - [free.x[0], free.y[0]]) / free.cell_m).astype(int)
    mask = np.zeros(free.components.shape, bool)
    mask[cells[:, 1], cells[:, 0]] = True
    return mask


def at_points(free: FreeSpace, cells: Flags, points: Array) -> Flags:
    """The value of that of the `cells` (rows, columns) of `free` that `points` (..., 2) lie in."""
    index = np.floor((points - [free.x[0], free.y[0]]) / free.cell_m + 0.5).astype(int)
    column, row = index[..., 0], index[..., 1]
    known = (column >= 0) & (column < len(free.x)) & (row >= 0) & (row < len(free.y))
    return known & cells[np.where(known, row, 0), np.where(known, column, 0)]


def placements(spawner: Spawner, seed: int, episodes: int) -> list[Placement]:
    """Start and goal of the first `episodes` of `seed`."""
    return [spawner.sample(stream(seed, "spawn", episode)) for episode in range(episodes)]


def example_episodes(spawner: Spawner, seed: int, count: int, apart_m: float) -> dict[int, Placement]:
    """Up to `count` of the first episodes of `seed`, whose ends lie `apart_m` [m] from each other's."""
    chosen: dict[int, Placement] = {}
    taken: list[tuple[float, float]] = []
    for episode, each in enumerate(placements(spawner, seed, _SAMPLE_TRIES)):
        ends = [(each.x, each.y), (each.goal_x, each.goal_y)]
        if len(chosen) == count:
            break
        if all(np.hypot(a[0] - b[0], a[1] - b[1]) >= apart_m for a in ends for b in taken):
            chosen[episode] = each
            taken += ends
    return chosen


@dataclass(frozen=True)
class Figures:
    """Figures of a rectangle of a site; shares are of its area, slopes in degrees."""

    width_m: float
    depth_m: float
    relief_m: float
    median_slope_deg: float
    steepest_tenth_deg: float
    too_steep: float
    obstructed: float
    traversable: float


def figures(world: World, free: FreeSpace, rectangle: Rectangle, max_slope_deg: float) -> Figures:
    """Figures of `rectangle` (xmin, xmax, ymin, ymax) [m], of the cells of `free` whose centres lie in it.

    Obstructed is where an obstacle stands, traversable where a robot can be.
    """
    xmin, xmax, ymin, ymax = rectangle
    inside = ((free.y >= ymin) & (free.y <= ymax))[:, None] & (free.x >= xmin) & (free.x <= xmax)
    points = free.centres(inside)
    height = world.terrain.height(points)
    slope = np.rad2deg(world.terrain.slope(points))
    return Figures(
        width_m=xmax - xmin,
        depth_m=ymax - ymin,
        relief_m=float(np.ptp(height)),
        median_slope_deg=float(np.median(slope)),
        steepest_tenth_deg=float(np.quantile(slope, 0.9)),
        too_steep=float((slope > max_slope_deg).mean()),
        obstructed=float((free.clearance[inside] <= 0.0).mean()),
        traversable=float(free.traversable[inside].mean()),
    )
