"""Level worlds with boxes, and bodies, for tests of pictures."""

import numpy as np

from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

SIZE = (96, 72)


def plain(*props: Prop, heights: np.ndarray | None = None) -> World:
    """Ground, 20 by 20 m, level unless told otherwise, with things on it."""
    ground = HeightField(np.zeros((11, 11)) if heights is None else heights, 2.0, (-10.0, -10.0))
    return World("plain", ground, props, region=(-4, 4, -4, 4))


def box(x: float, y: float, length: float, width: float, height: float, **settings) -> Prop:
    kind = "box" if settings.get("solid", True) else "water"
    return Prop("box", kind, *upright_box((x, y), 0.0, -0.1, height, length, width), **settings)


def wavy_world(relief_m: float = 0.4, *props: Prop) -> World:
    """Ground, 60 by 60 m, with waves of 12 m and of `relief_m` from top to bottom, and things on it."""
    at = np.arange(-30.0, 30.1, 0.25)
    heights = relief_m / 2 * np.sin(at[:, None] * np.pi / 6) * np.cos(at * np.pi / 6)
    return World("wavy", HeightField(heights, 0.25, (-30.0, -30.0)), props, region=(-4, 4, -4, 4))
