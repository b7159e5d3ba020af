"""Checks that the episodes of a set can be started as their rows say."""

from collections.abc import Sequence

import numpy as np

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import WorldError
from dune_rl.evaluation.episode_sets.apply import plan_of_set, settings_on_set
from dune_rl.evaluation.episode_sets.episode_set import EpisodeSet

# How far a robot may move while it settles on the ground [m].
_SETTLED_M = 0.2


def faulty_episodes(
    episode_set: EpisodeSet, numbers: Sequence[int] | None = None, overrides: Sequence[str] = ()
) -> list[str]:
    """Start episodes (None: all) and return a line for each that is faulty.

    It is if it does not start, if the robot touches something or settles away from its start, or if the goal
    is at another distance than the set says.

    `overrides` are settings of the robot, where its name does not tell all of it.
    """
    conf = settings_on_set(
        compose_environment(
            episode_set.header.settings["world"],
            [f"robot={episode_set.header.robot}", "sensors.enabled=[goal]", *overrides],
        ),
        episode_set,
    )
    simulation = make_simulation(conf, 1, episode_set.header.seed, plan=plan_of_set(conf, episode_set))
    faults = []
    try:
        for number in range(len(episode_set.episodes)) if numbers is None else numbers:
            row = episode_set.episodes[number]
            simulation.reseed(episode_set.header.seed, number)
            try:
                simulation.reset()
            except (ValueError, WorldError) as error:
                faults.append(f"episode {number}: {error}")
                continue
            (group,) = simulation.external
            state = simulation.state.groups[group.name]
            moved = float(np.hypot(*(state.motion.position_w[0, :2] - row.start[:2])))
            if moved > _SETTLED_M:
                faults.append(f"episode {number}: the robot settles {moved:.2f} m from its start")
            distance = float(np.hypot(*np.subtract(row.goal, row.start[:2])))
            low, high = episode_set.header.goal_distance_m
            if distance < low or (high is not None and distance > high):
                faults.append(f"episode {number}: the goal is {distance:.2f} m from the start")
    finally:
        simulation.close()
    return faults
