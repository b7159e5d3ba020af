"""A picture of a trajectory: its way on the map, enlarged, and its profile."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dune_rl.geometry.arrays import Array
from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.layers import (
    GroundGrid,
    PropFootprints,
    obstacle_tints,
    prop_footprints,
)
from dune_rl.visualization.site_map.legend import draw_sections, prop_legend, slope_legend
from dune_rl.visualization.site_map.page import (
    HEIGHT_IN,
    WIDTH_IN,
    PageRectangle,
    draw_text,
    fit_rectangle,
    frame_map,
    frame_panel,
    panel_axes,
)
from dune_rl.visualization.site_map.panel import (
    STRIPE_IN,
    draw_contours,
    draw_props,
    draw_region,
    shade_ground,
    slope_colours,
)
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.world import Rectangle, World

_WORLD = PageRectangle(0.62, 2.35, 4.9, 4.65)
_CLOSER = PageRectangle(6.2, 2.35, 4.9, 4.65)
_PROFILE = PageRectangle(0.62, 0.5, 10.48, 1.15)
_LEGEND = PageRectangle(11.3, 1.0, 1.6, 6.0)
_WAY, _EDGE = "#c2367f", colours.PAPER
_LEAST_SIDE_M, _MARGIN = 6.0, 0.18
_ARROWS = 12
# Numbers at the ends of the profile are inside its frame: the share that is an end, and shifts in points.
_END, _NUDGE = 0.005, {"left": 3, "center": 0, "right": -3}


def draw_trajectory(
    world: World, actor: ActorTrajectory, waypoints: Array, title: str, max_slope_deg: float, dpi: int
) -> Figure:
    """A page with the way of `actor` through `waypoints` (n, 2): in the world, enlarged, and its heights.

    The ground is rendered for `dpi`: save the figure with that.
    """
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=colours.PAPER)
    draw_text(figure, _WORLD.left, 7.62, title, 17, weight="bold")
    draw_text(figure, _WORLD.left, 7.38, _summary(actor), 8.5, colour=colours.FAINT)
    footprints = prop_footprints(world, len(colours.OBSTACLES))
    tints = obstacle_tints(footprints)
    closer = _surroundings(world, actor.poses[:, :2])
    for rectangle, room, caption in (
        (world.extent, _WORLD, "the world"),
        (closer, _CLOSER, "the way"),
    ):
        place = fit_rectangle(rectangle, room)
        axes = panel_axes(figure, place)
        _draw_ground(axes, world, footprints, tints, rectangle, place, max_slope_deg, dpi)
        _draw_way(axes, actor, waypoints, marks=rectangle is closer)
        if rectangle is not closer:
            draw_region(axes, closer, 0.8)
        axes.set_xlim(rectangle[:2])
        axes.set_ylim(rectangle[2:])
        frame_map(figure, axes, place, rectangle, caption, arrows=rectangle is not closer)
    _draw_profile(figure, world, actor, waypoints)
    draw_sections(figure, [[slope_legend(max_slope_deg), prop_legend(world, footprints, tints)]], _LEGEND)
    return figure


def _summary(actor: ActorTrajectory) -> str:
    steps = np.linalg.norm(np.diff(actor.poses[:, :3], axis=0), axis=1)
    moving = steps > 0.0
    length, walked_s = float(steps.sum()), float(np.diff(actor.times)[moving].sum())
    stood = actor.duration_s - walked_s
    pauses = f", {stood:g} s of pauses" if stood > 1e-6 else ""
    delay = f", after {actor.delay_s:g} s" if actor.delay_s else ""
    return (
        f"{length:.1f} m on the ground at {length / walked_s:.2f} m/s, {actor.duration_s:.1f} s{pauses}"
        f"{delay}, {'repeated' if actor.loop else 'once'}; {len(actor.times):,} poses"
    )


def _surroundings(world: World, xy: Array) -> Rectangle:
    """The square round the way with a margin, within the world where that is large enough."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    half = max(float((high - low).max()) * (0.5 + _MARGIN), _LEAST_SIDE_M / 2)
    extent = np.array(world.extent).reshape(2, 2)
    half = min(half, float((extent[:, 1] - extent[:, 0]).min()) / 2)
    centre = np.clip((low + high) / 2, extent[:, 0] + half, extent[:, 1] - half)
    (xmin, ymin), (xmax, ymax) = (centre - half).tolist(), (centre + half).tolist()
    return xmin, xmax, ymin, ymax


