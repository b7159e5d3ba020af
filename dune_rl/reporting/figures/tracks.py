"""Tracks on maps, coloured by speed: a panel for each method and site."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

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
from dune_rl.reporting.figures.results import COLLISION, FAILURES, REACHED, Ending
from dune_rl.reporting.figures.style import (
    FAINT,
    INK,
    PAGE_IN,
    RC,
    SMALL,
    new_figure,
    note_figure,
    short_names,
)
from dune_rl.reporting.figures.track_data import EpisodeTrack, TrackSite
from dune_rl.visualization.site_map.colours import rgb
from dune_rl.visualization.site_map.layers import (
    GroundGrid,
    PropFootprints,
    covered_by,
    prop_footprints,
    vegetation_props,
    water_props,
)
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
    footprints: Sequence[PropFootprints]

    @classmethod
    def of(cls, world: World, view: Rectangle) -> "SiteGround":
        """The ground of `world`, lit from the north-west; white beyond its edge."""
        ground = GroundGrid.sample(world.terrain, view, _CELLS, _CELLS)
        light = np.clip(0.93 + 0.28 * (np.clip(ground.shade, 0.2, 1.6) - 1.0), 0.55, 1.0)
        picture = np.repeat(light[..., None], 3, axis=2)
        for props, colour in ((water_props(world), _WATER), (vegetation_props(world), _PLANTS)):
            covered = covered_by(props, ground)
            picture[covered] = 0.35 * picture[covered] + 0.65 * rgb(colour)
        xmin, xmax, ymin, ymax = world.extent
        across, up = (ground.x >= xmin) & (ground.x <= xmax), (ground.y >= ymin) & (ground.y <= ymax)
        picture[~(up[:, None] & across)] = 1.0
        return cls(view, picture, prop_footprints(world, _KINDS))

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
        return note_figure("no evaluation has steps: evaluate with steps=10 to see tracks")
    most = max(len(site.tracks) for site in sites)
    # Rows of equal length: five methods are three and two.
    across = ceil(most / ceil(most / _MOST_ACROSS))
    rows = [ceil(len(site.tracks) / across) for site in sites]
    speeds = np.concatenate(
        [track.speeds for site in sites for tracks in site.tracks.values() for track in tracks]
    )
    fastest = float(np.quantile(speeds, _FASTEST_QUANTILE)) if len(speeds) else 1.0
    norm = Normalize(0.0, max(fastest, 0.1))
    with rc_context(RC):
        # Panels are square.
        side = min(2.3, (PAGE_IN - 0.8) / across)
        figure = new_figure(max(3.45, side * across + 0.8), 0.6 + sum(rows) * (side + 0.2))
        grid = figure.subplots(sum(rows), across, squeeze=False)
        shown: dict[str, Ending] = {}
        first = 0
        for site, count in zip(sites, rows, strict=True):
            block = grid[first : first + count].reshape(-1)
            _draw_site(list(block), site, norm, shown)
            first += count
        bar = figure.colorbar(
            ScalarMappable(norm, _SPEEDS), ax=list(figure.axes), shrink=min(1.0, 1.6 / sum(rows)),
            aspect=25, pad=0.01, extend="max",
        )  # fmt: skip
        bar.set_label("forward speed [m/s]")
        tracks = [track for site in sites for each in site.tracks.values() for track in each]
        _legend(figure, shown, with_others=any(track.walkers for track in tracks))
    return figure


def draw_track_map(axes: Axes, site: TrackSite, norm: Normalize) -> None:
    """The ways on a site that has tracks, on one panel without a title; goals may lie outside."""
    tracks = [track for tracks in site.tracks.values() for track in tracks]
    view = _square(np.concatenate([track.points for track in tracks]))
    _draw_panel(axes, _ground(site, view), tracks, view, norm, {})
    _draw_scale(axes, view)


def _ground(site: TrackSite, view: Rectangle) -> SiteGround | None:
    return None if site.world is None else SiteGround.of(site.world, view)


def _draw_panel(
    axes: Axes,
    ground: SiteGround | None,
    tracks: Sequence[EpisodeTrack],
    view: Rectangle,
    norm: Normalize,
    shown: dict[str, Ending],
) -> None:
    if ground is not None:
        ground.draw(axes)
    for track in tracks:
        _draw_track(axes, track, norm, shown)
    axes.set_xlim(view[:2])
    axes.set_ylim(view[2:])
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])


def _draw_site(panels: list[Axes], site: TrackSite, norm: Normalize, shown: dict[str, Ending]) -> None:
    view = view_of(site)
    ground = _ground(site, view)
    names = list(site.tracks)
    for axes in panels[len(names) :]:
        axes.remove()
    for number, (axes, label) in enumerate(zip(panels, short_names(names), strict=False)):
        tracks = site.tracks[names[number]]
        _draw_panel(axes, ground, tracks, view, norm, shown)
        hits = sum(track.success for track in tracks)
        told = f"{hits} of {len(tracks)} succeed" if tracks else "no steps"
        axes.set_title(f"{label}: {told}", loc="left", fontsize=SMALL)
        if number == 0:
            missing = "" if site.world is not None else "\n(the site cannot be built)"
            axes.set_ylabel(site.title + missing)
            _draw_scale(axes, view)


def view_of(site: TrackSite) -> Rectangle:
    """A square (xmin, xmax, ymin, ymax) [m] with all starts, goals and ways of a site's robots."""
    tracks = [track for tracks in site.tracks.values() for track in tracks]
    return _square(np.concatenate([*(each.points for each in tracks), *(each.goal[None] for each in tracks)]))


