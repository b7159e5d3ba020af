"""Path following: start poses, goals and scripted motion of agents on smooth paths, there and back."""

import math
from collections.abc import Callable
from copy import copy
from itertools import pairwise
from typing import Literal, NamedTuple, Protocol, Self
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import Field, model_validator

from dune_rl.behaviours.paths.loops import (
    LoopStops,
    advance_on_paths,
    hold_back_on_paths,
    limit_steps,
    next_stop,
)
from dune_rl.behaviours.paths.splines import (
    SPACING_M,
    PathBank,
    random_paths,
    spline_loop,
    spline_path,
    there_and_back,
    way_point_stations,
)
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.geometry.shared_per_scene import SharedPerScene, query_grouped
from dune_rl.state.state import GroupState, State
from dune_rl.worlds.walkable_points import PointWords, TerrainLimits, check_stretches, check_way_points
from dune_rl.worlds.world import World

SamplePoints = Callable[[np.random.Generator, int, float], Array]

# Random paths stored for agent k of a group in a world, with k from 1: this number over k.
_BANK_SIZE = 128
_MIN_PATHS = 8
_MAX_PATHS = 64
_START_TRIES = 50
# Between bodies that are placed beside each other [m].
_BETWEEN_M = 0.1
_LEAST_M = 1e-9
_NO_DISCS = np.zeros((0, 3))


class PathConf(Settings):
    """Settings of the paths: a spline through `waypoints`, or random paths, drawn at every reset.

    `waypoints` are (x, y) [m]; `length_range_m` bounds the length of random paths. With `mode` `once` agents
    start at the path's beginning and stay at its end; with `loop` the path is closed. They pause `pauses_s`
    at each way-point, or at the ends of random paths.
    """

    waypoints: tuple[tuple[float, float], ...] = ()
    length_range_m: tuple[float, float] = (6.0, 16.0)
    # Distance from the robots' starts at which agents start, if the path reaches that far [m].
    start_distance_m: float = Field(2.0, ge=0.0)
    mode: Literal["back_and_forth", "loop", "once"] = "back_and_forth"
    pauses_s: float = Field(0.0, ge=0.0, le=3600.0)

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if len(self.waypoints) == 1:
            raise ValueError("waypoints needs at least two points, or none for a random path (got 1)")
        if any(math.dist(a, b) < 0.1 for a, b in pairwise(self.waypoints)):
            raise ValueError("consecutive waypoints must be at least 0.1 m apart")
        if not 1.0 <= self.length_range_m[0] < self.length_range_m[1]:
            raise ValueError(f"length_range_m must rise from at least 1.0 (got {list(self.length_range_m)})")
        if self.mode == "loop" and len(self.waypoints) < 3:
            raise ValueError(
                f"mode=loop needs three waypoints or more (got {len(self.waypoints)}): give them, or take "
                "mode=back_and_forth"
            )
        if self.mode == "loop" and math.dist(self.waypoints[0], self.waypoints[-1]) < 0.1:
            raise ValueError("mode=loop goes from the last of the waypoints to the first: leave the last out")
        return self


class _WorldPaths(NamedTuple):
    """Paths of one world: the loops of all agents of a scene, the indices of each agent's, and stops."""

    bank: PathBank
    choices: tuple[Counts, ...]
    stops: LoopStops


