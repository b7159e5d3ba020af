"""Pictures of a scene for people: from behind an agent, or from anywhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.goal_markers import goal_flag
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.shared_per_scene import DerivedCache
from dune_rl.rendering.baked_scenery import BakedScenery
from dune_rl.rendering.moving_mesh import PosedMesh, RayMesh
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.rendering.renderer import Renderer, Viewpoint
from dune_rl.worlds.appearance import bake_in_weather
from dune_rl.worlds.batched_worlds import WorldAppearance
from dune_rl.worlds.world import Rectangle, World

Picture = NDArray[np.uint8]

_BEHIND_M, _ABOVE_M, _LOOK_AHEAD_M = 2.6, 1.35, 0.9
_CLEAR_OF_GROUND_M, _CLEAR_OF_WALLS_M = 0.35, 0.15
# The point of an agent that is to be seen, and how near to it a ray must come.
_SEEN_B, _IN_SIGHT_M = np.array([0.0, 0.0, 0.45]), 0.05
_NEAREST_EYE_M, _FARTHEST_EYE_M = 0.9, 3.0
# Bodies up to this height are seen from the same place.
_USUAL_HEIGHT_M = 0.5
# Where the agent is seen from if others hide it: from behind, beside, before.
_TURNS_DEG = (0.0, 40.0, -40.0, 80.0, -80.0, 130.0, -130.0, 180.0)
_HALF_ROBOT_M = 0.35
# Smaller sites are seen from steeper above, and of larger ones a part.
_SMALL_SITE_M, _LARGEST_SITE_M = 25.0, 60.0


@dataclass(frozen=True, eq=False)
class Moment:
    """All bodies of a scene at an instant, and the position (3,) [m] and heading [rad] of one agent."""

    bodies: list[PosedMesh]
    position: Array
    yaw: float


class Pictures:
    """Renders the scenes of a simulation; its light is computed at the first picture, which takes a
    moment.
    """

    def __init__(self, simulation: VectorSimulation) -> None:
        self._simulation = simulation

    @cached_property
    def _painters(self) -> DerivedCache[WorldAppearance, Renderer]:
        return self._simulation.worlds.appearances.map(_painter)

    @cached_property
    def _flag(self) -> RayMesh:
        return RayMesh(goal_flag())

    def bodies(self, scene: int) -> list[PosedMesh]:
        """The agents of all groups, and a flag at the goal of each robot."""
        return [part for parts in self.bodies_by_name(scene).values() for part in parts]

    def bodies_by_name(self, scene: int) -> dict[str, list[PosedMesh]]:
        """The parts of each agent that is there, by its name, and flags as those of goal_of_NAME."""
        agents: dict[str, list[PosedMesh]] = {}
        flags: dict[str, list[PosedMesh]] = {}
        for group in self._simulation.groups:
            for row in self._rows(scene, group):
                name = group.names[row - scene * group.count]
                agents[name] = group.body.pictures(row)
                if group.task is not None and group.description.is_robot:
                    flags[f"goal_of_{name}"] = [self._flag_at(scene, group.starts.goals_w[row])]
        return agents | flags

    def looks_by_name(self, scene: int) -> dict[str, Sequence[RayMesh]]:
        """The meshes that each agent is shown by one after another, as `Body.looks`, there or not."""
        return {
            name: group.body.looks(scene * group.count + number)
            for group in self._simulation.groups
            for number, name in enumerate(group.names)
        }

    def scenery(self, scene: int) -> tuple[BakedScenery, ParticipatingMedia]:
        """A scene's world in the light of its weather, and what is in the air."""
        look = self._simulation.worlds.appearances[scene]
        return bake_in_weather(look.world, look.weather), look.media

    def _rows(self, scene: int, group: AgentGroup) -> list[int]:
        """Rows of the agents that are in a scene."""
        return [scene * group.count + agent for agent in group.agents_of(scene)]

    def _flag_at(self, scene: int, goal: Array) -> PosedMesh:
        return PosedMesh(self._flag, np.array([*goal, self._ground(scene, goal)]), np.eye(3))

    def from_behind(
        self,
        scene: int = 0,
        width: int = 640,
        height: int = 480,
        samples: int = 1,
        agent: str | None = None,
        *,
        turns_for_agents: bool = False,
    ) -> Picture:
        """RGB (height, width, 3) of an agent as seen from `behind` it."""
        view = self.behind(scene, agent, turns_for_agents=turns_for_agents)
        return self.seen(view, scene, width, height, samples)

    def behind(
        self, scene: int = 0, agent: str | None = None, *, turns_for_agents: bool = False
    ) -> Viewpoint:
        """A viewpoint behind and above an agent, the first one without a name, and clear of fixed objects.

        With `turns_for_agents` it is beside or before the agent where others would hide it from behind.
        """
        group, row = self._seen_agent(scene, agent)
        motion = group.body.motion
        position = motion.position_w[row]
        yaw = float(motion.yaw[row])
        ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        # Somebody as tall as the eye would fill the picture, from so near.
        more = max(group.description.height_m - _USUAL_HEIGHT_M, 0.0)
        others = self._others(scene, group, row) if turns_for_agents else np.zeros((0, 4))
        views = []
        for turn in np.deg2rad(_TURNS_DEG):
            forward = np.array([np.cos(yaw + turn), np.sin(yaw + turn), 0.0])
            eye = position - (_BEHIND_M + more) * forward + [0.0, 0.0, _ABOVE_M + more]
            eye = self.free_eye(scene, position, eye, _FARTHEST_EYE_M + 1.5 * more)
            look_m = _LOOK_AHEAD_M * max(np.cos(turn), 0.0)
            views.append((eye, position + look_m * ahead + [0.0, 0.0, 0.5 * more]))
            if not _is_hidden(position, eye, others):
                break
        else:
            views = views[:1]
        eye, target = views[-1]
        return Viewpoint(tuple(eye), tuple(target), 1.05)

    def renderer(self, scene: int) -> Renderer:
        """The renderer of a scene's world in its weather."""
        return self._painters[scene]

    def _seen_agent(self, scene: int, agent: str | None) -> tuple[AgentGroup, int]:
        """Group and row of an agent or, without a name or if it is not there, of the first one that is."""
        first = self._simulation.group()
        if agent is not None:
            first = self._group_of(agent)
            number = first.names.index(agent)
            if number in first.agents_of(scene):
                return first, scene * first.count + number
        for group in (first, *self._simulation.external, *self._simulation.groups):
            if there := group.agents_of(scene):
                return group, scene * group.count + there[0]
        return first, scene * first.count

    def moment(self, scene: int, agent: str) -> Moment:
        """The present instant of an agent, for a picture that is rendered later (`of_moment`)."""
        group = self._group_of(agent)
        row = scene * group.count + group.names.index(agent)
        motion = group.body.motion
        return Moment(self.bodies(scene), motion.position_w[row].copy(), float(motion.yaw[row]))

    def of_moment(self, moment: Moment, scene: int, width: int, height: int, samples: int = 1) -> Picture:
        """RGB (height, width, 3) of a moment of a scene's episode, from behind its agent and above."""
        ahead = np.array([np.cos(moment.yaw), np.sin(moment.yaw), 0.0])
        eye = moment.position - _BEHIND_M * ahead + [0.0, 0.0, _ABOVE_M]
        eye = self.free_eye(scene, moment.position, eye, _FARTHEST_EYE_M)
        view = Viewpoint(tuple(eye), tuple(moment.position + _LOOK_AHEAD_M * ahead), 1.05)
        return self._painters[scene].render(view, width, height, moment.bodies, samples)

    def _others(self, scene: int, group: AgentGroup, row: int) -> Array:
        """Positions on the ground, radii and heights (K, 4) [m] of the scene's agents but that of `row`."""
        found = []
        for other in self._simulation.groups:
            body = other.body
            for each in self._rows(scene, other):
                if other is not group or each != row:
                    x, y = body.motion.position_w[each, :2].tolist()
                    found.append([x, y, other.description.radius_m, other.description.height_m])
        return np.array(found).reshape(-1, 4)

    def _group_of(self, agent: str) -> AgentGroup:
        return next(group for group in self._simulation.groups if agent in group.names)

    def seen(
        self, view: Viewpoint, scene: int = 0, width: int = 1280, height: int = 720, samples: int = 1
    ) -> Picture:
        """RGB (height, width, 3) of a scene from any viewpoint."""
        return self._painters[scene].render(view, width, height, self.bodies(scene), samples)

    def of_the_place(
        self,
        scene: int = 0,
        width: int = 1280,
        height: int = 720,
        samples: int = 2,
        bearing_rad: float = -2.3,
    ) -> Picture:
        """RGB (height, width, 3) of the whole world, or of its site where that is a small part of an imported
        world, seen from above at `bearing_rad` from its middle; steeply in small ones.
        """
        xmin, xmax, ymin, ymax = _site(self._simulation.worlds.worlds[scene])
        middle = np.array([(xmin + xmax) / 2, (ymin + ymax) / 2])
        reach = min(_LARGEST_SITE_M, max(xmax - xmin, ymax - ymin))
        level = self._ground(scene, middle)
        small = float(np.clip((_SMALL_SITE_M - reach) / 20.0, 0.0, 1.0))
        away = (0.95 * reach + 2.0 * small) * np.array([np.cos(bearing_rad), np.sin(bearing_rad)])
        eye = (*(middle + away).tolist(), level + (0.42 + 0.6 * small) * reach + small)
        target = (*(middle + 0.06 * away).tolist(), level)
        return self.seen(Viewpoint(eye, target, 0.95), scene, width, height, samples)

    def _ground(self, scene: int, xy: Array) -> float:
        return float(self._simulation.worlds.worlds[scene].terrain.height(xy))

    def is_in_sight(self, scene: int, position: Array, eye: Array) -> bool:
        """Whether an agent at `position` (3,) [m] is in sight of `eye` (3,), past ground and props."""
        start = position + _SEEN_B
        way = eye - start
        length = float(np.linalg.norm(way))
        reach = np.array([length], np.float32)
        self.scenery(scene)[0].rays.shorten_ranges(
            start[None].astype(np.float32), (way / max(length, 1e-9))[None].astype(np.float32), reach
        )
        return bool(reach[0] >= length - _IN_SIGHT_M)

    def free_eye(self, scene: int, position: Array, eye: Array, farthest_m: float) -> Array:
        """The point nearest to `eye` from which an agent at `position` is in sight, above the ground."""
        start = position + _SEEN_B
        # From behind; where a wall leaves no room there, from ever higher up.
        ways = eye - start + np.outer([0.0, 1.0, 2.5, 40.0], [0.0, 0.0, _ABOVE_M])
        lengths = np.linalg.norm(ways, axis=1).astype(np.float32)
        lengths = np.minimum(lengths, np.float32(farthest_m))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        reach = lengths.copy()
        self.scenery(scene)[0].rays.shorten_ranges(
            start[None].astype(np.float32), ways.astype(np.float32), reach
        )
        free = np.maximum(reach - np.float32(_CLEAR_OF_WALLS_M), 0.0)
        has_room = np.flatnonzero(free >= _NEAREST_EYE_M)
        chosen = int(has_room[0]) if len(has_room) else int(free.argmax())
        eye = start + ways[chosen] * float(free[chosen])
        eye[2] = max(eye[2], self._ground(scene, eye[:2]) + _CLEAR_OF_GROUND_M)
        return eye


