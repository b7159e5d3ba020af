"""The controller `trajectory`: actors that follow the timed way-points of a world's file, or of others."""

import warnings
from copy import copy
from typing import NamedTuple, Self
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.shared_per_scene import SharedPerScene, query_grouped
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.world import World

Scenes = NDArray[np.int64]

# Added to the times of agent k, k times, so that one sorted array holds the times of all.
_APART_S = 4e6
# Squared: what moves less in a control step stands [m²].
_NO_WAY_M2 = 1e-12


class TrajectoryBank(NamedTuple):
    """The trajectories of G agents end to end: `times` (P,) [s] and `poses` (P, 4); the rest is (G,).

    `keys` (P,) are the times, plus `_APART_S` for each agent before. The way-points of agent k are those from
    `starts[k]` to before `ends[k]`.
    """

    keys: Array
    times: Array
    poses: Array
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    delays: Array
    loops: Flags
    on_ground: Flags

    @classmethod
    def of(cls, actors: tuple[ActorTrajectory, ...]) -> Self:
        """The bank of `actors`."""
        counts = np.array([len(actor.times) for actor in actors])
        ends = np.cumsum(counts)
        times = np.concatenate([actor.times for actor in actors])
        return cls(
            times + _APART_S * np.repeat(np.arange(len(actors)), counts),
            times,
            np.concatenate([actor.poses for actor in actors]),
            ends - counts,
            ends,
            np.array([actor.delay_s for actor in actors]),
            np.array([actor.loop for actor in actors]),
            np.array([actor.on_ground for actor in actors]),
        )

    def poses_at(self, clock_s: Array) -> Array:
        """Poses (..., G, 4) at times (..., G) [s] since the start, linear between way-points."""
        last = self.times[self.ends - 1]
        cycle = self.delays + last
        repeats = self.loops & (last > 0.0)
        passed = np.where(repeats, np.mod(clock_s, np.where(repeats, cycle, 1.0)), clock_s)
        passed = np.clip(passed - self.delays, 0.0, last)
        after = np.searchsorted(self.keys, passed + _APART_S * np.arange(len(last)), side="right")
        after = np.clip(after, np.minimum(self.starts + 1, self.ends - 1), self.ends - 1)
        before = np.maximum(after - 1, self.starts)
        span = self.times[after] - self.times[before]
        share = (passed - self.times[before]) / np.where(span > 0.0, span, 1.0)
        start, end = self.poses[before], self.poses[after]
        poses: Array = start + share[..., None] * (end - start)
        poses[..., 3] = (poses[..., 3] + np.pi) % (2 * np.pi) - np.pi
        return poses


