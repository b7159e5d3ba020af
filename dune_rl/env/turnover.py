"""Agents that come and go: they are parked far away, and placed where there is room when they are due."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dune_rl.behaviours.paths.follower import PathFollower
from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.articulated import ArticulatedBody
from dune_rl.env.goals import PathGoals, RegionGoals
from dune_rl.env.kinematic import KinematicBody
from dune_rl.env.scene_manager import SceneManager, scene_rows
from dune_rl.env.visits import Visits
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.state.state import GroupState, State
from dune_rl.tasks.spawn import Placement


class Turnover:
    """Lets the agents of groups with `visits` come and go.

    An agent comes at the end of a control step, at rest, and acts from the next one on. One that is done, or
    whose time is over, is gone from the next step on. One without room when it is due comes as soon as there
    is some.
    """

    def __init__(self, groups: Sequence[AgentGroup], scenes: SceneManager) -> None:
        self._groups, self._scenes = groups, scenes
        self._visiting: list[tuple[AgentGroup, Visits, KinematicBody]] = []
        self._first: dict[str, int] = {}
        number = 0
        for group in groups:
            if isinstance(group.body, KinematicBody):
                self._first[group.name] = number
                number += group.count
                if group.visits is not None:
                    self._visiting.append((group, group.visits, group.body))

    def __bool__(self) -> bool:
        """Whether any agents come and go."""
        return bool(self._visiting)

    @property
    def ends_episodes(self) -> bool:
        """Whether an episode can be over because all external agents have left."""
        return any(group.is_external for group, _, _ in self._visiting)

    def remove(self) -> None:
        """Take the agents that are done out of their scenes; call it before a control step."""
        for group, visits, body in self._visiting:
            gone = group.done & ~visits.absent
            if not gone.any():
                continue
            visits.leave(gone)
            rows = np.flatnonzero(gone)
            _park(group, body, rows)
            self._move(group, body, rows.tolist())

    def admit(self, seed: int, episodes: Counts, steps: Counts) -> dict[str, Flags]:
        """Place the agents that are due, after a control step; flags (N,) of those by group.

        `episodes` and `steps` (M,) are those of the scenes. Where one of a group finds no room, the others of
        its group in that scene wait, too.
        """
        found = {}
        taken: dict[int, list[tuple[Placement, float]]] = {}
        for group, visits, body in self._visiting:
            arrived, full = np.zeros(group.num_rows, bool), set()
            for row in visits.due(np.repeat(steps, group.count)):
                scene, agent = divmod(row, group.count)
                if scene in full:
                    continue
                if scene not in taken:
                    taken[scene] = self._taken(scene)
                pose = self._find_place(group, scene, agent, seed, int(episodes[scene]), taken[scene])
                if pose is None:
                    full.add(scene)
                    continue
                body.come(row, pose)
                visits.admit(row, int(steps[scene]))
                taken[scene].append(_placement_of(group, row))
                arrived[row] = True
            if arrived.any():
                self._move(group, body, np.flatnonzero(arrived).tolist())
                group.collisions.reset(arrived)
                body.read_start(arrived)
                group.goals.begin(arrived, body.motion)
                found[group.name] = arrived
        return found

    def exchange(
        self, arrived: dict[str, Flags], steps: Counts, states: Mapping[str, GroupState]
    ) -> dict[str, GroupState]:
        """Truncate the agents whose time is over, and let those who `arrived` take part.

        These are flags (N,) by group; `steps` (M,) are those of the scenes. Returns the states of groups that
        change by that.
        """
        found = {}
        for group, visits, _ in self._visiting:
            group.truncate(visits.leaving(np.repeat(steps, group.count)) & ~group.done)
            if group.name in arrived:
                group.admit(arrived[group.name])
                now = states[group.name]
                found[group.name] = replace(now, done=now.done & ~arrived[group.name])
        return found

    def begin(self, arrived: dict[str, Flags], state: State) -> None:
        """Start task, metrics, sensors and controller of those who `arrived`, flags (N,) by group."""
        for group, _, _ in self._visiting:
            if group.name in arrived:
                group.begin(arrived[group.name], state)

    def _move(self, group: AgentGroup, body: KinematicBody, rows: Sequence[int]) -> None:
        for row in rows:
            scene, agent = divmod(row, group.count)
            self._scenes.move_kinematic(scene, self._first[group.name] + agent, body.poses[row])

    def _find_place(
        self,
        group: AgentGroup,
        scene: int,
        agent: int,
        seed: int,
        episode: int,
        taken: Sequence[tuple[Placement, float]],
    ) -> Array | None:
        """A pose (4: x, y, z, yaw) for an agent that comes, apart from those `taken`; None without room now.

        Agents on paths keep their distance from robots and from bodies that are not on paths; those who steer
        have room beside the others, too.
        """
        source, world = group.goals.source, self._scenes.worlds.worlds[scene]
        if isinstance(source, PathGoals):
            assert isinstance(source.follower, PathFollower), "trajectories have times of their own"
            draws = stream(seed, f"arrival {group.name}_{agent}", episode)
            discs = None if group.setup.is_scripted else self._discs_on_paths(scene)
            return source.follower.place_agent(
                scene, agent, draws, self._points(scene), discs, group.description.reach_m
            )
        assert isinstance(source, RegionGoals)
        try:
            one = source.place_agent(scene, seed, episode, agent, taken)
        except WorldError:
            return None
        return np.array([one.x, one.y, float(world.terrain.height(np.array([one.x, one.y]))), one.yaw])

    def _taken(self, scene: int) -> list[tuple[Placement, float]]:
        """Where the agents of a scene are and go to, and the radii of discs that hold them [m]."""
        return [
            _placement_of(group, scene * group.count + agent)
            for group in self._groups
            for agent in group.agents_of(scene)
        ]

    def _points(self, scene: int) -> Array:
        """Points (P, 2) [m] from which agents on paths start at a distance: robots, and bodies off paths."""
        points = [np.zeros((0, 2))]
        for group in self._groups:
            if isinstance(group.body, ArticulatedBody):
                rows = slice(scene * group.count, (scene + 1) * group.count)
                points.append(group.body.motion.position_w[rows, :2])
            elif isinstance(group.body, KinematicBody) and isinstance(group.goals.source, RegionGoals):
                points.append(group.body.outline_points(scene))
        return np.concatenate(points)

    def _discs_on_paths(self, scene: int) -> Array:
        """Discs (K, 3: x, y, radius) [m] that hold the bodies of a scene that started on paths."""
        on_paths = [group for group in self._groups if isinstance(group.goals.source, PathGoals)]
        return np.concatenate([discs_of(group, scene) for group in on_paths])


def discs_of(group: AgentGroup, scene: int) -> Array:
    """Discs (G, 3: x, y, radius) [m] that hold the bodies of a group in a scene."""
    rows = slice(scene * group.count, (scene + 1) * group.count)
    return np.column_stack([group.body.poses[rows, :2], np.full(group.count, group.description.reach_m)])


def park_absent(group: AgentGroup, scene: int) -> None:
    """Park the agents of a scene that are not there when its episode starts."""
    if group.visits is None or not isinstance(group.body, KinematicBody):
        return
    of_scene = scene_rows(np.arange(group.num_rows // group.count) == scene, group.count)
    _park(group, group.body, np.flatnonzero(group.visits.absent & of_scene))


def _park(group: AgentGroup, body: KinematicBody, rows: Counts) -> None:
    """Park the agents in `rows` (K,), with goals where they are: nothing is left of earlier ones."""
    body.park(rows)
    group.goals.source.set_goals(rows, body.poses[rows, :2])


def _placement_of(group: AgentGroup, row: int) -> tuple[Placement, float]:
    """Where an agent is and goes to, and the radius of a disc that holds it [m]."""
    x, y, _, yaw = group.body.poses[row, :4].tolist()
    goal_x, goal_y = group.goals.source.goals_w[row].tolist()
    return Placement(x, y, yaw, goal_x, goal_y), group.description.reach_m
