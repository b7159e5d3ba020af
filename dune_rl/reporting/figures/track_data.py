"""The tracks of episodes by site, and the worlds that they are in."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dune_rl.config.build import build_world
from dune_rl.config.checks import validate
from dune_rl.config.schema import EnvConf
from dune_rl.core.errors import DuneError
from dune_rl.geometry.arrays import Array
from dune_rl.reporting.comparison import EvaluatedPolicy
from dune_rl.reporting.figures.results import Ending, ending_of
from dune_rl.reporting.rows import Row, column
from dune_rl.worlds.world import World

MOST_SITES, MOST_EPISODES = 3, 4


@dataclass(frozen=True, eq=False)
class EpisodeTrack:
    """The way of an agent in an episode: `points` (T, 2) [m] from its start on, at `times_s` (T,) [s].

    `speeds` (T - 1,) [m/s] are those at the ends of the pieces of the way. `collisions` (K, 2) [m] are where
    new ones are first seen, at `collision_s` (K,) [s]. `walkers` (T, 3) [m, m, s] are the ways of others, and
    when they were there.
    """

    episode: int
    agent: str
    points: Array
    times_s: Array
    speeds: Array
    goal: Array
    collisions: Array
    collision_s: Array
    ending: Ending | None
    success: bool
    walkers: list[Array] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class TrackSite:
    """Tracks on a site by method; `world` is None where it cannot be built."""

    cases: str
    world_seed: int | None
    world: World | None
    tracks: dict[str, list[EpisodeTrack]]

    @property
    def title(self) -> str:
        """The cases and the site."""
        return self.cases if self.world_seed is None else f"{self.cases}, site {self.world_seed}"

    @property
    def all_tracks(self) -> list[EpisodeTrack]:
        """The tracks of all methods."""
        return [track for tracks in self.tracks.values() for track in tracks]


def collect_tracks(
    methods: Sequence[EvaluatedPolicy], most_sites: int = MOST_SITES, most_episodes: int = MOST_EPISODES
) -> list[TrackSite]:
    """The tracks of methods with steps: of each set of cases the first `most_sites` sites, as episodes come.

    Of each site they are those of the first `most_episodes` episodes. Methods without steps are left out.
    """
    by_cases: dict[str, list[EvaluatedPolicy]] = {}
    for method in methods:
        if method.run.steps:
            by_cases.setdefault(method.cases, []).append(method)
    found = []
    for cases, members in by_cases.items():
        sites = list(dict.fromkeys(_site(row) for method in members for row in method.rows))
        for site in sites[:most_sites]:
            rows = [row for method in members for row in method.rows if _site(row) == site]
            episodes = sorted({row["episode"] for row in rows})[:most_episodes]
            tracks = {method.name: _tracks(method, site, episodes) for method in members}
            found.append(TrackSite(cases, site, _world(members[0].run.config, rows[0]), tracks))
    return found


def track_of(method: EvaluatedPolicy, row: Row, kind: str, seconds: float) -> TrackSite | None:
    """The last `seconds` [s] before a failure in the episode of `row`, on its site; None without steps."""
    tracks = [
        track
        for track in _tracks(method, _site(row), [row["episode"]])
        if len(track.points) > 1 and track.agent == str(row["agent"])
    ]
    if not tracks:
        return None
    ends = [until_failure(track, kind, seconds) for track in tracks]
    return TrackSite(method.cases, _site(row), _world(method.run.config, row), {method.name: ends})


def until_failure(track: EpisodeTrack, kind: str, seconds: float) -> EpisodeTrack:
    """The `seconds` [s] of a track before its failure: its first collision, or its end for other kinds."""
    last = track.times_s[-1]
    if kind == "collision" and len(track.collision_s):
        last = track.collision_s[0]
    kept = (track.times_s <= last) & (track.times_s >= last - seconds)
    first, end = np.flatnonzero(kept)[[0, -1]] + [0, 1]
    seen = (track.collision_s <= last) & (track.collision_s >= last - seconds)
    return replace(
        track,
        points=track.points[first:end],
        times_s=track.times_s[first:end],
        speeds=track.speeds[first : end - 1],
        collisions=track.collisions[seen],
        collision_s=track.collision_s[seen],
        ending=track.ending if end == len(track.times_s) else None,
        walkers=[way[(way[:, 2] <= last) & (way[:, 2] >= last - seconds)] for way in track.walkers],
    )


def _site(row: Row) -> int | None:
    seed = _number(row, "world_seed")
    return int(seed) if math.isfinite(seed) else None


def _world(config: Mapping[str, Any], row: Row) -> World | None:
    """The world of an episode; None where it cannot be built."""
    try:
        known = {key: value for key, value in config.items() if key in EnvConf.model_fields}
        world = validate(EnvConf, known).world
        changed: dict[str, object] = {}
        for name, key in (("seed", "world_seed"), ("layout_seed", "randomisation/layout_seed")):
            value = _number(row, key)
            if name in type(world).model_fields and math.isfinite(value):
                changed[name] = int(value)
        if row.get("world_file"):
            changed["path"] = str(Path(str(config["set"])).parent / str(row["world_file"]))
        return build_world(world.model_copy(update=changed))
    except (DuneError, KeyError, OSError, ValueError):
        return None


def _tracks(method: EvaluatedPolicy, site: int | None, episodes: Sequence[float]) -> list[EpisodeTrack]:
    rows = [row for row in method.rows if row["episode"] in episodes and _site(row) == site]
    steps: dict[tuple[float, str], list[Row]] = {}
    for step in method.run.steps.of(method.policy, {row["episode"] for row in rows}):
        steps.setdefault((step["episode"], str(step["agent"])), []).append(step)
    agents = {str(row["agent"]) for row in method.rows}
    found = []
    for row in rows:
        if mine := steps.get((row["episode"], str(row["agent"]))):
            others = [
                each
                for (episode, agent), each in steps.items()
                if episode == row["episode"] and agent not in agents
            ]
            found.append(_track(row, mine, others))
    return found


def _track(row: Row, steps: Sequence[Row], others: Sequence[Sequence[Row]]) -> EpisodeTrack:
    points = _finite(steps, "x_m", "y_m", "speed_mps", "time_s")
    places, speeds, times = points[:, :2], np.abs(points[:, 2]), points[:, 3]
    start = np.array([[_number(row, "start_x_m"), _number(row, "start_y_m")]])
    if np.isfinite(start).all():
        places, times = np.concatenate([start, places]), np.append(0.0, times)
    else:
        speeds = speeds[1:]
    new = np.diff(np.nan_to_num(column(steps, "collisions_so_far")), prepend=0.0) > 0
    where = _finite([step for step, begins in zip(steps, new, strict=True) if begins], "x_m", "y_m", "time_s")
    return EpisodeTrack(
        int(row["episode"]),
        str(row["agent"]),
        places,
        times,
        speeds,
        np.array([_number(row, "goal_x_m"), _number(row, "goal_y_m")]),
        where[:, :2],
        where[:, 2],
        ending_of(row),
        _number(row, "success") > 0,
        [_finite(each, "x_m", "y_m", "time_s") for each in others],
    )


def _finite(steps: Sequence[Row], *names: str) -> Array:
    """The columns `names` of the steps that have a finite value in all of them."""
    points = np.column_stack([column(steps, name) for name in names])
    return points[np.isfinite(points).all(axis=1)]


def _number(row: Row, name: str) -> float:
    return float(column([row], name)[0])