class TrajectoryFollower:
    """Scripted poses of N = M * G agents on the trajectories of their worlds, rows scene after scene.

    Agent k of a scene follows trajectory k of `actors`, or where these are None of its world. An agent that a
    robot holds up is late from then on. `goals_w` (N, 2) [m] are the last way-points. Nothing is drawn at
    random.
    """

    def __init__(
        self,
        count: int,
        speed_mps: float,
        worlds: SharedPerScene[World],
        kind: str,
        actors: tuple[ActorTrajectory, ...] | None = None,
    ) -> None:
        self.count, self._actors = count, actors
        self._speed_mps, self._kind, self._worlds = speed_mps, kind, worlds
        # Entries live as long as their worlds.
        self._banks: WeakKeyDictionary[World, TrajectoryBank] = WeakKeyDictionary()
        scenes = len(worlds)
        self.goals_w = np.zeros((scenes * count, 2))
        self._clock_s = np.zeros((scenes, count))
        self._step_s = 0.0
        # Poses before and after the last `advance`, and offsets from the trajectories, to which robots push.
        self._before = np.zeros((scenes, count, 4))
        self._targets = np.zeros((scenes, count, 4))
        self._offsets = np.zeros((scenes, count, 2))

    def find_trajectories(self, world: World) -> None:
        """Take the trajectories through `world`; raises `WorldError` if there are fewer than agents."""
        if world in self._banks:
            return
        found = len(world.trajectories if self._actors is None else self._actors)
        if found < self.count:
            if self._actors is not None:
                raise WorldError(
                    f"{self._kind} has {self.count} agents, and its files of trajectories have {found} "
                    f"actors: set its count to {found}, or name more files."
                )
            raise WorldError(
                f"{self._kind} has {self.count} on trajectories, and the world {world.name!r} has {found} "
                "actors with one: choose actors=walkers or actors=none, or a smaller count."
            )
        if self._actors is None:
            self._banks[world] = TrajectoryBank.of(world.trajectories[: self.count])
        else:
            fitted = tuple(fit_to_world(actor, world) for actor in self._actors[: self.count])
            self._banks[world] = TrajectoryBank.of(fitted)

    def paths(self, agent: int, scene: int = 0) -> list[Array]:
        """The way-points (P, 2) [m] of an agent of a scene, as a list of one."""
        bank = self._banks[self._worlds[scene]]
        return [bank.poses[bank.starts[agent] : bank.ends[agent], :2]]

    def present_path(self, agent: int, scene: int = 0) -> Array:
        """The way-points (P, 2) [m] of an agent of a scene."""
        return self.paths(agent, scene)[0]

    def start_poses(self, world: World) -> Array:
        """Poses (G, 4) at the start of an episode in `world`."""
        poses = self._banks[world].poses_at(np.zeros(self.count))
        return self._on_ground(world, poses)

    def reset(self, scene: int) -> Array:
        """Start poses (G, 4) of a scene's agents."""
        world = self._worlds[scene]
        bank = self._banks[world]
        self._clock_s[scene], self._offsets[scene] = 0.0, 0.0
        poses = self.start_poses(world)
        # The bodies have views of the targets.
        self._targets = self._targets.copy()
        self._targets[scene] = poses
        # States that were handed out keep theirs.
        self.goals_w = self.goals_w.copy()
        self.goals_w[scene * self.count : (scene + 1) * self.count] = bank.poses[bank.ends - 1, :2]
        return poses

    def advance(self, step_s: float) -> Array:
        """Let `step_s` pass; returns the poses (N, 4)."""
        self._step_s = step_s
        self._clock_s = self._clock_s + step_s
        self._before = self._targets
        length = np.linalg.norm(self._offsets, axis=2, keepdims=True)
        left = np.maximum(length - self._speed_mps * step_s, 0.0)
        self._offsets = self._offsets * (left / np.where(length > 0.0, length, 1.0))
        poses = query_grouped(self._worlds.groups, self._poses_at, self._clock_s)
        poses[..., :2] += self._offsets
        self._targets = query_grouped(self._worlds.groups, self._on_ground, poses)
        return self._targets.reshape(-1, 4)

    def twin(self) -> Self:
        """A copy that moves on by itself; nothing of it is changed in place."""
        return copy(self)

    def hold_back(self, scenes: Scenes, poses: Array) -> None:
        """Set the agents of `scenes` (S,) to `poses` (S, G, 4), to which robots limited them."""
        way = self._targets[scenes, :, :2] - self._before[scenes, :, :2]
        reached = poses[..., :2] - self._before[scenes, :, :2]
        length = (way**2).sum(axis=2)
        share = np.clip((reached * way).sum(axis=2) / np.maximum(length, _NO_WAY_M2), 0.0, 1.0)
        # In a pause nothing is missing.
        missing = np.where(length > _NO_WAY_M2, 1.0 - share, 0.0)
        blocked = np.abs(poses[..., :2] - self._targets[scenes, :, :2]).max(axis=2) > 1e-9
        clock_s = self._clock_s.copy()
        clock_s[scenes] -= np.where(blocked, missing, 0.0) * self._step_s
        self._clock_s = np.maximum(clock_s, 0.0)
        places = query_grouped(self._worlds.groups, self._poses_at, self._clock_s)[scenes, :, :2]
        offsets, targets = self._offsets.copy(), self._targets.copy()
        offsets[scenes] = np.where(blocked[..., None], poses[..., :2] - places, offsets[scenes])
        targets[scenes, :, :2] = np.where(blocked[..., None], poses[..., :2], targets[scenes, :, :2])
        self._offsets, self._targets = offsets, targets

    def renew(self, mask: Flags) -> None:
        """Nothing: the goals stay the last way-points."""

    def _poses_at(self, world: World, clock_s: Array) -> Array:
        return self._banks[world].poses_at(clock_s)

    def _on_ground(self, world: World, poses: Array) -> Array:
        """`poses` (..., G, 4) with the ground's height for agents that walk on it."""
        found = poses.copy()
        found[..., 2] = np.where(
            self._banks[world].on_ground, world.terrain.height(poses[..., :2]), poses[..., 2]
        )
        return found


def fit_to_world(actor: ActorTrajectory, world: World) -> ActorTrajectory:
    """The trajectory of a file in `world`, on its ground if it is near that.

    Raises `WorldError` where it leaves the world, and warns where it leads through an obstacle.
    """
    xmin, xmax, ymin, ymax = world.extent
    xy = actor.poses[:, :2]
    outside = np.flatnonzero((xy < [xmin, ymin]).any(axis=1) | (xy > [xmax, ymax]).any(axis=1))
    if len(outside):
        x, y = xy[outside[0]].tolist()
        raise WorldError(
            f"the trajectory of {actor.name!r} leaves the world {world.name!r} at ({x:.2f}, {y:.2f}), "
            f"which is {xmin:g} to {xmax:g} by {ymin:g} to {ymax:g} m: choose the world that it was made "
            "for, or another file."
        )
    blocked = np.flatnonzero(world.clearance(xy) <= 0.0)
    if len(blocked):
        x, y = xy[blocked[0]].tolist()
        warnings.warn(
            f"the trajectory of {actor.name!r} leads through an obstacle of {world.name} at "
            f"({x:.2f}, {y:.2f})",
            WorldWarning,
            stacklevel=2,
        )
    return actor.set_on_ground(world.terrain)
