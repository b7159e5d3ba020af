"""Where the scenes of a batch are: the world, the weather and the physics of each."""

from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from dune_rl.actors.actor import ActorConf, Actors, capsules
from dune_rl.env.scene import scene_spec
from dune_rl.env.variety import Values, Variety
from dune_rl.errors import WorldError
from dune_rl.physics.interface import PhysicsConf, PhysicsScene, SceneSpec
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.robot import Robot
from dune_rl.seeding import stream
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

# A world in which no rover can start or no walker walk is passed over for another, so many times at most.
_TRIES = 8


class Places:
    """The place of each of M scenes.

    All begin in `world`; where worlds differ, a scene has no physics before it
    enters its first. `sites` tells the worlds, and `values` (M, n) are the drawn
    ones of the present episodes, whose names are those of `variety`.
    """

    def __init__(
        self,
        world: World,
        weather: WeatherConf,
        variety: Variety,
        robots: tuple[Robot, ...],
        make_scene: Callable[[SceneSpec], PhysicsScene],
        physics: PhysicsConf,
        spawn: SpawnConf,
        actors: tuple[ActorConf, ...],
        num_scenes: int,
        *,
        measures_work: bool = False,
    ) -> None:
        self.variety = variety
        self.sites = BatchedWorlds([(world, weather)] * num_scenes)
        self.values = np.zeros((num_scenes, len(variety.names)))
        self.most_bodies = 0
        self._world, self._weather, self._robots = world, weather, robots
        self._make_scene, self._conf, self._spawn = make_scene, physics, spawn
        self._capsules = capsules(actors)
        self._measures_work = measures_work
        self._confs: list[Any] = [None] * num_scenes
        self._unfit: dict[Any, str] = {}
        self._spawners: dict[tuple[World, float], Spawner] = {}
        self._physics: dict[int, PhysicsScene] = {}
        self._specs: WeakKeyDictionary[World, SceneSpec] = WeakKeyDictionary()
        if not variety.of_worlds:
            for scene in range(num_scenes):
                self._build(scene, world)

    @property
    def physics(self) -> list[PhysicsScene]:
        """The physics of every scene; each must have entered a world."""
        return [self._physics[scene] for scene in sorted(self._physics)]

    def spawner(self, scene: int, robot: int = 0) -> Spawner:
        """What draws starts and goals of a robot, counted from 0, in a scene's world."""
        return self.spawner_in(self.sites.worlds[scene], robot)

    def spawner_in(self, world: World, robot: int = 0) -> Spawner:
        """The same in any world; raises WorldError where it has no room."""
        radius = self._robots[robot].footprint_radius_m
        if (world, radius) not in self._spawners:
            self._spawners[world, radius] = Spawner(world, self._spawn, radius)
        return self._spawners[world, radius]

    def enter(self, scene: int, seed: int, episode: int, actors: Actors) -> PhysicsScene:
        """Bring a scene to where an episode of `seed` takes place; its physics.

        Raises WorldError where no world that was drawn has room.
        """
        values = self.variety.draw(seed, episode)
        if self.variety.of_worlds:
            values = self._enter_world(scene, seed, episode, actors)
        elif self.values.shape[1]:
            self.sites.put(scene, self._world, self.variety.weather(values))
        self.values[scene] = values
        if self.variety.of_bodies:
            physics = self._physics[scene]
            for robot in (physics, *physics.others):
                robot.set_body(self.variety.body(values))
        return self._physics[scene]

    def _enter_world(self, scene: int, seed: int, episode: int, actors: Actors) -> Values:
        for attempt in range(_TRIES):
            values = self.variety.draw(seed, episode, attempt)
            conf = self.variety.world_conf(values)
            try:
                world = self._roomy(conf, seed, actors)
                break
            except WorldError as error:
                # Not the error itself, which would keep the world.
                self._unfit[conf] = str(error)
                if attempt == _TRIES - 1:
                    raise
        if self._confs[scene] is None or self.sites.worlds[scene] is not world:
            self._build(scene, world)
        self._confs[scene] = conf
        self.sites.put(scene, world, self.variety.weather(values))
        actors.enter(scene, world)
        used = {world for world, _ in self.sites.worlds.groups} | {self._world}
        self._spawners = {place: spawner for place, spawner in self._spawners.items() if place[0] in used}
        return values

    def _roomy(self, conf: Any, seed: int, actors: Actors) -> World:
        """The world of `conf`, if a rover and the actors find room in it."""
        if conf in self._unfit:
            raise WorldError(self._unfit[conf])
        # Another scene may be there, and a world takes a moment to build.
        known = (self.sites.worlds[scene] for scene, other in enumerate(self._confs) if other == conf)
        world = next(known, None) or self.variety.world(conf)
        if world.extent != self._world.extent:
            raise ValueError(
                f"the worlds of {world.name!r} cover different ground ({world.extent} and "
                f"{self._world.extent}): observations would have no common bounds"
            )
        for robot in range(len(self._robots)):
            self.spawner_in(world, robot)
        actors.find_paths(world, self.spawner_in(world).sample_points, stream(seed, "paths"))
        return world

    def _build(self, scene: int, world: World) -> None:
        # Scenes of one world share their bodies, which DART reads once then.
        if world not in self._specs:
            self._specs[world] = scene_spec(
                world, self._robots[0], self._capsules, self._conf, self._measures_work, self._robots[1:]
            )
        spec = self._specs[world]
        if scene in self._physics:
            self._physics[scene].close()
        self._physics[scene] = self._make_scene(spec)
        self.most_bodies = max(self.most_bodies, spec.first_robot + len(spec.robots))

    def close(self) -> None:
        """Free the physics engine's memory."""
        for physics in self._physics.values():
            physics.close()
