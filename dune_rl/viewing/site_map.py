"""Maps: a site from above, with slopes, obstacles, starts and goals, actors' paths and driven tracks."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle as Box

from dune_rl.viewing import site_colours as colours
from dune_rl.viewing.site_layers import (
    Figures,
    figures,
    greenery,
    slope_edges,
    water,
)
from dune_rl.viewing.site_panel import (
    Site,
    draw_drives,
    draw_episodes,
    draw_ground,
    draw_paths,
    draw_region,
    draw_things,
)
from dune_rl.worlds.world import Rectangle

WIDTH_IN, HEIGHT_IN = 13.0, 8.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.62, 12.85, 6.98, 0.52
_GAP, _BELOW_AXES = 0.74, 0.62
# From this proportion on the legend stands below the site, not beside it.
_WIDE_SHAPE = 1.45
_CLOSER_IN = 3.2
# A region of less than this share of the world has a panel of its own.
_LARGE_SHARE = 0.3
_LINE_IN = 0.162
_SCALES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
_LONGEST_TEXT = 190


@dataclass(frozen=True)
class _Place:
    """A rectangle on the page [in], from its lower left corner."""

    left: float
    bottom: float
    width: float
    height: float

    @property
    def top(self) -> float:
        return self.bottom + self.height


def site_map(site: Site, title: str, settings: str, dpi: int) -> Figure:
    """A page of 12 by 8 in: the site, its starts and goals larger where they are but a part of it, a legend.

    The ground is drawn for `dpi`; save the figure with that.
    """
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=colours.PAPER)
    _text(figure, _LEFT, 7.62, title, 17, weight="bold")
    _text(figure, _LEFT, 7.38, _shortened(settings), 7.5, colour=colours.FAINT)
    extent, region = site.world.extent, site.spawner.region
    wide = (extent[1] - extent[0]) / (extent[3] - extent[2]) > _WIDE_SHAPE
    whole = _fitted(extent, _Place(_LEFT, _BOTTOM, 7.7 if wide else 6.6, _TOP - _BOTTOM))
    closer = _closer(site) if _area(region) < _LARGE_SHARE * _area(extent) else None
    tints = _tints(site)
    _panel(figure, site, extent, whole, tints, dpi, "the site", closer)
    left = whole.left + whole.width + _GAP
    below = _TOP
    slopes, found, episodes = _slope_legend(site), _thing_legend(site, tints), _episode_legend(site)
    beside: list[Section] = []
    if closer is not None:
        side = min(_CLOSER_IN if not wide else 4.2, _RIGHT - left)
        place = _fitted(closer, _Place(left, _TOP - side, side, side))
        _panel(figure, site, closer, place, tints, dpi, "starts and goals", None)
        below = place.bottom - _BELOW_AXES
        if not wide:
            right = place.left + place.width + 0.22
            _sections(figure, [slopes], _Place(right, place.bottom, _RIGHT - right, place.height))
    elif not wide:
        beside = [slopes]
    table = _Place(left, 0.16, _RIGHT - left, (len(_ROWS) + 1.5) * _LINE_IN)
    if wide:
        legend = _Place(_LEFT, 0.15, whole.width, whole.bottom - _BELOW_AXES - 0.15)
        _sections(figure, [slopes, found, episodes], legend)
        _table(figure, site, left, below)
        return figure
    legend = _Place(left, table.top + 0.08, _RIGHT - left, below - table.top - 0.08)
    _sections(figure, [*beside, found, episodes], legend)
    _table(figure, site, left, table.top)
    return figure


def _area(rectangle: Rectangle) -> float:
    return (rectangle[1] - rectangle[0]) * (rectangle[3] - rectangle[2])


def _fitted(rectangle: Rectangle, room: _Place) -> _Place:
    """The largest place of the rectangle's proportions at the top left of `room`."""
    width, height = rectangle[1] - rectangle[0], rectangle[3] - rectangle[2]
    scale = min(room.width / width, room.height / height)
    return _Place(room.left, room.top - scale * height, scale * width, scale * height)