def _is_hidden(position: Array, eye: Array, others: Array) -> bool:
    """Whether an agent of `others` (K, 4: x, y, radius, height) is between a robot and the eye."""
    way = eye[:2] - position[:2]
    offset = others[:, :2] - position[:2]
    share = np.clip(offset @ way / max(float(way @ way), 1e-9), 0.0, 1.0)
    aside = np.linalg.norm(offset - share[:, None] * way, axis=1)
    # The lines of sight from all of the robot narrow toward the eye.
    between = (aside < others[:, 2] + _HALF_ROBOT_M * (1.0 - share)) & (share > 0.0)
    below_top = (eye[2] - position[2]) * share < others[:, 3]
    return bool((between & below_top).any())


def _site(world: World) -> Rectangle:
    """The rectangle of an imported world's objects and region, with a margin; otherwise the whole world.

    Of larger sites it is the part about the region.
    """
    extent = np.array(world.extent)
    if not world.region_candidates:
        return world.extent
    corners = [np.array(world.region).reshape(2, 2).T]
    corners += [prop.vertices[:, :2] for prop in world.props if prop.solid]
    points = np.concatenate(corners)
    middle = corners[0].mean(axis=0)
    low = np.maximum(points.min(axis=0), middle - _LARGEST_SITE_M / 2)
    high = np.minimum(points.max(axis=0), middle + _LARGEST_SITE_M / 2)
    margin = 0.1 * float((high - low).max())
    xmin, ymin = np.maximum(low - margin, extent[[0, 2]]).tolist()
    xmax, ymax = np.minimum(high + margin, extent[[1, 3]]).tolist()
    return xmin, xmax, ymin, ymax


def _painter(look: WorldAppearance) -> Renderer:
    return Renderer(bake_in_weather(look.world, look.weather), look.media)
