"""The legend of a map, and its table of statistics."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle as Box

from dune_rl.visualization.site_map import colours, layers
from dune_rl.visualization.site_map.page import PageRectangle, draw_text, page_axes
from dune_rl.visualization.site_map.panel import MapContent
from dune_rl.worlds.world import World

LINE_IN = 0.162

Swatch = Callable[[Axes, float, float], None]
Section = tuple[str, list[tuple[Swatch, str]]]
_WIDE, _HIGH = 0.26, 0.115
# Rows and columns of points of the region that are looked at for what is below objects.
_PASSAGE_CELLS = 200


def slope_legend(max_slope_deg: float) -> Section:
    """Section of the slope classes."""
    edges = layers.slope_edges(max_slope_deg)
    steps = zip(colours.SLOPES, edges, edges[1:], strict=False)
    entries = [(_filled_box(fill), f"{low:g} to {high:g}°") for fill, low, high in steps]
    too_steep = _striped_box(colours.TOO_STEEP, colours.TOO_STEEP_STRIPE)
    return "slope", [*entries, (too_steep, f"over {edges[-1]:g}°, too steep")]


def prop_legend(world: World, footprints: Sequence[layers.PropFootprints], tints: dict[str, str]) -> Section:
    """Section of the kinds of props; `tints` has the colours of obstacles."""
    fills = [
        (colours.DRIVABLE, f"{each.kind}, drivable") if each.drivable else (tints[each.kind], each.kind)
        for each in footprints
    ]
    if layers.water_props(world):
        fills.append((colours.WATER, "water"))
    if layers.vegetation_props(world):
        fills.append(("#b0d0b0", "leaves, no obstacle"))
    if world.grass is not None:
        fills.append(("#cbdf9c", "tall grass"))
    return "objects" if fills else "no objects", [(_filled_box(fill), text) for fill, text in fills]


def episode_legend(content: MapContent) -> Section:
    """Section of starts, goals, paths and tracks, with the number of tracks by ending."""
    spawner, edge = content.spawner, colours.SPAWN_EDGE
    region = partial(_draw_box, fill=False, edgecolor=edge, linewidth=1.5)
    entries: list[tuple[Swatch, str]] = [(region, "region of starts and goals")]
    others = [
        f"{number}"
        for number, each in enumerate(content.world.region_candidates, start=1)
        if each.rectangle != spawner.region
    ]
    if others:
        dashed = partial(_draw_box, fill=False, edgecolor=edge, linewidth=1.2, linestyle=(0, (3, 1.5)))
        entries.append((dashed, f"others to choose: world.region={', '.join(others)}"))
    entries.append((_striped_box("#d9eff4", "#8fcfe0"), "positions they are drawn from"))
    ground = layers.GroundGrid.sample(content.world.terrain, spawner.region, _PASSAGE_CELLS, _PASSAGE_CELLS)
    if layers.spawn_mask_below_props(spawner, content.world, ground).any():
        entries.append((_striped_box(colours.OBSTACLES[0], colours.PASSAGE), "the same, below an object"))
    several = any(len(placements) > 1 for placements in content.episodes.values())
    start, goal = (partial(_draw_disc, face=face) for face in (colours.INK, colours.PAPER))
    entries.append((start, f"start: episode{', robot a, b, ...' if several else ''}"))
    entries.append((goal, "goal, with the radius that counts"))
    if content.paths:
        tints = colours.PATHS if not content.tracks else (colours.FAINT,) * 4
        entries.append((partial(_draw_dashes, tints=tints), "some paths of walkers"))
    ended = [track.ending for track in content.tracks if track.ending is not None]
    if len(ended) < len(content.tracks):
        entries.append((partial(_draw_line, color=colours.FAINT, linewidth=1.0), "tracks of other agents"))
    counts = Counter(ended)
    listed = [ending for ending in colours.ENDINGS if counts[ending]]
    for ending in [*listed, *sorted(ending for ending in counts if ending not in colours.ENDINGS)]:
        track = partial(_draw_track, ending=ending)
        entries.append((track, f"{ending}: {counts[ending]} of {len(ended)}"))
    return "episodes", entries


def _draw_box(page: Axes, x: float, y: float, **style: Any) -> None:
    page.add_patch(Box((x, y), _WIDE, _HIGH, **style))


def _filled_box(colour: str) -> Swatch:
    return partial(_draw_box, facecolor=colour, edgecolor=colours.INK, linewidth=0.5)


def _striped_box(colour: str, stripe: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        _filled_box(colour)(page, x, y)
        for start in np.arange(0.02, _WIDE - _HIGH, 0.06).tolist():
            page.plot(
                [x + start, x + start + _HIGH], [y + _HIGH * 0.96, y + _HIGH * 0.04], color=stripe,
                linewidth=1.6, solid_capstyle="butt",
            )  # fmt: skip
        _draw_box(page, x, y, fill=False, edgecolor=colours.INK, linewidth=0.5, zorder=4)

    return draw


def _draw_disc(page: Axes, x: float, y: float, face: str) -> None:
    centre, ink = (x + _WIDE / 2, y + _HIGH / 2), colours.PAPER if face == colours.INK else colours.INK
    page.plot(*centre, "o", color=face, markeredgecolor=colours.INK, markersize=9, markeredgewidth=1.2)
    page.text(*centre, "0", fontsize=6, fontweight="bold", color=ink, ha="center", va="center_baseline")


def _draw_line(page: Axes, x: float, y: float, **style: Any) -> None:
    page.plot([x, x + _WIDE], [y + _HIGH / 2] * 2, **style)


def _draw_dashes(page: Axes, x: float, y: float, tints: Sequence[str]) -> None:
    width = _WIDE / len(tints)
    for number, colour in enumerate(tints):
        ends = [x + number * width, x + (number + 0.75) * width]
        page.plot(ends, [y + _HIGH / 2] * 2, color=colour, linewidth=1.4, solid_capstyle="butt")


def _draw_track(page: Axes, x: float, y: float, ending: str) -> None:
    colour, mark = colours.ending_style(ending)
    _draw_line(page, x, y, color=colour, linewidth=1.9, solid_capstyle="butt")
    page.plot([x + _WIDE], [y + _HIGH / 2], mark, color=colour, markersize=6.5, markeredgecolor=colours.PAPER)


def draw_sections(figure: Figure, columns: Sequence[Sequence[Section]], place: PageRectangle) -> float:
    """Draw columns of legend sections from the top of `place`, with less spacing if they do not fit.

    Returns the position of the lower end on the page [in].
    """
    page = page_axes(figure)
    longest = max(sum(len(entries) + 1.5 for _, entries in sections) for sections in columns) - 0.5
    line = min(LINE_IN, place.height / longest)
    share = place.width / len(columns)
    for column, sections in enumerate(columns):
        x, y = place.left + column * share, place.top
        for heading, entries in sections:
            y -= line
            draw_text(figure, x, y, heading, 7.5, weight="bold")
            for swatch, text in entries:
                y -= line
                swatch(page, x, y - 0.015)
                draw_text(figure, x + _WIDE + 0.1, y, text, 7.2)
            y -= line / 2
    return place.top - longest * line


def draw_table(figure: Figure, content: MapContent, left: float, top: float) -> None:
    """Draw the statistics of the world and of the region, the first line below `top` [in]."""
    free = content.spawner.free_space
    columns = [
        layers.site_statistics(content.world, free, each, content.max_slope_deg)
        for each in (content.world.extent, content.spawner.region)
    ]
    rights = (left + 2.75, left + 3.6)
    y = top - LINE_IN
    draw_text(figure, left, y, "statistics", 7.5, weight="bold")
    for right, name in zip(rights, ("world", "region"), strict=True):
        draw_text(figure, right, y, name, 7.5, weight="bold", ha="right")
    page = page_axes(figure)
    page.plot([left, rights[-1]], [y - 0.05] * 2, color=colours.FAINT, linewidth=0.6)
    for row, (name, show) in enumerate(STATISTICS_ROWS, start=1):
        line = y - row * LINE_IN - 0.02
        draw_text(figure, left, line, name, 7.2)
        for right, each in zip(rights, columns, strict=True):
            draw_text(figure, right, line, show(each), 7.2, ha="right")


def _side(metres: float) -> str:
    return f"{metres:.1f}".removesuffix(".0")


STATISTICS_ROWS: tuple[tuple[str, Callable[[layers.SiteStatistics], str]], ...] = (
    ("size", lambda f: f"{_side(f.width_m)} by {_side(f.depth_m)} m"),
    ("relief", lambda f: f"{f.relief_m:.2f} m"),
    ("slope, median", lambda f: f"{f.median_slope_deg:.1f}°"),
    ("slope, 90 % below", lambda f: f"{f.steepest_tenth_deg:.1f}°"),
    ("too steep", lambda f: f"{f.too_steep:.1%}"),
    ("under obstacles", lambda f: f"{f.obstructed:.1%}"),
    ("free for the robot", lambda f: f"{f.traversable:.1%}"),
)
