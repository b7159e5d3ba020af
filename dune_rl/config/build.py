"""Environments built from settings: the one place that names concrete classes.

PyTorch and TorchRL are loaded where they are needed: PettingZoo and Gymnasium environments do without them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from gymnasium.vector import AutoresetMode

from dune_rl.behaviours.destinations import DestinedBehaviour
from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.behaviours.registry import BEHAVIOURS, BehaviourSettings
from dune_rl.bodies.settings import BodySettings
from dune_rl.config.agents import ResolvedGroup
from dune_rl.config.controllers import PATH, TRAJECTORY, FrozenPolicyConf, follows_trajectories
from dune_rl.config.controllers import Controller as ControllerConf
from dune_rl.config.group_files import describe_owner, read_group_files
from dune_rl.config.schema import EnvConf, SingleAgentConf
from dune_rl.core.errors import CheckpointError
from dune_rl.env.agent_group import AgentGroup, FileTrajectories, GroupSetup, MakeController
from dune_rl.env.arguments import check_whole
from dune_rl.env.controllers import BehaviourController, Controller, PolicyController
from dune_rl.env.curriculum import CurriculumConf
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.gymnasium import GymnasiumEnv
from dune_rl.env.gymnasium_vector import GymnasiumVectorEnv
from dune_rl.env.pettingzoo import ParallelDuneEnv
from dune_rl.env.render_mode import RenderMode
from dune_rl.env.requests import EpisodePlan
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.physics.interface import scene_maker
from dune_rl.robots.registry import ROBOTS
from dune_rl.robots.robot import Robot
from dune_rl.robots.settings import RobotSettings
from dune_rl.sensors.sensor import Reading
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.cache.store import shared_store
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World, describe_choice

if TYPE_CHECKING:
    from torchrl.envs import TransformedEnv

    from dune_rl.env.torchrl import DuneEnv


_MOST_NAMES = 5


def make_simulation(
    conf: EnvConf,
    num_scenes: int,
    seed: int,
    *,
    make_world: Callable[[WorldSettings], World] | None = None,
    prepare: Callable[[Sequence[WorldSettings]], None] | None = None,
    plan: EpisodePlan | None = None,
    curriculum: CurriculumConf | None = None,
) -> VectorSimulation:
    """The simulation of `num_scenes` scenes; raises `WorldError` if no start or goal can be found.

    `make_world` replaces `build_world`. `prepare` replaces `prepare_worlds`: it gets the settings of the
    worlds of the next episodes. `plan` has worlds, starts and goals of episodes in place of sampled ones.
    """
    check_whole("num_scenes", num_scenes, at_least=1)
    check_whole("seed", seed, at_least=0)
    make_world = build_world if make_world is None else make_world
    prepare = (
        partial(
            prepare_worlds, with_appearance=any(sensor.sensor == "camera" for sensor in conf.sensors.values())
        )
        if prepare is None
        else prepare
    )
    # Before the world is built, which may take minutes: files of theirs may be missing.
    groups = group_setups(conf)
    return VectorSimulation(
        world=make_world(conf.world),
        groups=groups,
        make_scene=scene_maker(conf.physics.backend),
        physics=conf.physics,
        weather=conf.weather,
        randomizer=DomainRandomizer(
            conf.world,
            conf.weather,
            conf.randomisation,
            make_world,
            prepare,
            plan,
            easiest=None if curriculum is None else curriculum.easiest,
            num_scenes=num_scenes,
        ),
        num_scenes=num_scenes,
        seed=seed,
        plan=plan,
        curriculum=curriculum,
    )


def group_setups(conf: EnvConf) -> list[GroupSetup]:
    """The agent groups of a scene; raises as `read_group_files`."""
    trajectories = read_group_files(conf)
    return [
        GroupSetup(
            group.name,
            group.count,
            group.body if isinstance(group.body, BodySettings) else partial(build_robot, group.body),
            controller=_controller_factory(group.controller),
            path=_path_of(group, trajectories.get(group.name)),
            is_scripted=group.controller == PATH or follows_trajectories(group.controller),
            sensors=group.sensors,
            task=group.task,
            metrics=group.metrics,
            presence=group.presence,
            settings=conf.path_of(group.name),
            places=_places_of(group.controller),
            is_shielded=conf.shield == "brake"
            and not isinstance(group.body, BodySettings)
            and group.sensors is not None,
        )
        for group in conf.groups
    ]


def _path_of(
    group: ResolvedGroup, given: tuple[ActorTrajectory, ...] | None
) -> PathConf | FileTrajectories | None:
    """What the agents of a group start on: trajectories, paths, or nothing."""
    if follows_trajectories(group.controller):
        return FileTrajectories(given)
    return PathConf() if group.path is None and group.controller == PATH else group.path


def _controller_factory(conf: ControllerConf) -> MakeController | None:
    """Factory of a group's controller; None for external groups and groups that walk paths."""
    if isinstance(conf, BehaviourSettings):
        return partial(_behaviour, conf)
    if isinstance(conf, FrozenPolicyConf):
        return partial(_frozen_policy, conf)
    return None


