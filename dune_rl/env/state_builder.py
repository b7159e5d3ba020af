"""Builds the state of a control step from what the groups' bodies are and where."""

from collections.abc import Callable, Sequence
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.proximity import GroupLayout, Proximity
from dune_rl.env.scene_manager import scene_rows
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.state.state import ContactState, EpisodeState, GoalState, GroupState, State
from dune_rl.worlds.batched_worlds import BatchedWorlds

Contacts = list[tuple[int, int]]

# Random draws of the agents of a group are apart by _STREAM_STRIDE in their stream's number, those of groups
# by _GROUP_STRIDE agents: an agent more in one group changes no draws of another.
_STREAM_STRIDE = 1 << 40
_GROUP_STRIDE = 1 << 14


class StateBuilder:
    """Builds the `State` of M scenes from the bodies of `groups`, after these have been read from physics.

    Body numbers of a scene count static bodies, then kinematic bodies, then robots, in the order of the
    groups. `neighbours` are in the order of body numbers.
    """

    def __init__(self, groups: Sequence[AgentGroup], worlds: BatchedWorlds, step_s: float) -> None:
        self._groups, self._worlds, self._step_s = groups, worlds, step_s
        kinematic = [group for group in groups if not group.description.is_robot]
        robots = [group for group in groups if group.description.is_robot]
        # Groups in the order of body numbers, and the first number of each after the static bodies.
        self._movers = [*kinematic, *robots]
        firsts = np.cumsum([0, *(group.count for group in self._movers)]).tolist()
        self._first = {group.name: first for group, first in zip(self._movers, firsts[:-1], strict=True)}
        self._layouts = {
            group.name: GroupLayout(index, group.count, group.body.outline, self._columns(group, firsts[-1]))
            for index, group in enumerate(groups)
        }
        self._kinds = [group.description.kind for group in self._movers for _ in range(group.count)]
        self._order = [self._layouts[group.name].index for group in self._movers]
        self._identity: dict[str, tuple[Counts, Counts]] = {}

    def _columns(self, group: AgentGroup, total: int) -> NDArray[np.int64]:
        """Indices (G, K) of the moving bodies that are neighbours of each agent of a group."""
        first = self._first[group.name]
        others = [np.delete(np.arange(total), first + agent) for agent in range(group.count)]
        return np.stack(others)

    def mesh_order(self, group: AgentGroup) -> list[AgentGroup]:
        """The group of each neighbour of an agent of `group`, in the order of `neighbours`."""
        owners = [mover for mover in self._movers for _ in range(mover.count)]
        return [owners[column] for column in self._layouts[group.name].neighbours[0].tolist()]

    def forecast_neighbours(self, group: AgentGroup, step_s: float, steps: int) -> Array:
        """Where the neighbours of a group's agents will be, (N, K, steps, 2) [m], every `step_s` [s].

        NaN of those whose ways are not fixed. It takes no notice of what may hold them up.
        """
        scenes = len(self._worlds)
        places = np.full((scenes, len(self._kinds), steps, 2), np.nan)
        for mover in self._movers:
            forecast = getattr(mover.controller, "forecast", None)
            found = None if forecast is None else forecast(step_s, steps)
            if found is not None:
                first = self._first[mover.name]
                places[:, first : first + mover.count] = found.reshape(scenes, mover.count, steps, 2)
        chosen = places[:, self._layouts[group.name].neighbours]
        return chosen.reshape(scenes * group.count, -1, steps, 2)

    # -- states -----------------------------------------------------------------------------------

    def begin_episodes(self, episodes: Counts) -> None:
        """Set the ids (M,) of the scenes' present episodes."""
        for index, group in enumerate(self._groups):
            ids = episodes if group.count == 1 else np.repeat(episodes, group.count)
            agents = np.tile(np.arange(group.count), len(episodes)) + index * _GROUP_STRIDE
            streams = ids + agents * _STREAM_STRIDE if agents.any() else ids
            self._identity[group.name] = ids, streams

    def start(self, mask: Flags, seed: int, steps: Counts, before: State | None) -> State:
        """The state at the start of the episodes of the scenes in `mask` (M,).

        In the other scenes contacts and endings are those `before`; None: all scenes begin.
        """
        goals, contacts = [], []
        endings: list[dict[str, Flags]] = [{} for _ in self._groups]
        for group, flags in zip(self._groups, endings, strict=True):
            rows = scene_rows(mask, group.count)
            goals.append(group.goals.begin(rows, group.body.motion))
            if before is None:
                contacts.append(group.collisions.at_rest)
                continue
            was = before.groups[group.name]
            contacts.append(was.contacts.begun(rows))
            flags.update({name: ended & ~rows for name, ended in was.endings.items()})
        return self._build(seed, steps, goals, contacts, endings)

    def build(
        self, seed: int, steps: Counts, contacts: dict[str, Contacts], count_statics: Callable[[int], int]
    ) -> State:
        """The state after a control step.

        `contacts` are pairs of row and body number for each group of robots; `count_statics(scene)` is the
        number of static bodies.
        """
        goals = [group.measure_goals() for group in self._groups]
        rows = [group.own_steps(steps) for group in self._groups]
        has_contacts = any(contacts.values())
        found = []
        for group, row_steps in zip(self._groups, rows, strict=True):
            pairs = contacts.get(group.name, [])
            if has_contacts and not group.description.is_robot:
                pairs = self._contacts_of_kinematic(group, contacts, count_statics)
            kind_of = partial(self._kind_of, group, count_statics)
            found.append(group.collisions.update(pairs, row_steps, kind_of))
        # The terminations of all groups are the last part of the state: they read all of the rest.
        endings: list[dict[str, Flags]] = [{} for _ in self._groups]
        state = self._build(seed, steps, goals, found, endings)
        for group, flags in zip(self._groups, endings, strict=True):
            flags.update(group.find_endings(state))
        return state

    def _contacts_of_kinematic(
        self, group: AgentGroup, contacts: dict[str, Contacts], count_statics: Callable[[int], int]
    ) -> Contacts:
        """Contacts of a group's kinematic bodies with robots, as pairs of row and body number."""
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

    def _kind_of(self, group: AgentGroup, count_statics: Callable[[int], int], row: int, body: int) -> str:
        """The class of a body that an agent of a group touches: static, or the kind of a moving body."""
        mover = body - count_statics(row // group.count)
        return self._kinds[mover] if mover >= 0 else "static"

    def _build(
        self,
        seed: int,
        steps: Counts,
        goals: Sequence[GoalState],
        contacts: Sequence[ContactState],
        endings: Sequence[dict[str, Flags]],
    ) -> State:
        motions = [group.body.motion for group in self._groups]
        proximity = Proximity(self._worlds, self._layouts, self._order, motions)
        states = {}
        for index, group in enumerate(self._groups):
            ids, streams = self._identity[group.name]
            states[group.name] = GroupState(
                name=group.name,
                count=group.count,
                body=group.description,
                episode=EpisodeState(seed, ids, group.own_steps(steps), streams, self._step_s),
                motion=motions[index],
                contacts=contacts[index],
                goal=goals[index],
                done=group.done.copy(),
                proximity=proximity,
                absent=group.absent,
                energy=group.body.energy,
                scanner=group.scanner,
                last_action=group.last_action,
                endings=MappingProxyType(endings[index]),
            )
        return State(states, self._worlds, len(steps))
