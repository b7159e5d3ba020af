"""Trajectories of actors read from files: SDF, CSV and JSON."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from dune_rl.core.errors import WorldError
from dune_rl.core.settings import Settings
from dune_rl.core.untrusted_files import (
    ImportReport,
    WorldFiles,
    first_line,
    printable,
    read_bytes,
)
from dune_rl.geometry.frames import wrap_angle
from dune_rl.worlds.actor_trajectory import (
    FARTHEST_M,
    LONGEST_S,
    MOST_WAY_POINTS,
    ActorTrajectory,
    unwrap_yaw,
)
from dune_rl.worlds.importing.sdf.actors import MOST_ACTORS, SKIN_NOTE, close_loop
from dune_rl.worlds.importing.sdf.elements import SdfFileFinder
from dune_rl.worlds.importing.sdf.reader import SdfReader

FORMATS = (".sdf", ".csv", ".json")
COLUMNS = ("actor", "loop", "delay_s", "time_s", "x_m", "y_m", "z_m", "yaw_rad")
_NEEDED = COLUMNS[3:]
_FILE_BYTES = 64 * 2**20


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


class _CsvRow(BaseModel):
    actor: str = "actor"
    loop: bool = True
    delay_s: float = 0.0
    time_s: float
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


def read_actor_file(path: str | Path) -> tuple[ActorTrajectory, ...]:
    """The actors of a file, by its ending; raises `WorldError` if it is no such file, or has none.

    Differences from the file cause a `WorldWarning`.
    """
    file, known = Path(path).expanduser(), ", ".join(FORMATS)
    if not file.is_file():
        raise WorldError(f"there is no file {file}: name one with trajectories ({known}).")
    kind = file.suffix.lower()
    if kind not in FORMATS:
        raise WorldError(f"{file} is no file of trajectories: {kind or 'no ending'} is none of {known}.")
    report = ImportReport(file.name)
    if kind == ".sdf":
        own = WorldFiles(file.resolve().parent)
        reader = SdfReader(SdfFileFinder(own.root, report), report, actors_only=True)
        actors = reader.read(file.resolve(), own).actors
        # Only the trajectories are needed.
        report.texts = [text for text in report.texts if text != SKIN_NOTE]
    else:
        read = _read_csv if kind == ".csv" else _read_json
        actors = [_make_actor(record, report) for record in read(read_bytes(file, _FILE_BYTES), file.name)]
    if not actors:
        raise report.explain(f"{file} has no actors with trajectories: name another file.")
    if len(actors) > MOST_ACTORS:
        raise WorldError(f"{file} has more than {MOST_ACTORS} actors: reduce it.")
    report.emit_warnings()
    return tuple(actors)


def _read_json(data: bytes, name: str) -> list[ActorRecord]:
    try:
        return ActorRecords.model_validate_json(data).actors
    except ValidationError as error:
        fault = error.errors()[0]
        place = "".join(f"{each}." for each in fault["loc"]).removesuffix(".")
        raise WorldError(
            f"{name} is no file of trajectories ({place + ': ' if place else ''}{first_line(fault['msg'])}): "
            "write it with python -m dune_rl.trajectory."
        ) from None


def _read_csv(data: bytes, name: str) -> list[ActorRecord]:
    actors: dict[str, list[_CsvRow]] = {}
    try:
        rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig")), strict=True)
        missing = [column for column in _NEEDED if column not in (rows.fieldnames or ())]
        if missing:
            raise WorldError(f"{name} has no column {', '.join(missing)}: its first line names the columns.")
        for values in rows:
            row = _parse_row(values, rows.line_num, name)
            actors.setdefault(row.actor, []).append(row)
    except (UnicodeDecodeError, csv.Error) as error:
        raise WorldError(f"{name} is no CSV file ({first_line(error)}): export it again.") from None
    records = []
    for actor, own in actors.items():
        for column in ("loop", "delay_s"):
            if len({getattr(row, column) for row in own}) > 1:
                raise WorldError(
                    f"{name} has several {column} of the actor {printable(actor, 60)!r}: keep one."
                )
        poses = [(row.x_m, row.y_m, row.z_m, row.yaw_rad) for row in own]
        times = [row.time_s for row in own]
        # Not validated: `_make_actor` refuses numbers that are not finite.
        record = ActorRecord.model_construct(
            name=actor, loop=own[0].loop, delay_s=own[0].delay_s, times_s=times, poses=poses
        )
        records.append(record)
    return records


def _parse_row(values: dict[str, Any], line: int, name: str) -> _CsvRow:
    try:
        return _CsvRow.model_validate({key: values[key] for key in COLUMNS if values.get(key)})
    except ValidationError as error:
        column = str(error.errors()[0]["loc"][0])
        text, form = str(values.get(column)), "true or false" if column == "loop" else "a number"
        raise WorldError(
            f"{name} has {printable(text, 40)!r} for {column} in line {line}: write {form}."
        ) from None


def _make_actor(record: ActorRecord, report: ImportReport) -> ActorTrajectory:
    """The trajectory of plain numbers, closed if it is a loop; `WorldError` where they make none."""
    name, times = printable(record.name, 60), np.array(record.times_s)
    poses = np.array(record.poses).reshape(-1, 4)
    for faulty, message in (
        (not len(times) or len(times) != len(poses), "needs as many times as poses, and at least one"),
        (len(times) > MOST_WAY_POINTS, f"has more than {MOST_WAY_POINTS:,} poses"),
        (not (np.isfinite(times).all() and np.isfinite(poses).all()), "has numbers that are not finite"),
        (not 0.0 <= record.delay_s <= LONGEST_S, f"needs a delay_s of 0 to {LONGEST_S:g}"),
        ((np.diff(times) <= 0.0).any(), "needs times that rise from pose to pose"),
        ((times < 0.0).any() or (times > LONGEST_S).any(), f"needs times of 0 to {LONGEST_S:g} s"),
        ((np.abs(poses[:, :3]) > FARTHEST_M).any(), f"has a pose farther off than {FARTHEST_M:g} m"),
    ):
        if faulty:
            raise WorldError(f"{report.source}: the actor {name!r} {message}.")
    poses[:, 3] = unwrap_yaw(wrap_angle(poses[:, 3]))
    delay_s, times = record.delay_s + float(times[0]), times - times[0]
    if record.loop:
        times, poses = close_loop(name, times, poses, report)
    return ActorTrajectory(name, times, poses, record.loop, delay_s)
