"""One panel of a map: a rectangle of the world from above."""

import string
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle
from matplotlib.patches import Rectangle as Box
from matplotlib.path import Path
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.visualization.site_map import colours, layers
from dune_rl.worlds.world import Rectangle, World

STRIPE_IN = 0.028
_CONTOUR_COLUMNS = 320
_SHORTEST_CONTOUR_IN = 0.35


@dataclass(frozen=True, eq=False)
class Track:
    """Positions of an agent in an episode, `points` (T, 2) [m], and how its episode ended.

    `ending` is None for agents without an episode of their own, such as scripted walkers.
    """

    agent: str
    episode: int
    points: Array
    ending: str | None


@dataclass(frozen=True, eq=False)
class MapContent:
    """What a map shows.

    `episodes` has the starts and goals of all robots by episode, `paths` (P, 2) [m] are examples of walkers'
    paths. Slopes over `max_slope_deg` are marked as too steep, and goals have circles of `goal_distance_m`.
    """

    world: World
    spawner: Spawner
    max_slope_deg: float
    goal_distance_m: float
    footprints: Sequence[layers.PropFootprints]
    paths: Sequence[Array] = ()
    episodes: dict[int, list[Placement]] = field(default_factory=dict)
    tracks: Sequence[Track] = ()


# Stripes on props are fainter and wider apart than on the ground: the prop is to be seen first.
_PASSAGE_OPACITY, _PASSAGE_STRIPES = 0.4, 3.2


def render_ground(content: MapContent, ground: layers.GroundGrid, stripe_px: float) -> Array:
    """Colours (rows, columns, 3) of the ground in sRGB: slope, shading, spawn cells, plants and water."""
    picture = slope_colours(ground, content.max_slope_deg, stripe_px)
    up, across = np.ogrid[: len(ground.y), : len(ground.x)]
    chosen = content.spawner.free_space.values_at(layers.spawn_mask(content.spawner), ground.points)
    _blend(picture, chosen, colours.SPAWN, 0.16)
    _blend(picture, chosen & _stripes(across - up, 1.6 * stripe_px), colours.SPAWN, 0.30)
    return shade_ground(picture, content.world, ground)


def slope_colours(ground: layers.GroundGrid, max_slope_deg: float, stripe_px: float) -> Array:
    """Colours (rows, columns, 3) in sRGB of the slopes of the ground, with stripes where it is too steep."""
    palette = np.array([colours.rgb(c) for c in (*colours.SLOPES, colours.TOO_STEEP)])
    classes = layers.slope_class(ground.slope, max_slope_deg)
    picture = palette[classes]
    up, across = np.ogrid[: classes.shape[0], : classes.shape[1]]
    striped = (classes == layers.SLOPE_CLASSES) & _stripes(across + up, stripe_px)
    picture[striped] = colours.rgb(colours.TOO_STEEP_STRIPE)
    return picture


def shade_ground(picture: Array, world: World, ground: layers.GroundGrid) -> Array:
    """Colours (rows, columns, 3) of the ground with grass, light from the north-west, water and plants."""
    if world.grass is not None:
        _blend(picture, grass_mask(world, ground), colours.GRASS, 0.5)
    # Shading moves colours towards black and white, so their hues stay those of the legend.
    light = np.clip(ground.shade, 0.0, 1.5)[..., None]
    picture *= 1.0 - 0.55 * np.maximum(1.0 - light, 0.0)
    picture += 0.8 * np.maximum(light - 1.0, 0.0) * (1.0 - picture)
    _blend(picture, layers.covered_by(layers.water_props(world), ground), colours.WATER, 0.92)
    _blend(picture, layers.covered_by(layers.vegetation_props(world), ground), colours.GREENERY, 0.38)
    return picture


def render_passages(content: MapContent, ground: layers.GroundGrid, stripe_px: float) -> Array:
    """Stripes (rows, columns, 4), sRGB and opacity, on spawn cells below props such as solar arrays."""
    below = layers.spawn_mask_below_props(content.spawner, content.world, ground)
    up, across = np.ogrid[: below.shape[0], : below.shape[1]]
    picture = np.zeros((*below.shape, 4))
    picture[..., :3] = colours.rgb(colours.PASSAGE)
    picture[..., 3] = _PASSAGE_OPACITY * (below & _stripes(across - up, _PASSAGE_STRIPES * stripe_px))
    return picture


def grass_mask(world: World, ground: layers.GroundGrid) -> Flags:
    """Mask (rows, columns) of the ground with tall grass."""
    assert world.grass is not None
    density = world.grass.density
    xmin, xmax, ymin, ymax = world.extent
    column = ((ground.x - xmin) / (xmax - xmin) * density.shape[1]).astype(int)
    row = ((ground.y - ymin) / (ymax - ymin) * density.shape[0]).astype(int)
    column, row = np.clip(column, 0, density.shape[1] - 1), np.clip(row, 0, density.shape[0] - 1)
    return density[row[:, None], column] > 0.0


