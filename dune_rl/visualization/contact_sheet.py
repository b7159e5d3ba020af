"""Contact sheets: the readings of all sensors of one agent at one instant, on one page."""

from collections.abc import Callable
from functools import partial
from typing import Any

from matplotlib.figure import Figure
from numpy.typing import NDArray

from dune_rl.sensors.settings import SensorSettings
from dune_rl.visualization.reading_panels import (
    INK,
    LABELS,
    PANELS,
    PAPER,
    POLAR,
    Picture,
    Readings,
    Sensors,
    draw_numbers,
    draw_scans,
    draw_values,
    style_axes,
)

# What draws a panel, and whether its axes are polar.
_Panel = tuple[Callable[[Any], None], bool]
_COLUMNS = 4
# Readings of more values are drawn.
_MOST_NUMBERS = 9


def contact_sheet(readings: Readings, conf: Sensors, picture: Picture, title: str) -> Figure:
    """A page with `picture` (H, W, 3) of the scene and a panel for each of one agent's `readings`."""
    panels = _choose_panels(readings, conf)
    # The picture takes two columns and two rows at the top left of the grid.
    rows = 2 + max(0, -(-(len(panels) - 2 * (_COLUMNS - 2)) // _COLUMNS))
    figure = Figure(figsize=(4.0 * _COLUMNS, 3.3 * rows + 0.5), facecolor=PAPER, layout="constrained")
    figure.suptitle(title, color=INK, fontsize=17, x=0.01, ha="left")
    grid = figure.add_gridspec(rows, _COLUMNS)
    scene = figure.add_subplot(grid[:2, :2])
    scene.imshow(picture)
    style_axes(scene, "scene")
    cells = [(row, column) for row in range(rows) for column in range(_COLUMNS) if row > 1 or column > 1]
    for (draw, is_polar), cell in zip(panels, cells, strict=False):
        draw(figure.add_subplot(grid[cell], projection="polar" if is_polar else None))
    return figure


def _choose_panels(readings: Readings, conf: Sensors) -> list[_Panel]:
    """The panels: of sensors that are called after their kind, of others, of LiDARs, and of what is left."""
    plain = {kind: conf[kind] for kind in LABELS if kind in conf and conf[kind].sensor == kind}
    panels: list[_Panel] = []
    scans: list[_Panel] = []
    shown: set[str] = set()
    for name, settings in (plain | dict(conf)).items():
        label = LABELS.get(name, name) if name == settings.sensor else name
        for (kind, output), draw in PANELS.items():
            reading = f"{name}_{output}" if output else name
            if kind == settings.sensor and reading in readings:
                drawn = partial(draw, reading=readings[reading], conf=settings, label=label)
                panels.append((drawn, kind in POLAR))
                shown.add(reading)
        if settings.sensor == "lidar":
            seen = _seen_with(name, readings, conf)
            if seen:
                drawn = partial(draw_scans, seen=seen, goal=readings.get("goal"), conf=settings, label=label)
                scans.append((drawn, True))
                shown |= set(seen)
    panels += scans
    rest = {name: value for name, value in readings.items() if name not in shown}
    long = {name: value for name, value in rest.items() if value.size > _MOST_NUMBERS}
    panels += [(partial(draw_values, name=name, values=value), False) for name, value in long.items()]
    numbers = {name: value for name, value in rest.items() if name not in long}
    if numbers:
        panels.append((partial(draw_numbers, readings=numbers), False))
    return panels


def _seen_with(
    lidar: str, readings: Readings, conf: Sensors
) -> dict[str, tuple[SensorSettings, NDArray[Any]]]:
    """What is drawn as seen by a LiDAR: the sensor's settings and the reading, by the readings' names."""
    seen = {}
    for name, settings in conf.items():
        source: Any = settings
        if settings.sensor == "low_obstacles":
            source = conf.get(source.tracks)
        of = name if settings.sensor == "lidar" else getattr(source, "lidar", None)
        if of == lidar and name in readings:
            seen[name] = settings, readings[name]
    return seen
