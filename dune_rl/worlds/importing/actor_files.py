"""Trajectories of actors read from files: SDF, CSV and JSON."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from dune_rl.core.errors import WorldError
from dune_rl.core.settings import Settings
from dune_rl.core.untrusted_files import (
    ImportReport,
    WorldFiles,
    first_line,
    printable,
    read_bytes,
)
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import wrap_angle
from dune_rl.worlds.actor_trajectory import (
    FARTHEST_M,
    LONGEST_S,
    MOST_WAY_POINTS,
    ActorTrajectory,
    unwrap_yaw,
)
from dune_rl.worlds.importing.sdf.actors import MOST_ACTORS, SKIN_NOTE, close_loop
from dune_rl.worlds.importing.sdf.files import SdfFileFinder
from dune_rl.worlds.importing.sdf.reader import SdfReader

FORMATS = (".sdf", ".csv", ".json")
COLUMNS = ("actor", "loop", "delay_s", "time_s", "x_m", "y_m", "z_m", "yaw_rad")
_NEEDED = COLUMNS[3:]
_NUMBERS = COLUMNS[2:]
_FILE_BYTES = 64 * 2**20
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


class ActorRecord(Settings):
    """An actor in a JSON file: `times_s` (T), and `poses` (T, 4) of x, y, z [m] and yaw [rad]."""

    name: str = Field("actor", min_length=1, max_length=60)
    loop: bool = True
    delay_s: float = 0.0
    times_s: list[float]
    poses: list[tuple[float, float, float, float]]


class ActorRecords(Settings):
    """The actors of a JSON file."""

    actors: list[ActorRecord]


def read_actor_file(path: str | Path) -> tuple[ActorTrajectory, ...]:
    """The actors of a file, by its ending; raises `WorldError` if it is no such file, or has none.

    Differences from the file cause a `WorldWarning`.
    """
    file = Path(path).expanduser()
    if not file.is_file():
        raise WorldError(f"there is no file {file}: name one with trajectories ({', '.join(FORMATS)}).")
    kind = file.suffix.lower()
    if kind not in FORMATS:
        raise WorldError(
            f"{file} is no file of trajectories: {kind or 'no ending'} is none of {', '.join(FORMATS)}."
        )
    report = ImportReport(file.name)
    if kind == ".sdf":
        actors = _read_sdf(file, report)
    else:
        read = _read_csv if kind == ".csv" else _read_json
        actors = [_close_if_loop(actor, report) for actor in read(read_bytes(file, _FILE_BYTES), file.name)]
    if not actors:
        raise report.explain(f"{file} has no actors with trajectories: name another file.")
    if len(actors) > MOST_ACTORS:
        raise WorldError(f"{file} has more than {MOST_ACTORS} actors: reduce it.")
    report.emit_warnings()
    return tuple(actors)


def _read_sdf(file: Path, report: ImportReport) -> list[ActorTrajectory]:
    own = WorldFiles(file.resolve().parent)
    found = SdfReader(SdfFileFinder(own.root, report), report, actors_only=True).read(file.resolve(), own)
    # Only the trajectories are needed.
    report.texts = [text for text in report.texts if text != SKIN_NOTE]
    return found.actors


def _read_json(data: bytes, name: str) -> list[ActorTrajectory]:
    try:
        records = ActorRecords.model_validate_json(data)
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"]))
        raise WorldError(
            f"{name} is no file of trajectories ({place + ': ' if place else ''}{first_line(fault['msg'])}): "
            "write it with python -m dune_rl.trajectory."
        ) from None
    return [
        _make_actor(
            actor.name,
            np.array(actor.times_s),
            np.array(actor.poses).reshape(-1, 4),
            actor.loop,
            actor.delay_s,
            name,
        )
        for actor in records.actors
    ]


def _read_csv(data: bytes, name: str) -> list[ActorTrajectory]:
    try:
        rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig")), strict=True)
        columns = rows.fieldnames or ()
        missing = [column for column in _NEEDED if column not in columns]
        if missing:
            raise WorldError(f"{name} has no column {', '.join(missing)}: its first line names the columns.")
        actors: dict[str, list[dict[str, Any]]] = {}
        for row in rows:
            actors.setdefault(row.get("actor") or "actor", []).append(_numbers(row, rows.line_num, name))
    except (UnicodeDecodeError, csv.Error) as error:
        raise WorldError(f"{name} is no CSV file ({first_line(error)}): export it again.") from None
    return [_actor_of_rows(actor, found, name) for actor, found in actors.items()]


def _numbers(row: dict[str, Any], line: int, name: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for column in _NUMBERS:
        text = row.get(column)
        try:
            found[column] = 0.0 if text in (None, "") and column == "delay_s" else float(text or "none")
        except ValueError:
            raise WorldError(
                f"{name} has {printable(str(text), 40)!r} for {column} in line {line}: write a number."
            ) from None
    loop = (row.get("loop") or "true").strip().lower()
    if loop not in _TRUTH:
        raise WorldError(f"{name} has {printable(loop, 40)!r} for loop in line {line}: write true or false.")
    return found | {"loop": _TRUTH[loop]}


def _actor_of_rows(actor: str, rows: Sequence[dict[str, Any]], name: str) -> ActorTrajectory:
    for column in ("loop", "delay_s"):
        if len({row[column] for row in rows}) > 1:
            raise WorldError(f"{name} has several {column} of the actor {printable(actor, 60)!r}: keep one.")
    times = np.array([row["time_s"] for row in rows])
    poses = np.array([[row[column] for column in _NEEDED[1:]] for row in rows])
    return _make_actor(printable(actor, 60), times, poses, rows[0]["loop"], rows[0]["delay_s"], name)


def _make_actor(
    actor: str, times: Array, poses: Array, loop: bool, delay_s: float, source: str
) -> ActorTrajectory:
    """The trajectory of plain numbers; raises `WorldError` where they make none."""
    actor = printable(actor, 60)
    faults = [
        (not len(times) or len(times) != len(poses), "needs as many times as poses, and at least one"),
        (len(times) > MOST_WAY_POINTS, f"has more than {MOST_WAY_POINTS:,} poses"),
        (not (np.isfinite(times).all() and np.isfinite(poses).all()), "has numbers that are not finite"),
        (not 0.0 <= delay_s <= LONGEST_S, f"needs a delay_s of 0 to {LONGEST_S:g}"),
        (bool((np.diff(times) <= 0.0).any()), "needs times that rise from pose to pose"),
        (
            len(times) and not 0.0 <= times[0] <= times[-1] <= LONGEST_S,
            f"needs times of 0 to {LONGEST_S:g} s",
        ),
        (bool((np.abs(poses[:, :3]) > FARTHEST_M).any()), f"has a pose farther off than {FARTHEST_M:g} m"),
    ]
    for faulty, message in faults:
        if faulty:
            raise WorldError(f"{source}: the actor {actor!r} {message}.")
    turned = poses.copy()
    turned[:, 3] = unwrap_yaw(wrap_angle(poses[:, 3]))
    return ActorTrajectory(actor, times - times[0], turned, loop, delay_s + float(times[0]))


def _close_if_loop(actor: ActorTrajectory, report: ImportReport) -> ActorTrajectory:
    if not actor.loop:
        return actor
    times, poses = close_loop(actor.name, actor.times, actor.poses, report)
    return ActorTrajectory(actor.name, times, poses, actor.loop, actor.delay_s)
