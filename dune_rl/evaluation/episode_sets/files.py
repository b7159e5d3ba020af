"""Files of episode sets: NAME.json with the header, and NAME.csv with a row for each episode."""

import csv
import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.paths import assets_folder
from dune_rl.core.suggestions import closest, one_of
from dune_rl.evaluation.episode_sets.episode_set import (
    COLUMNS,
    FORMAT,
    FORMAT_VERSION,
    EpisodeSet,
    SetEpisode,
    SetHeader,
    checksum,
)

_LARGEST_FILE = 16 * 2**20


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
    raw = _read_json(file)
    rows_text = _read_text(rows_file)
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
    if [one.episode for one in episodes] != list(range(header.episodes)):
        raise ConfigError(f"{rows_file} must have the episodes 0 to {header.episodes - 1}, one a line")
    return EpisodeSet(header, episodes)


def write_episode_set(folder: Path, header: dict[str, Any], episodes: tuple[SetEpisode, ...]) -> EpisodeSet:
    """Write the files of a set, with its checksum; `header` is as in `SetHeader`, without format and sum."""
    full = {"format": FORMAT, "format_version": FORMAT_VERSION, **header}
    # As it will be read: tuples become lists.
    full = json.loads(json.dumps(full))
    unsigned = EpisodeSet(SetHeader.model_validate({**full, "sha256": "0" * 64}), episodes)
    rows_text = unsigned.rows_text()
    full["sha256"] = checksum(full, rows_text)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in ((".csv", rows_text), (".json", json.dumps(full, indent=1) + "\n")):
        with write_atomically(folder / f"{full['name']}{name}") as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    return EpisodeSet(SetHeader.model_validate(full), episodes)


def _read_json(file: Path) -> Any:
    try:
        return json.loads(_read_text(file))
    except (ValueError, RecursionError):
        raise ConfigError(f"{file} is not JSON; copy the set again") from None


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
    rows = list(csv.reader(text.splitlines()))
    if not rows or tuple(rows[0]) != COLUMNS:
        raise ConfigError(f"{file} must begin with the columns {','.join(COLUMNS)}")
    try:
        return tuple(_parse_row(row) for row in rows[1:])
    except ValueError as error:
        raise ConfigError(f"{file} has a row that cannot be read: {error}") from None


def _parse_row(row: list[str]) -> SetEpisode:
    number, seed, x, y, yaw, goal_x, goal_y = row
    return SetEpisode(
        int(number),
        int(seed) if seed else None,
        (float(x), float(y), float(yaw)),
        (float(goal_x), float(goal_y)),
    )
