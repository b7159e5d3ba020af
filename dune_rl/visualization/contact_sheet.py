"""Contact sheets: what every sensor of a rover says at one instant, on one page."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.conf import SensorsConf

Picture = NDArray[np.uint8]
Readings = Mapping[str, NDArray[Any]]

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


def contact_sheet(readings: Readings, conf: SensorsConf, picture: Picture, title: str) -> Figure:
    """A page with `picture` (H, W, 3) of the scene and a panel for each of one rover's `readings`."""
    panels = [(name, _PANELS[name]) for name in _PANELS if name in readings]
    scans = [name for name in ("lidar", "lidar_past") if name in readings]
    vectors = [name for name in readings if name not in _PANELS and name not in scans]
    count = len(panels) + bool(scans) + bool(vectors)
    # The picture takes two columns and two rows of the grid's top left.
    rows = 2 + max(0, -(-(count - 2 * (_COLUMNS - 2)) // _COLUMNS))
    figure = Figure(figsize=(4.0 * _COLUMNS, 3.3 * rows + 0.5), facecolor=_PAPER, layout="constrained")
    figure.suptitle(title, color=_INK, fontsize=17, x=0.01, ha="left")
    grid = figure.add_gridspec(rows, _COLUMNS)
    scene = figure.add_subplot(grid[:2, :2])
    scene.imshow(picture)
    _bare(scene, "scene")
    cells = [(row, column) for row in range(2) for column in range(2, _COLUMNS)]
    cells += [(row, column) for row in range(2, rows) for column in range(_COLUMNS)]
    for (name, draw), cell in zip(panels, cells, strict=False):
        draw(figure.add_subplot(grid[cell]), readings[name], conf)
    left = cells[len(panels) :]
    if scans:
        _scans(figure.add_subplot(grid[left.pop(0)], projection="polar"), readings, conf)
    if vectors:
        _numbers(figure.add_subplot(grid[left.pop(0)]), {name: readings[name] for name in vectors})
    return figure


def _bare(axes: Axes, title: str) -> None:
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


def _rgb(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    axes.imshow(reading, interpolation="nearest")
    _bare(axes, f"camera, RGB, {conf.camera.width} by {conf.camera.height}")


def _grey(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    axes.imshow(reading[..., 0], cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    _bare(axes, "camera, grey")


def _depth(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    metres = np.where(reading[..., 0] >= conf.camera.range_m * 0.999, np.nan, reading[..., 0])
    image = axes.imshow(
        metres, cmap="magma_r", norm=LogNorm(0.1, conf.camera.range_m), interpolation="nearest"
    )
    _bare(axes, "camera, depth")
    _bar(axes, image, "m")


def _segmentation(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    _segments(axes, reading[..., 0], "camera, segments", "equal")


def _segments(axes: Axes, segments: NDArray[Any], title: str, aspect: Any) -> None:
    colours = ListedColormap([_SEGMENT_COLOURS[segment] for segment in Segment])
    axes.imshow(
        segments, cmap=colours, vmin=-0.5, vmax=len(Segment) - 0.5, interpolation="nearest", aspect=aspect
    )
    _bare(axes, title)
    present = [segment for segment in Segment if (segments == segment).any()]
    handles = [Patch(color=_SEGMENT_COLOURS[each], label=each.name.lower()) for each in present]
    axes.legend(
        handles=handles, loc="lower left", fontsize=7, framealpha=0.75, facecolor=_PAPER, labelcolor=_INK
    )


def _normals(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    axes.imshow(np.clip((reading + 1.0) / 2.0, 0.0, 1.0), interpolation="nearest")
    _bare(axes, "camera, normals")


def _rings(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    metres = np.where(reading[..., 0] >= conf.lidar_3d.range_m * 0.999, np.nan, reading[..., 0])
    image = axes.imshow(metres[:, ::-1], cmap="turbo_r", aspect="auto", interpolation="nearest")
    _bare(axes, f"3D LiDAR, {reading.shape[0]} rings, seen from within")
    _bar(axes, image, "m")


def _intensity(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    image = axes.imshow(reading[:, ::-1, 0], cmap="viridis", aspect="auto", interpolation="nearest")
    _bare(axes, "3D LiDAR, intensity")
    _bar(axes, image, "share returned")


def _ring_segments(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    _segments(axes, reading[:, ::-1, 0], "3D LiDAR, segments", "auto")


def _height_scan(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    scan = conf.height_scan
    grid = reading.reshape(scan.rows, scan.columns)
    limit = max(0.1, float(np.abs(grid).max()))
    # Ahead is up, and left is left.
    image = axes.imshow(
        grid[::-1, ::-1], cmap="BrBG_r", vmin=-limit, vmax=limit, interpolation="nearest", aspect="equal"
    )
    _bare(axes, f"height scan, {scan.rows} by {scan.columns}, ahead is up")
    _bar(axes, image, "m over the rover's ground")


def _depth_strip(axes: Axes, reading: NDArray[Any], conf: SensorsConf) -> None:
    strip = conf.depth_strip
    width = np.rad2deg(strip.fov_rad) / len(reading)
    to_the_right = (len(reading) / 2 - np.arange(len(reading)) - 0.5) * width
    _bare(axes, "depth strip, seen from within")
    axes.bar(to_the_right, reading, width=width * 0.9, color=_COOL)
    axes.set_ylim(0.0, strip.range_m)
    axes.set_ylabel("m", color=_INK, fontsize=9)
    axes.set_xlabel("degrees to the right", color=_INK, fontsize=9)
    axes.tick_params(colors=_INK, labelsize=8)
    axes.set_xticks([-40, -20, 0, 20, 40])
    axes.set_yticks(np.linspace(0.0, strip.range_m, 5))


def _scans(axes: Any, readings: Readings, conf: SensorsConf) -> None:
    axes.set_theta_zero_location("N")
    axes.set_facecolor(_PAPER)
    axes.set_title("LiDAR, ahead is up", color=_INK, fontsize=11, loc="left")
    for name, colour, label in (("lidar_past", _COOL, "a moment ago"), ("lidar", _WARM, "now")):
        if name in readings:
            ranges = readings[name]
            lidar = conf.lidar
            width = lidar.fov_rad / len(ranges)
            bearing = -lidar.fov_rad / 2 + (np.arange(len(ranges)) + 0.5) * width
            seen = ranges < lidar.range_m * 0.999
            axes.bar(
                bearing[seen], 0.35, width=width * 0.92, bottom=ranges[seen] - 0.18, color=colour,
                alpha=0.9 if name == "lidar" else 0.45, label=label,
            )  # fmt: skip
    if "goal" in readings:
        distance, bearing_goal = readings["goal"]
        axes.plot([bearing_goal], [min(distance, conf.lidar.range_m)], "o", color=_GREEN, label="goal")
    axes.set_ylim(0.0, conf.lidar.range_m)
    axes.tick_params(colors=_INK, labelsize=7)
    axes.grid(color=_FAINT)
    axes.legend(loc="lower right", fontsize=7, facecolor=_PAPER, labelcolor=_INK, framealpha=0.75)


def _numbers(axes: Axes, readings: Readings) -> None:
    _bare(axes, "numbers")
    lines = []
    for name, values in readings.items():
        text = "  ".join(f"{value:8.3f}" for value in np.ravel(values)[:9])
        parts = [text[start : start + 30] for start in range(0, len(text), 30)]
        lines += [name, *(f"   {part}" for part in parts)]
    axes.text(
        0.02, 0.98, "\n".join(lines), color=_INK, fontsize=8, family="monospace", va="top",
        transform=axes.transAxes,
    )  # fmt: skip


_PANELS: dict[str, Callable[[Axes, NDArray[Any], SensorsConf], None]] = {
    "camera_rgb": _rgb,
    "camera_depth": _depth,
    "camera_segmentation": _segmentation,
    "camera_normals": _normals,
    "camera_grey": _grey,
    "lidar_3d_range": _rings,
    "lidar_3d_intensity": _intensity,
    "lidar_3d_segmentation": _ring_segments,
    "height_scan": _height_scan,
    "depth_strip": _depth_strip,
}
