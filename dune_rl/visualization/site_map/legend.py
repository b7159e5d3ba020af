"""What stands beside a map: its legend, and figures of the site."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle as Box

from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.layers import Figures, figures, greenery, slope_edges, water
from dune_rl.visualization.site_map.page import Place, page_axes, write
from dune_rl.visualization.site_map.panel import Site

LINE_IN = 0.162

Swatch = Callable[[Axes, float, float], None]
Section = tuple[str, list[tuple[Swatch, str]]]
_WIDE, _HIGH = 0.26, 0.115


def slope_legend(site: Site) -> Section:
    """Classes of slopes."""
    edges = slope_edges(site.max_slope_deg)
    steps = zip(colours.SLOPES, edges, edges[1:], strict=False)
    entries = [(_filled(fill), f"{low:g} to {high:g}°") for fill, low, high in steps]
    too_steep = _striped(colours.TOO_STEEP, colours.TOO_STEEP_STRIPE)
    return "slope", [*entries, (too_steep, f"over {edges[-1]:g}°, too steep")]


def thing_legend(site: Site, tints: dict[str, str]) -> Section:
    """Kinds of things, each obstacle in its of the `tints`."""
    entries: list[tuple[Swatch, str]] = []
    for each in site.things:
        fill = colours.DRIVABLE if each.drivable else tints[each.kind]
        entries.append((_filled(fill), f"{each.kind}, driven on" if each.drivable else each.kind))
    if water(site.world):
        entries.append((_filled(colours.WATER), "water"))
    if greenery(site.world):
        entries.append((_filled("#b0d0b0"), "leaves, no obstacle"))
    if site.world.grass is not None:
        entries.append((_filled("#cbdf9c"), "tall grass"))
    return "things" if entries else "no things", entries


def episode_legend(site: Site) -> Section:
    """Where episodes start and end, and how those driven ended."""
    entries = [
        (_outlined(colours.SPAWN_EDGE), "region of starts and goals"),
        (_striped("#d9eff4", "#8fcfe0"), "where in it they lie"),
        (_numbered(colours.INK, colours.PAPER), "start, with the episode's number"),
        (_numbered(colours.PAPER, colours.INK), "its goal, and how near is there"),
    ]
    if site.paths:
        many = colours.PATHS if not site.drives else (colours.FAINT,)
        entries.append((_dashed(many), "actors' paths, some of them"))
    counts = Counter(drive.ending for drive in site.drives)
    for ending, (colour, mark) in colours.ENDINGS.items():
        if counts[ending]:
            entries.append((_track(colour, mark), f"{ending}: {counts[ending]} of {len(site.drives)}"))
    return "episodes", entries


def _filled(colour: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        page.add_patch(Box((x, y), _WIDE, _HIGH, facecolor=colour, edgecolor=colours.INK, linewidth=0.5))

    return draw


def _striped(colour: str, stripe: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        _filled(colour)(page, x, y)
        for start in np.arange(0.02, _WIDE - _HIGH, 0.06).tolist():
            page.plot(
                [x + start, x + start + _HIGH], [y + _HIGH * 0.96, y + _HIGH * 0.04], color=stripe,
                linewidth=1.6, solid_capstyle="butt",
            )  # fmt: skip
        page.add_patch(Box((x, y), _WIDE, _HIGH, fill=False, edgecolor=colours.INK, linewidth=0.5, zorder=4))

    return draw


def _outlined(colour: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        page.add_patch(Box((x, y), _WIDE, _HIGH, fill=False, edgecolor=colour, linewidth=1.5))

    return draw


def _numbered(face: str, ink: str) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        centre = (x + _WIDE / 2, y + _HIGH / 2)
        page.plot(*centre, "o", color=face, markeredgecolor=colours.INK, markersize=9, markeredgewidth=1.2)
        page.text(*centre, "0", fontsize=6, fontweight="bold", color=ink, ha="center", va="center_baseline")

    return draw


def _dashed(many: Sequence[str]) -> Swatch:
    def draw(page: Axes, x: float, y: float) -> None:
        pieces = list(many) if len(many) > 1 else 4 * list(many)
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


def draw_sections(figure: Figure, columns: Sequence[Sequence[Section]], place: Place) -> float:
    """Columns of sections of a legend from the top of `place`, closer where it is too low for them.

    Gives the height on the page [in] that is left below.
    """
    page = page_axes(figure)
    longest = max(sum(len(entries) + 1.5 for _, entries in sections) for sections in columns) - 0.5
    line = min(LINE_IN, place.height / longest)
    share = place.width / len(columns)
    for column, sections in enumerate(columns):
        x, y = place.left + column * share, place.top
        for heading, entries in sections:
            y -= line
            write(figure, x, y, heading, 7.5, weight="bold")
            for swatch, text in entries:
                y -= line
                swatch(page, x, y - 0.015)
                write(figure, x + _WIDE + 0.1, y, text, 7.2)
            y -= line / 2
    return place.top - longest * line


def draw_table(figure: Figure, site: Site, left: float, top: float) -> None:
    """Figures of the world and of the region, the first line below `top`."""
    free = site.spawner.free_space
    columns = [
        figures(site.world, free, each, site.max_slope_deg)
        for each in (site.world.extent, site.spawner.region)
    ]
    rights = (left + 2.75, left + 3.6)
    y = top - LINE_IN
    write(figure, left, y, "figures", 7.5, weight="bold")
    for right, name in zip(rights, ("world", "region"), strict=True):
        write(figure, right, y, name, 7.5, weight="bold", ha="right")
    page = page_axes(figure)
    page.plot([left, rights[-1]], [y - 0.05] * 2, color=colours.FAINT, linewidth=0.6)
    for row, (name, show) in enumerate(ROWS, start=1):
        line = y - row * LINE_IN - 0.02
        write(figure, left, line, name, 7.2)
        for right, each in zip(rights, columns, strict=True):
            write(figure, right, line, show(each), 7.2, ha="right")


ROWS: tuple[tuple[str, Callable[[Figures], str]], ...] = (
    ("size", lambda f: f"{f.width_m:.4g} by {f.depth_m:.4g} m"),
    ("relief", lambda f: f"{f.relief_m:.2f} m"),
    ("slope, median", lambda f: f"{f.median_slope_deg:.1f}°"),
    ("slope, 90 % below", lambda f: f"{f.steepest_tenth_deg:.1f}°"),
    ("too steep", lambda f: f"{f.too_steep:.1%}"),
    ("under obstacles", lambda f: f"{f.obstructed:.1%}"),
    ("free for the rover", lambda f: f"{f.traversable:.1%}"),
)
