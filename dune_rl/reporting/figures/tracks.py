"""Tracks on maps, coloured by speed: a panel for each method and site."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from matplotlib import colormaps, patheffects, rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle as Box

from dune_rl.geometry.arrays import Array
from dune_rl.reporting.figures import style
from dune_rl.reporting.figures.results import COLLISION, FAILURES, REACHED
from dune_rl.reporting.figures.track_data import EpisodeTrack, TrackSite
from dune_rl.visualization.site_map import layers
from dune_rl.visualization.site_map.colours import rgb
from dune_rl.worlds.world import Rectangle, World

# The lightness of viridis rises evenly.
_SPEEDS = colormaps["viridis"]
_MOST_ACROSS = 4
_LEAST_SIDE_M, _MARGIN = 5.0, 0.06
# Longer tracks are pixels in a PDF, which would be slow to show otherwise.
_MOST_PIECES = 1_000
_SCALES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_FASTEST_QUANTILE = 0.99
# Of the ground below tracks.
_CELLS = 260
_KINDS = 8
_DRIVABLE, _OBSTACLE, _WATER, _PLANTS = "#e4e0d6", "#9aa3b2", "#a7d3ef", "#a9cbac"


@dataclass(frozen=True, eq=False)
class SiteGround:
    """The ground of `view` (xmin, xmax, ymin, ymax) [m] in colours (rows, columns, 3), and objects on it."""

    view: Rectangle
    picture: Array
    footprints: Sequence[layers.PropFootprints]

    @classmethod
    def of(cls, world: World, view: Rectangle) -> "SiteGround":
        """The ground of `world`, lit from the north-west; white beyond its edge."""
        ground = layers.GroundGrid.sample(world.terrain, view, _CELLS, _CELLS)
        light = np.clip(0.93 + 0.28 * (np.clip(ground.shade, 0.2, 1.6) - 1.0), 0.55, 1.0)
        picture = np.repeat(light[..., None], 3, axis=2)
        for props, colour in ((layers.water_props(world), _WATER), (layers.vegetation_props(world), _PLANTS)):
            covered = layers.covered_by(props, ground)
            picture[covered] = 0.35 * picture[covered] + 0.65 * rgb(colour)
        xmin, xmax, ymin, ymax = world.extent
        across, up = (ground.x >= xmin) & (ground.x <= xmax), (ground.y >= ymin) & (ground.y <= ymax)
        picture[~(up[:, None] & across)] = 1.0
        return cls(view, picture, layers.prop_footprints(world, _KINDS))

    def draw(self, axes: Axes) -> None:
        """Draw it below everything else."""
        axes.imshow(self.picture, extent=self.view, origin="lower", interpolation="bilinear", zorder=0)
        for each in self.footprints:
            colour = _DRIVABLE if each.drivable else _OBSTACLE
            shapes = PolyCollection(
                list(each.triangles), facecolors=colour, edgecolors=colour, linewidths=0.2, rasterized=True
            )
            shapes.set_zorder(1)
            axes.add_collection(shapes, autolim=False)


def draw_tracks(sites: Sequence[TrackSite]) -> Figure:
    """The ways of all agents on maps: rows are sites, panels methods, colours the forward speed.

    A white dot is the start (with the number of the episode), a star the goal, filled where it was reached
    without collision; crosses are collisions, and other marks how episodes failed. Ways of other actors are
    thin lines, objects grey; the ground is lit from the north-west. All panels of a site show the same part.
    """
    sites = [site for site in sites if any(site.tracks.values())]
    if not sites:
        return style.note_figure("no evaluation has steps: evaluate with steps=10 to see tracks")
    most = max(len(site.tracks) for site in sites)
    # Rows of equal length: five methods are three and two.
    across = ceil(most / ceil(most / _MOST_ACROSS))
    rows = [ceil(len(site.tracks) / across) for site in sites]
    tracks = [track for site in sites for track in site.all_tracks]
    speeds = np.concatenate([track.speeds for track in tracks])
    fastest = float(np.quantile(speeds, _FASTEST_QUANTILE)) if len(speeds) else 1.0
    norm = Normalize(0.0, max(fastest, 0.1))
    with rc_context(style.RC):
        # Panels are square.
        side = min(2.3, (style.PAGE_IN - 0.8) / across)
        figure = style.new_figure(max(3.45, side * across + 0.8), 0.6 + sum(rows) * (side + 0.2))
        grid = iter(figure.subplots(sum(rows), across, squeeze=False))
        for site, count in zip(sites, rows, strict=True):
            _draw_site([axes for _ in range(count) for axes in next(grid)], site, norm)
        bar = figure.colorbar(
            ScalarMappable(norm, _SPEEDS), ax=list(figure.axes), shrink=min(1.0, 1.6 / sum(rows)),
            aspect=25, pad=0.01, extend="max",
        )  # fmt: skip
        bar.set_label("forward speed [m/s]")
        _draw_legend(figure, tracks)
    return figure


def draw_track_map(axes: Axes, site: TrackSite, norm: Normalize) -> None:
    """The ways on a site that has tracks, on one panel without a title; goals may lie outside."""
    view = _square([track.points for track in site.all_tracks])
    ground = None if site.world is None else SiteGround.of(site.world, view)
    _draw_panel(axes, ground, site.all_tracks, view, norm)
    _draw_scale(axes, view)


def view_of(site: TrackSite) -> Rectangle:
    """A square (xmin, xmax, ymin, ymax) [m] with all starts, goals and ways of a site's robots."""
    return _square([points for each in site.all_tracks for points in (each.points, each.goal[None])])


