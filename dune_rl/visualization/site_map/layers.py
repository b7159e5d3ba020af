"""Layers of a map as arrays: ground, slopes, props, starts and goals, and statistics."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.scenery import Segment
from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.visualization.site_map import colours
from dune_rl.worlds.passage import FreeSpace
from dune_rl.worlds.props import bisect_triangles, merge_meshes
from dune_rl.worlds.world import Prop, Rectangle, World

SLOPE_CLASSES = 5
# From the north-west at 45 degrees: the usual light of maps, with which hills do not look like hollows.
_LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)])
_STEPS_M = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_MOST_CONTOURS = 12
_LEAST_RELIEF_M = 0.03
_LEAST_AREA_M2 = 1e-6
_SAMPLE_TRIES = 60
# Triangles that reach below the ground are cut into pieces of at most this size, or this share of the world.
_LONGEST_M, _LONGEST_SHARE = 0.5, 1 / 250
_MOST_CUTS = 16
_FLUSH_M = 0.005


@dataclass(frozen=True, eq=False)
class GroundGrid:
    """The ground at cell centres `x` (columns,) and `y` (rows,) [m]; the other arrays are (rows, columns).

    `height` is in m, `slope` in rad; `shade` is light from the north-west, 1 on level ground.
    """

    x: Array
    y: Array
    height: Array
    slope: Array
    shade: Array

    @classmethod
    def sample(cls, terrain: HeightField, rectangle: Rectangle, columns: int, rows: int) -> "GroundGrid":
        """The grid of `columns` by `rows` cells over `rectangle` (xmin, xmax, ymin, ymax) [m]."""
        xmin, xmax, ymin, ymax = rectangle
        x = xmin + (np.arange(columns) + 0.5) * (xmax - xmin) / columns
        y = ymin + (np.arange(rows) + 0.5) * (ymax - ymin) / rows
        height, normal = terrain.height_and_normal(np.stack(np.meshgrid(x, y), axis=-1))
        slope = np.arccos(np.minimum(normal[..., 2], 1.0))
        # Gentle relief is shaded as if it were up to four times as steep, or it would not be visible.
        steeper = float(np.clip(np.tan(np.deg2rad(18.0)) / max(np.tan(np.quantile(slope, 0.9)), 1e-6), 1, 4))
        raised = normal * [steeper, steeper, 1.0]
        lit = raised @ _LIGHT / np.linalg.norm(raised, axis=-1)
        return cls(x, y, height, slope, np.maximum(lit, 0.0) / _LIGHT[2])

    @property
    def points(self) -> Array:
        """The centres (rows, columns, 2) [m]."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)


def slope_edges(max_slope_deg: float) -> Array:
    """Limits (SLOPE_CLASSES + 1,) [degrees] of the classes of allowed slopes, in rising order."""
    return np.linspace(0.0, max_slope_deg, SLOPE_CLASSES + 1)


def slope_class(slope: Array, max_slope_deg: float) -> NDArray[np.int64]:
    """Classes of slopes [rad], 0 for the gentlest; SLOPE_CLASSES above the limit."""
    inner = np.deg2rad(slope_edges(max_slope_deg)[1:])
    # A slope equal to the limit is allowed, as in the spawner.
    return np.searchsorted(inner, slope, side="left")


def contour_levels(height: Array) -> Array:
    """At most `_MOST_CONTOURS` round heights [m] between the lowest and the highest; none on a plane."""
    low, high = float(height.min()), float(height.max())
    if high - low < _LEAST_RELIEF_M:
        return np.zeros(0)
    step = next((step for step in _STEPS_M if (high - low) / step <= _MOST_CONTOURS), _STEPS_M[-1])
    levels = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    return levels[(levels > low) & (levels < high)]


@dataclass(frozen=True, eq=False)
class PropFootprints:
    """What is above the ground of all props of a kind, projected onto it: `triangles` (T, 3, 2) [m]."""

    kind: str
    triangles: Array
    drivable: bool


