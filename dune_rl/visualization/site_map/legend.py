"""The legend of a map, and its table of statistics."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle as Box

from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.layers import (
    GroundGrid,
    PropFootprints,
    SiteStatistics,
    site_statistics,
    slope_edges,
    spawn_mask_below_props,
    vegetation_props,
    water_props,
)
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
    edges = slope_edges(max_slope_deg)
    steps = zip(colours.SLOPES, edges, edges[1:], strict=False)
    entries = [(_filled_box(fill), f"{low:g} to {high:g}°") for fill, low, high in steps]
    too_steep = _striped_box(colours.TOO_STEEP, colours.TOO_STEEP_STRIPE)
    return "slope", [*entries, (too_steep, f"over {edges[-1]:g}°, too steep")]


def prop_legend(world: World, footprints: Sequence[PropFootprints], tints: dict[str, str]) -> Section:
    """Section of the kinds of props; `tints` has the colours of obstacles."""
    entries: list[tuple[Swatch, str]] = []
    for each in footprints:
        fill = colours.DRIVABLE if each.drivable else tints[each.kind]
        entries.append((_filled_box(fill), f"{each.kind}, drivable" if each.drivable else each.kind))
    if water_props(world):
        entries.append((_filled_box(colours.WATER), "water"))
    if vegetation_props(world):
        entries.append((_filled_box("#b0d0b0"), "leaves, no obstacle"))
    if world.grass is not None:
        entries.append((_filled_box("#cbdf9c"), "tall grass"))
    return "objects" if entries else "no objects", entries


def episode_legend(content: MapContent) -> Section:
    """Section of starts, goals, paths and tracks, with the number of tracks by ending."""
    several = any(len(placements) > 1 for placements in content.episodes.values())
    entries: list[tuple[Swatch, str]] = [
        (_box(fill=False, edgecolor=colours.SPAWN_EDGE, linewidth=1.5), "region of starts and goals"),
        *_candidate_entries(content),
        (_striped_box("#d9eff4", "#8fcfe0"), "positions they are drawn from"),
        *_passage_entries(content),
        (
            _numbered_disc(colours.INK, colours.PAPER),
            f"start: episode{', robot a, b, ...' if several else ''}",
        ),
        (_numbered_disc(colours.PAPER, colours.INK), "goal, with the radius that counts"),
    ]
    if content.paths:
        tints = colours.PATHS if not content.tracks else (colours.FAINT,)
        entries.append((_dashed_line(tints), "some paths of walkers"))
    ended = [track.ending for track in content.tracks if track.ending is not None]
    if len(ended) < len(content.tracks):
        entries.append((_plain_line(colours.FAINT), "tracks of other agents"))
    counts = Counter(ended)
    listed = [ending for ending in colours.ENDINGS if counts[ending]]
    for ending in [*listed, *sorted(ending for ending in counts if ending not in colours.ENDINGS)]:
        entries.append((_track(*colours.ending_style(ending)), f"{ending}: {counts[ending]} of {len(ended)}"))
    return "episodes", entries


def _passage_entries(content: MapContent) -> list[tuple[Swatch, str]]:
    """An entry of the positions below objects, if there are any."""
    spawner = content.spawner
    ground = GroundGrid.sample(content.world.terrain, spawner.region, _PASSAGE_CELLS, _PASSAGE_CELLS)
    if not spawn_mask_below_props(spawner, content.world, ground).any():
        return []
    return [(_striped_box(colours.OBSTACLES[0], colours.PASSAGE), "the same, below an object")]


def _candidate_entries(content: MapContent) -> list[tuple[Swatch, str]]:
    """An entry of the regions that could be chosen instead, if there are any."""
    others = [
        f"{number}"
        for number, each in enumerate(content.world.region_candidates, start=1)
        if each.rectangle != content.spawner.region
    ]
    if not others:
        return []
    dashed = _box(fill=False, edgecolor=colours.SPAWN_EDGE, linewidth=1.2, linestyle=(0, (3, 1.5)))
    return [(dashed, f"others to choose: world.region={', '.join(others)}")]


def _box(**style: Any) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        page.add_patch(Box((x, y), _WIDE, _HIGH, **style))

    return draw


def _filled_box(colour: str) -> Swatch:
    return _box(facecolor=colour, edgecolor=colours.INK, linewidth=0.5)


def _striped_box(colour: str, stripe: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        _filled_box(colour)(page, x, y)
        for start in np.arange(0.02, _WIDE - _HIGH, 0.06).tolist():
            page.plot(
                [x + start, x + start + _HIGH], [y + _HIGH * 0.96, y + _HIGH * 0.04], color=stripe,
                linewidth=1.6, solid_capstyle="butt",
            )  # fmt: skip
        page.add_patch(Box((x, y), _WIDE, _HIGH, fill=False, edgecolor=colours.INK, linewidth=0.5, zorder=4))

    return draw


def _numbered_disc(face: str, ink: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        centre = (x + _WIDE / 2, y + _HIGH / 2)
        page.plot(*centre, "o", color=face, markeredgecolor=colours.INK, markersize=9, markeredgewidth=1.2)
        page.text(*centre, "0", fontsize=6, fontweight="bold", color=ink, ha="center", va="center_baseline")

    return draw


def _plain_line(colour: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        page.plot([x, x + _WIDE], [y + _HIGH / 2] * 2, color=colour, linewidth=1.0)

    return draw


def _dashed_line(tints: Sequence[str]) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        pieces = list(tints) if len(tints) > 1 else 4 * list(tints)
        width = _WIDE / len(pieces)
        for number, colour in enumerate(pieces):
            ends = [x + number * width, x + (number + 0.75) * width]
            page.plot(ends, [y + _HIGH / 2] * 2, color=colour, linewidth=1.4, solid_capstyle="butt")

    return draw


def _track(colour: str, mark: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        page.plot([x, x + _WIDE], [y + _HIGH / 2] * 2, color=colour, linewidth=1.9, solid_capstyle="butt")
        page.plot(
            [x + _WIDE], [y + _HIGH / 2], mark, color=colour, markersize=6.5, markeredgecolor=colours.PAPER
        )

    return draw


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
        site_statistics(content.world, free, each, content.max_slope_deg)
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


STATISTICS_ROWS: tuple[tuple[str, Callable[[SiteStatistics], str]], ...] = (
    ("size", lambda f: f"{_side(f.width_m)} by {_side(f.depth_m)} m"),
    ("relief", lambda f: f"{f.relief_m:.2f} m"),
    ("slope, median", lambda f: f"{f.median_slope_deg:.1f}°"),
    ("slope, 90 % below", lambda f: f"{f.steepest_tenth_deg:.1f}°"),
    ("too steep", lambda f: f"{f.too_steep:.1%}"),
    ("under obstacles", lambda f: f"{f.obstructed:.1%}"),
    ("free for the robot", lambda f: f"{f.traversable:.1%}"),
)
