"""Panels of a contact sheet: each draws a reading of one agent into axes."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, ListedColormap, LogNorm
from matplotlib.patches import Patch
from numpy.typing import NDArray

from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.settings import SensorSettings

Picture = NDArray[np.uint8]
Readings = Mapping[str, NDArray[Any]]
Sensors = Mapping[str, SensorSettings]

PAPER, INK = "#10151c", "#e8ecf1"
# Numbers in a panel are smaller where there are more lines of them.
_MOST_LINES = 22
_FAINT, _WARM, _COOL, _GREEN, _RED = "#3a4656", "#ffc43d", "#5bb8ff", "#40d67a", "#ff6a5e"
_SEGMENT_COLOURS = {
    Segment.SKY: "#a8c8ea",
    Segment.GROUND: "#7c7a4a",
    Segment.DECK: "#b8814e",
    Segment.OBSTACLE: "#8d99ae",
    Segment.WATER: "#2f7fb8",
    Segment.VEGETATION: "#3f8f4a",
    Segment.ACTOR: "#ff7f2a",
    Segment.ROBOT: "#d94fa0",
}
# How the readings of a scan's segments are drawn: colour, opacity and legend, by kind of sensor.
_SCAN_STYLES = {
    "lidar_past": (_COOL, 0.45, "past"),
    "lidar": (_WARM, 0.9, "now"),
    "low_obstacles": (_RED, 0.9, "low"),
}


def style_axes(axes: Axes, title: str) -> None:
    axes.set_title(title, color=INK, fontsize=11, loc="left")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor(PAPER)
    for spine in axes.spines.values():
        spine.set_color(_FAINT)


def _bar(axes: Axes, image: Any, label: str) -> None:
    bar = axes.figure.colorbar(image, ax=axes, fraction=0.045, pad=0.02)
    bar.set_label(label, color=INK, fontsize=9)
    bar.ax.tick_params(colors=INK, labelsize=8)
    bar.outline.set_edgecolor(_FAINT)


def _draw_image(
    axes: Axes, reading: NDArray[Any], conf: Any, label: str, *, title: str, bar: str = "",
    shown: Callable[[NDArray[Any], Any], NDArray[Any]] = lambda reading, conf: reading, **options: Any,
) -> None:  # fmt: skip
    image = axes.imshow(shown(reading, conf), interpolation="nearest", **options)
    style_axes(axes, f"{label}, {title.format(conf=conf, reading=reading)}")
    if bar:
        _bar(axes, image, bar)


def _ranges(reading: NDArray[Any], conf: Any) -> NDArray[Any]:
    """Ranges [m] of a picture, NaN where nothing is in range."""
    return np.where(reading[..., 0] >= conf.range_m * 0.999, np.nan, reading[..., 0])


def _draw_depth(axes: Axes, reading: NDArray[Any], conf: Any, label: str) -> None:
    norm = LogNorm(0.1, conf.range_m)
    _draw_image(axes, reading, conf, label, title="depth", bar="m", shown=_ranges, cmap="magma_r", norm=norm)


def _draw_segments(
    axes: Axes, reading: NDArray[Any], conf: Any, label: str, *, aspect: Any, step: int = 1
) -> None:
    segments = reading[:, ::step, 0]
    colours = ListedColormap([_SEGMENT_COLOURS[segment] for segment in Segment])
    axes.imshow(
        segments, cmap=colours, vmin=-0.5, vmax=len(Segment) - 0.5, interpolation="nearest", aspect=aspect
    )
    style_axes(axes, f"{label}, segments")
    present = [segment for segment in Segment if (segments == segment).any()]
    handles = [Patch(color=_SEGMENT_COLOURS[each], label=each.name.lower()) for each in present]
    axes.legend(
        handles=handles, loc="lower left", fontsize=7, framealpha=0.75, facecolor=PAPER, labelcolor=INK
    )


def _draw_heights(
    axes: Axes, reading: NDArray[Any], conf: Any, label: str, *, title: str, aspect: Any
) -> None:
    # Ahead is up, left is left.
    _draw_image(
        axes, reading.reshape(conf.rows, conf.columns)[::-1, ::-1], conf, label,
        title=title, bar="m above the ground below", cmap="BrBG_r",
        norm=CenteredNorm(halfrange=max(0.1, float(np.abs(reading).max()))), aspect=aspect,
    )  # fmt: skip


def _draw_depth_strip(axes: Axes, reading: NDArray[Any], conf: Any, label: str) -> None:
    width = conf.fov_deg / len(reading)
    to_the_right = (len(reading) / 2 - np.arange(len(reading)) - 0.5) * width
    style_axes(axes, f"{label}, seen from inside")
    axes.bar(to_the_right, reading, width=width * 0.9, color=_COOL)
    axes.set_ylim(0.0, conf.range_m)
    axes.set_ylabel("m", color=INK, fontsize=9)
    axes.set_xlabel("degrees to the right", color=INK, fontsize=9)
    axes.tick_params(colors=INK, labelsize=8)
    axes.set_xticks([-40, -20, 0, 20, 40])
    axes.set_yticks(np.linspace(0.0, conf.range_m, 5))


def _style_polar(axes: Any, title: str) -> None:
    axes.set_theta_zero_location("N")
    axes.set_facecolor(PAPER)
    axes.set_title(f"{title}, ahead is up", color=INK, fontsize=11, loc="left")
    axes.tick_params(colors=INK, labelsize=7)
    axes.grid(color=_FAINT)


def draw_scans(
    axes: Any, seen: Mapping[str, tuple[Any, NDArray[Any]]], goal: NDArray[Any] | None, conf: Any, label: str
) -> None:
    """What is `seen` by a LiDAR, now and before, low obstacles and tracks: sensors' settings and readings."""
    _style_polar(axes, label)
    drawn: set[str] = set()
    distances = [np.zeros(0)]
    for kind, (colour, opacity, when) in _SCAN_STYLES.items():
        for settings, ranges in seen.values():
            if settings.sensor == kind:
                fov_rad = np.deg2rad(conf.fov_deg)
                width = fov_rad / len(ranges)
                bearing = -fov_rad / 2 + (np.arange(len(ranges)) + 0.5) * width
                hit = ranges < 0.999 * getattr(settings, "range_m", conf.range_m)
                axes.bar(
                    bearing[hit], 0.35, width=width * 0.92, bottom=ranges[hit] - 0.18, color=colour,
                    alpha=opacity, label=None if when in drawn else when,
                )  # fmt: skip
                drawn.add(when)
                distances.append(ranges[hit])
    distances += [
        _draw_tracks(axes, reading.reshape(-1, 6))
        for settings, reading in seen.values()
        if settings.sensor == "agent_tracks"
    ]
    if goal is not None:
        distances.append(np.minimum(goal[:1], conf.range_m))
        axes.plot(goal[1:2], distances[-1], "o", color=_GREEN, label="goal")
    found = np.concatenate(distances)
    axes.set_ylim(0.0, max(1.0, 1.2 * found.max()) if len(found) else conf.range_m)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="lower right", fontsize=7, facecolor=PAPER, labelcolor=INK, framealpha=0.75)