def _stripes(place: NDArray[np.int64], width_px: float) -> Flags:
    return place % (2 * width_px) < width_px * 0.8


def _blend(picture: Array, where: Flags, colour: str, share: float) -> None:
    picture[where] += share * (colours.rgb(colour) - picture[where])


def draw_ground(
    axes: Axes, content: MapContent, rectangle: Rectangle, size_in: tuple[float, float], dpi: int
) -> None:
    """Draw relief, slopes, contours, plants and water of `rectangle`, with one cell per pixel."""
    columns, rows = (max(2, round(side * dpi)) for side in size_in)
    ground = layers.GroundGrid.sample(content.world.terrain, rectangle, columns, rows)
    picture = render_ground(content, ground, STRIPE_IN * dpi)
    under = render_passages(content, ground, STRIPE_IN * dpi)
    for layer, order in ((picture, 0.0), (under, 3.0)):
        axes.imshow(layer, extent=rectangle, origin="lower", interpolation="nearest", zorder=order)
    axes.set_xlim(rectangle[:2])
    axes.set_ylim(rectangle[2:])
    draw_contours(axes, content.world, rectangle, size_in)


def draw_contours(axes: Axes, world: World, rectangle: Rectangle, size_in: tuple[float, float]) -> None:
    """Draw the contour lines of `rectangle`, with their heights."""
    columns = _CONTOUR_COLUMNS
    rows = max(2, round(columns * size_in[1] / size_in[0]))
    ground = layers.GroundGrid.sample(world.terrain, rectangle, columns, rows)
    # Smoothed over the width of a line: smaller details cannot be drawn.
    height = gaussian_filter(ground.height, 1.5, mode="nearest")
    levels = layers.contour_levels(height)
    if not len(levels):
        return
    lines = axes.contour(
        ground.x, ground.y, height, levels, colors=colours.CONTOUR, linewidths=0.45, zorder=1,
        negative_linestyles="solid",
    )  # fmt: skip
    per_m = size_in[0] / (rectangle[1] - rectangle[0])
    long = [_drop_short_lines(path, _SHORTEST_CONTOUR_IN / per_m) for path in lines.get_paths()]
    lines.set_paths(long)
    labelled = [level for level, path in zip(levels, long, strict=True) if np.size(path.vertices)]
    for text in axes.clabel(lines, labelled, fontsize=5.5, fmt=_metres, inline=True, inline_spacing=2):
        text.set_path_effects([patheffects.withStroke(linewidth=1.4, foreground="#ffffffb0")])
        text.set_zorder(1.5)


def _drop_short_lines(path: Path, shortest_m: float) -> Path:
    lines = path.to_polygons(closed_only=False)
    long = [Path(line) for line in lines if np.hypot(*np.diff(line, axis=0).T).sum() >= shortest_m]
    return Path.make_compound_path(*long) if long else Path(np.zeros((0, 2)))


def _metres(value: float) -> str:
    return f"{value + 0.0:.2f}".rstrip("0").rstrip(".").replace("-", "\N{MINUS SIGN}")


def draw_props(axes: Axes, footprints: Sequence[layers.PropFootprints], tints: dict[str, str]) -> None:
    """Draw the props from above, each kind in its colour with a common outline."""
    for number, each in enumerate(footprints):
        fill = colours.DRIVABLE if each.drivable else tints[each.kind]
        edge = colours.DRIVABLE_EDGE if each.drivable else colours.INK
        # First the edges of every triangle, then their faces on top: only the outline remains visible.
        for colour, width, order in ((edge, 0.9, 0.0), (fill, 0.1, 0.01)):
            shapes = PolyCollection(list(each.triangles), color=colour, linewidths=width)
            shapes.set_zorder(2 + 0.02 * number + order)
            axes.add_collection(shapes, autolim=False)


def draw_region(axes: Axes, region: Rectangle, width: float) -> None:
    """Draw the outline of the region of starts and goals."""
    _outline(axes, region, edgecolor=colours.PAPER, linewidth=width + 1.4)
    _outline(axes, region, edgecolor=colours.SPAWN_EDGE, linewidth=width)


def _outline(axes: Axes, rectangle: Rectangle, **style: Any) -> None:
    xmin, xmax, ymin, ymax = rectangle
    axes.add_patch(Box((xmin, ymin), xmax - xmin, ymax - ymin, fill=False, zorder=4, **style))