class PathFollower:
    """Start poses, goals and scripted poses of N = M * G agents on paths, rows scene after scene.

    Each agent has a closed loop: a path to its far end and back, or one round. `goals_w` (N, 2) [m] are the
    ends of the paths that steered agents go to; `renew` sets the other end. `advance` moves followers along
    their loops at the constant speed `speed_mps`, but for their pauses. `settings` is the path of the
    group's settings; errors about way-points name it.
    """

    def __init__(
        self,
        conf: PathConf,
        count: int,
        radius_m: float,
        worlds: SharedPerScene[World],
        settings: str = "actors.walker",
        speed_mps: float = 1.0,
        max_water_m: float = 100.0,
    ) -> None:
        self.conf, self.count = conf, count
        self._limits = TerrainLimits(radius_m=radius_m, max_slope_deg=90.0, max_water_m=max_water_m)
        self._radius_m, self._settings, self._worlds = radius_m, settings, worlds
        self._speed_mps = speed_mps
        rows = len(worlds) * count
        # Entries live as long as their worlds.
        self._paths: WeakKeyDictionary[World, _WorldPaths] = WeakKeyDictionary()
        self.goals_w = np.zeros((rows, 2))
        self._loop = np.zeros((len(worlds), count), np.int64)
        self._outbound = np.ones(rows, bool)
        # Ways along the loops, the last steps and the next ones, and offsets of agents from their paths [m].
        self._travelled, self._step, self._distances = np.zeros((3, len(worlds), count))
        self._offsets = np.zeros((len(worlds), count, 2))
        # Where they would be on their paths after the last `advance`.
        self._targets = np.zeros((len(worlds), count, 4))
        # See `loops`.
        self._agents = self._travelled, self._step, self._offsets, self._targets
        self._scenes = np.arange(len(worlds))
        self._next_stop_m, self._pause_left_m = np.zeros((2, len(worlds), count))
        self._has_stops = conf.mode == "once" or conf.pauses_s > 0.0

    def find_paths(self, world: World, sample_points: SamplePoints, rng: np.random.Generator) -> None:
        """Find the paths of `world` unless they are known.

        `sample_points(rng, n, radius_m)` draws free points (n, 2). Raises `WorldError` if no path fits.
        """
        if world not in self._paths:
            self._paths[world] = self._make_paths(world, sample_points, rng)

    def clear_paths(self) -> None:
        """Drop the paths of all worlds."""
        self._paths.clear()

    def _make_paths(self, world: World, sample_points: SamplePoints, rng: np.random.Generator) -> _WorldPaths:
        conf = self.conf
        loops: list[Array] = []
        choices: list[Counts] = []
        given = [self._path_through_way_points(world)] if conf.waypoints else []
        for agent in range(self.count):
            paths = given
            if not given:
                room = self._radius_m + 0.1
                # By the agent's own number, so that agents behind it leave its paths as they are.
                number = min(_MAX_PATHS, max(_MIN_PATHS, _BANK_SIZE // (agent + 1)))
                paths = random_paths(
                    world, sample_points, rng, number, room, conf.length_range_m, self._settings
                )
            choices.append(np.arange(len(loops), len(loops) + len(paths)))
            loops += paths if conf.mode == "loop" else [there_and_back(path) for path in paths]
        return _WorldPaths(PathBank.of(loops), tuple(choices), self._find_stops(loops))

    def _path_through_way_points(self, world: World) -> Array:
        """The path (P, 4); raises `WorldError`, which names the way-points where it cannot be walked."""
        points, closed = np.asarray(self.conf.waypoints), self.conf.mode == "loop"
        words = PointWords("way-point", f"{self._settings}.path.waypoints", f"{self._settings}.body")
        check_way_points(world, points, self._limits, words, closed=closed)
        path = (spline_loop if closed else spline_path)(points, world.terrain)
        stops = way_point_stations(points, closed=closed)
        ends = (np.concatenate([path, path[:1]]), np.append(stops, len(path))) if closed else (path, stops)
        check_stretches(world, ends[0][:, :3], ends[1], self._limits, words)
        return path

    def _find_stops(self, loops: list[Array]) -> LoopStops:
        """Where agents pause and end on `loops`."""
        conf, closed = self.conf, self.conf.mode == "loop"
        stops = []
        for loop in loops:
            length = len(loop) if closed else len(loop) // 2
            ends = np.array([0, length])
            there = way_point_stations(np.asarray(conf.waypoints), closed=closed) if conf.waypoints else ends
            back = np.zeros(0, np.int64) if closed else len(loop) - there
            found = np.unique(np.concatenate([there, back]) % len(loop)) if conf.pauses_s > 0.0 else ends[:0]
            stops.append(SPACING_M * found)
        lengths = [SPACING_M * len(loop) for loop in loops]
        is_once = conf.mode == "once"
        return LoopStops.of(stops, lengths, [length / 2 if is_once else np.inf for length in lengths])

    def paths(self, agent: int, scene: int = 0) -> list[Array]:
        """One-way paths of an agent of a scene, each (P, 2) [m]."""
        bank, choices, _ = self._paths[self._worlds[scene]]
        counts = bank.lengths[choices[agent]]
        starts, counts = bank.starts[choices[agent]], counts if self.conf.mode == "loop" else counts // 2 + 1
        return [bank.poses[start : start + n, :2] for start, n in zip(starts, counts, strict=True)]

    def present_path(self, agent: int, scene: int = 0) -> Array:
        """The loop (P, 2) [m] that an agent of a scene is on."""
        bank = self._paths[self._worlds[scene]].bank
        loop = int(self._loop[scene, agent])
        first = int(bank.starts[loop])
        return bank.poses[first : first + int(bank.lengths[loop]), :2]

    def reset(
        self,
        scene: int,
        rng: np.random.Generator,
        avoid_xy: Array,
        discs: Array | None = None,
        radius_m: float = 0.0,
    ) -> Array:
        """Start poses (G, 4: x, y, z, yaw) of a scene's agents, each on a path drawn with `rng`.

        They are `start_distance_m` away from the points `avoid_xy` (R, 2); if no sampled point of an agent's
        paths is that far away, the farthest one is used. Agents may overlap, as followers go through each
        other; with `discs` (K, 3: x, y, radius), agents of `radius_m` keep off these and off each other.
        """
        found = []
        for agent in range(self.count):
            pose, _ = self._start(scene, agent, rng, avoid_xy, discs, radius_m)
            found.append(pose)
            if discs is not None:
                discs = np.concatenate([discs, [[*pose[:2], radius_m]]])
        return np.array(found)

    def place_agent(
        self,
        scene: int,
        agent: int,
        rng: np.random.Generator,
        avoid_xy: Array,
        discs: Array | None,
        radius_m: float,
    ) -> Array | None:
        """As `reset`, of one agent; None where it has no room."""
        pose, apart = self._start(scene, agent, rng, avoid_xy, discs, radius_m)
        return pose if apart >= 1.0 else None

    def _start(
        self,
        scene: int,
        agent: int,
        rng: np.random.Generator,
        avoid_xy: Array,
        discs: Array | None,
        radius_m: float,
    ) -> tuple[Array, float]:
        """Start an agent on one of its paths: its pose (4), and how far it is from the others.

        That is the least of its distances from the points `avoid_xy` (R, 2) and from the middles of `discs`
        (K, 3), each over the distance that is to be kept: 1 or more where there is room.
        """
        discs = _NO_DISCS if discs is None else discs + np.array([0.0, 0.0, radius_m + _BETWEEN_M])
        bank, choices, stops = self._paths[self._worlds[scene]]
        is_once, row = self.conf.mode == "once", scene * self.count + agent
        farthest, found = -1.0, np.zeros(4)
        keeps_m = max(self.conf.start_distance_m, _LEAST_M)
        # States that were handed out keep theirs.
        self.goals_w = self.goals_w.copy()
        for _ in range(_START_TRIES):
            loop = rng.choice(choices[agent])
            travelled = 0.0 if is_once else rng.uniform(0.0, bank.lengths[loop]) * SPACING_M
            pose = bank.pose(loop, np.asarray(travelled))
            apart = float(np.hypot(*(pose[:2] - avoid_xy).T).min(initial=np.inf)) / keeps_m
            apart = float((np.hypot(*(pose[:2] - discs[:, :2]).T) / discs[:, 2]).min(initial=apart))
            if apart > farthest:
                farthest, found = apart, pose
                self._loop[scene, agent] = loop
                self._travelled[scene, agent] = travelled
                self.goals_w[row] = bank.far_end(loop)[:2]
            if apart >= 1.0:
                break
        drawn = int(self._loop[scene, agent]), float(self._travelled[scene, agent])
        self._next_stop_m[scene, agent], self._pause_left_m[scene, agent] = next_stop(stops, *drawn), 0.0
        self._outbound[row] = True
        self._offsets[scene, agent] = 0.0
        return found, farthest

    def advance(self, step_s: float) -> Array:
        """Move each agent along its loop for `step_s`, after returning to it; returns the poses (N, 4)."""
        self._distances[:] = self._speed_mps * step_s
        for world, scenes in self._worlds.groups:
            bank, _, stops = self._paths[world]
            rows = self._scenes[scenes]
            if self._has_stops:
                pause_m, agents = (
                    self.conf.pauses_s * self._speed_mps,
                    (self._next_stop_m, self._pause_left_m),
                )
                limit_steps(stops, rows, self._loop, self._travelled, pause_m, agents, self._distances)
            advance_on_paths(bank.arrays, rows, self._loop, self._distances, SPACING_M, self._agents)
        poses = self._targets.copy()
        if self._offsets.any():
            poses[..., :2] += self._offsets
            height = query_grouped(self._worlds.groups, _height, poses[..., :2])
            poses[..., 2] = np.where(self._offsets.any(axis=2), height, poses[..., 2])
        return poses.reshape(-1, 4)

    def twin(self) -> Self:
        """A copy that moves on by itself, by the same paths."""
        twin = copy(self)
        twin._travelled, twin._step, twin._distances = (
            self._travelled.copy(),
            self._step.copy(),
            self._distances.copy(),
        )
        twin._offsets, twin._targets = self._offsets.copy(), self._targets.copy()
        twin._next_stop_m, twin._pause_left_m = self._next_stop_m.copy(), self._pause_left_m.copy()
        twin._agents = twin._travelled, twin._step, twin._offsets, twin._targets
        return twin

    def targets(self, scenes: Counts) -> Array:
        """Where the agents of `scenes` (S,) would be on their paths, (S, G, 4), after the last `advance`."""
        return self._targets[scenes]

    def hold_back(self, scenes: Counts, poses: Array) -> None:
        """Set the agents of `scenes` (S,) to `poses` (S, G, 4), to which robots limited them.

        An agent repeats the missing part of its step, and returns from a lateral offset to its path.
        """
        xy = np.ascontiguousarray(poses[..., :2])
        for world, own in self._worlds.select_groups(scenes):
            paths = self._paths[world].bank.arrays
            hold_back_on_paths(paths, scenes[own], self._loop, xy[own], SPACING_M, self._agents)

    def renew(self, mask: Flags) -> None:
        """Set the other end of the path as goal of the agents in `mask` (N,)."""
        self._outbound = self._outbound ^ mask
        shape = self._loop.shape

        def ends(world: World, loop: Counts, outbound: Flags) -> Array:
            bank = self._paths[world].bank
            near_w = bank.poses[bank.starts[loop], :2]
            return np.where(outbound[..., None], bank.far_end(loop)[..., :2], near_w)

        ends_w = query_grouped(self._worlds.groups, ends, self._loop, self._outbound.reshape(shape))
        self.goals_w = np.where(mask[:, None], ends_w.reshape(-1, 2), self.goals_w)


class Follower(Protocol):
    """Moves agents along their ways."""

    def advance(self, step_s: float) -> Array:
        """Let `step_s` [s] pass; returns the poses (N, 4)."""
        ...

    def twin(self) -> Self:
        """A copy that moves on by itself."""
        ...


class FollowPath:
    """The behaviours `path` and `trajectory`: moves agents along their paths, whatever is in their way.

    Actions are poses (N, 4: x, y, z, yaw) [m, rad], for `KinematicBody(is_prescribed=True)`.
    """

    def __init__(self, follower: Follower) -> None:
        self._follower = follower

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing: the source of starts puts agents on their paths."""

    def act(self, state: State, group: GroupState) -> Array:
        """The poses (N, 4) of the agents at the end of the next control step."""
        return self._follower.advance(group.episode.step_s)

    def forecast(self, step_s: float, steps: int) -> Array:
        """Where the agents will be, (N, steps, 2) [m], every `step_s` [s] from now on, unless held up."""
        follower = self._follower.twin()
        return np.stack([follower.advance(step_s)[:, :2] for _ in range(steps)], axis=1)


def _height(world: World, xy: Array) -> Array:
    return world.terrain.height(xy)
