"""The worlds that the scenes of a batch stand in, asked as if there were one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.shared_per_scene import SharedPerScene, query_grouped
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.rendering.weather import Haze, WeatherConf
from dune_rl.worlds.appearance import with_own_sun
from dune_rl.worlds.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WorldAppearance:
    """A world in a weather."""

    world: World
    weather: WeatherConf

    @property
    def air(self) -> ParticipatingMedia:
        """What lies between an eye and what it sees."""
        grass = self.world.grass
        return ParticipatingMedia(Haze.of(with_own_sun(self.world, self.weather)), None if grass is None else grass.foliage)


class BatchedWorlds:
    """The world and the weather of each of M scenes.

    Points and what is told of them have the leading axis M. Each query loops
    over different worlds, never over scenes; where all scenes share one, it
    costs what that world's own query costs.
    """

    def __init__(self, looks: Sequence[tuple[World, WeatherConf]]) -> None:
        world, weather = looks[0]
        first = WorldAppearance(world, weather)
        self.worlds: SharedPerScene[World] = SharedPerScene([world] * len(looks))
        self.appearances: SharedPerScene[WorldAppearance] = SharedPerScene([first] * len(looks))
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
        if self.appearances[scene].world is world and self.appearances[scene].weather == weather:
            return
        # Scenes that look alike share one look, so that they are drawn together.
        alike = (look for look, _ in self.appearances.groups if look.world is world and look.weather == weather)
        self.appearances.put(scene, next(alike, None) or WorldAppearance(world, weather))

    @property
    def extents(self) -> Array:
        """The rectangles (xmin, xmax, ymin, ymax) [m] of the terrains, (M, 4)."""
        return self._extents

    def height(self, xy: Array) -> Array:
        """Height of the ground [m], (M, ...), at points (M, ..., 2)."""
        return query_grouped(self._terrains.groups, HeightField.height, xy)

    def clearance(self, xy: Array) -> Array:
        """As `World.clearance`: distance [m], (M, ...), from points (M, ..., 2) to what can be hit."""
        return query_grouped(self.worlds.groups, World.clearance, xy)


def _terrain(world: World) -> HeightField:
    return world.terrain