def _closer(site: Site) -> Rectangle:
    """The region with some room round it, and all that was driven."""
    xmin, xmax, ymin, ymax = site.spawner.region
    margin = 0.07 * max(xmax - xmin, ymax - ymin)
    low, high = np.array([xmin, ymin]) - margin, np.array([xmax, ymax]) + margin
    for drive in site.drives:
        low = np.minimum(low, drive.track.min(axis=0) - margin / 2)
        high = np.maximum(high, drive.track.max(axis=0) + margin / 2)
    # No narrower than square, so that the panels' places are as good as the same for all worlds.
    centre, half = (low + high) / 2, np.max(high - low) / 2
    extent = np.array(site.world.extent).reshape(2, 2)
    low, high = np.maximum(centre - half, extent[:, 0]), np.minimum(centre + half, extent[:, 1])
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _tints(site: Site) -> dict[str, str]:
    """A colour for each kind of obstacle."""
    kinds = [each.kind for each in site.things if not each.drivable]
    return dict(zip(kinds, colours.OBSTACLES, strict=False))


def _panel(
    figure: Figure,
    site: Site,
    rectangle: Rectangle,
    place: _Place,
    tints: dict[str, str],
    dpi: int,
    caption: str,
    closer: Rectangle | None,
) -> None:
    axes = _axes(figure, place)
    per_m = place.width / (rectangle[1] - rectangle[0])
    detail = closer is None
    draw_ground(axes, site, rectangle, (place.width, place.height), dpi)
    draw_things(axes, site.things, tints)
    draw_region(axes, site.spawner.region, 1.5)
    draw_paths(axes, site, 1.3, closer)
    draw_drives(axes, site.drives, 2.0 if detail else 1.0, marks=detail)
    if detail:
        draw_episodes(axes, site, per_m, joined=not site.drives)
    _frame(axes)
    _text(figure, place.left, place.top + 0.1, caption, 9, weight="bold")
    _scale_bar(figure, place, per_m)
    if rectangle == site.world.extent:
        _arrows(figure, place)


def _axes(figure: Figure, place: _Place) -> Axes:
    return figure.add_axes(
        (place.left / WIDTH_IN, place.bottom / HEIGHT_IN, place.width / WIDTH_IN, place.height / HEIGHT_IN)
    )


def _frame(axes: Axes) -> None:
    axes.set_xlabel("x [m], east", fontsize=7.5, color=colours.INK, labelpad=2)
    axes.set_ylabel("y [m], north", fontsize=7.5, color=colours.INK, labelpad=2)
    axes.tick_params(labelsize=7, colors=colours.INK, length=3, width=0.6)
    for spine in axes.spines.values():
        spine.set_color(colours.INK)
        spine.set_linewidth(0.8)
        spine.set_zorder(9)


def _page(figure: Figure) -> Axes:
    """Axes over the whole page, in inches."""
    for axes in figure.axes:
        if axes.get_label() == "page":
            return axes
    axes = figure.add_axes((0, 0, 1, 1), label="page", zorder=-1)
    axes.set_xlim(0, WIDTH_IN)
    axes.set_ylim(0, HEIGHT_IN)
    axes.set_axis_off()
    return axes


def _text(
    figure: Figure, x: float, y: float, text: str, size: float, *, weight: str = "normal",
    colour: str = colours.INK, ha: str = "left",
) -> None:  # fmt: skip
    _page(figure).text(x, y, text, fontsize=size, fontweight=weight, color=colour, ha=ha, va="baseline")


def _scale_bar(figure: Figure, place: _Place, per_m: float) -> None:
    longest = 0.24 * place.width / per_m
    length = max((scale for scale in _SCALES_M if scale <= longest), default=_SCALES_M[0])
    right, y = place.left + place.width - 0.62, place.top + 0.13
    left = right - length * per_m
    page = _page(figure)
    half = (right - left) / 2
    page.add_patch(
        Box((left, y - 0.025), half, 0.05, facecolor=colours.INK, edgecolor=colours.INK, linewidth=0.6)
    )
    page.add_patch(
        Box(
            (left + half, y - 0.025),
            half,
            0.05,
            facecolor=colours.PAPER,
            edgecolor=colours.INK,
            linewidth=0.6,
        )
    )
    _text(figure, right + 0.06, y - 0.045, f"{length:g} m", 7.5)