def prop_footprints(world: World, most_kinds: int) -> list[PropFootprints]:
    """Footprints of solid props by kind: first drivable ones, then obstacles by falling area.

    What is below the ground has none.
    Of more than `most_kinds` kinds of obstacles, the last are merged into the kind "other".
    """
    groups: dict[tuple[bool, str], list[Prop]] = {}
    for prop in world.props:
        if prop.solid:
            groups.setdefault((prop.drivable, prop.kind), []).append(prop)
    footprints = []
    for (drivable, kind), props in groups.items():
        corners = np.concatenate([prop.vertices[prop.faces] for prop in props])
        triangles = clip_above_ground(corners, world.terrain)[..., :2]
        # Vertical faces project to lines within the outline of the others.
        flat = triangles[_areas(triangles) > _LEAST_AREA_M2]
        if len(flat):
            footprints.append(PropFootprints(kind, flat, drivable))
    footprints.sort(key=lambda each: (not each.drivable, -_areas(each.triangles).sum()))
    most = sum(each.drivable for each in footprints) + most_kinds
    if len(footprints) > most:
        rest = np.concatenate([each.triangles for each in footprints[most - 1 :]])
        footprints[most - 1 :] = [PropFootprints("other", rest, drivable=False)]
    return footprints


def obstacle_tints(footprints: Sequence[PropFootprints]) -> dict[str, str]:
    """The colour of each kind of obstacle."""
    kinds = [each.kind for each in footprints if not each.drivable]
    return dict(zip(kinds, colours.OBSTACLES, strict=False))


def _areas(triangles: Array) -> Array:
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def covered_by(props: Iterable[Prop], ground: GroundGrid) -> Flags:
    """Mask (rows, columns) of the ground that `props` hide from above."""
    covered = np.zeros(ground.height.shape, bool)
    meshes = [(prop.vertices, prop.faces) for prop in props if len(prop.faces)]
    if not meshes:
        return covered
    vertices, faces = merge_meshes(meshes)
    top = float(vertices[:, 2].max()) + 1.0
    room = top - float(ground.height.min()) + 1.0
    highest = RayScene(vertices, faces).topmost(ground.points.reshape(-1, 2), top, room)
    return highest.reshape(covered.shape) > ground.height


def water_props(world: World) -> list[Prop]:
    """Props that are water."""
    return [prop for prop in world.props if prop.segment_class == Segment.WATER]


def vegetation_props(world: World) -> list[Prop]:
    """Crowns of trees and bushes, which are no obstacles."""
    return [prop for prop in world.props if prop.segment_class == Segment.VEGETATION and not prop.solid]


def spawn_mask(spawner: Spawner) -> Flags:
    """Mask (rows, columns) of the spawner's free space: the cells that contain starts and goals."""
    free = spawner.free_space
    cells = np.rint((spawner.cells - [free.x[0], free.y[0]]) / free.cell_m).astype(int)
    mask = np.zeros(free.components.shape, bool)
    mask[cells[:, 1], cells[:, 0]] = True
    return mask


def spawn_mask_below_props(spawner: Spawner, world: World, ground: GroundGrid) -> Flags:
    """Mask (rows, columns) of ground below solid props, such as solar arrays, on which agents can start."""
    chosen = spawner.free_space.values_at(spawn_mask(spawner), ground.points)
    return chosen & covered_by([prop for prop in world.props if prop.solid], ground)


def choose_spread_episodes(
    place_robots: Callable[[int], list[Placement]], count: int, apart_m: float
) -> dict[int, list[Placement]]:
    """Up to `count` of the first episodes whose starts and goals are `apart_m` [m] from each other's.

    `place_robots(episode)` gives the starts and goals of an episode's robots.
    """
    chosen: dict[int, list[Placement]] = {}
    taken: list[tuple[float, float]] = []
    for episode in range(_SAMPLE_TRIES):
        if len(chosen) == count:
            break
        placements = place_robots(episode)
        ends = [end for each in placements for end in ((each.x, each.y), (each.goal_x, each.goal_y))]
        if all(np.hypot(a[0] - b[0], a[1] - b[1]) >= apart_m for a in ends for b in taken):
            chosen[episode] = placements
            taken += ends
    return chosen