def _draw_ground(
    axes: Axes,
    world: World,
    footprints: list[PropFootprints],
    tints: dict[str, str],
    rectangle: Rectangle,
    place: PageRectangle,
    max_slope_deg: float,
    dpi: int,
) -> None:
    columns, rows = (max(2, round(side * dpi)) for side in (place.width, place.height))
    ground = GroundGrid.sample(world.terrain, rectangle, columns, rows)
    picture = shade_ground(slope_colours(ground, max_slope_deg, STRIPE_IN * dpi), world, ground)
    axes.imshow(picture, extent=rectangle, origin="lower", interpolation="nearest", zorder=0)
    draw_contours(axes, world, rectangle, (place.width, place.height))
    draw_props(axes, footprints, tints)


def _draw_way(axes: Axes, actor: ActorTrajectory, waypoints: Array, *, marks: bool) -> None:
    xy = actor.poses[:, :2]
    width = 2.0 if marks else 1.4
    axes.plot(*xy.T, color=_EDGE, linewidth=width + 1.6, zorder=5, solid_capstyle="round")
    axes.plot(*xy.T, color=_WAY, linewidth=width, zorder=5.1, solid_capstyle="round")
    if not marks:
        return
    # Evenly in time, and not where it stands.
    at = np.interp(np.linspace(0.0, actor.duration_s, _ARROWS + 2)[1:-1], actor.times, np.arange(len(xy)))
    for k in np.unique(at.astype(int)).tolist():
        if k + 1 < len(xy) and np.linalg.norm(xy[k + 1] - xy[k]) > 0.0:
            axes.annotate(
                "", xy[k + 1], xy[k], zorder=5.3,
                arrowprops={"arrowstyle": "-|>,head_length=4.5,head_width=2.6", "color": _WAY,
                            "mutation_scale": 1, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0},
            )  # fmt: skip
    for number, (x, y) in enumerate(waypoints.tolist(), start=1):
        axes.plot([x], [y], "o", color=colours.PAPER, markeredgecolor=colours.INK, markersize=11.5, zorder=6)
        axes.annotate(
            f"{number}", (x, y), color=colours.INK, fontsize=7 if number < 100 else 5, fontweight="bold",
            ha="center", va="center_baseline", zorder=6.1,
        )  # fmt: skip


def _draw_profile(figure: Figure, world: World, actor: ActorTrajectory, waypoints: Array) -> None:
    """The height of the ground over time, and when the way-points are reached."""
    axes = panel_axes(figure, _PROFILE)
    height = actor.poses[:, 2]
    relief = max(float(np.ptp(height)), 0.5)
    low, high = float(height.min()) - 0.15 * relief, float(height.min()) + 1.35 * relief
    axes.fill_between(actor.times, low, height, color=colours.SLOPES[2], linewidth=0)
    axes.plot(actor.times, height, color=_WAY, linewidth=1.5)
    tolerance = float(np.linalg.norm(np.diff(actor.poses[:, :2], axis=0), axis=1).max()) * 0.51 + 1e-6
    for number, point in enumerate(waypoints, start=1):
        near = np.linalg.norm(actor.poses[:, :2] - point, axis=1) <= tolerance
        # The first pose of each spell at the way-point.
        for k in np.flatnonzero(near & ~np.append(False, near[:-1])).tolist():
            share = actor.times[k] / actor.duration_s
            side = "left" if share < _END else "right" if share > 1 - _END else "center"
            axes.annotate(
                f"{number}", (actor.times[k], height[k]), (_NUDGE[side], 4), textcoords="offset points",
                fontsize=7, fontweight="bold", ha=side, va="bottom", color=colours.INK,
            )  # fmt: skip
    axes.set_ylim(low, high)
    axes.set_xlim(0.0, max(actor.duration_s, 1e-3))
    frame_panel(axes)
    axes.set_xlabel("time [s]", fontsize=7.5, color=colours.INK, labelpad=2)
    axes.set_ylabel("ground [m]", fontsize=7.5, color=colours.INK, labelpad=2)
    draw_text(figure, _PROFILE.left, _PROFILE.top + 0.1, "profile", 9, weight="bold")