def _places_of(conf: ControllerConf) -> tuple[tuple[float, float], ...]:
    """The places [m] to which a controller is told to go; none for most."""
    part = BEHAVIOURS.find(conf.name) if isinstance(conf, BehaviourSettings) else None
    goes = part is not None and isinstance(part.target, type) and issubclass(part.target, DestinedBehaviour)
    return getattr(conf, "places", ()) if goes else ()


def _behaviour(conf: BehaviourSettings, group: AgentGroup) -> Controller:
    behaviour = BEHAVIOURS.build(conf, group.num_rows)
    group.bind(behaviour, conf.name)
    return BehaviourController(behaviour)


def _frozen_policy(conf: FrozenPolicyConf, group: AgentGroup) -> Controller:
    """Raises `CheckpointError`, which names the group's setting, where the file has no policy for what the
    group observes and does.
    """
    # Only now: most groups need no PyTorch.
    import torch
    from tensordict import TensorDict

    from dune_rl.learning.group_policy import Deterministic
    from dune_rl.learning.networks.policy import BEGINS
    from dune_rl.learning.policy_spec import PolicySpec
    from dune_rl.learning.saved_policies import load_group_policy

    spec = PolicySpec.of_bounds(group.observation_bounds, group.action_bounds)
    try:
        found, _ = load_group_policy(
            Path(conf.checkpoint), group.name, spec, trained_as=conf.group, allow_more=True
        )
    except CheckpointError as error:
        setting = f"{group.setup.settings}.controller.checkpoint"
        what_to_do = describe_owner(conf.checkpoint, conf.group or group.name, group.setup.settings)
        # In place of what to do where the robot itself is to be driven by it.
        lines = [str(error).splitlines()[0], what_to_do] if what_to_do else [str(error)]
        raise CheckpointError("\n".join([f"{setting}: {lines[0]}", *lines[1:]])) from None
    policy = Deterministic(found)

    def act(readings: dict[str, Reading], begins: Flags) -> Array:
        rows = group.num_rows
        observation = {
            key: torch.from_numpy(reading).reshape(-1, group.count, *reading.shape[1:])
            for key, reading in readings.items()
        }
        size = (rows // group.count, group.count)
        inputs = TensorDict({group.name: {"observation": observation}}, batch_size=size[:1])
        inputs[group.name].batch_size = size
        inputs[group.name, "observation"].batch_size = size
        inputs[group.name, BEGINS] = torch.from_numpy(begins).reshape(*size, 1)
        action: torch.Tensor = policy(inputs)[group.name, "action"]
        return action.reshape(rows, -1).numpy().astype(np.float64)

    return PolicyController(act)


def build_robot(conf: RobotSettings, num_robots: int) -> Robot:
    return ROBOTS.build(conf, num_robots)


@lru_cache(maxsize=4)
def build_world(conf: WorldSettings) -> World:
    """The world; equal settings share one immutable object."""
    return shared_store().get(conf)


def describe_world(conf: EnvConf, *, fixes_starts: bool = False) -> list[str]:
    """Lines about what an importer chose in a world: the region of starts and goals, and its own actors.

    Where something else `fixes_starts`, the region is left out.
    """
    world = build_world(conf.world)
    uses_region = not fixes_starts and any(
        group.task is not None and group.task.spawn.region == "world" for group in conf.groups
    )
    line = describe_choice(world.region, world.region_candidates) if uses_region else None
    lines = [] if line is None else [line]
    followers = [group for group in conf.groups if group.controller == TRAJECTORY]
    if followers:
        names = [actor.name for actor in world.trajectories[: max(group.count for group in followers)]]
        listed = ", ".join(names[:_MOST_NAMES]) + (", ..." if len(names) > _MOST_NAMES else "")
        lines.append(
            f"Actors: {len(names)} of the file ({listed}) on their trajectories; actors=none leaves them "
            "out, actors=walkers has walkers instead"
        )
    return lines


def prepare_worlds(confs: Iterable[WorldSettings], *, with_appearance: bool = False) -> None:
    """Start to build worlds in the background, for later calls of `build_world` (`WorldStore.prepare`)."""
    shared_store().prepare(confs, with_appearance=with_appearance)


def make_torchrl_env(
    conf: EnvConf,
    num_scenes: int,
    seed: int,
    flatten: bool = False,
    plan: EpisodePlan | None = None,
    curriculum: CurriculumConf | None = None,
) -> DuneEnv:
    """A TorchRL environment of batch size (num_scenes,)."""
    from dune_rl.env.torchrl import DuneEnv

    simulation = make_simulation(conf, num_scenes, seed, plan=plan, curriculum=curriculum)
    env = DuneEnv(simulation, flatten=flatten)
    env.remake = partial(make_torchrl_env, conf, num_scenes, seed, flatten, plan, curriculum)
    return env


def make_learning_env(
    conf: EnvConf,
    num_scenes: int,
    seed: int,
    plan: EpisodePlan | None = None,
    curriculum: CurriculumConf | None = None,
) -> TransformedEnv:
    """A TorchRL environment with the metrics of its episodes, for training and evaluation."""
    from torchrl.envs import TransformedEnv

    from dune_rl.env.torchrl import EpisodeMetrics

    env = make_torchrl_env(conf, num_scenes, seed, plan=plan, curriculum=curriculum)
    return TransformedEnv(env, EpisodeMetrics())


def make_parallel_env(
    conf: EnvConf, seed: int, render_mode: RenderMode = None, flatten: bool = False
) -> ParallelDuneEnv:
    """A PettingZoo environment of one scene."""
    env = ParallelDuneEnv(make_simulation(conf, 1, seed), render_mode, flatten=flatten)
    env.remake = partial(make_parallel_env, conf, seed, render_mode, flatten)
    return env


def make_gymnasium_env(
    conf: SingleAgentConf,
    seed: int,
    render_mode: RenderMode = None,
    flatten: bool = False,
    plan: EpisodePlan | None = None,
) -> GymnasiumEnv:
    """A Gymnasium environment of one scene with one external agent."""
    env = GymnasiumEnv(make_simulation(conf, 1, seed, plan=plan), render_mode, flatten=flatten)
    env.remake = partial(make_gymnasium_env, conf, seed, render_mode, flatten, plan)
    return env


def make_gymnasium_vector_env(
    conf: SingleAgentConf,
    num_scenes: int,
    seed: int,
    render_mode: RenderMode = None,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    flatten: bool = False,
    max_episode_steps: int | None = None,
) -> GymnasiumVectorEnv:
    """A Gymnasium vector environment of scenes with one external agent each."""
    simulation = make_simulation(conf, num_scenes, seed)
    env = GymnasiumVectorEnv(
        simulation, render_mode, autoreset_mode, flatten=flatten, max_episode_steps=max_episode_steps
    )
    arguments = conf, num_scenes, seed, render_mode, autoreset_mode, flatten, max_episode_steps
    env.remake = partial(make_gymnasium_vector_env, *arguments)
    return env
