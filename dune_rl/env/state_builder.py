"""Builds the state of a control step from what the groups' bodies are and where."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.kinematic import KinematicBody
from dune_rl.env.proximity import Proximity
from dune_rl.env.scene_manager import scene_rows
from dune_rl.state import ContactState, EpisodeState, GoalState, GroupState, State
from dune_rl.worlds.batched_worlds import BatchedWorlds

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]
Contacts = list[tuple[int, int]]

# Random draws of the agents of a scene are apart by this in their stream's number.
_STREAM_STRIDE = 1 << 40


class StateBuilder:
    """Builds `State`s of M scenes of `groups`, whose bodies have been read.

    Bodies of a scene are numbered: static ones first, then kinematic bodies, then robots, in the order of
    the groups. `neighbours` are in the order of kinematic bodies, then robots.
    """

    def __init__(self, groups: Sequence[AgentGroup], worlds: BatchedWorlds, step_s: float) -> None:
        self._groups, self._worlds, self._step_s = groups, worlds, step_s
        self._outlines = [group.outline for group in groups]
        self._counts = [group.count for group in groups]
        kinematic = [group for group in groups if isinstance(group.body, KinematicBody)]
        robots = [group for group in groups if isinstance(group.body, ArticulatedBody)]
        # Groups in the order of their bodies' numbers, and the first number of each behind the statics.
        self._movers = [*kinematic, *robots]
        firsts = np.cumsum([0, *(group.count for group in self._movers)]).tolist()
        self._first = {group.name: first for group, first in zip(self._movers, firsts[:-1], strict=True)}
        self._columns = {group.name: self._neighbour_columns(group, firsts[-1]) for group in groups}
        self._streams_of = {}
        agents = 0
        for group in groups:
            self._streams_of[group.name] = agents
            agents += group.count
        self._identity: dict[str, tuple[Counts, Counts]] = {}

    def _neighbour_columns(self, group: AgentGroup, total: int) -> NDArray[np.int64]:
        """Columns (G, K) of all movers that are neighbours of each agent of a group."""
        first = self._first[group.name]
        others = [np.delete(np.arange(total), first + agent) for agent in range(group.count)]
        return np.stack(others)

    def mesh_order(self, group: AgentGroup) -> list[AgentGroup]:
        """The group that each neighbour of an agent of `group` is of, in the order of `neighbours`."""
        owners = [mover for mover in self._movers for _ in range(mover.count)]
        return [owners[column] for column in self._columns[group.name][0].tolist()]

    # -- states -----------------------------------------------------------------------------------

    def begin_episodes(self, episodes: Counts) -> None:
        """Take the ids (M,) of the episodes that the scenes are in."""
        for group in self._groups:
            ids = episodes if group.count == 1 else np.repeat(episodes, group.count)
            agents = np.tile(np.arange(group.count), len(episodes)) + self._streams_of[group.name]
            streams = ids + agents * _STREAM_STRIDE if agents.any() else ids
            self._identity[group.name] = ids, streams

    def start(self, mask: Flags, seed: int, steps: Counts) -> State:
        """The state at the start of the episodes of the scenes in `mask` (M,)."""
        goals, contacts = [], []
        for group in self._groups:
            goals.append(group.goals.begin(scene_rows(mask, group.count), group.body.motion))
            contacts.append(group.collisions.at_rest)
        return self._build(seed, steps, goals, contacts)

    def build(
        self, seed: int, steps: Counts, contacts: dict[str, Contacts], count_statics: Callable[[int], int]
    ) -> State:
        """The state after a control step.

        `contacts` are pairs of row and body number of each group of robots, `count_statics` tells how many
        static bodies a scene has.
        """
        goals = [group.goals.measure(group.body.motion) for group in self._groups]
        rows = [self._rows(steps, group) for group in self._groups]
        touched = any(contacts.values())
        found = []
        for group, row_steps in zip(self._groups, rows, strict=True):
            pairs = contacts.get(group.name, [])
            if touched and isinstance(group.body, KinematicBody):
                pairs = self._contacts_of_kinematic(group, contacts, count_statics)
            found.append(group.collisions.update(pairs, row_steps))
        return self._build(seed, steps, goals, found)

    def _contacts_of_kinematic(
        self, group: AgentGroup, contacts: dict[str, Contacts], count_statics: Callable[[int], int]
    ) -> Contacts:
        """Contacts of robots with a group's bodies, as seen from these."""
        pairs: Contacts = []
        first = self._first[group.name]
        for mover in self._movers:
            for row, body in contacts.get(mover.name, []):
                scene = row // mover.count
                agent = body - count_statics(scene) - first
                if 0 <= agent < group.count:
                    number = count_statics(scene) + self._first[mover.name] + row % mover.count
                    pairs.append((scene * group.count + agent, number))
        return pairs

    def _rows(self, values: Counts, group: AgentGroup) -> Counts:
        return values if group.count == 1 else np.repeat(values, group.count)

    def _build(
        self, seed: int, steps: Counts, goals: Sequence[GoalState], contacts: Sequence[ContactState]
    ) -> State:
        motions = [group.body.motion for group in self._groups]
        proximity = Proximity(self._worlds, self._outlines, self._counts, motions)
        neighbours = self._neighbours(len(steps))
        states = {}
        for index, group in enumerate(self._groups):
            ids, streams = self._identity[group.name]
            episode = EpisodeState(seed, ids, self._rows(steps, group), streams, self._step_s)
            states[group.name] = GroupState(
                name=group.name,
                count=group.count,
                episode=episode,
                motion=motions[index],
                contacts=contacts[index],
                neighbours=neighbours[group.name],
                done=group.done.copy(),
                measure_clearance=partial(proximity.clearance, index),
                goal=goals[index],
                radius_m=group.radius_m,
                work_j=group.work_j,
                battery=group.battery,
            )
        return State(states, self._worlds, len(steps))

    def _neighbours(self, scenes: int) -> dict[str, Array]:
        """The poses (N, K, 4) of the neighbours of each group's agents."""
        poses = [group.body.poses.reshape(scenes, group.count, 4) for group in self._movers]
        every = poses[0] if len(poses) == 1 else np.concatenate(poses, axis=1)
        found = {}
        for group in self._groups:
            columns = self._columns[group.name]
            seen = every[:, columns] if group.count > 1 else every[:, columns[0]]
            found[group.name] = seen.reshape(scenes * group.count, columns.shape[1], 4)
        return found
