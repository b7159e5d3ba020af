"""Contact sheets: the readings of all sensors of one agent at one instant, on one page."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.settings import SensorSettings

Picture = NDArray[np.uint8]
Readings = Mapping[str, NDArray[Any]]
Sensors = Mapping[str, SensorSettings]
# What draws a panel, the names of the readings in it, and its projection.
Panel = tuple[Callable[..., None], list[str], str | None]

_PAPER, _INK, _FAINT = "#10151c", "#e8ecf1", "#3a4656"
_WARM, _COOL, _GREEN = "#ffc43d", "#5bb8ff", "#40d67a"
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
_COLUMNS = 4


def contact_sheet(readings: Readings, conf: Sensors, picture: Picture, title: str) -> Figure:
    """A page with `picture` (H, W, 3) of the scene and a panel for each of one agent's `readings`."""
    panels = _choose_panels(readings, conf)
    shown = {name for _, names, _ in panels for name in names}
    vectors = {name: value for name, value in readings.items() if name not in shown}
    if vectors:
        panels.append((partial(_draw_numbers, readings=vectors), [], None))
    # The picture takes two columns and two rows at the top left of the grid.
    rows = 2 + max(0, -(-(len(panels) - 2 * (_COLUMNS - 2)) // _COLUMNS))
    figure = Figure(figsize=(4.0 * _COLUMNS, 3.3 * rows + 0.5), facecolor=_PAPER, layout="constrained")
    figure.suptitle(title, color=_INK, fontsize=17, x=0.01, ha="left")
    grid = figure.add_gridspec(rows, _COLUMNS)
    scene = figure.add_subplot(grid[:2, :2])
    scene.imshow(picture)
    _style(scene, "scene")
    cells = [(row, column) for row in range(rows) for column in range(_COLUMNS) if row > 1 or column > 1]
    for (draw, _, projection), cell in zip(panels, cells, strict=False):
        draw(figure.add_subplot(grid[cell], projection=projection))
    return figure


def _choose_panels(
    readings: Readings, conf: Sensors
) -> list[tuple[Callable[..., None], list[str], str | None]]:
    """The panels: first those of sensors that are called after their kind, and last planar LiDARs."""
    plain = {kind: conf[kind] for kind in _LABELS if kind in conf and conf[kind].sensor == kind}
    panels: list[Panel] = []
    scans: list[Panel] = []
    for name, settings in (plain | dict(conf)).items():
        kind = settings.sensor
        label = _LABELS[kind] if name == kind and kind in _LABELS else name
        for (panel_kind, output), draw in _PANELS.items():
            reading = f"{name}_{output}" if output else name
            if panel_kind == kind and reading in readings:
                drawn = partial(draw, reading=readings[reading], conf=settings, label=label)
                panels.append((drawn, [reading], None))
        past, now = readings.get(f"{name}_past"), readings.get(name)
        if kind == "lidar" and (past is not None or now is not None):
            drawn = partial(
                _draw_scans, past=past, now=now, goal=readings.get("goal"), conf=settings, label=label
            )
            scans.append((drawn, [f"{name}_past", name], "polar"))
    return panels + scans


def _style(axes: Axes, title: str) -> None:
    axes.set_title(title, color=_INK, fontsize=11, loc="left")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor(_PAPER)
    for spine in axes.spines.values():
        spine.set_color(_FAINT)


def _bar(axes: Axes, image: Any, label: str) -> None:
    bar = axes.figure.colorbar(image, ax=axes, fraction=0.045, pad=0.02)
    bar.set_label(label, color=_INK, fontsize=9)
    bar.ax.tick_params(colors=_INK, labelsize=8)
    bar.outline.set_edgecolor(_FAINT)


def _draw_image(
    axes: Axes, reading: NDArray[Any], conf: Any, label: str, *, title: str, bar: str = "",
    shown: Callable[[NDArray[Any], Any], NDArray[Any]] = lambda reading, conf: reading, **options: Any,
) -> None:  # fmt: skip
    image = axes.imshow(shown(reading, conf), interpolation="nearest", **options)
    _style(axes, f"{label}, {title.format(conf=conf, reading=reading)}")
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
    _style(axes, f"{label}, segments")
    present = [segment for segment in Segment if (segments == segment).any()]
    handles = [Patch(color=_SEGMENT_COLOURS[each], label=each.name.lower()) for each in present]
    axes.legend(
        handles=handles, loc="lower left", fontsize=7, framealpha=0.75, facecolor=_PAPER, labelcolor=_INK
    )


def _draw_height_scan(axes: Axes, reading: NDArray[Any], conf: Any, label: str) -> None:
    # Ahead is up, left is left.
    _draw_image(
        axes, reading.reshape(conf.rows, conf.columns)[::-1, ::-1], conf, label,
        title="{conf.rows} by {conf.columns}, ahead is up", bar="m above the ground below", cmap="BrBG_r",
        norm=CenteredNorm(halfrange=max(0.1, float(np.abs(reading).max()))), aspect="equal",
    )  # fmt: skip


def _draw_depth_strip(axes: Axes, reading: NDArray[Any], conf: Any, label: str) -> None:
    width = conf.fov_deg / len(reading)
    to_the_right = (len(reading) / 2 - np.arange(len(reading)) - 0.5) * width
    _style(axes, f"{label}, seen from inside")
    axes.bar(to_the_right, reading, width=width * 0.9, color=_COOL)
    axes.set_ylim(0.0, conf.range_m)
    axes.set_ylabel("m", color=_INK, fontsize=9)
    axes.set_xlabel("degrees to the right", color=_INK, fontsize=9)
    axes.tick_params(colors=_INK, labelsize=8)
    axes.set_xticks([-40, -20, 0, 20, 40])
    axes.set_yticks(np.linspace(0.0, conf.range_m, 5))


def _draw_scans(
    axes: Any, past: NDArray[Any] | None, now: NDArray[Any] | None, goal: NDArray[Any] | None, conf: Any,
    label: str,
) -> None:  # fmt: skip
    axes.set_theta_zero_location("N")
    axes.set_facecolor(_PAPER)
    axes.set_title(f"{label}, ahead is up", color=_INK, fontsize=11, loc="left")
    for ranges, colour, opacity, when in ((past, _COOL, 0.45, "past"), (now, _WARM, 0.9, "now")):
        if ranges is not None:
            fov_rad = np.deg2rad(conf.fov_deg)
            width = fov_rad / len(ranges)
            bearing = -fov_rad / 2 + (np.arange(len(ranges)) + 0.5) * width
            hit = ranges < conf.range_m * 0.999
            axes.bar(
                bearing[hit], 0.35, width=width * 0.92, bottom=ranges[hit] - 0.18, color=colour,
                alpha=opacity, label=when,
            )  # fmt: skip
    if goal is not None:
        distance, bearing_goal = goal
        axes.plot([bearing_goal], [min(distance, conf.range_m)], "o", color=_GREEN, label="goal")
    axes.set_ylim(0.0, conf.range_m)
    axes.tick_params(colors=_INK, labelsize=7)
    axes.grid(color=_FAINT)
    axes.legend(loc="lower right", fontsize=7, facecolor=_PAPER, labelcolor=_INK, framealpha=0.75)


def _draw_numbers(axes: Axes, readings: Readings) -> None:
    _style(axes, "numbers")
    lines = []
    for name, values in readings.items():
        text = "  ".join(f"{value:8.3f}" for value in np.ravel(values)[:9])
        parts = [text[start : start + 30] for start in range(0, len(text), 30)]
        lines += [name, *(f"   {part}" for part in parts)]
    axes.text(
        0.02, 0.98, "\n".join(lines), color=_INK, fontsize=8, family="monospace", va="top",
        transform=axes.transAxes,
    )  # fmt: skip


_LABELS = {
    "camera": "camera",
    "lidar_3d": "3D LiDAR",
    "height_scan": "height scan",
    "depth_strip": "depth strip",
    "lidar": "LiDAR",
}
# By kind of sensor and output; sensors with a single output have an empty one.
_PANELS: dict[tuple[str, str], Callable[..., None]] = {
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
    ("height_scan", ""): _draw_height_scan,
    ("depth_strip", ""): _draw_depth_strip,
}  # fmt: skip