def _square(points: Array) -> Rectangle:
    """The square with a margin about those `points` (P, 2) that are finite."""
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    half = max(float((high - low).max()) * (0.5 + _MARGIN), _LEAST_SIDE_M / 2)
    x, y = ((low + high) / 2).tolist()
    return x - half, x + half, y - half, y + half


def _draw_track(axes: Axes, track: EpisodeTrack, norm: Normalize, shown: dict[str, Ending]) -> None:
    for way in track.walkers:
        # Who goes there and back would fill the gaps of dashes.
        axes.plot(*way[:, :2].T, color=FAINT, linewidth=0.6, alpha=0.55, zorder=2)
    if len(track.points) > 1:
        axes.plot(*track.points.T, color=INK, linewidth=2.0, zorder=3, solid_capstyle="round")
        pieces = np.stack([track.points[:-1], track.points[1:]], axis=1)
        lines = LineCollection(
            list(pieces), cmap=_SPEEDS, norm=norm, linewidths=1.4, zorder=4, capstyle="round",
            rasterized=len(pieces) > _MOST_PIECES,
        )  # fmt: skip
        lines.set_array(track.speeds)
        axes.add_collection(lines, autolim=False)
    _draw_mark(axes, track.goal, REACHED.mark, REACHED.colour if track.success else "white", INK, 8.0)
    axes.annotate(
        f"{track.episode}", _pair(track.goal), (4, 3), textcoords="offset points", fontsize=4.5, zorder=8.1,
        annotation_clip=True, path_effects=[patheffects.withStroke(linewidth=1.2, foreground="white")],
    )  # fmt: skip
    if len(track.collisions):
        shown[COLLISION.name] = COLLISION
        axes.plot(
            *track.collisions.T, COLLISION.mark, color=COLLISION.colour, markersize=4, markeredgewidth=1.2,
            linestyle="", zorder=7.6,
        )  # fmt: skip
    if not len(track.points):
        return
    if track.times_s[0] == 0.0:
        _draw_mark(axes, track.points[0], "o", "white", INK, 6.5)
        axes.annotate(
            f"{track.episode}", _pair(track.points[0]), fontsize=4.5, ha="center", va="center_baseline",
            zorder=8.1, annotation_clip=True,
        )  # fmt: skip
    if track.ending is not None and track.ending is not REACHED:
        shown[track.ending.name] = track.ending
        _draw_mark(axes, track.points[-1], track.ending.mark, track.ending.colour, "white", 8.0)


def _draw_mark(axes: Axes, place: Array, mark: str, face: str, edge: str, size: float) -> None:
    axes.plot(
        *place, mark, color=face, markersize=size, markeredgecolor=edge, markeredgewidth=0.6, zorder=7.5
    )


def _pair(place: Array) -> tuple[float, float]:
    x, y = place.tolist()
    return x, y


def _legend(figure: Figure, shown: dict[str, Ending], *, with_others: bool) -> None:
    def mark(shape: str, face: str, edge: str, label: str) -> Line2D:
        return Line2D(
            [], [], linestyle="", marker=shape, color=face, markeredgecolor=edge, markersize=5, label=label
        )

    handles = [
        mark("o", "white", INK, "start, episode"),
        mark(REACHED.mark, REACHED.colour, INK, "goal, success"),
        mark(REACHED.mark, "white", INK, "goal, no success"),
    ]
    if "collision" in shown:
        handles.append(mark(COLLISION.mark, COLLISION.colour, COLLISION.colour, COLLISION.name))
    failed = [one for one in FAILURES.values() if one.name in shown]
    handles += [mark(one.mark, one.colour, "white", one.name) for one in failed]
    if with_others:
        handles.append(Line2D([], [], color=FAINT, linewidth=1.0, alpha=0.55, label="other actors"))
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
        Box((left, bottom), length, 0.012 * width, facecolor=INK, edgecolor="white", linewidth=0.5, zorder=9)
    )
    axes.text(
        left + length / 2, bottom + 0.02 * width, f"{length:g} m", ha="center", va="bottom",
        fontsize=SMALL - 1, zorder=9,
        bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7},
    )  # fmt: skip