@dataclass(frozen=True)
class SiteStatistics:
    """Statistics of a rectangle of a world; shares are of its area, slopes in degrees."""

    width_m: float
    depth_m: float
    relief_m: float
    median_slope_deg: float
    steepest_tenth_deg: float
    too_steep: float
    obstructed: float
    traversable: float


def site_statistics(
    world: World, free: FreeSpace, rectangle: Rectangle, max_slope_deg: float
) -> SiteStatistics:
    """Statistics of `rectangle` (xmin, xmax, ymin, ymax) [m], over the cells of `free` with centres in it.

    Obstructed cells have an obstacle; traversable cells admit the robot.
    """
    xmin, xmax, ymin, ymax = rectangle
    inside = ((free.y >= ymin) & (free.y <= ymax))[:, None] & (free.x >= xmin) & (free.x <= xmax)
    points = free.centres(inside)
    height = world.terrain.height(points)
    slope = np.rad2deg(world.terrain.slope(points))
    return SiteStatistics(
        width_m=xmax - xmin,
        depth_m=ymax - ymin,
        relief_m=float(np.ptp(height)),
        median_slope_deg=float(np.median(slope)),
        steepest_tenth_deg=float(np.quantile(slope, 0.9)),
        too_steep=float((slope > max_slope_deg).mean()),
        obstructed=float((free.clearance[inside] <= 0.0).mean()),
        traversable=float(free.traversable[inside].mean()),
    )


def clip_above_ground(corners: Array, terrain: HeightField) -> Array:
    """The parts (N, 3, 3) of triangles (T, 3, 3) [m] that are above the ground.

    The ground is planar below each piece of half a metre (more in worlds over 125 m).
    """
    xmin, xmax, ymin, ymax = terrain.extent
    longest_m = max(_LONGEST_M, _LONGEST_SHARE * max(xmax - xmin, ymax - ymin))
    whole, rest = [], corners
    for _ in range(_MOST_CUTS):
        above = (_height_above_ground(rest, terrain) > 0.0).all(axis=1)
        whole.append(rest[above])
        rest = rest[~above]
        edges = np.linalg.norm((np.roll(rest, -1, axis=1) - rest)[..., :2], axis=2)
        long = edges.max(axis=1, initial=0.0) > longest_m
        if not long.any():
            break
        rest = np.concatenate([rest[~long], bisect_triangles(rest[long], edges[long].argmax(axis=1))])
    return np.concatenate([*whole, *_cut_at_ground(rest, _height_above_ground(rest, terrain))])


def _height_above_ground(corners: Array, terrain: HeightField) -> Array:
    return corners[..., 2] - terrain.height(corners[..., :2]) - _FLUSH_M


def _rotate(values: Array, first: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """The values of the three corners of triangles (N, 3, ...), from corner `first` (N,) on."""
    row = np.arange(len(values))
    return values[row, first], values[row, (first + 1) % 3], values[row, (first + 2) % 3]


def _cut_at_ground(corners: Array, height: Array) -> list[Array]:
    """The parts above the ground of triangles (N, 3, 3) with heights (N, 3) above it."""
    above = height > 0.0
    count = above.sum(axis=1)
    one, two = np.flatnonzero(count == 1), np.flatnonzero(count == 2)
    top, right, left = _rotate(corners[one], above[one].argmax(axis=1))
    h_top, h_right, h_left = _rotate(height[one], above[one].argmax(axis=1))
    tips = np.stack([top, _crossing(top, right, h_top, h_right), _crossing(top, left, h_top, h_left)], axis=1)
    low, next_, last = _rotate(corners[two], above[two].argmin(axis=1))
    h_low, h_next, h_last = _rotate(height[two], above[two].argmin(axis=1))
    start, end = _crossing(next_, low, h_next, h_low), _crossing(last, low, h_last, h_low)
    halves = [np.stack([start, next_, last], axis=1), np.stack([start, last, end], axis=1)]
    return [corners[count == 3], tips, *halves]


def _crossing(above: Array, below: Array, height_above: Array, height_below: Array) -> Array:
    """Points (N, 3) at height 0 on the edges between points above and below."""
    share = height_above / (height_above - height_below)
    return above + share[:, None] * (below - above)
