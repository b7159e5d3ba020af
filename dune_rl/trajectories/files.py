"""Files of trajectories: SDF with an <actor>, CSV and JSON."""

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from dune_rl.core.files import write_atomically
from dune_rl.geometry.frames import wrap_angle
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.importing.actor_files import COLUMNS

# Printed digits behind the point: micrometres, microseconds and microradians.
_DIGITS = 6
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
    way_points = "\n".join(
        f"        <waypoint><time>{time}</time><pose>{x} {y} {z} 0 0 {yaw}</pose></waypoint>"
        for time, x, y, z, yaw in _format_rows(actor, lift)
    )
    skin, animation = escape(appearance.skin), escape(appearance.animation)
    return f"""<?xml version="1.0"?>
<sdf version="{_SDF_VERSION}">
  <actor name={quoteattr(actor.name)}>
    <skin>
      <filename>{skin}</filename>
    </skin>
    <animation name="walking">
      <filename>{animation}</filename>
      <interpolate_x>true</interpolate_x>
    </animation>
    <script>
      <loop>{str(actor.loop).lower()}</loop>
      <delay_start>{_format_number(actor.delay_s)}</delay_start>
      <auto_start>true</auto_start>
      <!-- The poses' z is {_format_number(lift)} m above the ground: the height of the skin's origin. -->
      <trajectory id="0" type="walking">
{way_points}
      </trajectory>
    </script>
  </actor>
</sdf>
"""


def csv_text(actor: ActorTrajectory) -> str:
    """A CSV file with a row for each pose."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    leading = actor.name, str(actor.loop).lower(), _format_number(actor.delay_s)
    rows.writerows((*leading, *numbers) for numbers in _format_rows(actor))
    return text.getvalue()


def json_text(actor: ActorTrajectory) -> str:
    """A JSON file: an object with a list of `actors`, here one."""
    rows = [[float(number) for number in row] for row in _format_rows(actor)]
    record = {
        "name": actor.name,
        "loop": actor.loop,
        "delay_s": float(_format_number(actor.delay_s)),
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


def _format_rows(actor: ActorTrajectory, lift_m: float = 0.0) -> list[tuple[str, ...]]:
    """The rows time, x, y, z, yaw; yaw is within half a turn."""
    rows = np.column_stack([actor.times, actor.poses])
    rows[:, 3] += lift_m
    rows[:, 4] = wrap_angle(rows[:, 4])
    return [tuple(map(_format_number, row)) for row in rows.tolist()]


def _format_number(value: float) -> str:
    # Rounded first, so that there is no negative zero.
    return f"{round(value, _DIGITS) + 0.0:.{_DIGITS}f}"
