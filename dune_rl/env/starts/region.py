"""Starts and goals that are sampled in a region of the world."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.env.body import Body
from dune_rl.env.requests import AgentRequest
from dune_rl.env.starts.source import Asked, StartDraw, StartSource, Taken, TakenPlaces
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.geometry.shared_per_scene import SharedPerScene
from dune_rl.tasks.spawn import Placement, SpawnConf, SpawnedBody, Spawner
from dune_rl.worlds.world import World


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
        self._conf, self.radius_m, self._worlds = conf, radius_m, worlds
        self._is_passable, self._body, self._whose = is_passable, body or SpawnedBody(), whose
        # Weak references would not work, because a spawner refers to its world.
        self._by_world: dict[tuple[World, bool], Spawner] = {}

    def of(self, world: World, *, anywhere: bool = False) -> Spawner:
        """The spawner of a world's region, or of all of it; raises `WorldError` if there is no room."""
        if (world, anywhere) not in self._by_world:
            conf = self._conf.model_copy(update={"region": "anywhere"}) if anywhere else self._conf
            try:
                self._by_world[world, anywhere] = Spawner(
                    world, conf, self.radius_m, self._is_passable, self._body
                )
            except WorldError as error:
                raise WorldError(f"{self._whose}{error}") from None
        return self._by_world[world, anywhere]

    def of_scene(self, scene: int, *, anywhere: bool = False) -> Spawner:
        """As `of`, of a scene's present world."""
        return self.of(self._worlds[scene], anywhere=anywhere)

    def keep(self, worlds: Collection[World]) -> None:
        """Drop the spawners of all other worlds."""
        self._by_world = {key: spawner for key, spawner in self._by_world.items() if key[0] in worlds}


@dataclass(frozen=True)
class StartContext:
    """What a source of starts and goals knows of its group.

    `agents` are the agents' names, and `streams` the names of their random streams. `avoided` lists the
    sources from whose agents and goals new goals keep their distance; the new source appends itself. `name`
    is the group's in errors, empty for robots. `position` returns the agents' positions (N, 3) [m], and
    `spawn` has the settings.
    """

    name: str
    agents: tuple[str, ...]
    is_robot: bool
    worlds: SharedPerScene[World]
    spawners: Spawners
    position: Callable[[], Array]
    streams: tuple[str, ...]
    avoided: "list[RegionStarts]"
    spawn: SpawnConf


