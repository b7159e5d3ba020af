"""Files of trajectories: SDF with an <actor>, CSV and JSON."""

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from dune_rl.core.files import write_atomically
from dune_rl.gazebo.actors import format_number, make_actor
from dune_rl.gazebo.elements import document_text
from dune_rl.geometry.frames import wrap_angle
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.importing.actor_files import COLUMNS

# The newest version that Gazebo classic 11 reads; all newer ones read it, too.
_SDF_VERSION = "1.7"
# Of Open Robotics' examples; its origin is at the hip.
WALKING_ACTOR = "https://fuel.gazebosim.org/1.0/Mingfei/models/actor/tip/files/meshes/walk.dae"
WALKING_ACTOR_HIP_M = 1.0


@dataclass(frozen=True)
class Appearance:
    """What a simulator draws in the place of an SDF actor; its mesh is the user's own, and not read here.

    `origin_height_m` is the height of the mesh's origin above its feet.
    """

    skin: str = WALKING_ACTOR
    animation: str = WALKING_ACTOR
    origin_height_m: float = WALKING_ACTOR_HIP_M


def sdf_text(actor: ActorTrajectory, appearance: Appearance = Appearance()) -> str:
    """An SDF file with an <actor> that walks the trajectory; `z` is raised by the mesh's origin."""
    lift = appearance.origin_height_m
    poses = np.zeros((len(actor.times), 6))
    poses[:, :3], poses[:, 5] = actor.poses[:, :3] + [0.0, 0.0, lift], actor.poses[:, 3]
    root = Element("sdf", version=_SDF_VERSION)
    root.append(
        make_actor(
            actor.name,
            actor.times,
            poses,
            skin=appearance.skin,
            animation=appearance.animation,
            interpolate_x=True,
            loop=actor.loop,
            delay_s=actor.delay_s,
            comment=(
                f"The poses' z is {format_number(lift)} m above the ground: the height of the skin's origin."
            ),
        )
    )
    return document_text(root)


def csv_text(actor: ActorTrajectory) -> str:
    """A CSV file with a row for each pose."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    leading = actor.name, str(actor.loop).lower(), format_number(actor.delay_s)
    rows.writerows((*leading, *numbers) for numbers in _format_rows(actor))
    return text.getvalue()


def json_text(actor: ActorTrajectory) -> str:
    """A JSON file: an object with a list of `actors`, here one."""
    rows = [[float(number) for number in row] for row in _format_rows(actor)]
    record = {
        "name": actor.name,
        "loop": actor.loop,
        "delay_s": float(format_number(actor.delay_s)),
        "times_s": [row[0] for row in rows],
        "poses": [row[1:] for row in rows],
    }
    return json.dumps({"actors": [record]}) + "\n"


def write_trajectory(path: Path, actor: ActorTrajectory, appearance: Appearance) -> None:
    """Write the trajectory as the ending of `path` says: .sdf, .csv or .json."""
    kind = path.suffix.lower()
    others = {".csv": csv_text, ".json": json_text}
    text = sdf_text(actor, appearance) if kind == ".sdf" else others[kind](actor)
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _format_rows(actor: ActorTrajectory) -> list[tuple[str, ...]]:
    """The rows time, x, y, z, yaw; yaw is within half a turn."""
    rows = np.column_stack([actor.times, actor.poses])
    rows[:, 4] = wrap_angle(rows[:, 4])
    return [tuple(map(format_number, row)) for row in rows.tolist()]
