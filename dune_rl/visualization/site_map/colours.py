"""Colours of maps, distinguishable with every kind of colour vision and by lightness."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

INK, FAINT, PAPER = "#1d1d1f", "#6b6b70", "#ffffff"
# Darker with the slope; slopes over the limit are striped.
SLOPES = ("#fbf9f1", "#f6ebcf", "#efdaab", "#e3c27f", "#cda258")
TOO_STEEP, TOO_STEEP_STRIPE = "#57386e", "#8f72a8"
WATER, GREENERY, GRASS = "#a7d3ef", "#4f9d57", "#9cc24a"
SPAWN, SPAWN_EDGE, PASSAGE = "#2aa7c9", "#0b6d88", "#9fdcec"
CONTOUR = "#6d5435"
DRIVABLE, DRIVABLE_EDGE = "#f1ede4", "#7d766a"
# Cool or dark colours, which contrast with the warm ground.
OBSTACLES = ("#2c3950", "#1d8a86", "#a3b6cc", "#b8437c", "#2c64b4", "#0c0c0e", "#e4e6ea")
PATHS = ("#0072b2", "#c2367f", "#007f5f", "#5b3fa3", "#c2452d", "#0096c7")
# Colour and end mark of an episode's track by its ending; OTHER_ENDING is for endings that are not listed.
ENDINGS = {
    "goal reached": ("#0067b1", "o"),
    "goal reached, after a collision": ("#3fb0e8", "D"),
    "collision": ("#c01030", "*"),
    "stuck": ("#d1570a", "X"),
    "turned over": ("#b8317c", "^"),
    "left the world": ("#111111", "s"),
    "physics diverged": ("#e0b000", "P"),
    "out of time": ("#707070", "v"),
}
OTHER_ENDING = ("#8a6d3b", "p")


def ending_style(ending: str) -> tuple[str, str]:
    """Colour and mark of an ending."""
    return ENDINGS.get(ending, OTHER_ENDING)


def rgb(colour: str) -> Floats:
    """A colour "#rrggbb" as sRGB (3,) in [0, 1]."""
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)]) / 255.0
