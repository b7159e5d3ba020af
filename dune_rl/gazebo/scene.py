"""A scene as files for Gazebo: the world with its actors, and its robots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from PIL import Image

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.simulation import VectorSimulation
from dune_rl.gazebo.actors import make_actor
from dune_rl.gazebo.elements import UniqueNames, add, add_pose, document_text, make_sdf
from dune_rl.gazebo.episode import RecordedActor, record_actors
from dune_rl.gazebo.mesh_folder import MeshFolder
from dune_rl.gazebo.painted_mesh import paint_scenery
from dune_rl.gazebo.robot.files import WrittenRobot, write_robot
from dune_rl.gazebo.skin import write_skin
from dune_rl.gazebo.world import make_world
from dune_rl.robots.urdf.reader import read_urdf
from dune_rl.worlds.importing.sdf.elements import role_attribute
from dune_rl.worlds.world import World

WORLD, SURFACES = "world.sdf", "surfaces.png"


@dataclass(frozen=True)
class WrittenScene:
    """What was written: numbers of `objects` and `actors`, and the robots by the name of their group."""

    objects: int
    actors: int
    robots: Mapping[str, WrittenRobot]


def write_robots(folder: Path, simulation: VectorSimulation) -> dict[str, WrittenRobot]:
    """Write each kind of robot of a scene into a folder of its own in `folder`."""
    names = UniqueNames()
    return {
        group.name: write_robot(
            folder,
            names.make(read_urdf(body.robot.body.urdf).name),
            body.robot,
            {} if group.suite is None else group.suite.settings,
            simulation.physics.control_step_s,
        )
        for group, body in _robots_of(simulation)
    }


def write_scene(
    folder: Path, name: str, simulation: VectorSimulation, duration_s: float, *, with_robots: bool
) -> WrittenScene:
    """Write the first scene of a simulation, which has just been reset, as a world called `name`.

    Its actors are followed for `duration_s`. The robots are left out unless `with_robots`.
    """
    look = simulation.scenes.worlds.appearances[0]
    world = look.world
    meshes = MeshFolder(folder)
    agents = [agent for group in simulation.groups for agent in group.names]
    element = make_world(name, world, look.weather, simulation.physics, meshes, agents)
    robots = write_robots(folder, simulation) if with_robots else {}
    for group, body in _robots_of(simulation):
        if with_robots:
            _include_robots(element, group, body, robots[group.name])
    actors = record_actors(simulation, duration_s)
    _add_actors(element, actors, meshes)
    root = make_sdf()
    root.append(element)
    (folder / WORLD).write_text(document_text(root), encoding="utf-8")
    if world.surfaces is not None:
        _write_surfaces(folder / SURFACES, world)
    return WrittenScene(len(world.props), len(actors), robots)


def _robots_of(simulation: VectorSimulation) -> list[tuple[AgentGroup, ArticulatedBody]]:
    return [(group, group.body) for group in simulation.groups if isinstance(group.body, ArticulatedBody)]


def _include_robots(world: Element, group: AgentGroup, body: ArticulatedBody, written: WrittenRobot) -> None:
    """Include the robots of a group in the first scene, as they stand there now, their joints at zero."""
    motion, standing = body.motion, body.robot.description.standing_height_m
    for agent, name in enumerate(group.names):
        include = add(world, "include", **role_attribute("robot"))
        add(include, "uri", f"model://{written.name}")
        add(include, "name", name)
        # Legs are longer with all joints at zero.
        lift = [0.0, 0.0, max(0.0, written.height_m - standing)]
        add_pose(include, motion.position_w[agent] + lift, motion.rotation[agent])


def _add_actors(world: Element, actors: Sequence[RecordedActor], meshes: MeshFolder) -> None:
    skins: dict[int, str] = {}
    for actor in actors:
        key = id(actor.shape)
        if key not in skins:
            skins[key] = write_skin(meshes, actor.name, paint_scenery(actor.shape))
        world.append(make_actor(actor.name, actor.times, actor.poses, skin=skins[key], animation=skins[key]))


def _write_surfaces(path: Path, world: World) -> None:
    """Write the numbers of a world's surfaces as a picture, its first row in the north."""
    assert world.surfaces is not None
    Image.fromarray(np.ascontiguousarray(world.surfaces.numbers[::-1])).save(path)
