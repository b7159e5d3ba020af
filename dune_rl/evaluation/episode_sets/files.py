"""Episode sets and their files: NAME.json with the header, and NAME.csv with a row for each episode."""

import csv
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError, field_validator

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_not_later, write_atomically
from dune_rl.core.paths import assets_folder
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import closest, one_of
from dune_rl.core.untrusted_files import first_line
from dune_rl.worlds.world import Rectangle

_LARGEST_FILE = 16 * 2**20
FORMAT = "dune_rl episode set"
# A later format must state `written_by`, the version of dune_rl that it needs.
FORMAT_VERSION = 1
_SHA256 = r"^[0-9a-f]{64}$"
NAME_PATTERN = "[A-Za-z0-9][A-Za-z0-9_-]*"
# With the unit at the end of each name; metres have a precision of 1 mm, and yaw one of 0.0001 rad.
COLUMNS = ("episode", "world_seed", "start_x_m", "start_y_m", "start_yaw_rad", "goal_x_m", "goal_y_m")


@dataclass(frozen=True)
class SetEpisode:
    """One row: the episode's number, its world's seed (None: the world has none), start and goal [m, rad].

    In a set of several world files, `world_seed` is the number of the file.
    """

    episode: int
    world_seed: int | None
    start: tuple[float, float, float]
    goal: tuple[float, float]

    def line(self) -> str:
        """The row as text, in the order of `COLUMNS`."""
        seed = "" if self.world_seed is None else str(self.world_seed)
        x, y, yaw = self.start
        places = f"{x:.3f},{y:.3f},{yaw:.4f},{self.goal[0]:.3f},{self.goal[1]:.3f}"
        return f"{self.episode},{seed},{places}"


class SetWorldFile(Settings):
    """A world file of a set: its path, from the folder of the set's file, and its SHA-256 (hexadecimal)."""

    path: str = Field(min_length=1)
    sha256: str = Field(pattern=_SHA256)


