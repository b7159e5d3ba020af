"""One panel of a map: a rectangle of a site from above."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle
from matplotlib.patches import Rectangle as Box
from matplotlib.path import Path
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from dune_rl.tasks.spawn import Placement, Spawner
from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.layers import (
    SLOPE_CLASSES,
    Ground,
    Things,
    at_points,
    contour_levels,
    greenery,
    over_ground,
    slope_class,
    spawn_mask,
    water,
)
from dune_rl.worlds.world import Rectangle, World

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_STRIPE_IN = 0.028
_CONTOUR_COLUMNS = 320
_SHORTEST_CONTOUR_IN = 0.35


@dataclass(frozen=True, eq=False)
class Drive:
    """An episode that was driven: its `track` (T, 2) [m], and in words how it ended."""

    episode: int
    track: Array
    ending: str


@dataclass(frozen=True, eq=False)
class Site:
    """What a map is of: `episodes` are starts and goals by number, `paths` (P, 2) [m] the actors'.

    Slopes over `max_slope_deg` are too steep, and within `goal_distance_m` a goal is reached.
    """

    world: World
    spawner: Spawner
    max_slope_deg: float
    goal_distance_m: float
    things: Sequence[Things]
    paths: Sequence[Array] = ()
    episodes: dict[int, Placement] = field(default_factory=dict)
    drives: Sequence[Drive] = ()


def ground_picture(site: Site, ground: Ground, stripe_px: float) -> Array:
    """The ground's colours (rows, columns, 3) in sRGB: slope, light, where episodes start, plants, water."""
    palette = np.array([colours.rgb(c) for c in (*colours.SLOPES, colours.TOO_STEEP)])
    classes = slope_class(ground.slope, site.max_slope_deg)
    picture = palette[classes]
    rows, columns = classes.shape
    across, up = np.arange(columns), np.arange(rows)[:, None]
    picture[(classes == SLOPE_CLASSES) & _stripes(across + up, stripe_px)] = colours.rgb(
        colours.TOO_STEEP_STRIPE
    )
    free = site.spawner.free_space
    chosen = at_points(free, spawn_mask(site.spawner), ground.points)
    _blend(picture, chosen, colours.SPAWN, 0.16)
    _blend(picture, chosen & _stripes(across - up, 1.6 * stripe_px), colours.SPAWN, 0.30)
    if site.world.grass is not None:
        _blend(picture, grass_at(site.world, ground), colours.GRASS, 0.5)
    # Towards black and white, which leaves the colours' hues as they are in the legend.
    light = np.clip(ground.shade, 0.0, 1.5)[..., None]
    picture *= 1.0 - 0.55 * np.maximum(1.0 - light, 0.0)
    picture += 0.8 * np.maximum(light - 1.0, 0.0) * (1.0 - picture)
    _blend(picture, over_ground(water(site.world), ground), colours.WATER, 0.92)
    _blend(picture, over_ground(greenery(site.world), ground), colours.GREENERY, 0.38)
    return picture


def passage_picture(site: Site, ground: Ground, stripe_px: float) -> Array:
    """Stripes (rows, columns, 4), sRGB and opacity, where episodes start under things: a solar array, say."""
    chosen = at_points(site.spawner.free_space, spawn_mask(site.spawner), ground.points)
    hidden = over_ground([prop for prop in site.world.props if prop.solid], ground)
    rows, columns = chosen.shape
    across, up = np.arange(columns), np.arange(rows)[:, None]
    picture = np.zeros((rows, columns, 4))
    picture[..., :3] = colours.rgb(colours.PASSAGE)
    picture[..., 3] = 0.75 * (chosen & hidden & _stripes(across - up, 1.6 * stripe_px))
    return picture


def grass_at(world: World, ground: Ground) -> Flags:
    """Where tall grass grows, (rows, columns)."""
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


def draw_ground(axes: Axes, site: Site, rectangle: Rectangle, size_in: tuple[float, float], dpi: int) -> None:
    """Relief, slopes, contours, plants and water of `rectangle`, one cell a pixel."""
    columns, rows = (max(2, round(side * dpi)) for side in size_in)
    ground = Ground.of(site.world.terrain, rectangle, columns, rows)
    picture = ground_picture(site, ground, _STRIPE_IN * dpi)
    under = passage_picture(site, ground, _STRIPE_IN * dpi)
    for layer, order in ((picture, 0.0), (under, 3.0)):
        axes.imshow(layer, extent=rectangle, origin="lower", interpolation="nearest", zorder=order)
    axes.set_xlim(rectangle[:2])
    axes.set_ylim(rectangle[2:])
    _contours(axes, site.world, rectangle, size_in)


def _contours(axes: Axes, world: World, rectangle: Rectangle, size_in: tuple[float, float]) -> None:
    columns = _CONTOUR_COLUMNS
    rows = max(2, round(columns * size_in[1] / size_in[0]))
    ground = Ground.of(world.terrain, rectangle, columns, rows)
    # As wide as a line: what is smaller cannot be drawn.
    height = gaussian_filter(ground.height, 1.5, mode="nearest")
    levels = contour_levels(height)
    if not len(levels):
        return
    lines = axes.contour(
        ground.x,
        ground.y,
        height,
        levels,
        colors=colours.CONTOUR,
        linewidths=0.45,
        zorder=1,
        negative_linestyles="solid",
    )
    per_m = size_in[0] / (rectangle[1] - rectangle[0])
    kept = [_without_specks(path, _SHORTEST_CONTOUR_IN / per_m) for path in lines.get_paths()]
    lines.set_paths(kept)
    labelled = [level for level, path in zip(levels, kept, strict=True) if np.size(path.vertices)]
    for text in axes.clabel(lines, labelled, fontsize=5.5, fmt=_metres, inline=True, inline_spacing=2):
        text.set_path_effects([patheffects.withStroke(linewidth=1.4, foreground="#ffffffb0")])
        text.set_zorder(1.5)