def _draw_tracks(axes: Any, tracks: NDArray[Any]) -> NDArray[Any]:
    """Draw where tracks (K, 6), of `agent_tracks`, are and will be in a second; their distances [m] now."""
    tracks = tracks[tracks[:, 4] > 0.0]
    now = tracks[:, :2] / tracks[:, 4:5]
    places = np.stack([now, now + tracks[:, 2:4]], axis=1)
    bearings = np.unwrap(np.arctan2(places[..., 1], places[..., 0]), axis=1)
    apart = np.hypot(places[..., 0], places[..., 1])
    for number, (bearing, distance) in enumerate(zip(bearings, apart, strict=True)):
        label = None if number else "tracks, in 1 s"
        axes.plot(bearing, distance, color=INK, linewidth=1.2)
        axes.plot(bearing[:1], distance[:1], "o", color=INK, markersize=5, label=label)
    return apart[:, 0]


def _draw_way_left(axes: Any, reading: NDArray[Any], conf: Any, label: str) -> None:
    _style_polar(axes, label)
    radii = np.asarray(conf.radii_m)
    # The first direction is behind.
    bearings = np.pi + np.arange(conf.directions) * 2.0 * np.pi / conf.directions
    values = reading.reshape(len(radii), conf.directions)
    norm = CenteredNorm(halfrange=max(0.1, float(np.abs(values).max())))
    points = axes.scatter(
        np.broadcast_to(bearings, values.shape), np.broadcast_to(radii[:, None], values.shape),
        c=values, cmap="RdYlGn_r", norm=norm, s=45, zorder=3,
    )  # fmt: skip
    axes.set_ylim(0.0, radii.max() * 1.12)
    axes.set_yticks(radii)
    axes.set_xticks([])
    axes.set_rlabel_position(10.0)
    _bar(axes, points, "m of way more than from here")


