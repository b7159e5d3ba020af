"""Maps of the built-in worlds, and pieces of small worlds, for the tests of maps."""

from functools import cache

import numpy as np
from matplotlib.figure import Figure

from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose
from dune_rl.geometry.heightfield import HeightField
from dune_rl.reporting.views import maps
from dune_rl.visualization.site_map.panel import MapContent
from dune_rl.worlds.world import Prop, World

Corner = tuple[float, float, float]
WORLDS = ("flat", "inspection", "construction", "rubicon", "island")
# Coarse maps, for tests that are not about their pixels.
COARSE = "dpi=72"


def conf_of(*words: str) -> ViewConf:
    return compose(ViewConf, [*words, "view=map", COARSE])


@cache
def site(world: str) -> MapContent:
    return maps.map_content(conf_of(f"+world={world}"), [])


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def box(name: str, low: Corner, high: Corner, kind: str = "box", **more: bool) -> Prop:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    vertices = np.array(low) + corners * (np.array(high) - low)
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 7, 3), (1, 5, 7),
    ]  # fmt: skip
    return Prop(name, kind, vertices, np.array(faces, np.int32), **more)


def ramp(slope: float) -> HeightField:
    x = np.arange(21.0) - 10.0
    return HeightField(np.tile(slope * x, (21, 1)), 1.0, (-10.0, -10.0))


def world_with(*props: Prop, slope: float = 0.0) -> World:
    return World("test", ramp(slope), props, region=(-4.0, 4.0, -4.0, 4.0))
