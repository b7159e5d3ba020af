"""Places the agents of a scene, when an episode starts and when they come later."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import combinations, groupby

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.requests import EpisodeRequest
from dune_rl.env.starts.source import StartDraw, Taken, TakenPlaces
from dune_rl.geometry.arrays import Array, Counts
from dune_rl.tasks.spawn import Placement
from dune_rl.worlds.walkable_points import PointWords, TerrainLimits, check_points
from dune_rl.worlds.world import World

# How often agents are placed anew where there is no room for the last of them.
_ATTEMPTS = 8


def in_order(groups: Sequence[AgentGroup]) -> list[AgentGroup]:
    """The groups in the order in which they are placed: robots first, agents on paths last."""
    return sorted(groups, key=_rank)


def _rank(group: AgentGroup) -> int:
    return group.starts.rank


def prepare_starts(groups: Sequence[AgentGroup], seed: int, world: World) -> None:
    """Find what starts in `world` need; raises `WorldError`, with the faults of all groups."""
    check_all([partial(group.starts.prepare, world, seed) for group in in_order(groups)])


def check_places(group: AgentGroup, world: World, *, only_edge: bool) -> None:
    """Raise `WorldError` with a line for each place of a group's behaviour where its bodies can never be.

    With `only_edge` places need only be inside the world, as where worlds are drawn that differ in the rest.
    """
    setup, deepest_m = group.setup, group.description.max_water_m
    if not setup.places or deepest_m is None:
        return
    limits = None if only_edge else TerrainLimits(radius_m=0.0, max_slope_deg=90.0, max_water_m=deepest_m)
    words = PointWords("place", f"{setup.settings}.controller.places", f"{setup.settings}.body")
    check_points(world, np.array(setup.places, float), limits, words)


def check_counts(groups: Sequence[AgentGroup], seed: int, world: World) -> None:
    """Raise `WorldError` if `world` has no room for all agents beside each other.

    The error is that of the last of a few episodes, in none of which all could be placed. Agents that come
    later are not counted: they wait until there is room.
    """
    for episode in range(_ATTEMPTS):
        taken = fixed_starts(groups, world)
        try:
            for group in in_order(groups):
                if group.is_there_at_start:
                    group.starts.check_count(world, StartDraw(0, seed, episode), taken)
            return
        except WorldError:
            if episode == _ATTEMPTS - 1:
                raise


def fixed_starts(groups: Sequence[AgentGroup], world: World) -> list[Taken]:
    """Starts that never change, of all groups."""
    return [taken for group in groups for taken in group.starts.fixed_starts(world)]


def place_agents(
    groups: Sequence[AgentGroup], draw: StartDraw, world: World, request: EpisodeRequest
) -> None:
    """Place the bodies of a scene for an episode.

    `request` has starts and goals of robots in place of sampled ones. Raises `WorldError` if there is no
    room, and ValueError if a requested place is not free, or not a robot's.
    """
    robots = {name for group in groups if group.description.is_robot for name in group.names}
    others = [name for name in request if name not in robots]
    if others:
        raise ValueError(f"{', '.join(others)}: only robots start and go where they are told")
    taken = TakenPlaces(fixed_starts(groups, world))
    for _, ranked in groupby(in_order(groups), key=_rank):
        _place_together(list(ranked), draw, taken, request)


def draw_starts(groups: Sequence[AgentGroup], world: World, seed: int, episode: int) -> list[Placement]:
    """Starts and goals that are sampled for an episode in scene 0, without placing any body."""
    taken = TakenPlaces(fixed_starts(groups, world))
    first = len(taken.placements)
    for _, ranked in groupby(in_order(groups), key=_rank):
        together = list(ranked)
        for group in together:
            if group.presence is not None:
                group.presence.begin(0, seed, episode)
        _place_together(together, StartDraw(0, seed, episode), taken, {}, puts_bodies=False)
    return [placement for placement, _ in taken.placements[first:]]


def _place_together(
    groups: Sequence[AgentGroup],
    draw: StartDraw,
    taken: TakenPlaces,
    request: EpisodeRequest,
    *,
    puts_bodies: bool = True,
) -> None:
    """Place groups of equal rank. Where agents placed first leave no room for the last, draw all anew."""
    for attempt in range(_ATTEMPTS):
        tried = taken.copy()
        try:
            placed = _try_placing(groups, draw._replace(attempt=attempt), tried, request, puts_bodies)
            break
        except WorldError:
            if attempt == _ATTEMPTS - 1:
                raise
    taken.placements, taken.points, taken.discs = tried.placements, tried.points, tried.discs
    if request:
        _check_apart([(name, *placed[name]) for group in groups for name in group.names if name in placed])


def _try_placing(
    groups: Sequence[AgentGroup],
    draw: StartDraw,
    taken: TakenPlaces,
    request: EpisodeRequest,
    puts_bodies: bool,
) -> dict[str, Taken]:
    """Place groups of equal rank: agents whose starts are requested first, the others away from them.

    Returns the sampled starts and goals by agent.
    """
    placed: dict[str, Taken] = {}
    scene = draw.scene
    poses = [np.zeros((group.count, 4)) for group in groups]

    def place(index: int, group: AgentGroup, agents: Sequence[int]) -> None:
        asked = {agent: request[name] for agent, name in enumerate(group.names) if name in request}
        before = len(taken.placements)
        poses[index][list(agents)] = group.starts.place(draw, agents, taken, asked)
        placed.update(zip([group.names[agent] for agent in agents], taken.placements[before:], strict=False))

    given = {name for name, one in request.items() if one.start is not None}
    for index, group in enumerate(groups):
        agents = [agent for agent in group.agents_of(scene) if group.names[agent] in given]
        if agents:
            place(index, group, agents)
    for index, group in enumerate(groups):
        place(index, group, [each for each in group.agents_of(scene) if group.names[each] not in given])
        if puts_bodies:
            group.place(scene, poses[index])
            group.starts.occupy(taken, group.body, scene)
    return placed


def admit_arrivals(
    groups: Sequence[AgentGroup], seed: int, episodes: Counts, steps: Counts, difficulty: Array
) -> None:
    """Place the agents that are due after a control step; `episodes` and `steps` (M,) are the scenes'.

    `difficulty` (M,) is that of the episodes' curriculum.

    An agent comes at rest, and acts from the next step on. Where one of a group finds no room, the others of
    its group in that scene wait, too.
    """
    for group in groups:
        full = set()
        for row in group.due(steps):
            scene, agent = divmod(row, group.count)
            if scene in full:
                continue
            draw = StartDraw(scene, seed, int(episodes[scene]), difficulty=float(difficulty[scene]))
            pose = group.starts.admit(draw, agent, _taken_now(groups, scene))
            if pose is None:
                full.add(scene)
            else:
                group.come(row, pose, int(steps[scene]))
        group.begin_arrivals()


def _taken_now(groups: Sequence[AgentGroup], scene: int) -> TakenPlaces:
    """Where the agents of a scene are and go to now."""
    taken = TakenPlaces([each.placement(scene, agent) for each in groups for agent in each.agents_of(scene)])
    for group in groups:
        group.starts.occupy(taken, group.body, scene)
    return taken


def check_all(checks: Sequence[Callable[[], object]]) -> None:
    """Make all `checks`, and raise one `WorldError` with the faults of those that did."""
    faults = []
    for check in checks:
        try:
            check()
        except WorldError as error:
            faults.append(str(error))
    if faults:
        raise WorldError("\n".join(dict.fromkeys(faults)))


def _check_apart(placed: Sequence[tuple[str, Placement, float]]) -> None:
    """Raise ValueError if two robots, by name, placement and footprint radius [m], start in one another."""
    for (one, first, radius), (other, second, other_radius) in combinations(placed, 2):
        if math.hypot(first.x - second.x, first.y - second.y) < radius + other_radius:
            raise ValueError(
                f"{one} and {other} would start in one another, at ({first.x:g}, {first.y:g}) and "
                f"({second.x:g}, {second.y:g}): give both of them starts that are apart"
            )
