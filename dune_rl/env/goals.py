"""Where the agents of a group start and where they are to go."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dune_rl.behaviours.paths.follower import PathFollower
from dune_rl.behaviours.trajectory import TrajectoryFollower
from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import wrap_angle
from dune_rl.geometry.shared_per_scene import SharedPerScene
from dune_rl.state.state import GoalState, Motion
from dune_rl.tasks.spawn import Placement, SpawnConf, Spawner
from dune_rl.tasks.spawned_body import SpawnedBody
from dune_rl.worlds.world import World

Rows = NDArray[np.int64]

# How often agents are placed anew where there is no room for the last of them.
PLACING_ATTEMPTS = 8


class GoalSource(Protocol):
    """Goals of N agents, which are replaced when they are reached."""

    @property
    def goals_w(self) -> Array:
        """Goals (N, 2) [m]."""
        ...

    def renew(self, mask: Flags) -> None:
        """Set new goals for the agents in `mask` (N,)."""
        ...

    def set_goals(self, rows: Rows, goals_w: Array) -> None:
        """Set the goals of the agents in `rows` (K,) to `goals_w` (K, 2) [m]."""
        ...


class Spawners:
    """Cache of one `Spawner` per world, for a footprint of `radius_m`.

    `is_passable` and `body` are as for `Spawner`. Errors start with `whose`, if it is given.
    """

    def __init__(
        self,
        conf: SpawnConf,
        radius_m: float,
        worlds: SharedPerScene[World],
        is_passable: Callable[[World, Array], Flags] | None = None,
        body: SpawnedBody | None = None,
        whose: str = "",
    ) -> None:
        self._conf, self._radius_m, self._worlds = conf, radius_m, worlds
        self._is_passable, self._body, self._whose = is_passable, body or SpawnedBody(), whose
        # Weak references would not work, because a spawner refers to its world.
        self._by_world: dict[World, Spawner] = {}

    def of(self, world: World) -> Spawner:
        """The spawner of a world; raises `WorldError` if the world has no room."""
        if world not in self._by_world:
            try:
                self._by_world[world] = Spawner(
                    world, self._conf, self._radius_m, self._is_passable, self._body
                )
            except WorldError as error:
                raise WorldError(f"{self._whose}{error}") from None
        return self._by_world[world]

    def of_scene(self, scene: int) -> Spawner:
        """The spawner of a scene's present world."""
        return self.of(self._worlds[scene])

    def keep(self, worlds: Collection[World]) -> None:
        """Drop the spawners of all other worlds."""
        self._by_world = {world: spawner for world, spawner in self._by_world.items() if world in worlds}


