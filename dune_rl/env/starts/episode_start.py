"""Starts an episode in a scene: world, start poses, goals, and settling of the robots."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.requests import EpisodeRequest
from dune_rl.env.scene_manager import SceneManager
from dune_rl.env.starts.placement import check_all, check_counts, check_places, place_agents, prepare_starts
from dune_rl.env.starts.source import StartDraw
from dune_rl.geometry.arrays import Array
from dune_rl.worlds.world import World

# Of kinematic bodies in physics: x, y, z, yaw, roll and pitch.
_POSE_COLUMNS = 6


class EpisodeStarter:
    """Starts episodes of the groups in a scene; it takes no part in a step."""

    def __init__(self, groups: Sequence[AgentGroup], scenes: SceneManager) -> None:
        self._groups, self._scenes = groups, scenes
        self._kinematic = [group for group in groups if not group.description.is_robot]

    def check(self, seed: int, world: World, *, sets_starts: bool) -> None:
        """Raise `WorldError` if `world` has no room for an agent or a path, or a place where no body can be.

        This also finds the paths. Room for all agents beside each other is not checked where a plan
        `sets_starts`, or where worlds are drawn.
        """
        worlds_differ = self._scenes.randomizer.randomizes_worlds
        prepare_starts(self._groups, seed, world)
        check_all([partial(check_places, group, world, only_edge=worlds_differ) for group in self._groups])
        if not sets_starts and not worlds_differ:
            check_counts(self._groups, seed, world)

    def replan(self, seed: int, world: World) -> None:
        """Find paths of `world` with another `seed`, and drop those of all worlds."""
        check_all([partial(group.starts.replan, world, seed) for group in self._groups])

    def start(self, draw: StartDraw, request: EpisodeRequest) -> None:
        """Start an episode in a scene; raises `WorldError` if there is no room.

        `request` has starts and goals of robots in place of sampled ones; raises ValueError if they are not
        free, or not of robots.
        """
        scenes, groups = self._scenes, self._groups
        scene, seed, episode = draw.scene, draw.seed, draw.episode
        world = scenes.enter(scene, seed, episode, partial(prepare_starts, groups, seed), draw.difficulty)
        if scenes.randomizer.randomizes_worlds:
            used = scenes.used_worlds()
            for group in groups:
                group.starts.keep(used)
        for group in groups:
            group.body.bind(scene, scenes.physics(scene))
            if group.presence is not None:
                group.presence.begin(scene, seed, episode)
        place_agents(groups, draw, world, request)
        scenes.reset(scene, kinematic_poses(self._kinematic, len(scenes.worlds))[scene])
        variation = scenes.randomizer.variation(scenes.values[scene])
        for group in groups:
            group.body.touch_ground(scene, world, variation)
        scenes.settle(scene)


def kinematic_poses(groups: Sequence[AgentGroup], num_scenes: int) -> Array:
    """Poses (M, K, 6) of the kinematic bodies of `groups`, which are all groups of such bodies."""
    poses = np.zeros((num_scenes, sum(group.count for group in groups), _POSE_COLUMNS))
    for group in groups:
        own, first = group.body.poses, group.body.first
        # Bodies that never lean leave out roll and pitch.
        poses[:, first : first + group.count, : own.shape[1]] = own.reshape(num_scenes, group.count, -1)
    return poses
