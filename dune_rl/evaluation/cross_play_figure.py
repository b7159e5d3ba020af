"""The heat maps of a cross-play: a matrix of robots and populations for each measure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from dune_rl.core.files import write_atomically
from dune_rl.evaluation.tables import describe_estimate
from dune_rl.metrics.catalogue import measure_of
from dune_rl.statistics.intervals import Estimate

Row = Mapping[str, Any]
_LONGEST_NAME = 22
_LIGHT = 0.45
# Obstacle clearance is measured up to this distance [m]: where nothing is nearer, it is no result of driving,
# and would leave all other cells pale.
_CLEARANCE, _FARTHEST_M = "OC", 12.0 - 1e-3
_BEYOND, _NOTHING_NEAR = "#e4e4e8", "12.00\nnothing\nnearer"


def describe_cell(row: Row, separator: str = " ") -> str:
    """Value and interval of a row, shares in per cent; a dash where nothing was measured."""
    value, low, high = (float(row[key]) for key in ("value", "low", "high"))
    return describe_estimate(measure_of(str(row["measure"])), Estimate(value, low, high, 0), separator)


def cells_of(rows: Sequence[Row], measure: str) -> dict[tuple[str, str, str], Row]:
    """The rows of a measure, by robot, its group and the population."""
    return {
        (str(row["robot"]), str(row["group"]), str(row["population"])): row
        for row in rows
        if row["measure"] == measure
    }


def draw_matrices(rows: Sequence[Row], measures: Sequence[str], path: Path) -> None:
    """Draw `rows` (robot, group, population, measure, value, low, high) as a PNG, better values darker."""
    shown = [measure for measure in measures if any(row["measure"] == measure for row in rows)]
    populations = list(dict.fromkeys(str(row["population"]) for row in rows))
    robots = list(dict.fromkeys((str(row["robot"]), str(row["group"])) for row in rows))
    width = 1.6 + len(shown) * max(1.9, 1.25 * len(populations))
    height = 1.4 + 0.62 * len(robots)
    with rc_context({"font.family": "DejaVu Sans", "font.size": 8}):
        figure = Figure(figsize=(width, height), dpi=160, layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        grid = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
        for axes, measure in zip(grid, shown, strict=True):
            _draw(axes, measure, cells_of(rows, measure), robots, populations)
        grid[0].set_ylabel("robot")
        figure.supxlabel("in brackets: 95 % intervals; darker is better", fontsize=7, color="#6b6b70")
        with write_atomically(path) as temporary:
            figure.savefig(temporary, format="png")


def _draw(
    axes: Axes,
    measure: str,
    cells: Mapping[tuple[str, str, str], Row],
    robots: Sequence[tuple[str, str]],
    populations: Sequence[str],
) -> None:
    about = measure_of(measure)
    nothing: Row = {"value": np.nan}
    values = np.array(
        [[float(cells.get((*robot, name), nothing)["value"]) for name in populations] for robot in robots]
    )
    beyond = values >= _FARTHEST_M if measure == _CLEARANCE else np.zeros(values.shape, bool)
    measured = np.where(beyond, np.nan, values)
    lowest, highest = (0.0, 1.0) if about.is_share else _range(measured, about.better)
    shade = (measured - lowest) / (highest - lowest)
    if about.better == "lower":
        shade = 1.0 - shade
    colours = colormaps["Blues"](0.08 + 0.82 * np.nan_to_num(shade))
    colours[beyond] = to_rgba(_BEYOND)
    axes.imshow(colours, aspect="auto")
    for (*robot, name), cell in cells.items():
        row, column = robots.index((robot[0], robot[1])), populations.index(name)
        text = _NOTHING_NEAR if beyond[row, column] else describe_cell(cell, "\n")
        colour = "white" if shade[row, column] > 1 - _LIGHT else "#1d1d1f"
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    axes.set_yticks(range(len(robots)), [_short(row_title(*robot, robots)) for robot in robots])
    axes.set_xticks(range(len(populations)), [_short(name) for name in populations], rotation=20, ha="right")
    unit = "" if about.is_share or not about.unit else f" [{about.unit}]"
    axes.set_title(f"{measure}: {about.meaning}{unit}", fontsize=8, loc="left")
    axes.set_xlabel("among")
    axes.tick_params(which="both", length=0)
    axes.set_xticks(np.arange(len(populations) - 1) + 0.5, minor=True)
    axes.set_yticks(np.arange(len(robots) - 1) + 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=2.0)
    axes.spines[:].set_visible(False)


def row_title(robot: str, group: str, robots: Sequence[tuple[str, str]]) -> str:
    """The name of a row: the policy's, with its agent group where `robots` are of several groups."""
    return f"{robot}, {group}" if len({each for _, each in robots}) > 1 else robot


def _range(values: np.ndarray, better: str | None) -> tuple[float, float]:
    """Lowest and highest value, apart; from 0 on where less is better, so that none at all is the best."""
    if np.isnan(values).all():
        return 0.0, 1.0
    lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
    if better == "lower" and lowest >= 0.0:
        return 0.0, max(highest, 1.0)
    return (lowest, highest) if highest > lowest else (lowest - 0.5, highest + 0.5)


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"