class RegionGoals:
    """Start poses and goals of M * G agents, sampled by a `Spawner` in a region of the world.

    `position` returns the agents' positions (N, 3). `robots` lists the goals of the groups before this one
    from which its starts and goals are apart; the new object is appended. A robot's number among all robots
    of a scene selects its random stream, so that further robots do not change its starts and goals; agents
    with another body have a stream by the name of their group, `stream_name`, and leave robots' alone.
    """

    def __init__(
        self,
        conf: SpawnConf,
        footprint_radius_m: float,
        spawners: Spawners,
        num_scenes: int,
        count: int,
        position: Callable[[], Array],
        robots: "list[RegionGoals]",
        stream_name: str | None = None,
    ) -> None:
        self.conf, self.footprint_radius_m, self._stream_name = conf, footprint_radius_m, stream_name
        self._spawners, self._count, self._position = spawners, count, position
        self._first = sum(other._count for other in robots)
        self._robots = robots
        robots.append(self)
        self.goals_w = np.zeros((num_scenes * count, 2))
        self._streams: list[np.random.Generator | None] = [None] * (num_scenes * count)

    def place(
        self,
        scene: int,
        seed: int,
        episode: int,
        taken: Sequence[tuple[Placement, float]],
        agents: Iterable[int] | None = None,
        attempt: int = 0,
    ) -> list[Placement]:
        """Sample starts and goals of a scene's agents for an episode, at a distance from those `taken`.

        `agents` are the numbers of those that are placed; None: all.
        `taken` has the placements of other robots and their footprint radii [m]. Raises WorldError if there
        is no room; with another `attempt` they are drawn anew.
        """
        found = list(taken)
        for agent in range(self._count) if agents is None else agents:
            placed = self.place_agent(scene, seed, episode, agent, found, attempt)
            found.append((placed, self.footprint_radius_m))
        return [placement for placement, _ in found[len(taken) :]]

    def place_agent(
        self,
        scene: int,
        seed: int,
        episode: int,
        agent: int,
        taken: Sequence[tuple[Placement, float]],
        attempt: int = 0,
    ) -> Placement:
        """As `place`, of one of a scene's agents."""
        row = scene * self._count + agent
        draws = self._draws(seed, agent, episode, attempt)
        placement = self._sample(self._spawners.of_scene(scene), draws, taken)
        self._streams[row] = draws
        self.set_goals(np.array([row]), np.array([placement.goal_x, placement.goal_y]))
        return placement

    def set_goals(self, rows: Rows, goals_w: Array) -> None:
        """Set the goals of the agents in `rows` (K,) to `goals_w` (K, 2) [m]."""
        # States that were handed out keep theirs.
        self.goals_w = self.goals_w.copy()
        self.goals_w[rows] = goals_w

    def try_placing(
        self, world: World, seed: int, episode: int, taken: Sequence[tuple[Placement, float]]
    ) -> list[tuple[Placement, float]]:
        """`taken`, and what `place` would add to it in `world`; nothing is kept."""
        found = list(taken)
        for agent in range(self._count):
            placed = self._sample(self._spawners.of(world), self._draws(seed, agent, episode), found)
            found.append((placed, self.footprint_radius_m))
        return found

    def _draws(self, seed: int, agent: int, episode: int, attempt: int = 0) -> np.random.Generator:
        number, again = self._first + agent, (attempt,) if attempt else ()
        if self._stream_name is not None:
            return stream(seed, f"spawn {self._stream_name}_{agent}", episode, *again)
        return stream(seed, f"spawn rover_{number}" if number else "spawn", episode, *again)

    def _sample(
        self, spawner: Spawner, draws: np.random.Generator, taken: Sequence[tuple[Placement, float]]
    ) -> Placement:
        reach = self.footprint_radius_m + self.conf.robots_apart_m
        placements, apart = [one for one, _ in taken], [reach + radius for _, radius in taken]
        try:
            return spawner.sample(draws, placements, apart)
        except WorldError as error:
            name = self._stream_name
            raise WorldError(f"{name} (count {self._count}): {error}" if name else str(error)) from None

    def move(self, scene: int, agent: int, name: str, placement: Placement, *, has_goal: bool) -> Placement:
        """Place an agent, called `name`, somewhere else; raises ValueError where it has no room.

        Unless it `has_goal`, its goal is drawn anew, at the usual distance from the new start. It is not
        checked that a way leads from a given start to a given goal.
        """
        spawner, row = self._spawners.of_scene(scene), scene * self._count + agent
        draws = self._streams[row]
        if not has_goal:
            assert draws is not None, "an agent is placed before it is moved"
            start = np.array([placement.x, placement.y])
            goal_x, goal_y = spawner.sample_goal(draws, start, np.zeros((0, 2)), np.zeros(0))
            placement = replace(placement, goal_x=goal_x, goal_y=goal_y)
        for what, x, y in (
            ("start", placement.x, placement.y),
            ("goal", placement.goal_x, placement.goal_y),
        ):
            reason = spawner.why_not(x, y)
            if reason:
                raise ValueError(f"the {what} of {name} ({x:g}, {y:g}) {reason}: choose another")
        self.set_goals(np.array([row]), np.array([placement.goal_x, placement.goal_y]))
        return placement

    def renew(self, mask: Flags) -> None:
        """Sample new goals for the agents in `mask` (N,), at a distance from their positions, from the other
        robots and from these robots' goals.
        """
        self.goals_w = self.goals_w.copy()
        position_w = self._position()
        for row in np.flatnonzero(mask).tolist():
            draws = self._streams[row]
            assert draws is not None, "an agent is placed before its goal is renewed"
            taken, apart_m = self._taken_by_others(row)
            spawner = self._spawners.of_scene(row // self._count)
            self.goals_w[row] = spawner.sample_goal(draws, position_w[row, :2], taken, apart_m)

    def _taken_by_others(self, row: int) -> tuple[Array, Array]:
        """Positions and goals (K, 2) of a scene's other robots, and the distance to keep from each [m]."""
        scene, points, apart = row // self._count, [np.zeros((0, 2))], [np.zeros(0)]
        for robots in self._robots:
            rows = np.arange(scene * robots._count, (scene + 1) * robots._count)
            if robots is self:
                rows = rows[rows != row]
            points += [robots._position()[rows, :2], robots.goals_w[rows]]
            reach = self.footprint_radius_m + self.conf.robots_apart_m + robots.footprint_radius_m
            apart.append(np.full(2 * len(rows), reach))
        return np.concatenate(points), np.concatenate(apart)


def place_groups(
    groups: Sequence[tuple[GoalSource, Iterable[int] | None]],
    scene: int,
    seed: int,
    episode: int,
    taken: Sequence[tuple[Placement, float]],
) -> list[list[Placement]]:
    """Starts and goals of a scene's agents, by group, away from those `taken` and from each other.

    Where those placed first leave no room for others, all are drawn anew. `groups` are `RegionGoals` and the
    numbers of the agents that are placed, None for all. Raises WorldError if there is no room.
    """
    for attempt in range(PLACING_ATTEMPTS):
        found: list[list[Placement]] = []
        others = list(taken)
        try:
            for source, agents in groups:
                assert isinstance(source, RegionGoals)
                found.append(source.place(scene, seed, episode, others, agents, attempt))
                others += [(one, source.footprint_radius_m) for one in found[-1]]
            break
        except WorldError:
            if attempt == PLACING_ATTEMPTS - 1:
                raise
    return found


class PathGoals:
    """Goals of agents on paths: the far end of an agent's path, then its start, and so on.

    Of agents on trajectories they are the last way-points.
    """

    def __init__(self, follower: PathFollower | TrajectoryFollower) -> None:
        self.follower = follower

    @property
    def goals_w(self) -> Array:
        """Goals (N, 2) [m]."""
        return self.follower.goals_w

    def renew(self, mask: Flags) -> None:
        """Set the other end of the path as goal of the agents in `mask` (N,)."""
        self.follower.renew(mask)

    def set_goals(self, rows: Rows, goals_w: Array) -> None:
        """Set the goals of the agents in `rows` (K,) to `goals_w` (K, 2) [m], for now."""
        self.follower.goals_w = self.follower.goals_w.copy()
        self.follower.goals_w[rows] = goals_w


class GoalTracker:
    """Tracks the distance and bearing of N agents' goals from step to step."""

    def __init__(self, source: GoalSource, num_rows: int) -> None:
        self.source = source
        self._distance = np.zeros(num_rows)
        self.latest = GoalState(source.goals_w, self._distance, self._distance, self._distance)

    def begin(self, mask: Flags, motion: Motion) -> GoalState:
        """The goals at the start of the episodes in `mask` (N,)."""
        distance, bearing = self._polar(motion)
        self._distance = np.where(mask, distance, self._distance)
        self.latest = GoalState(self.source.goals_w, distance, self._distance, bearing)
        return self.latest

    def measure(self, motion: Motion) -> GoalState:
        """The goals after a control step; call it once a step."""
        previous = self._distance
        self._distance, bearing = self._polar(motion)
        self.latest = GoalState(self.source.goals_w, self._distance, previous, bearing)
        return self.latest

    def renew(self, mask: Flags, motion: Motion, now: GoalState) -> GoalState:
        """Renew the goals of the agents in `mask` (N,) and return the updated state."""
        if not mask.any():
            return now
        self.source.renew(mask)
        self._distance, bearing = self._polar(motion)
        return GoalState(self.source.goals_w, self._distance, now.previous_distance, bearing)

    def _polar(self, motion: Motion) -> tuple[Array, Array]:
        offset = self.source.goals_w - motion.position_w[:, :2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        return distance, wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - motion.yaw)