def _square(parts: Sequence[Array]) -> Rectangle:
    """The square with a margin about the points (P, 2) of all parts that are finite."""
    points = np.concatenate(parts)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    half = max(float((high - low).max()) * (0.5 + _MARGIN), _LEAST_SIDE_M / 2)
    x, y = ((low + high) / 2).tolist()
    return x - half, x + half, y - half, y + half


def _draw_site(panels: list[Axes], site: TrackSite, norm: Normalize) -> None:
    view = view_of(site)
    ground = None if site.world is None else SiteGround.of(site.world, view)
    for axes in panels[len(site.tracks) :]:
        axes.remove()
    labels = style.short_names(site.tracks)
    for axes, label, tracks in zip(panels, labels, site.tracks.values(), strict=False):
        _draw_panel(axes, ground, tracks, view, norm)
        hits = sum(track.success for track in tracks)
        told = f"{hits} of {len(tracks)} succeed" if tracks else "no steps"
        axes.set_title(f"{label}: {told}", loc="left", fontsize=style.SMALL)
    panels[0].set_ylabel(site.title + ("" if ground is not None else "\n(the site cannot be built)"))
    _draw_scale(panels[0], view)


def _draw_panel(
    axes: Axes, ground: SiteGround | None, tracks: Sequence[EpisodeTrack], view: Rectangle, norm: Normalize
) -> None:
    if ground is not None:
        ground.draw(axes)
    for track in tracks:
        _draw_track(axes, track, norm)
    axes.set(xlim=view[:2], ylim=view[2:], aspect="equal", xticks=[], yticks=[])


def _draw_track(axes: Axes, track: EpisodeTrack, norm: Normalize) -> None:
    def mark(place: Array, shape: str, face: str, edge: str, size: float) -> None:
        axes.plot(
            *place, shape, color=face, markersize=size, markeredgecolor=edge, markeredgewidth=0.6, zorder=7.5
        )

    for way in track.walkers:
        # Who goes there and back would fill the gaps of dashes.
        axes.plot(*way[:, :2].T, color=style.FAINT, linewidth=0.6, alpha=0.55, zorder=2)
    if len(track.points) > 1:
        axes.plot(*track.points.T, color=style.INK, linewidth=2.0, zorder=3, solid_capstyle="round")
        pieces = np.stack([track.points[:-1], track.points[1:]], axis=1)
        lines = LineCollection(
            list(pieces), cmap=_SPEEDS, norm=norm, linewidths=1.4, zorder=4, capstyle="round",
            rasterized=len(pieces) > _MOST_PIECES,
        )  # fmt: skip
        lines.set_array(track.speeds)
        axes.add_collection(lines, autolim=False)
    mark(track.goal, REACHED.mark, REACHED.colour if track.success else "white", style.INK, 8.0)
    number: dict[str, Any] = {"fontsize": 4.5, "zorder": 8.1, "annotation_clip": True}
    axes.annotate(
        f"{track.episode}", tuple(track.goal), (4, 3), textcoords="offset points",
        path_effects=[patheffects.withStroke(linewidth=1.2, foreground="white")], **number,
    )  # fmt: skip
    if len(track.collisions):
        axes.plot(
            *track.collisions.T, COLLISION.mark, color=COLLISION.colour, markersize=4, markeredgewidth=1.2,
            linestyle="", zorder=7.6,
        )  # fmt: skip
    if not len(track.points):
        return
    if track.times_s[0] == 0.0:
        start = track.points[0]
        mark(start, "o", "white", style.INK, 6.5)
        axes.annotate(f"{track.episode}", tuple(start), ha="center", va="center_baseline", **number)
    if track.ending is not None and track.ending is not REACHED:
        mark(track.points[-1], track.ending.mark, track.ending.colour, "white", 8.0)


def _draw_legend(figure: Figure, tracks: Sequence[EpisodeTrack]) -> None:
    marks = [
        ("o", "white", style.INK, "start, episode"),
        (REACHED.mark, REACHED.colour, style.INK, "goal, success"),
        (REACHED.mark, "white", style.INK, "goal, no success"),
    ]
    if any(len(track.collisions) for track in tracks):
        marks.append((COLLISION.mark, COLLISION.colour, COLLISION.colour, COLLISION.name))
    failed = {track.ending for track in tracks if len(track.points)}
    marks += [(one.mark, one.colour, "white", one.name) for one in FAILURES.values() if one in failed]
    handles = [
        Line2D([], [], linestyle="", marker=mark, color=face, markeredgecolor=edge, markersize=5, label=label)
        for mark, face, edge, label in marks
    ]
    if any(track.walkers for track in tracks):
        handles.append(Line2D([], [], color=style.FAINT, linewidth=1.0, alpha=0.55, label="other actors"))
    across = min(len(handles), 7 if figure.get_figwidth() > 5 else 4)
    figure.legend(
        handles=handles, loc="outside upper center", ncols=across, frameon=False, handletextpad=0.1,
        columnspacing=1.0,
    )  # fmt: skip


def _draw_scale(axes: Axes, view: Rectangle) -> None:
    width = view[1] - view[0]
    length = max((scale for scale in _SCALES_M if scale <= 0.3 * width), default=_SCALES_M[0])
    left, bottom = view[0] + 0.04 * width, view[2] + 0.04 * width
    axes.add_patch(
        Box(
            (left, bottom),
            length,
            0.012 * width,
            facecolor=style.INK,
            edgecolor="white",
            linewidth=0.5,
            zorder=9,
        )
    )
    axes.text(
        left + length / 2, bottom + 0.02 * width, f"{length:g} m", ha="center", va="bottom",
        fontsize=style.SMALL - 1, zorder=9,
        bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7},
    )  # fmt: skip
