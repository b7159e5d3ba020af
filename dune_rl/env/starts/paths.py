"""Starts and goals on paths, and on the trajectories of files."""

from collections.abc import Collection, Sequence

import numpy as np

from dune_rl.behaviours.paths.follower import PathFollower
from dune_rl.behaviours.trajectory import TrajectoryFollower
from dune_rl.core.seeding import stream
from dune_rl.env.body import Body
from dune_rl.env.starts.region import Spawners
from dune_rl.env.starts.source import Asked, StartDraw, StartSource, Taken, TakenPlaces
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.tasks.spawn import Placement
from dune_rl.worlds.world import World


class _FollowerStarts(StartSource):
    """Starts and goals that a follower of paths or trajectories has for N = M * G agents."""

    follower: PathFollower | TrajectoryFollower
    reach_m: float

    @property
    def goals_w(self) -> Array:  # type: ignore[override]
        return self.follower.goals_w

    def occupy(self, taken: TakenPlaces, body: Body, scene: int) -> None:
        rows = slice(scene * body.count, (scene + 1) * body.count)
        reach = np.full(body.count, self.reach_m)
        taken.discs = np.concatenate([taken.discs, np.column_stack([body.poses[rows, :2], reach])])

    def renew(self, mask: Flags) -> None:
        """Set the other end of the path as goal of the agents in `mask` (N,)."""
        self.follower.renew(mask)

    def set_goals(self, rows: Counts, goals_w: Array) -> None:
        """Set the goals of the agents in `rows` (K,) to `goals_w` (K, 2) [m], for now."""
        self.follower.goals_w = self.follower.goals_w.copy()
        self.follower.goals_w[rows] = goals_w

    def example_paths(self, agent: int) -> list[Array]:
        """The paths (P, 2) [m] of an agent in scene 0."""
        return self.follower.paths(agent)

    def present_path(self, agent: int) -> Array | None:
        return self.follower.present_path(agent)


class PathStarts(_FollowerStarts):
    """Agents start on their paths; goals are the far end of an agent's path, then its start, and so on.

    `spawners` find the points that random paths lead through. `names` are the random streams of paths and of
    starts. Agents that steer (`steers`) start beside each other and beside agents that are moved along their
    paths, which may overlap; `reach_m` is the radius of their bodies.
    """

    follower: PathFollower

    def __init__(
        self,
        follower: PathFollower,
        spawners: Spawners,
        group: str,
        names: tuple[str, str],
        *,
        steers: bool,
        reach_m: float,
    ) -> None:
        self.follower, self._spawners, self._group = follower, spawners, group
        self._paths_stream, self._starts_stream = names
        self._steers, self.reach_m = steers, reach_m
        self.rank = 3 if steers else 2

    def prepare(self, world: World, seed: int) -> None:
        """Find the paths of `world`; raises `WorldError` if none fits."""
        sample_points = self._spawners.of(world).sample_points
        self.follower.find_paths(world, sample_points, stream(seed, self._paths_stream))

    def replan(self, world: World, seed: int) -> None:
        """Find paths with another seed."""
        self.follower.clear_paths()
        self.prepare(world, seed)

    def keep(self, worlds: Collection[World]) -> None:
        """Drop what was found in all other worlds; paths live as long as their worlds."""
        self._spawners.keep(worlds)

    def place(self, draw: StartDraw, agents: Sequence[int], taken: TakenPlaces, asked: Asked) -> Array:
        """Start all agents of a scene on paths, and return the poses of `agents`."""
        draws = stream(draw.seed, self._starts_stream, draw.episode)
        points, discs = taken.all_points, taken.discs if self._steers else None
        return self.follower.reset(draw.scene, draws, points, discs, self.reach_m)[list(agents)]

    def admit(self, draw: StartDraw, agent: int, taken: TakenPlaces) -> Array | None:
        """A start pose (4) on a path for an agent that comes later; None without room now."""
        draws = stream(draw.seed, f"arrival {self._group}_{agent}", draw.episode)
        discs = taken.discs if self._steers else None
        return self.follower.place_agent(draw.scene, agent, draws, taken.all_points, discs, self.reach_m)

    def hold_back(self, scenes: Counts, poses: Array, absent: Flags | None) -> None:
        """Have agents that are moved along their paths go on from `poses` (S, G, 4 or more)."""
        if self._steers:
            return
        if absent is not None:
            are_absent = absent.reshape(-1, self.follower.count)[scenes]
            poses = np.where(are_absent[..., None], self.follower.targets(scenes), poses[..., :4])
        self.follower.hold_back(scenes, poses)


class TrajectoryStarts(_FollowerStarts):
    """Agents start at the first way-points of their trajectories; goals are the last ones."""

    follower: TrajectoryFollower

    def __init__(self, follower: TrajectoryFollower, group: str, radius_m: float, reach_m: float) -> None:
        self.follower, self._group, self._radius_m, self.reach_m = follower, group, radius_m, reach_m
        self.rank = 2

    def prepare(self, world: World, seed: int) -> None:
        """Take the trajectories through `world`; raises `WorldError` if there are fewer than agents."""
        self.follower.find_trajectories(world)

    def fixed_starts(self, world: World) -> list[Taken]:
        """Where the agents start, as placements that stay there."""
        poses = self.follower.start_poses(world).tolist()
        return [(Placement(x, y, yaw, x, y), self._radius_m) for x, y, _, yaw in poses]

    def place(self, draw: StartDraw, agents: Sequence[int], taken: TakenPlaces, asked: Asked) -> Array:
        """Start all agents of a scene on their trajectories, and return the poses of `agents`."""
        return self.follower.reset(draw.scene)[list(agents)]

    def admit(self, draw: StartDraw, agent: int, taken: TakenPlaces) -> Array | None:
        """Trajectories have times of their own: nobody comes later."""
        raise AssertionError(f"{self._group} follows trajectories and does not come and go")

    def hold_back(self, scenes: Counts, poses: Array, absent: Flags | None) -> None:
        """Have agents go on from `poses` (S, G, 4 or more)."""
        self.follower.hold_back(scenes, poses)
