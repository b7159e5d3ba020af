"""A quiet map below tracks: relief in grey, water, plants, and objects from above."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from dune_rl.geometry.arrays import Array
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
