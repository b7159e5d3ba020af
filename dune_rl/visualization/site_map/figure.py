"""The page of a map: the world, an enlarged region, the legend and a table of statistics."""

import numpy as np
from matplotlib.figure import Figure

from dune_rl.visualization.site_map import colours, legend, page, panel
from dune_rl.visualization.site_map.layers import obstacle_tints
from dune_rl.worlds.world import Rectangle

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.62, 12.78, 6.98, 0.52
_GAP, _BELOW_AXES = 0.74, 0.62
# From this ratio of width to height on, the legend is below the map, not beside it.
_WIDE_SHAPE = 1.45
_SITE_IN, _WIDE_SITE_IN = 6.6, 7.7
_CLOSER_IN, _WIDE_CLOSER_IN = 3.2, 4.2
# A region that covers less than this share of the world has a panel of its own.
_LARGE_SHARE = 0.3
_LONGEST_TEXT = 225


def draw_site_map(content: panel.MapContent, title: str, settings: str, dpi: int) -> Figure:
    """A page of 13 by 8 in with the map of `content`, and the region of starts and goals enlarged if small.

    The ground is rendered for `dpi`: save the figure with that.
    """
    figure = Figure(figsize=(page.WIDTH_IN, page.HEIGHT_IN), facecolor=colours.PAPER)
    page.draw_text(figure, _LEFT, 7.62, title, 17, weight="bold")
    page.draw_text(figure, _LEFT, 7.4, _shorten(settings), 7.5, colour=colours.FAINT)
    extent = content.world.extent
    wide = (extent[1] - extent[0]) / (extent[3] - extent[2]) > _WIDE_SHAPE
    whole = page.fit_rectangle(
        extent, page.PageRectangle(_LEFT, _BOTTOM, _WIDE_SITE_IN if wide else _SITE_IN, _TOP - _BOTTOM)
    )
    closer = _enlarged_area(content) if _area(content.spawner.region) < _LARGE_SHARE * _area(extent) else None
    tints = obstacle_tints(content.footprints)
    _panel(figure, content, extent, whole, tints, dpi, "the world", closer)
    slopes, episodes = legend.slope_legend(content.max_slope_deg), legend.episode_legend(content)
    props = legend.prop_legend(content.world, content.footprints, tints)
    left, below = whole.left + whole.width + _GAP, _TOP
    room = _RIGHT - left
    if closer is not None:
        side = min(_WIDE_CLOSER_IN if wide else _CLOSER_IN, room)
        place = page.fit_rectangle(closer, page.PageRectangle(left, _TOP - side, side, side))
        _panel(figure, content, closer, place, tints, dpi, "starts and goals", None)
        below = place.bottom - _BELOW_AXES
    table_in = (len(legend.STATISTICS_ROWS) + 1.5) * legend.LINE_IN
    if wide:
        low = page.PageRectangle(_LEFT, 0.15, whole.width, whole.bottom - _BELOW_AXES - 0.15)
        legend.draw_sections(figure, [[slopes], [props], [episodes]], low)
        legend.draw_table(figure, content, left, below)
    elif closer is None:
        high = page.PageRectangle(left, 0.3 + table_in, room, below - 0.3 - table_in)
        legend.draw_table(
            figure, content, left, legend.draw_sections(figure, [[slopes, props], [episodes]], high) - 0.2
        )
    else:
        right = place.left + place.width + 0.22
        legend.draw_sections(
            figure, [[slopes]], page.PageRectangle(right, place.bottom, _RIGHT - right, place.height)
        )
        table_top = 0.16 + table_in
        legend.draw_sections(
            figure,
            [[props], [episodes]],
            page.PageRectangle(left, table_top + 0.08, room, below - table_top - 0.08),
        )
        legend.draw_table(figure, content, left, table_top)
    return figure


def _area(rectangle: Rectangle) -> float:
    return (rectangle[1] - rectangle[0]) * (rectangle[3] - rectangle[2])


def _enlarged_area(content: panel.MapContent) -> Rectangle:
    """The region with a margin, and all tracks."""
    xmin, xmax, ymin, ymax = content.spawner.region
    margin = 0.07 * max(xmax - xmin, ymax - ymin)
    low, high = np.array([xmin, ymin]) - margin, np.array([xmax, ymax]) + margin
    for track in content.tracks:
        # Agents without an ending of their own, such as walkers, do not enlarge the panel.
        if track.ending is not None:
            low = np.minimum(low, track.points.min(axis=0) - margin / 2)
            high = np.maximum(high, track.points.max(axis=0) + margin / 2)
    # At least square, so that the panels have similar positions for all worlds.
    centre, half = (low + high) / 2, np.max(high - low) / 2
    extent = np.array(content.world.extent).reshape(2, 2)
    low, high = np.maximum(centre - half, extent[:, 0]), np.minimum(centre + half, extent[:, 1])
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _panel(
    figure: Figure,
    content: panel.MapContent,
    rectangle: Rectangle,
    place: page.PageRectangle,
    tints: dict[str, str],
    dpi: int,
    caption: str,
    closer: Rectangle | None,
) -> None:
    axes = page.panel_axes(figure, place)
    per_m = place.width / (rectangle[1] - rectangle[0])
    detail = closer is None
    panel.draw_ground(axes, content, rectangle, (place.width, place.height), dpi)
    panel.draw_props(axes, content.footprints, tints)
    panel.draw_region(axes, content.spawner.region, 1.5)
    if rectangle == content.world.extent:
        panel.draw_candidates(axes, content)
    panel.draw_paths(axes, content, 1.3, closer)
    panel.draw_tracks(axes, content.tracks, 2.0 if detail else 1.0, marks=detail)
    if detail:
        panel.draw_episodes(axes, content, per_m, joined=not content.tracks)
    page.frame_map(figure, axes, place, rectangle, caption, arrows=rectangle == content.world.extent)


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 2].rstrip() + " …"
