"""The worlds that the scenes of a batch stand in, asked as if there were one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.per_scene import PerScene, asked
from dune_rl.rendering.air import Air
from dune_rl.rendering.weather import Haze, WeatherConf
from dune_rl.worlds.appearance import under_own_sun
from dune_rl.worlds.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Look:
    """A world in a weather."""

    world: World
    weather: WeatherConf

    @property
    def air(self) -> Air:
        """What lies between an eye and what it sees."""
        grass = self.world.grass
        return Air(Haze.of(under_own_sun(self.world, self.weather)), None if grass is None else grass.foliage)


class Sites:
    """The world and the weather of each of M scenes.

    Points and what is told of them have the leading axis M. Each query loops
    over different worlds, never over scenes; where all scenes share one, it
    costs what that world's own query costs.
    """

    def __init__(self, looks: Sequence[tuple[World, WeatherConf]]) -> None:
        world, weather = looks[0]
        first = Look(world, weather)
        self.worlds: PerScene[World] = PerScene([world] * len(looks))
        self.looks: PerScene[Look] = PerScene([first] * len(looks))
        self._terrains = self.worlds.map(_terrain)
        self._extents = np.tile(np.array(world.extent), (len(looks), 1))
        for scene, look in enumerate(looks):
            self.put(scene, *look)

    def __len__(self) -> int:
        return len(self.worlds)

    def put(self, scene: int, world: World, weather: WeatherConf) -> None:
        """Move a scene to `world` in `weather`."""
        self.worlds.put(scene, world)
        self._extents[scene] = world.extent
        if self.looks[scene].world is world and self.looks[scene].weather == weather:
            return
        # Scenes that look alike share one look, so that they are drawn together.
        alike = (look for look, _ in self.looks.groups if look.world is world and look.weather == weather)
        self.looks.put(scene, next(alike, None) or Look(world, weather))

    @property
    def extents(self) -> Array:
        """The rectangles (xmin, xmax, ymin, ymax) [m] of the terrains, (M, 4)."""
        return self._extents

    def height(self, xy: Array) -> Array:
        """Height of the ground [m], (M, ...), at points (M, ..., 2)."""
        return asked(self._terrains.groups, HeightField.height, xy)

    def clearance(self, xy: Array) -> Array:
        """As `World.clearance`: distance [m], (M, ...), from points (M, ..., 2) to what can be hit."""
        return asked(self.worlds.groups, World.clearance, xy)


def _terrain(world: World) -> HeightField:
    return world.terrain