def _arrows(figure: Figure, place: _Place) -> None:
    page = _page(figure)
    x, y = place.left + 0.42 * place.width, place.top + 0.07
    for dx, dy, name, at in ((0.3, 0.0, "x", (0.36, -0.035)), (0.0, 0.3, "y, N", (-0.05, 0.33))):
        page.annotate(
            "", (x + dx, y + dy), (x, y),
            arrowprops={"arrowstyle": "-|>,head_length=4,head_width=2", "color": colours.INK,
                        "mutation_scale": 1, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        _text(figure, x + at[0], y + at[1], name, 7)


# -- legend -------------------------------------------------------------------------------------------

Swatch = Callable[[Axes, float, float], None]
Section = tuple[str, list[tuple[Swatch, str]]]
_WIDE, _HIGH = 0.26, 0.115


def _slope_legend(site: Site) -> Section:
    edges = slope_edges(site.max_slope_deg)
    steps = zip(colours.SLOPES, edges, edges[1:], strict=False)
    entries = [(_filled(fill), f"{low:g} to {high:g}°") for fill, low, high in steps]
    too_steep = _striped(colours.TOO_STEEP, colours.TOO_STEEP_STRIPE)
    return "slope", [*entries, (too_steep, f"over {edges[-1]:g}°, too steep")]


def _thing_legend(site: Site, tints: dict[str, str]) -> Section:
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


def _episode_legend(site: Site) -> Section:
    entries = [
        (_outlined(colours.SPAWN_EDGE), "region of starts and goals"),
        (_striped("#d9eff4", "#8fcfe0"), "where in it they lie"),
        (_numbered(colours.INK, colours.PAPER), "start, with the episode's number"),
        (_numbered(colours.PAPER, colours.INK), "its goal"),
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
        width = _WIDE / len(many)
        for number, colour in enumerate(many):
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


def _sections(figure: Figure, sections: Sequence[Section], place: _Place) -> None:
    """Sections of a legend side by side from the top of `place`, closer where it is too low for them."""
    page = _page(figure)
    longest = max(len(entries) for _, entries in sections) + 1
    line = min(_LINE_IN, place.height / longest)
    share = place.width / len(sections)
    for column, (heading, entries) in enumerate(sections):
        x = place.left + column * share
        _text(figure, x, place.top - line, heading, 7.5, weight="bold")
        for row, (swatch, text) in enumerate(entries, start=2):
            y = place.top - row * line
            swatch(page, x, y - 0.015)
            _text(figure, x + _WIDE + 0.1, y, text, 7.2)


def _table(figure: Figure, site: Site, left: float, top: float) -> None:
    """Figures of the world and of the region, the first line below `top`."""
    free = site.spawner.free_space
    columns = [
        figures(site.world, free, each, site.max_slope_deg)
        for each in (site.world.extent, site.spawner.region)
    ]
    rights = (left + 2.75, left + 3.6)
    y = top - _LINE_IN
    _text(figure, left, y, "figures", 7.5, weight="bold")
    for right, name in zip(rights, ("world", "region"), strict=True):
        _text(figure, right, y, name, 7.5, weight="bold", ha="right")
    page = _page(figure)
    page.plot([left, rights[-1]], [y - 0.05] * 2, color=colours.FAINT, linewidth=0.6)
    for row, (name, show) in enumerate(_ROWS, start=1):
        line = y - row * _LINE_IN - 0.02
        _text(figure, left, line, name, 7.2)
        for right, each in zip(rights, columns, strict=True):
            _text(figure, right, line, show(each), 7.2, ha="right")


_ROWS: tuple[tuple[str, Callable[[Figures], str]], ...] = (
    ("size", lambda f: f"{f.width_m:.4g} by {f.depth_m:.4g} m"),
    ("relief", lambda f: f"{f.relief_m:.2f} m"),
    ("slope, median", lambda f: f"{f.median_slope_deg:.1f}°"),
    ("slope, 90 % below", lambda f: f"{f.steepest_tenth_deg:.1f}°"),
    ("too steep", lambda f: f"{f.too_steep:.1%}"),
    ("under obstacles", lambda f: f"{f.obstructed:.1%}"),
    ("free for the rover", lambda f: f"{f.traversable:.1%}"),
)


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 2].rstrip() + " …"
