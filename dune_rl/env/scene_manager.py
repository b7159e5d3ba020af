"""The scenes of a simulation: the world, the weather and the physics of each, from episode to episode."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dune_rl.env.domain_randomizer import DomainRandomizer, Values
from dune_rl.env.scene_spec import scene_spec
from dune_rl.errors import WorldError
from dune_rl.physics.interface import (
    KinematicCapsule,
    PhysicsConf,
    PhysicsRobot,
    PhysicsScene,
    RobotBody,
    SceneSpec,
)
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

# A world without room for the agents is passed over for another draw, at most so many times.
_TRIES = 8
_SETTLE_S = 0.1

MakeScene = Callable[[SceneSpec], PhysicsScene]


@dataclass(frozen=True)
class SceneBodies:
    """What the groups put into each scene: robots and kinematic bodies, each in the order of its group."""

    robots: tuple[RobotBody, ...]
    kinematics: tuple[KinematicCapsule, ...]


class RoomCheck(Protocol):
    """Finds out whether a world has room for the agents, and prepares what they need there."""

    def __call__(self, world: World) -> None:
        """Raise `WorldError` where there is none."""
        ...


class SceneManager:
    """The world, weather and physics of each of M scenes.

    All begin in `world`; where worlds differ, a scene has no physics before it enters its first. `worlds`
    answers for all scenes, and `values` (M, n) are the sampled ones of the present episodes, named by the
    randomizer.
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
        self.worlds = BatchedWorlds([(world, weather)] * num_scenes)
        self.values = np.zeros((num_scenes, len(randomizer.names)))
        self.most_bodies = 0
        self._world = world
        self._make_scene, self._measures_work = make_scene, measures_work
        self._bodies = SceneBodies((), ())
        self._confs: list[Any] = [None] * num_scenes
        self._rejected: dict[Any, str] = {}
        self._physics: list[PhysicsScene | None] = [None] * num_scenes
        self._specs: WeakKeyDictionary[World, SceneSpec] = WeakKeyDictionary()
        self._kinematic_poses = np.zeros((num_scenes, 0, 4))

    def build(self, bodies: SceneBodies) -> None:
        """Build the scenes that hold `bodies`, where their worlds are known already."""
        self._bodies = bodies
        self._kinematic_poses = np.zeros((len(self.worlds), len(bodies.kinematics), 4))
        if not self.randomizer.randomizes_worlds:
            for scene in range(len(self.worlds)):
                self._build_scene(scene, self._world)

    def _build_scene(self, scene: int, world: World) -> None:
        # Scenes of one world share their bodies, which DART then reads once.
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

    def enter(self, scene: int, seed: int, episode: int, check_room: RoomCheck) -> World:
        """Bring a scene to where an episode of `seed` takes place; gives its world.

        Raises `WorldError` where no world that was drawn has room.
        """
        values = self.randomizer.draw(seed, episode)
        if self.randomizer.randomizes_worlds:
            values = self._enter_world(scene, seed, episode, check_room)
        elif self.values.shape[1]:
            self.worlds.put(scene, self._world, self.randomizer.weather(values))
        self.values[scene] = values
        if self.randomizer.randomizes_bodies:
            for robot in self._scene(scene).robots:
                robot.set_body(self.randomizer.body(values))
        return self.worlds.worlds[scene]

    def _enter_world(self, scene: int, seed: int, episode: int, check_room: RoomCheck) -> Values:
        for attempt in range(_TRIES):
            values = self.randomizer.draw(seed, episode, attempt)
            conf = self.randomizer.world_conf(values)
            try:
                world = self._world_with_room(conf, check_room)
                break
            except WorldError as error:
                # Not the error itself, which would keep the world.
                self._rejected[conf] = str(error)
                if attempt == _TRIES - 1:
                    raise
        if self._confs[scene] is None or self.worlds.worlds[scene] is not world:
            self._build_scene(scene, world)
        self._confs[scene] = conf
        self.worlds.put(scene, world, self.randomizer.weather(values))
        return values

    def _world_with_room(self, conf: Any, check_room: RoomCheck) -> World:
        if conf in self._rejected:
            raise WorldError(self._rejected[conf])
        # Another scene may be there, and a world takes a moment to build.
        known = (self.worlds.worlds[scene] for scene, other in enumerate(self._confs) if other == conf)
        world = next(known, None) or self.randomizer.world(conf)
        if world.extent != self._world.extent:
            raise ValueError(
                f"the worlds of {world.name!r} cover different ground ({world.extent} and "
                f"{self._world.extent}): observations would have no common bounds"
            )
        check_room(world)
        return world

    def used_worlds(self) -> set[World]:
        """The worlds that scenes are in now, and the first one."""
        return {world for world, _ in self.worlds.worlds.groups} | {self._world}

    def reset(self, scene: int, kinematic_poses: NDArray[np.float64]) -> None:
        """Put the robots down at their start poses, and the kinematic bodies at `kinematic_poses` (K, 4)."""
        self._kinematic_poses[scene] = kinematic_poses
        self._scene(scene).reset(kinematic_poses)

    def settle(self, scene: int) -> None:
        """Let the robots of a scene come to rest under the commands that they were put down with."""
        count = round(_SETTLE_S * self.conf.physics_hz)
        self._scene(scene).step(count, self._kinematic_poses[scene])

    # -- a step -----------------------------------------------------------------------------------

    def step(self, kinematic_poses: NDArray[np.float64]) -> dict[int, NDArray[np.float64]]:
        """Advance the physics of all scenes by a control step, at whose end bodies are at the poses (M,
        K, 4).

        Returns by scene where the bodies (K, 4) are instead, if a robot held any of them back.
        """
        substeps = self.conf.substeps
        held_back = {}
        for index, (scene, poses) in enumerate(zip(self._physics, kinematic_poses, strict=True)):
            scene.step(substeps, poses)  # type: ignore[union-attr]
            reached = scene.held_back_poses()  # type: ignore[union-attr]
            if reached is not None:
                held_back[index] = reached
        return held_back

    def step_passive(self) -> None:
        """Advance physics alone by a control step, with the last commands and nothing moved."""
        for scene in range(len(self.worlds)):
            self._scene(scene).step_passive(self.conf.substeps)

    def robots(self, scene: int) -> Sequence[PhysicsRobot]:
        """The robots of a scene that is built."""
        return self._scene(scene).robots

    @property
    def built(self) -> list[PhysicsScene]:
        """The physics of the scenes that have any, in their order."""
        return [scene for scene in self._physics if scene is not None]

    def is_built(self, scene: int) -> bool:
        """Whether a scene has physics: where worlds differ, it has none before its first episode."""
        return self._physics[scene] is not None

    def count_statics(self, scene: int) -> int:
        """How many static bodies a scene has that is built."""
        return len(self._specs[self.worlds.worlds[scene]].statics)

    def _scene(self, scene: int) -> PhysicsScene:
        physics = self._physics[scene]
        assert physics is not None, "a scene has physics once it has entered a world"
        return physics

    def close(self) -> None:
        """Free the physics engine's memory."""
        for physics in self._physics:
            if physics is not None:
                physics.close()


def scene_rows(mask: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """`mask` (M,) of scenes as one of rows (M * count,)."""
    return mask if count == 1 else np.repeat(mask, count)
