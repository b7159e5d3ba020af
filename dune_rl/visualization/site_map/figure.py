"""Maps: a site from above, with slopes, obstacles, starts and goals, actors' paths and driven tracks."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.legend import (
    LINE_IN,
    ROWS,
    draw_sections,
    draw_table,
    episode_legend,
    slope_legend,
    thing_legend,
)
from dune_rl.visualization.site_map.page import (
    HEIGHT_IN,
    WIDTH_IN,
    Place,
    arrows,
    panel_axes,
    scale_bar,
    write,
)
from dune_rl.visualization.site_map.panel import (
    Site,
    draw_drives,
    draw_episodes,
    draw_ground,
    draw_paths,
    draw_region,
    draw_things,
)
from dune_rl.worlds.world import Rectangle

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.62, 12.78, 6.98, 0.52
_GAP, _BELOW_AXES = 0.74, 0.62
# From this proportion on the legend stands below the site, not beside it.
_WIDE_SHAPE = 1.45
_SITE_IN, _WIDE_SITE_IN = 6.6, 7.7
_CLOSER_IN, _WIDE_CLOSER_IN = 3.2, 4.2
# A region of less than this share of the world has a panel of its own.
_LARGE_SHARE = 0.3
_LONGEST_TEXT = 225


def site_map(site: Site, title: str, settings: str, dpi: int) -> Figure:
    """A page of 13 by 8 in: the site, its starts and goals larger where they are but a part of it, a legend.

    The ground is drawn for `dpi`; save the figure with that.
    """
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=colours.PAPER)
    write(figure, _LEFT, 7.62, title, 17, weight="bold")
    write(figure, _LEFT, 7.4, _shortened(settings), 7.5, colour=colours.FAINT)
    extent = site.world.extent
    wide = (extent[1] - extent[0]) / (extent[3] - extent[2]) > _WIDE_SHAPE
    whole = _fitted(extent, Place(_LEFT, _BOTTOM, _WIDE_SITE_IN if wide else _SITE_IN, _TOP - _BOTTOM))
    closer = _closer(site) if _area(site.spawner.region) < _LARGE_SHARE * _area(extent) else None
    tints = _tints(site)
    _panel(figure, site, extent, whole, tints, dpi, "the site", closer)
    slopes, found, episodes = slope_legend(site), thing_legend(site, tints), episode_legend(site)
    left, below = whole.left + whole.width + _GAP, _TOP
    room = _RIGHT - left
    if closer is not None:
        side = min(_WIDE_CLOSER_IN if wide else _CLOSER_IN, room)
        place = _fitted(closer, Place(left, _TOP - side, side, side))
        _panel(figure, site, closer, place, tints, dpi, "starts and goals", None)
        below = place.bottom - _BELOW_AXES
    table_in = (len(ROWS) + 1.5) * LINE_IN
    if wide:
        low = Place(_LEFT, 0.15, whole.width, whole.bottom - _BELOW_AXES - 0.15)
        draw_sections(figure, [[slopes], [found], [episodes]], low)
        draw_table(figure, site, left, below)
    elif closer is None:
        high = Place(left, 0.3 + table_in, room, below - 0.3 - table_in)
        draw_table(figure, site, left, draw_sections(figure, [[slopes, found], [episodes]], high) - 0.2)
    else:
        right = place.left + place.width + 0.22
        draw_sections(figure, [[slopes]], Place(right, place.bottom, _RIGHT - right, place.height))
        table_top = 0.16 + table_in
        draw_sections(
            figure, [[found], [episodes]], Place(left, table_top + 0.08, room, below - table_top - 0.08)
        )
        draw_table(figure, site, left, table_top)
    return figure


def _area(rectangle: Rectangle) -> float:
    return (rectangle[1] - rectangle[0]) * (rectangle[3] - rectangle[2])


def _fitted(rectangle: Rectangle, room: Place) -> Place:
    """The largest place of the rectangle's proportions at the top left of `room`."""
    width, height = rectangle[1] - rectangle[0], rectangle[3] - rectangle[2]
    scale = min(room.width / width, room.height / height)
    return Place(room.left, room.top - scale * height, scale * width, scale * height)


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
    place: Place,
    tints: dict[str, str],
    dpi: int,
    caption: str,
    closer: Rectangle | None,
) -> None:
    axes = panel_axes(figure, place)
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
    write(figure, place.left, place.top + 0.1, caption, 9, weight="bold")
    scale_bar(figure, place, per_m)
    if rectangle == site.world.extent:
        arrows(figure, place)


def _frame(axes: Axes) -> None:
    axes.set_xlabel("x [m], east", fontsize=7.5, color=colours.INK, labelpad=2)
    axes.set_ylabel("y [m], north", fontsize=7.5, color=colours.INK, labelpad=2)
    axes.tick_params(labelsize=7, colors=colours.INK, length=3, width=0.6)
    for spine in axes.spines.values():
        spine.set_color(colours.INK)
        spine.set_linewidth(0.8)
        spine.set_zorder(9)


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 2].rstrip() + " …"
