"""Manages the world, weather and physics of each scene of a simulation over its episodes."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.env.body import SceneBodies
from dune_rl.env.domain_randomizer import DomainRandomizer, Values
from dune_rl.env.scene_spec import scene_spec
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.physics.interface import PhysicsConf, PhysicsRobot, PhysicsScene, SceneSpec, step_scene
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

# Number of draws of a world: one without room for the agents is replaced by another.
_MAX_DRAWS = 8
_SETTLE_S = 0.1

MakeScene = Callable[[SceneSpec], PhysicsScene]


class RoomCheck(Protocol):
    """Finds out whether a world has room for the agents, and prepares what they need there."""

    def __call__(self, world: World) -> None:
        """Raise `WorldError` where there is none."""
        ...


class SceneManager:
    """Manages the world, weather and physics of each of M scenes.

    All scenes start with `world`. If the randomizer draws worlds, a scene has no physics until it enters its
    first one. `worlds` has the present worlds of all scenes; `values` (M, n) are the sampled values of the
    present episodes, in the order of `randomizer.names`. `extent` is the rectangle (xmin, xmax, ymin, ymax)
    [m] that holds the worlds of all episodes, by which readings are bounded.
    """

    def __init__(
        self,
        world: World,
        weather: WeatherConf,
        randomizer: DomainRandomizer,
        make_scene: MakeScene,
        physics: PhysicsConf,
        num_scenes: int,
        *,
        measures_work: bool = False,
    ) -> None:
        self.randomizer, self.conf = randomizer, physics
        self.extent = randomizer.common_extent or world.extent
        self.worlds = BatchedWorlds([(world, weather)] * num_scenes)
        self.values = np.zeros((num_scenes, len(randomizer.names)))
        self.most_bodies = 0
        self._world = world
        self._make_scene, self._measures_work = make_scene, measures_work
        self._bodies = SceneBodies()
        self._confs: list[Any] = [None] * num_scenes
        self._rejected: dict[Any, str] = {}
        self._physics: list[PhysicsScene | None] = [None] * num_scenes
        self._specs: WeakKeyDictionary[World, SceneSpec] = WeakKeyDictionary()
        self._kinematic_poses = np.zeros((num_scenes, 0, 6))

    def build(self, bodies: SceneBodies) -> None:
        """Build the physics of the scenes with `bodies`, unless the first reset draws their worlds."""
        self._bodies = bodies
        self._kinematic_poses = np.zeros((len(self.worlds), len(bodies.kinematics), 6))
        if not self.randomizer.randomizes_worlds:
            for scene in range(len(self.worlds)):
                self._build_scene(scene, self._world)

    def _build_scene(self, scene: int, world: World) -> None:
        # Scenes of one world share its static bodies, which DART then reads once.
        if world not in self._specs:
            self._specs[world] = scene_spec(
                world, self._bodies.robots, self._bodies.kinematics, self.conf, self._measures_work
            )
        spec = self._specs[world]
        before = self._physics[scene]
        if before is not None:
            before.close()
        self._physics[scene] = self._make_scene(spec)
        bodies = len(spec.statics) + len(spec.kinematics) + len(spec.robots)
        self.most_bodies = max(self.most_bodies, bodies)

    # -- a new episode ----------------------------------------------------------------------------

    def enter(
        self, scene: int, seed: int, episode: int, check_room: RoomCheck, difficulty: float = 1.0
    ) -> World:
        """Set world, weather and robot bodies of a scene for an episode; returns the world.

        `difficulty` is that of the episode's curriculum. Raises `WorldError` if none of the drawn worlds has
        room.
        """
        values = self.randomizer.draw(seed, episode, difficulty=difficulty)
        if self.randomizer.randomizes_worlds:
            values = self._enter_world(scene, seed, episode, check_room, difficulty)
        elif self.values.shape[1]:
            self.worlds.put(scene, self._world, self.randomizer.variation(values).weather)
        self.values[scene] = values
        if self.randomizer.randomizes_bodies:
            for robot in self.physics(scene).robots:
                robot.set_body(self.randomizer.variation(values).body)
        return self.worlds.worlds[scene]

    def _enter_world(
        self, scene: int, seed: int, episode: int, check_room: RoomCheck, difficulty: float
    ) -> Values:
        for attempt in range(_MAX_DRAWS):
            values = self.randomizer.draw(seed, episode, attempt, difficulty)
            conf = self.randomizer.variation(values).world
            try:
                world = self._world_with_room(conf, check_room)
                break
            except WorldError as error:
                # Only the message: the error's traceback would keep the world in memory.
                self._rejected[conf] = str(error)
                if attempt == _MAX_DRAWS - 1:
                    raise
        if self._confs[scene] is None or self.worlds.worlds[scene] is not world:
            self._build_scene(scene, world)
        self._confs[scene] = conf
        self.worlds.put(scene, world, self.randomizer.variation(values).weather)
        return values

    def _world_with_room(self, conf: Any, check_room: RoomCheck) -> World:
        if conf in self._rejected:
            raise WorldError(self._rejected[conf])
        # Another scene may have this world, which takes long to build.
        known = (self.worlds.worlds[scene] for scene, other in enumerate(self._confs) if other == conf)
        world = next(known, None) or self.randomizer.world(conf)
        self._check_extent(world)
        check_room(world)
        return world

    def _check_extent(self, world: World) -> None:
        if self.randomizer.common_extent is None:
            if world.extent != self._world.extent:
                raise ValueError(
                    f"the worlds of {world.name!r} differ in extent ({world.extent} and "
                    f"{self._world.extent}), but observations need the same bounds in all of them"
                )
            return
        (xmin, xmax, ymin, ymax), (left, right, low, high) = self.extent, world.extent
        if left < xmin or right > xmax or low < ymin or high > ymax:
            raise WorldError(f"the world {world.name!r} covers {world.extent}: set world.size_m to hold it")

    def used_worlds(self) -> set[World]:
        """The present worlds of the scenes, and the first one."""
        return {world for world, _ in self.worlds.worlds.groups} | {self._world}

    def reset(self, scene: int, kinematic_poses: Array) -> None:
        """Reset a scene: robots to their start poses, kinematic bodies to `kinematic_poses` (K, 6)."""
        self._kinematic_poses[scene] = kinematic_poses
        self.physics(scene).reset(kinematic_poses)

    def settle(self, scene: int) -> None:
        """Simulate until the robots of a scene have settled on the ground, under their rest commands."""
        count = round(_SETTLE_S * self.conf.physics_hz)
        step_scene(self.physics(scene), count, self._kinematic_poses[scene])

    # -- a step -----------------------------------------------------------------------------------

    def step(self, kinematic_poses: Array, resting: Flags) -> dict[int, Array]:
        """Advance the physics by a control step in the scenes that are not `resting` (M,).

        Kinematic bodies move to poses (M, K, 6). Returns, by scene, the poses (K, 6) reached where a robot
        blocked any of the bodies.
        """
        substeps, built = self.conf.substeps, self.built
        moving = [(index, built[index]) for index in np.flatnonzero(~resting).tolist()]
        held_back = {}
        # One after another, so that the processor has the code of each part in its caches.
        for index, scene in moving:
            scene.begin_step(substeps, kinematic_poses[index])
        for index, scene in moving:
            scene.finish_step()
            reached = scene.held_back_poses()
            if reached is not None:
                held_back[index] = reached
        return held_back

    def step_passive(self) -> None:
        """Advance physics by a control step, with the last commands and without moving kinematic bodies."""
        for scene in range(len(self.worlds)):
            self.physics(scene).step_passive(self.conf.substeps)

    def robots(self, scene: int) -> Sequence[PhysicsRobot]:
        """The robots of a scene, whose physics must have been built."""
        return self.physics(scene).robots

    @property
    def built(self) -> list[PhysicsScene]:
        """The physics of all scenes that have been built, in order."""
        return [scene for scene in self._physics if scene is not None]

    def count_statics(self, scene: int) -> int:
        """Number of static bodies of a scene, whose physics must have been built."""
        return len(self._specs[self.worlds.worlds[scene]].statics)

    def physics(self, scene: int) -> PhysicsScene:
        """The physics of a scene, which must have been built."""
        physics = self._physics[scene]
        assert physics is not None, "a scene has physics once it has entered a world"
        return physics

    def close(self) -> None:
        """Release the physics engine."""
        for physics in self._physics:
            if physics is not None:
                physics.close()


def scene_rows(mask: Flags, count: int) -> Flags:
    """`mask` (M,) of scenes, repeated for the `count` agents of each: (M * count,)."""
    return mask if count == 1 else np.repeat(mask, count)
