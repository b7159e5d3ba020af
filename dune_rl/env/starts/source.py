"""What a source of starts and goals does for an agent group."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dune_rl.env.body import Body
from dune_rl.env.requests import AgentRequest
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.tasks.spawn import Placement
from dune_rl.worlds.world import World

# Requested starts and goals by agent.
Asked = Mapping[int, AgentRequest]
# A start and a goal, and the radius of the disc that holds the agent [m].
Taken = tuple[Placement, float]


class StartDraw(NamedTuple):
    """Which starts are drawn: of a scene's episode of a seed; another `attempt` draws anew.

    `difficulty` in [0, 1] is that of the episode's curriculum.
    """

    scene: int
    seed: int
    episode: int
    attempt: int = 0
    difficulty: float = 1.0


@dataclass
class TakenPlaces:
    """Places of one scene that other agents have.

    `placements` are starts and goals, from which sampled ones keep their distance. `points` are points (P, 2)
    [m] from which starts on paths keep their distance: robots, and outlines of bodies that are not on paths.
    `discs` (K, 3: x, y, radius) [m] hold the bodies that started on paths.
    """

    placements: list[Taken] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    discs: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def copy(self) -> "TakenPlaces":
        """Places that change independently."""
        return TakenPlaces(list(self.placements), list(self.points), self.discs)

    @property
    def all_points(self) -> Array:
        """All `points` as one array (P, 2)."""
        return np.concatenate([np.zeros((0, 2)), *self.points])


class StartSource:
    """Starts and goals of N = M * G agents, rows scene after scene.

    Methods without `NotImplementedError` do nothing by default.

    `goals_w` (N, 2) [m] are the goals; the array is never written afterwards. Sources of lower `rank` are
    placed first. `faces_free_way` says whether bodies that cannot turn on the
    spot may be turned at their starts.
    """

    rank: int
    faces_free_way = False
    goals_w: Array

    def prepare(self, world: World, seed: int) -> None:
        """Find what starts need in `world`; raises `WorldError` if there is no room."""
        raise NotImplementedError

    def replan(self, world: World, seed: int) -> None:
        """Drop what depends on the seed, and find it anew in `world`."""

    def keep(self, worlds: Collection[World]) -> None:
        """Drop what was found in all other worlds."""

    def fixed_starts(self, world: World) -> list[Taken]:
        """Starts that never change, which all other agents avoid."""
        return []

    def check_count(self, world: World, draw: StartDraw, taken: list[Taken]) -> None:
        """Add what `place` would sample in `world` to `taken`; raises `WorldError` if there is no room."""

    def place(self, draw: StartDraw, agents: Sequence[int], taken: TakenPlaces, asked: Asked) -> Array:
        """Start poses (len(agents), 4: x, y, z, yaw) of a scene's `agents`, whose goals are set as well.

        The places are added to `taken.placements`. `asked` has requested starts and goals by agent. Raises
        `WorldError` if there is no room.
        """
        raise NotImplementedError

    def admit(self, draw: StartDraw, agent: int, taken: TakenPlaces) -> Array | None:
        """A start pose (4) for an agent that comes later; None without room now."""
        raise NotImplementedError

    def occupy(self, taken: TakenPlaces, body: Body, scene: int) -> None:
        """Add where the bodies of a scene are to `taken`, for starts on paths."""
        raise NotImplementedError

    def renew(self, mask: Flags) -> None:
        """Set new goals for the agents in `mask` (N,)."""
        raise NotImplementedError

    def set_goals(self, rows: Counts, goals_w: Array) -> None:
        """Set the goals of the agents in `rows` (K,) to `goals_w` (K, 2) [m]."""
        raise NotImplementedError

    def hold_back(self, scenes: Counts, poses: Array, absent: Flags | None) -> None:
        """Take note that robots limited the agents of `scenes` (S,) to `poses` (S, G, 4 or more).

        `absent` (N,) marks agents that are not in their scenes.
        """

    def example_paths(self, agent: int) -> list[Array]:
        """Ways (P, 2) [m] that an agent may take in scene 0, for maps."""
        return []

    def present_path(self, agent: int) -> Array | None:
        """The path (P, 2) [m] that an agent of scene 0 is on; None where it is on none."""
        return None
