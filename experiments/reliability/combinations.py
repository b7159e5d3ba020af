"""What the studies of reliability combine: every world, robot, engine and kind of actors of `conf/`.

Worlds from files are small files that `write_world_files` makes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from dune_rl.core.paths import assets_folder, conf_folder
from dune_rl.physics.interface import OWN_ENGINES

# `default` is `walkers` where the world brings no actors of its own.
_SAME_AS_ANOTHER = ("default",)
# For what has no room in its world, such as large vehicles and herds.
ROOMY_WORLD = "flat"
_FILES = {"heightmap": "heights.npy", "mesh": "yard.obj", "sdf": "yard.sdf"}
_SDF = """<?xml version="1.0"?><sdf version="1.9"><world name="yard">
<model name="ground"><static>true</static><link name="l"><collision name="c"><geometry><plane>
<normal>0 0 1</normal><size>60 60</size></plane></geometry></collision></link></model>{boxes}</world></sdf>"""
_SDF_BOX = """<model name="box_{i}"><static>true</static><pose>{x} {y} 0.4 0 0 0.3</pose><link name="l">
<collision name="c"><geometry><box><size>0.8 0.8 0.8</size></box></geometry></collision></link></model>"""
_BOXES = ((4.0, 3.0), (-5.0, -2.0), (1.0, -6.0), (-3.0, 6.0))
_HALF_M, _SPACING_M = 25.0, 0.5


@dataclass(frozen=True)
class Combination:
    """A world, a robot, an engine and a kind of actors, as options of `conf/`."""

    world: str
    robot: str
    engine: str
    actors: str

    def words(self, files: Path) -> list[str]:
        """The overrides that choose them; `files` is the folder of `write_world_files`."""
        words = [f"physics={self.engine}", f"robot={self.robot}", f"actors={self.actors}"]
        if self.world in _FILES:
            words.append(f"world.path={files / _FILES[self.world]}")
        if self.world == "heightmap":
            words.append(f"world.size_m=[{2 * _HALF_M},{2 * _HALF_M}]")
        if self.robot == "urdf":
            words.append(f"robot.path={assets_folder() / 'robots' / 'leo_rover' / 'leo_rover.urdf'}")
        return words

    @property
    def name(self) -> str:
        return f"{self.engine} {self.world} {self.robot} {self.actors}"

    @property
    def has_sites(self) -> bool:
        """Whether the world is one of a family, of which each seed is another."""
        return self.world not in (*_FILES, "flat")


def _options(group: str) -> list[str]:
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


WORLDS, ROBOTS = _options("world"), _options("robot")
ACTORS = [name for name in _options("actors") if name not in _SAME_AS_ANOTHER]


def all_combinations() -> list[Combination]:
    """Every combination."""
    return [
        Combination(world, robot, engine, actors)
        for world in WORLDS
        for robot in ROBOTS
        for engine in OWN_ENGINES
        for actors in ACTORS
    ]


def every_pair() -> list[Combination]:
    """Combinations that have every pair of two options of different kinds at least once."""
    return [
        _at(world, world + actors, (world + actors) // len(ROBOTS) + actors, actors)
        for actors in range(len(ACTORS))
        for world in range(len(WORLDS))
    ]


def every_option(turn: int = 0) -> list[Combination]:
    """Combinations that have every option, each kind of actors once; another `turn` combines them anew."""
    decks = [_deck(options, turn, kind) for kind, options in enumerate((WORLDS, ROBOTS, OWN_ENGINES))]
    return [_at(*drawn, actors) for actors, drawn in enumerate(zip(*decks, strict=True))]


def _deck(options: Sequence[str], turn: int, kind: int) -> list[int]:
    """A number of an option for each kind of actors: all equally often, in an order of `turn`."""
    numbers = np.resize(np.arange(len(options)), len(ACTORS))
    return np.random.default_rng((turn, kind)).permutation(numbers).tolist()


def _at(world: int, robot: int, engine: int, actors: int) -> Combination:
    return Combination(
        WORLDS[world % len(WORLDS)],
        ROBOTS[robot % len(ROBOTS)],
        OWN_ENGINES[engine % len(OWN_ENGINES)],
        ACTORS[actors % len(ACTORS)],
    )


# By the name of each design.
DESIGNS = {"options": every_option, "pairs": every_pair, "all": all_combinations}


def write_world_files(folder: Path) -> None:
    """A map of heights, a mesh and an SDF world in `folder`: bumps or a plane, and some boxes."""
    folder.mkdir(parents=True, exist_ok=True)
    along = np.arange(-_HALF_M, _HALF_M + _SPACING_M / 2, _SPACING_M)
    x, y = np.meshgrid(along, along)
    heights = 0.2 * np.sin(x / 2.0) * np.cos(y / 3.0)
    np.save(folder / _FILES["heightmap"], heights)
    corner = (np.arange(len(along) - 1)[:, None] * len(along) + np.arange(len(along) - 1)).reshape(-1)
    right, ahead = corner + 1, corner + len(along)
    faces = np.concatenate(
        [np.stack([corner, right, ahead + 1], -1), np.stack([corner, ahead + 1, ahead], -1)]
    )
    parts = {"Terrain": trimesh.Trimesh(np.stack([x, y, heights], -1).reshape(-1, 3), faces, process=False)}
    for i, (at_x, at_y) in enumerate(_BOXES):
        parts[f"Box_{i}"] = trimesh.creation.box((0.8, 0.8, 1.2)).apply_translation([at_x, at_y, 0.2])
    (folder / _FILES["mesh"]).write_text(_obj_text(parts))
    boxes = "".join(_SDF_BOX.format(i=i, x=x, y=y) for i, (x, y) in enumerate(_BOXES))
    (folder / _FILES["sdf"]).write_text(_SDF.format(boxes=boxes))


def _obj_text(parts: dict[str, trimesh.Trimesh]) -> str:
    lines, start = [], 1
    for name, mesh in parts.items():
        lines.append(f"o {name}")
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
        lines += ["f {} {} {}".format(*(face + start)) for face in mesh.faces]
        start += len(mesh.vertices)
    return "\n".join(lines) + "\n"
