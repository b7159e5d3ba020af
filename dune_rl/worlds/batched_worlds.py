"""The worlds and weathers of a batch of scenes, queried together."""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, freeze
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.shared_per_scene import SharedPerScene, query_grouped
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.rendering.weather import Haze, WeatherConf
from dune_rl.worlds.appearance import with_own_sun
from dune_rl.worlds.world import World


@dataclass(frozen=True, eq=False)
class WorldAppearance:
    """A world and the weather it is rendered in."""

    world: World
    weather: WeatherConf

    @property
    def media(self) -> ParticipatingMedia:
        """Haze and grass that light passes on its way to a camera."""
        grass = self.world.grass
        return ParticipatingMedia(
            Haze.from_weather(with_own_sun(self.world, self.weather)),
            None if grass is None else grass.foliage,
        )


class BatchedWorlds:
    """The world and the weather of each of M scenes.

    Points and results have the leading axis M. Each query runs once per distinct world, not once per scene;
    where all scenes share a world, it costs as much as that world's own query.
    """

    def __init__(self, scenes: Sequence[tuple[World, WeatherConf]]) -> None:
        world, weather = scenes[0]
        first = WorldAppearance(world, weather)
        self.worlds: SharedPerScene[World] = SharedPerScene([world] * len(scenes))
        self.appearances: SharedPerScene[WorldAppearance] = SharedPerScene([first] * len(scenes))
        self._terrains = self.worlds.map(attrgetter("terrain"))
        self._extents = np.tile(np.array(world.extent), (len(scenes), 1))
        for scene, (its_world, its_weather) in enumerate(scenes):
            self.put(scene, its_world, its_weather)

    def __len__(self) -> int:
        return len(self.worlds)

    def put(self, scene: int, world: World, weather: WeatherConf) -> None:
        """Replace the world and the weather of one scene."""
        self.worlds.put(scene, world)
        extents = self._extents.copy()
        extents[scene] = world.extent
        self._extents = freeze(extents)
        if self.appearances[scene].world is world and self.appearances[scene].weather == weather:
            return
        # Scenes of equal world and weather share one appearance, so that they are rendered together.
        equal = (
            appearance
            for appearance, _ in self.appearances.groups
            if appearance.world is world and appearance.weather == weather
        )
        self.appearances.put(scene, next(equal, None) or WorldAppearance(world, weather))

    @property
    def extents(self) -> Array:
        """The rectangles (xmin, xmax, ymin, ymax) [m] of the terrains, (M, 4)."""
        return self._extents

    def height(self, xy: Array, scenes: NDArray[np.int64] | None = None) -> Array:
        """Height of the ground [m], (M, ...), at points (M, ..., 2), or, of m `scenes` (m,), (m, ..., 2)."""
        terrains = self._terrains
        groups = terrains.groups if scenes is None else terrains.select_groups(scenes)
        return query_grouped(groups, HeightField.height, xy)

    def clearance(self, xy: Array, scenes: NDArray[np.int64] | None = None) -> Array:
        """As `World.clearance`: distance [m], (M, ...), from points (M, ..., 2) to the nearest obstacle.

        Of m `scenes` (m,) only, points are (m, ..., 2).
        """
        groups = self.worlds.groups if scenes is None else self.worlds.select_groups(scenes)
        return query_grouped(groups, World.clearance, xy)
