"""Export of a world, its actors and robots for Gazebo, or of robots alone."""

import shlex
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

from dune_rl.commands import command_line
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import GazeboConf
from dune_rl.config.compose import compose
from dune_rl.config.endless import without_ends
from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import file_stem
from dune_rl.core.suggestions import text_word
from dune_rl.core.version import VERSION
from dune_rl.env.simulation import VectorSimulation
from dune_rl.gazebo.episode import is_recorded
from dune_rl.gazebo.folder import check_folder, replace_export
from dune_rl.gazebo.robot.files import WrittenRobot
from dune_rl.gazebo.scene import SURFACES, WORLD, WrittenScene, write_robots, write_scene

# Where a robot is exported without a world.
_WITHOUT_WORLD = ("+world=flat", "actors=none")
# What tells nothing of a robot alone.
_OF_WORLDS = ("actors", "duration_s", "seed")


def compose_words(parsed: Namespace) -> GazeboConf:
    """The settings of a command line; `ConfigError` names every fault."""
    words, folders = list(parsed.overrides), command_line.config_folders(parsed)
    if not any(word.lstrip("+").startswith(("world", "scenario")) for word in words):
        for word in words:
            if word.lstrip("+~").partition("=")[0] in _OF_WORLDS:
                raise ConfigError(f"{word} is of worlds: give world=NAME too, or leave it out")
        words = [*_WITHOUT_WORLD, *words]
    return compose(GazeboConf, words, folders)


def export_scene(conf: GazeboConf, *, with_world: bool, with_robots: bool) -> None:
    """Write the folder of the settings, and print what is in it."""
    assert conf.out is not None
    out = Path(conf.out)
    check_folder(out, overwrite=conf.overwrite)
    # The robots stand while the actors are recorded.
    simulation = make_simulation(without_ends(conf), 1, conf.seed)
    try:
        simulation.reset()
        with replace_export(out, _manifest(conf), overwrite=conf.overwrite) as folder:
            if with_world:
                scene = write_scene(
                    folder, _name_of(conf), simulation, conf.duration_s, with_robots=with_robots
                )
            else:
                scene = WrittenScene(0, 0, write_robots(folder, simulation))
        lines = [*(_describe_world(out, scene, simulation) if with_world else ())]
        lines += [line for each in scene.robots.values() for line in _describe_robot(out, each)]
        lines.append(f"Gazebo finds it by: export GZ_SIM_RESOURCE_PATH={shlex.quote(str(out.resolve()))}")
    finally:
        simulation.close()
    console = command_line.make_console()
    for line in lines:
        command_line.print_line(console, line)


def _manifest(conf: GazeboConf) -> dict[str, object]:
    settings = conf.model_dump(mode="json", exclude={"out", "overwrite"})
    return {"dune_rl": VERSION, "settings": settings}


def _name_of(conf: GazeboConf) -> str:
    """The world's name, and that of its file, which may be one that SDF reserves."""
    path = getattr(conf.world, "path", None)
    return conf.world.name if path is None else file_stem(f"{conf.world.name}_{Path(path).stem}")


def _describe_world(out: Path, scene: WrittenScene, simulation: VectorSimulation) -> Iterator[str]:
    world = simulation.scenes.worlds.worlds[0]
    yield f"{out / WORLD}: {scene.objects} objects, {scene.actors} actors"
    left_out = [
        group.name for group in simulation.groups if not group.description.is_robot and not is_recorded(group)
    ]
    if left_out:
        yield f"left out: {', '.join(left_out)}, who come and go"
    if world.grass is not None:
        yield "left out: tall grass, through which beams pass"
    region = ",".join(f"{side:g}" for side in world.region)
    words = [
        "+world=sdf",
        text_word("world.path", str(out / WORLD)),
        f"world.spacing_m={world.terrain.spacing_m:.9g}",
    ]
    words += [f"world.region=[{region}]"]
    if world.surfaces is not None:
        words += [text_word("world.surface_map", str(out / SURFACES))]
    yield f"read back: {command_line.shell_command('dune_rl.view', *words)}"


def _describe_robot(out: Path, robot: WrittenRobot) -> Iterator[str]:
    folder = out / robot.name
    yield f"{folder}: model.sdf, {robot.name}.urdf"
    if robot.others:
        yield f"left out: the sensors {', '.join(robot.others)}, which Gazebo does not have"