class RegionStarts(StartSource):
    """Start poses and goals of M * G agents, sampled by a `Spawner` in a region of the world.

    A subclass may draw in another way: see `draw_start` and `draw_goal`.
    """

    faces_free_way = True

    def __init__(self, context: StartContext, conf: SpawnConf) -> None:
        self.conf, self._context = conf, context
        self.rank = 0 if context.is_robot else 1
        self.footprint_radius_m = context.spawners.radius_m
        self._count, self._worlds, self._spawners = len(context.agents), context.worlds, context.spawners
        context.avoided.append(self)
        rows = len(context.worlds) * self._count
        self.goals_w = np.zeros((rows, 2))
        self._draws: list[np.random.Generator | None] = [None] * rows
        self._difficulty = np.ones(len(context.worlds))
        self._anywhere = np.zeros(len(context.worlds), bool)

    # -- drawing ----------------------------------------------------------------------------------

    def draw_start(
        self,
        spawner: Spawner,
        draws: np.random.Generator,
        taken: Sequence[Placement],
        apart_m: Sequence[float],
    ) -> Placement:
        """A start and a goal, at `apart_m` from those `taken`; raises `WorldError` if there is no room."""
        return spawner.sample(draws, taken, apart_m)

    def draw_goal(
        self, spawner: Spawner, draws: np.random.Generator, start: Array, taken: Array, apart_m: Array
    ) -> tuple[float, float]:
        """A new goal for an agent at `start` (2,), at `apart_m` (K,) from the points `taken` (K, 2)."""
        return spawner.sample_goal(draws, start, taken, apart_m)

    def _sample(self, spawner: Spawner, draws: np.random.Generator, taken: Sequence[Taken]) -> Placement:
        reach = self.footprint_radius_m + self.conf.robots_apart_m
        placements, apart = [one for one, _ in taken], [reach + radius for _, radius in taken]
        try:
            return self.draw_start(spawner, draws, placements, apart)
        except WorldError as error:
            name = self._context.name
            raise WorldError(f"{name} (count {self._count}): {error}" if name else str(error)) from None

    def _spawner(self, scene: int) -> Spawner:
        """The spawner of a scene's world, for the difficulty of its episode."""
        spawner = self._spawners.of_scene(scene, anywhere=bool(self._anywhere[scene]))
        return spawner.eased(float(self._difficulty[scene]))

    def _stream(self, draw: StartDraw, agent: int) -> np.random.Generator:
        again = (draw.attempt,) if draw.attempt else ()
        return stream(draw.seed, self._context.streams[agent], draw.episode, *again)

    # -- worlds -----------------------------------------------------------------------------------

    def prepare(self, world: World, seed: int) -> None:
        """Find the free space of `world`; raises `WorldError` if there is no room."""
        self._spawners.of(world)
        if self.conf.anywhere_share and self.conf.region != "anywhere":
            self._spawners.of(world, anywhere=True)

    def keep(self, worlds: Collection[World]) -> None:
        """Drop the free space of all other worlds."""
        self._spawners.keep(worlds)

    # -- starts -----------------------------------------------------------------------------------

    def place(self, draw: StartDraw, agents: Sequence[int], taken: TakenPlaces, asked: Asked) -> Array:
        poses, scene = np.zeros((len(agents), 4)), draw.scene
        self._difficulty[scene] = draw.difficulty
        if self.conf.anywhere_share and self.conf.region != "anywhere":
            share = stream(draw.seed, f"{self._context.streams[0]} anywhere", draw.episode).random()
            self._anywhere[scene] = share < self.conf.anywhere_share
        for index, agent in enumerate(agents):
            row = scene * self._count + agent
            request = asked.get(agent, AgentRequest())
            self._draws[row] = draws = self._stream(draw, agent)
            avoided = () if request.start is not None else taken.placements
            placement = self._sample(self._spawner(scene), draws, avoided)
            if agent in asked:
                placement = self._move(scene, agent, draws, request, placement)
            self.set_goals(np.array([row]), np.array([placement.goal_x, placement.goal_y]))
            taken.placements.append((placement, self.footprint_radius_m))
            poses[index] = placement.x, placement.y, 0.0, placement.yaw
        poses[:, 2] = self._worlds[scene].terrain.height(poses[:, :2])
        return poses

    def _move(
        self, scene: int, agent: int, draws: np.random.Generator, asked: AgentRequest, sampled: Placement
    ) -> Placement:
        """The placement that is asked for; raises ValueError where the agent has no room.

        Without a goal, it is drawn anew, at the usual distance from the new start. It is not checked that a
        way leads from a given start to a given goal.
        """
        spawner, placement = self._spawner(scene), asked.applied(sampled)
        if asked.goal is None:
            start = np.array([placement.x, placement.y])
            goal_x, goal_y = self.draw_goal(spawner, draws, start, np.zeros((0, 2)), np.zeros(0))
            placement = replace(placement, goal_x=goal_x, goal_y=goal_y)
        for what, x, y in (
            ("start", placement.x, placement.y),
            ("goal", placement.goal_x, placement.goal_y),
        ):
            reason = spawner.why_not(x, y)
            if reason:
                name = self._context.agents[agent]
                raise ValueError(f"the {what} of {name} ({x:g}, {y:g}) {reason}: choose another")
        return placement

    def admit(self, draw: StartDraw, agent: int, taken: TakenPlaces) -> Array | None:
        """A start pose (4) for an agent that comes later; None without room now."""
        try:
            pose: Array = self.place(draw, [agent], taken, {})[0]
        except WorldError:
            return None
        return pose

    def occupy(self, taken: TakenPlaces, body: Body, scene: int) -> None:
        taken.points.append(body.outline_points(scene))

    def check_count(self, world: World, draw: StartDraw, taken: list[Taken]) -> None:
        for agent in range(self._count):
            placement = self._sample(self._spawners.of(world), self._stream(draw, agent), taken)
            taken.append((placement, self.footprint_radius_m))

    # -- goals ------------------------------------------------------------------------------------

    def set_goals(self, rows: Counts, goals_w: Array) -> None:
        self.goals_w = self.goals_w.copy()
        self.goals_w[rows] = goals_w

    def renew(self, mask: Flags) -> None:
        """Sample new goals for the agents in `mask` (N,), at a distance from their positions, from the other
        agents and from these agents' goals.
        """
        goals_w, position_w = self.goals_w.copy(), self._context.position()
        for row in np.flatnonzero(mask).tolist():
            draws = self._draws[row]
            assert draws is not None, "an agent is placed before its goal is renewed"
            taken, apart_m = self._taken_by_others(row, goals_w)
            spawner = self._spawner(row // self._count)
            goals_w[row] = self.draw_goal(spawner, draws, position_w[row, :2], taken, apart_m)
        self.goals_w = goals_w

    def _taken_by_others(self, row: int, own_goals_w: Array) -> tuple[Array, Array]:
        """Positions and goals (K, 2) of a scene's other agents, and the distance to keep from each [m]."""
        scene, points, apart = row // self._count, [np.zeros((0, 2))], [np.zeros(0)]
        for other in self._context.avoided:
            rows = np.arange(scene * other._count, (scene + 1) * other._count)
            goals_w = other.goals_w
            if other is self:
                rows, goals_w = rows[rows != row], own_goals_w
            points += [other._context.position()[rows, :2], goals_w[rows]]
            reach = self.footprint_radius_m + self.conf.robots_apart_m + other.footprint_radius_m
            apart.append(np.full(2 * len(rows), reach))
        return np.concatenate(points), np.concatenate(apart)
