"""An episode set: its settings, its rows and their checksum."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from dune_rl.core.settings import Settings

FORMAT = "dune_rl episode set"
FORMAT_VERSION = 1
NAME_PATTERN = "[A-Za-z0-9][A-Za-z0-9_-]*"
# With the unit at the end of each name; metres have a precision of 1 mm, and yaw one of 0.0001 rad.
COLUMNS = ("episode", "world_seed", "start_x_m", "start_y_m", "start_yaw_rad", "goal_x_m", "goal_y_m")


@dataclass(frozen=True)
class SetEpisode:
    """One row: the episode's number, its world's seed (None: the world has none), start and goal [m, rad]."""

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


class SetHeader(Settings):
    """What a set's JSON file says of it.

    `seed` is that of the actors' paths, of sensor noise and of all else that an episode draws, together with
    the episode's number. `settings` are the sections of an environment's settings that the set determines.
    `footprint_radius_m` is that of the largest robot that the starts and goals have room for.
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
    settings: dict[str, Any]
    command: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


@dataclass(frozen=True)
class EpisodeSet:
    """A set's header and its episodes, numbered from 0."""

    header: SetHeader
    episodes: tuple[SetEpisode, ...]

    @property
    def name(self) -> str:
        """The set's name, which ends with its version, such as inspection-v1."""
        return self.header.name

    @property
    def world(self) -> str:
        """The name of its world."""
        return str(self.header.settings["world"]["name"])

    def rows_text(self) -> str:
        """The rows as the text of the CSV file."""
        return "\n".join([",".join(COLUMNS), *(episode.line() for episode in self.episodes)]) + "\n"


def checksum(header: Mapping[str, Any], rows_text: str) -> str:
    """SHA-256 (hexadecimal) of a set: of its header without the checksum, as canonical JSON, and its rows."""
    content = {key: value for key, value in header.items() if key != "sha256"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(f"{canonical}\n{rows_text}".encode()).hexdigest()