def _draw_command_costs(axes: Axes, reading: NDArray[Any], conf: Any, label: str) -> None:
    # Fast is up, left is left.
    _draw_image(
        axes, reading.reshape(-1, conf.commands.headings)[::-1, ::-1], conf, label,
        title="fast is up, left is left", bar="m above the cheapest", cmap="magma_r", aspect="auto",
        vmin=0.0, vmax=conf.max_cost,
    )  # fmt: skip


def draw_values(axes: Axes, name: str, values: NDArray[Any]) -> None:
    """A reading of many values, in their order."""
    style_axes(axes, f"{name}, {values.size} values")
    axes.step(np.arange(values.size), np.ravel(values), where="mid", color=_COOL, linewidth=1.0)
    axes.set_xticks([0, values.size - 1])
    axes.set_yticks(axes.get_ylim())
    axes.yaxis.set_major_formatter("{x:.3g}")
    axes.tick_params(colors=INK, labelsize=8)


def draw_numbers(axes: Axes, readings: Readings) -> None:
    """The numbers of `readings`, three in a line."""
    style_axes(axes, "numbers")
    lines = []
    for name, values in readings.items():
        numbers = [f" {value:9.3f}" for value in np.ravel(values)]
        lines += [name, *("  " + "".join(numbers[at : at + 3]) for at in range(0, len(numbers), 3))]
    text = axes.text(
        0.02, 0.98, "\n".join(lines), color=INK, fontsize=8 if len(lines) <= _MOST_LINES else 5.5,
        family="monospace", va="top", transform=axes.transAxes,
    )  # fmt: skip
    text.set_in_layout(False)


LABELS = {
    "camera": "camera",
    "lidar_3d": "3D LiDAR",
    "height_scan": "height scan",
    "depth_strip": "depth strip",
    "lidar": "LiDAR",
}
# By kind of sensor and output; sensors with a single output have an empty one.
PANELS: dict[tuple[str, str], Callable[..., None]] = {
    ("camera", "rgb"): partial(_draw_image, title="RGB, {conf.width} by {conf.height}"),
    ("camera", "depth"): _draw_depth,
    ("camera", "segmentation"): partial(_draw_segments, aspect="equal"),
    ("camera", "normals"): partial(
        _draw_image, title="normals", shown=lambda reading, conf: np.clip((reading + 1.0) / 2.0, 0.0, 1.0)
    ),
    ("camera", "grey"): partial(
        _draw_image, title="grey", shown=lambda reading, conf: reading[..., 0], cmap="gray", vmin=0, vmax=255
    ),
    ("lidar_3d", "range"): partial(
        _draw_image, title="{reading.shape[0]} rings, seen from inside", bar="m", cmap="turbo_r",
        shown=lambda reading, conf: _ranges(reading, conf)[:, ::-1], aspect="auto",
    ),
    ("lidar_3d", "intensity"): partial(
        _draw_image, title="intensity", bar="share returned", cmap="viridis",
        shown=lambda reading, conf: reading[:, ::-1, 0], aspect="auto",
    ),
    ("lidar_3d", "segmentation"): partial(_draw_segments, aspect="auto", step=-1),
    ("height_scan", ""): partial(
        _draw_heights, title="{conf.rows} by {conf.columns}, ahead is up", aspect="equal"
    ),
    ("depth_strip", ""): _draw_depth_strip,
    ("ground_profile", ""): partial(
        _draw_heights, title="{conf.rows} rays by {conf.columns}, far is up", aspect="auto"
    ),
    ("command_costs", ""): _draw_command_costs,
    ("way_left", ""): _draw_way_left,
}  # fmt: skip
# Kinds of these whose panels are polar, as those of LiDARs are.
POLAR = {"way_left"}