def draw_candidates(axes: Axes, content: MapContent) -> None:
    """Draw the numbers of the regions that `world.region` chooses from, and outlines of those not chosen."""
    _, _, ymin, ymax = content.world.extent
    for number, each in enumerate(content.world.region_candidates, start=1):
        left, _, _, high = each.rectangle
        if each.rectangle != content.spawner.region:
            _outline(axes, each.rectangle, edgecolor=colours.PAPER, linewidth=2.4)
            dashed = {"linewidth": 1.2, "linestyle": (0, (3, 1.5))}
            _outline(axes, each.rectangle, edgecolor=colours.SPAWN_EDGE, **dashed)
        # Above the rectangle, or inside at the upper edge of the world.
        inside = ymax - high < 0.05 * (ymax - ymin)
        axes.annotate(
            f"{number}", (left, high), (0, -1.5 if inside else 1.5), textcoords="offset points",
            ha="left", va="top" if inside else "bottom", fontsize=7, fontweight="bold", color=colours.PAPER,
            bbox={"boxstyle": "round,pad=0.2", "facecolor": colours.SPAWN_EDGE, "edgecolor": colours.PAPER,
                  "linewidth": 0.8},
            zorder=6.5,
        )  # fmt: skip


def draw_paths(axes: Axes, content: MapContent, width: float, closer: Rectangle | None) -> None:
    """Draw walkers' paths as dashed lines: in several colours, or grey where there are tracks.

    Paths within `closer`, which has a panel of its own, are left out.
    """
    for number, path in enumerate(content.paths):
        if closer is not None and ((path >= closer[::2]) & (path <= closer[1::2])).all():
            continue
        colour = colours.FAINT if content.tracks else colours.PATHS[number % len(colours.PATHS)]
        axes.plot(*path.T, color=colours.PAPER, linewidth=width + 0.9, alpha=0.7, zorder=4.2)
        axes.plot(*path.T, color=colour, linewidth=width, linestyle=(0, (4, 1.6)), zorder=4.3)


def draw_tracks(axes: Axes, tracks: Sequence[Track], width: float, marks: bool) -> None:
    """Draw tracks in the colours of their endings, with its mark at the end; others thin and grey."""
    for each in tracks:
        if each.ending is None:
            axes.plot(*each.points.T, color=colours.FAINT, linewidth=0.5 * width, zorder=4.6)
            continue
        colour, mark = colours.ending_style(each.ending)
        axes.plot(
            *each.points.T, color=colours.PAPER, linewidth=width + 1.2, zorder=5, solid_capstyle="round"
        )
        axes.plot(*each.points.T, color=colour, linewidth=width, zorder=5.1, solid_capstyle="round")
        if marks:
            x, y = each.points[-1]
            axes.plot([x], [y], mark, color=colour, markersize=7, markeredgecolor=colours.PAPER, zorder=5.8)


def draw_episodes(axes: Axes, content: MapContent, per_m: float, joined: bool) -> None:
    """Draw starts with their headings, and goals, labelled by episode; `per_m` is the scale [in/m].

    Where an episode has several robots, letters tell them apart.
    """
    reach = 0.2 / per_m
    labelled = [
        (f"{episode}{string.ascii_lowercase[robot % 26]}" if len(placements) > 1 else f"{episode}", each)
        for episode, placements in content.episodes.items()
        for robot, each in enumerate(placements)
    ]
    for label, each in labelled:
        if joined:
            axes.plot(
                [each.x, each.goal_x], [each.y, each.goal_y], color=colours.INK, linewidth=0.7,
                linestyle=(0, (1, 2)), zorder=5.5,
            )  # fmt: skip
        style = {"fill": False, "linewidth": 0.6, "linestyle": (0, (3, 2)), "zorder": 5.6}
        goal = (each.goal_x, each.goal_y)
        axes.add_patch(Circle(goal, content.goal_distance_m, edgecolor=colours.INK, **style))
        nose = (each.x + reach * np.cos(each.yaw), each.y + reach * np.sin(each.yaw))
        axes.annotate(
            "", nose, (each.x, each.y), zorder=6,
            arrowprops={"arrowstyle": "-|>,head_length=4,head_width=2.6", "color": colours.INK,
                        "mutation_scale": 1, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        ends = (((each.x, each.y), colours.INK, colours.PAPER), (goal, colours.PAPER, colours.INK))
        for (x, y), face, ink in ends:
            axes.plot(
                [x], [y], "o", color=face, markeredgecolor=colours.INK, markersize=10.5, markeredgewidth=1.3,
                zorder=6.2,
            )  # fmt: skip
            axes.annotate(
                label, (x, y), color=ink, fontsize=6.5 if len(label) < 2 else 5.5, fontweight="bold",
                ha="center", va="center_baseline", zorder=6.3,
            )  # fmt: skip