class SetHeader(Settings):
    """What a set's JSON file says of it.

    `seed` is that of the actors' paths, of sensor noise and of all else that an episode draws, together with
    the episode's number. `settings` are the sections of an environment's settings that the set determines.
    `footprint_radius_m` is that of the largest robot that the starts and goals have room for. `metrics` are
    terms that are measured beside the chosen ones. `files` are those of imported worlds: where there are
    several, rows have their numbers from 0 in place of world seeds, and `bounds` (xmin, xmax, ymin, ymax) [m]
    holds all their worlds.
    """

    format: str
    format_version: int
    name: str = Field(pattern=f"^{NAME_PATTERN}$")
    description: str
    robot: str
    footprint_radius_m: float = Field(gt=0.0)
    episodes: int = Field(ge=1)
    sites: int = Field(ge=1)
    goal_distance_m: tuple[float, float | None]
    seed: int = Field(ge=0)
    settings: dict[str, dict[str, Any]]
    metrics: dict[str, dict[str, Any]] = Field(default_factory=dict)
    files: tuple[SetWorldFile, ...] = ()
    bounds: Rectangle | None = None
    command: str
    sha256: str = Field(pattern=_SHA256)

    @field_validator("settings")
    @classmethod
    def _name_the_world(cls, settings: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        if not isinstance(settings.get("world", {}).get("name"), str):
            raise ValueError("must have a world with a name")
        return settings


@dataclass(frozen=True)
class EpisodeSet:
    """A set's header and its episodes, numbered from 0; `folder` is that of its file."""

    header: SetHeader
    episodes: tuple[SetEpisode, ...]
    folder: Path = field(default=Path(), compare=False)

    @property
    def name(self) -> str:
        """The set's name, which ends with its version, such as inspection-v1."""
        return self.header.name

    @property
    def world(self) -> str:
        """The name of its world."""
        return str(self.header.settings["world"]["name"])


def checksum(header: Mapping[str, Any], rows_text: str) -> str:
    """SHA-256 (hexadecimal) of a set: of its header without the checksum, as canonical JSON, and its rows."""
    content = {key: value for key, value in header.items() if key != "sha256"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(f"{canonical}\n{rows_text}".encode()).hexdigest()


def sets_folder() -> Path:
    """The folder of the sets that come with the package."""
    return assets_folder() / "episode_sets"


def set_names() -> list[str]:
    """Names of the sets that come with the package."""
    return sorted(path.stem for path in sets_folder().glob("*.json"))


def find_episode_set(name: str) -> Path:
    """The JSON file of a set: of one of the package by its name, or a path that ends in .json."""
    if name.endswith(".json"):
        return Path(name)
    known = set_names()
    if name not in known:
        near = closest(name, known)
        remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}, or a path that ends in .json"
        raise ConfigError(f"there is no episode set {name!r}; {remedy}")
    return sets_folder() / f"{name}.json"


def read_episode_set(name: str) -> EpisodeSet:
    """The set of a name or path; raises ConfigError if it is damaged or its checksum differs."""
    file = find_episode_set(name)
    rows_file = file.with_suffix(".csv")
    text, rows_text = _read_text(file), _read_text(rows_file)
    try:
        raw = json.loads(text)
    except (ValueError, RecursionError):
        raise ConfigError(f"{file} is not JSON; copy the set again") from None
    if isinstance(raw, dict):
        # Before the header, whose fields may be others in a later format.
        version, writer = raw.get("format_version"), raw.get("written_by")
        check_not_later(file, version, FORMAT_VERSION, writer, ConfigError)
    try:
        header = SetHeader.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{file} is no episode set ({where}: {first['msg']}); copy it again") from None
    if (header.format, header.format_version) != (FORMAT, FORMAT_VERSION):
        raise ConfigError(
            f"{file} has format {header.format!r} {header.format_version}; this dune_rl reads "
            f"{FORMAT!r} {FORMAT_VERSION}"
        )
    found = checksum(raw, rows_text)
    if found != header.sha256:
        raise ConfigError(
            f"{file} or {rows_file.name} was changed: its checksum is {found[:12]}..., and the file says "
            f"{header.sha256[:12]}...\nCopy the set again; a changed set needs a name and a file of its own."
        )
    episodes = _parse_rows(rows_text, rows_file)
    numbers = [one.episode for one in episodes]
    if len(numbers) != header.episodes or numbers != list(range(len(numbers))):
        raise ConfigError(f"{rows_file} must have the episodes 0 to {header.episodes - 1}, one a line")
    return EpisodeSet(header, episodes, file.parent)


def write_episode_set(folder: Path, header: dict[str, Any], episodes: tuple[SetEpisode, ...]) -> EpisodeSet:
    """Write the files of a set, with its checksum; `header` is as in `SetHeader`, without format and sum."""
    full = {"format": FORMAT, "format_version": FORMAT_VERSION, **header}
    # As it will be read: tuples become lists.
    full = json.loads(json.dumps(full))
    rows_text = "\n".join([",".join(COLUMNS), *(episode.line() for episode in episodes)]) + "\n"
    full["sha256"] = checksum(full, rows_text)
    header_of_set = SetHeader.model_validate(full)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in ((".csv", rows_text), (".json", json.dumps(full, indent=1) + "\n")):
        with write_atomically(folder / f"{full['name']}{name}") as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    return EpisodeSet(header_of_set, episodes, folder)


def _read_text(file: Path) -> str:
    try:
        if file.stat().st_size > _LARGEST_FILE:
            raise ConfigError(f"{file} is larger than an episode set can be; give another")
        # Line ends as some tools for versions change them are no change of the rows.
        return file.read_bytes().decode().replace("\r\n", "\n")
    except OSError as error:
        raise ConfigError(
            f"{file} cannot be read: {error.strerror or error}; a set has a .json and a .csv file"
        ) from None
    except UnicodeDecodeError:
        raise ConfigError(f"{file} is not UTF-8 text; copy the set again") from None


def _parse_rows(text: str, file: Path) -> tuple[SetEpisode, ...]:
    try:
        rows = list(csv.reader(text.splitlines()))
    except csv.Error as error:
        raise ConfigError(f"{file} is no CSV file: {error}") from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise ConfigError(f"{file} must begin with the columns {','.join(COLUMNS)}")
    found = []
    try:
        for number, seed, x, y, yaw, *goal in rows[1:]:
            goal_x, goal_y = map(float, goal)
            start = (float(x), float(y), float(yaw))
            found.append(SetEpisode(int(number), int(seed) if seed else None, start, (goal_x, goal_y)))
    except ValueError as error:
        raise ConfigError(f"{file} has a row that cannot be read: {first_line(error)}") from None
    return tuple(found)
