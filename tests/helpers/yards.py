"""Level yards with boxes, and bumpy ground, for tests of what walks there."""

import numpy as np

from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

# x, y, yaw, length and width of a box.
Box = tuple[float, float, float, float, float]
BOXES: list[Box] = [(0.0, 0.0, 0.5, 2.0, 1.0), (-5.0, 4.0, 0.0, 1.0, 1.0), (4.0, -5.0, 1.0, 3.0, 0.4)]
# Way points of a path round no corner.
BEND = np.array([[-6.0, -4.0], [-2.0, -3.0], [1.0, -6.0], [6.0, -6.0]])


def hills(half: int = 10) -> HeightField:
    heights = np.random.default_rng(0).normal(0.0, 0.2, (2 * half + 1, 2 * half + 1))
    return HeightField(heights, 1.0, (-half, -half))


def yard(*boxes: Box, half: int = 10) -> World:
    """Level ground, twice `half` m wide, with boxes."""
    terrain = HeightField(np.zeros((2 * half + 1, 2 * half + 1)), 1.0, (-half, -half))
    props = [
        Prop(f"box_{i}", "box", *upright_box((x, y), yaw, -0.1, 1.0, length, width))
        for i, (x, y, yaw, length, width) in enumerate(boxes)
    ]
    return World("yard", terrain, props, region=(-half, half, -half, half))


def points_anywhere(rng: np.random.Generator, n: int, radius_m: float) -> np.ndarray:
    """Points (n, 2) in the yard, free or not."""
    return rng.uniform(-9.0, 9.0, (n, 2))