def _without_specks(path: Path, shortest_m: float) -> Path:
    lines = path.to_polygons(closed_only=False)
    kept = [Path(line) for line in lines if np.hypot(*np.diff(line, axis=0).T).sum() >= shortest_m]
    return Path.make_compound_path(*kept) if kept else Path(np.zeros((0, 2)))


def _metres(value: float) -> str:
    return f"{value + 0.0:.2f}".rstrip("0").rstrip(".").replace("-", "\N{MINUS SIGN}")


def draw_things(axes: Axes, found: Sequence[Things], tints: dict[str, str]) -> None:
    """Things from above, each kind in its colour with an outline round all of it."""
    for number, each in enumerate(found):
        fill = colours.DRIVABLE if each.drivable else tints[each.kind]
        edge = colours.DRIVABLE_EDGE if each.drivable else colours.INK
        # First the edges of every triangle, then what lies between them: the outline is left.
        for colour, width, order in ((edge, 0.9, 0.0), (fill, 0.1, 0.01)):
            axes.add_collection(
                PolyCollection(
                    list(each.triangles),
                    facecolors=colour,
                    edgecolors=colour,
                    linewidths=width,
                    zorder=2 + 0.02 * number + order,
                ),
                autolim=False,
            )


def draw_region(axes: Axes, region: Rectangle, width: float) -> None:
    """The outline of the rectangle in which starts and goals lie."""
    xmin, xmax, ymin, ymax = region
    for colour, line in ((colours.PAPER, width + 1.4), (colours.SPAWN_EDGE, width)):
        axes.add_patch(
            Box(
                (xmin, ymin), xmax - xmin, ymax - ymin, fill=False, edgecolor=colour, linewidth=line, zorder=4
            )
        )


def draw_paths(axes: Axes, site: Site, width: float, closer: Rectangle | None) -> None:
    """The actors' paths, dashed: in several colours, or grey under the tracks of a policy.

    Those that lie within `closer` are left out, where there is such a panel.
    """
    for number, path in enumerate(site.paths):
        if closer is not None and within(path, closer):
            continue
        colour = colours.FAINT if site.drives else colours.PATHS[number % len(colours.PATHS)]
        axes.plot(*path.T, color=colours.PAPER, linewidth=width + 0.9, alpha=0.7, zorder=4.2)
        axes.plot(*path.T, color=colour, linewidth=width, linestyle=(0, (4, 1.6)), zorder=4.3)


def within(points: Array, rectangle: Rectangle) -> bool:
    """Whether all `points` (P, 2) lie in the rectangle (xmin, xmax, ymin, ymax)."""
    limits = np.array(rectangle).reshape(2, 2)
    return bool(((points >= limits[:, 0]) & (points <= limits[:, 1])).all())


def draw_drives(axes: Axes, drives: Sequence[Drive], width: float, marks: bool) -> None:
    """The tracks driven, in the colour of how they ended, and its mark at their ends."""
    for each in drives:
        colour, mark = colours.ENDINGS[each.ending]
        axes.plot(*each.track.T, color=colours.PAPER, linewidth=width + 1.2, zorder=5, solid_capstyle="round")
        axes.plot(*each.track.T, color=colour, linewidth=width, zorder=5.1, solid_capstyle="round")
        if marks:
            x, y = each.track[-1]
            axes.plot([x], [y], mark, color=colour, markersize=7, markeredgecolor=colours.PAPER, zorder=5.8)


def draw_episodes(axes: Axes, site: Site, per_m: float, joined: bool) -> None:
    """Numbered starts, with the way they face, and goals; `per_m` is the scale [in/m]."""
    reach = 0.2 / per_m
    for number, each in site.episodes.items():
        if joined:
            axes.plot(
                [each.x, each.goal_x], [each.y, each.goal_y], color=colours.INK, linewidth=0.7,
                linestyle=(0, (1, 2)), zorder=5.5,
            )  # fmt: skip
        axes.add_patch(
            Circle((each.goal_x, each.goal_y), site.goal_distance_m, fill=False, edgecolor=colours.INK,
                   linewidth=0.6, linestyle=(0, (3, 2)), zorder=5.6)
        )  # fmt: skip
        nose = (each.x + reach * np.cos(each.yaw), each.y + reach * np.sin(each.yaw))
        axes.annotate(
            "", nose, (each.x, each.y), zorder=6,
            arrowprops={"arrowstyle": "-|>,head_length=4,head_width=2.6", "color": colours.INK,
                        "mutation_scale": 1, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        for (x, y), face, ink in (
            ((each.x, each.y), colours.INK, colours.PAPER),
            ((each.goal_x, each.goal_y), colours.PAPER, colours.INK),
        ):
            axes.plot(
                [x],
                [y],
                "o",
                color=face,
                markeredgecolor=colours.INK,
                markersize=10.5,
                markeredgewidth=1.3,
                zorder=6.2,
            )
            axes.annotate(
                str(number), (x, y), color=ink, fontsize=6.5 if number < 10 else 5.5, fontweight="bold",
                ha="center", va="center_baseline", zorder=6.3,
            )  # fmt: skip
