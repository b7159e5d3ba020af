"""Agent groups: teams, kinds of robots and crowds of actors, in every interface and on both engines."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from conformance import (
    check_kept,
    check_no_leak,
    check_parallel_api,
    check_seeding,
    check_spaces,
    check_torchrl,
    check_values,
)
from pettingzoo import ParallelEnv
from torchrl.envs import TransformedEnv

import dune_rl
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.env.simulation import VectorSimulation
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.physics.interface import ENGINES

SHORT = {"terminations": {"time_limit": {"max_steps": 15}}}
TWO_WALKERS = [{"controller": "external"}, {"controller": "external"}]
SCRIPTED = {"speed_mps": 0.7}
SCENES: dict[str, dict[str, Any]] = {
    "one": {"robots": ["rover_zero"], "actors": "walkers"},
    "team": {"robots": ["rover_zero"] * 3, "actors": "none"},
    "kinds": {"robots": ["rover_zero", "rover_zero", "hyperdog"], "actors": [*TWO_WALKERS, SCRIPTED]},
    "crowd": {"robots": ["rover_zero"], "actors": [{"controller": "external"}] * 20},
}
AGENTS = {
    "one": ["rover_0"],
    "team": ["rover_0", "rover_1", "rover_2"],
    "kinds": ["rover_0", "rover_1", "hyperdog_0", "walker_0", "walker_1"],
    "crowd": ["rover_0", *(f"walker_{number}" for number in range(20))],
}
every_scene = pytest.mark.parametrize("scene", SCENES)
every_engine = pytest.mark.parametrize("engine", ENGINES)


def parallel(scene: str, engine: str = "bullet", world: str = "flat") -> ParallelEnv:
    return dune_rl.parallel_env(world, overrides=[f"physics={engine}"], task=SHORT, **SCENES[scene])


def simulation(scene: str, num_scenes: int = 1, world: str = "flat", **settings: Any) -> VectorSimulation:
    conf = compose_environment(world, (), {**SCENES[scene], **settings})
    made = make_simulation(conf, num_scenes, seed=0)
    made.reset()
    return made


def idle(core: VectorSimulation) -> dict[str, np.ndarray]:
    return {
        group.name: np.zeros((core.num_scenes, group.count, group.action_size), np.float32)
        for group in core.external
    }


# -- conformance -----------------------------------------------------------------------------------


@every_engine
@every_scene
@pytest.mark.parametrize("check", [check_parallel_api, check_values, check_kept, check_spaces, check_no_leak])
def test_pettingzoo(check: Callable[[ParallelEnv], None], scene: str, engine: str) -> None:
    env = parallel(scene, engine)
    assert env.possible_agents == AGENTS[scene]
    check(env)
    env.close()


@every_scene
def test_pettingzoo_seeding(scene: str) -> None:
    check_seeding(partial(parallel, scene))


@every_engine
@every_scene
def test_torchrl(scene: str, engine: str) -> None:
    env = dune_rl.make("flat", 2, overrides=[f"physics={engine}"], task=SHORT, **SCENES[scene])
    assert [name for names in env.group_map.values() for name in names] == AGENTS[scene]
    check_torchrl(env)
    env.close()


@every_scene
def test_torchrl_with_metrics(scene: str) -> None:
    env = TransformedEnv(dune_rl.make("flat", 2, task=SHORT, **SCENES[scene]), EpisodeMetrics())
    check_torchrl(env)
    env.close()


def test_observation_spec_has_observations_only() -> None:
    env = dune_rl.make("flat", 2, task=SHORT, **SCENES["kinds"])
    keys = {key[1] for key in env.observation_spec.keys(True, True)}
    assert keys == {"observation"}
    env.close()


# -- groups ----------------------------------------------------------------------------------------


@every_scene
def test_a_group_has_equal_spaces(scene: str) -> None:
    env = parallel(scene)
    by_group: dict[str, list[str]] = {}
    for agent in env.possible_agents:
        by_group.setdefault(agent.rpartition("_")[0], []).append(agent)
    for members in by_group.values():
        for agent in members[1:]:
            assert env.observation_space(agent) == env.observation_space(members[0])
            assert env.action_space(agent) == env.action_space(members[0])
    env.close()


def test_members_of_a_team_see_each_other() -> None:
    core = simulation("team")
    group = core.group("rover")
    now = core.state.groups["rover"]
    assert now.neighbours.shape == (3, 2, 4)
    position = now.motion.position_w
    for row in range(3):
        others = np.delete(position, row, axis=0)
        np.testing.assert_allclose(now.neighbours[row, :, :3], others)
    assert group.observe()["lidar"].shape == (3, 32)
    core.close()


def test_clearance_of_a_team_is_to_its_nearest_member() -> None:
    core = simulation("team")
    now = core.state.groups["rover"]
    robot = core.group("rover").body.robot
    position = now.motion.position_w[:, :2]
    centres = np.linalg.norm(position[:, None] - position, axis=2)
    centres[np.diag_indices(3)] = np.inf
    nearest = centres.min(axis=1)
    # Between centres less both circumscribed circles, and less both inscribed ones.
    assert (now.clearance >= nearest - 2 * robot.footprint_radius_m - 1e-9).all()
    assert (now.clearance <= nearest - robot.width_m + 1e-9).all()
    core.close()


def test_a_team_in_many_scenes_is_the_same_as_in_one() -> None:
    alone, together = simulation("team"), simulation("team", 3)
    for _ in range(5):
        forward = {"rover": np.tile(np.float32([0.5, 0.3]), (1, 3, 1))}
        alone.step(forward)
        together.step({"rover": np.repeat(forward["rover"], 3, axis=0)})
    one, three = alone.observe("rover"), together.observe("rover")
    for name, values in one.items():
        np.testing.assert_array_equal(values[0], three[name][0], err_msg=name)
    alone.close()
    together.close()


def test_members_that_are_done_wait_for_the_others() -> None:
    core = simulation("team", task={"terminations": {"goal_reached": {"distance_m": 0.75}}})
    group = core.group("rover")
    goals = group.goals.source.goals_w
    goals[0] = core.state.groups["rover"].motion.position_w[0, :2]
    step = core.step(idle(core))
    rover = step.groups["rover"]
    assert rover.terminated.tolist() == [True, False, False]
    assert not step.done[0], "the others still have to arrive"
    assert rover.reward[0] > 50.0
    later = core.step({"rover": np.ones((1, 3, 2), np.float32)}).groups["rover"]
    assert later.reward[0] == 0.0
    assert later.terminated[0], "its end stays set"
    assert core.state.groups["rover"].motion.velocity_b[0, 0] < 0.3, "it stands, whatever its action"
    core.close()


def test_a_crowd_is_counted_once_for_each_body() -> None:
    core = simulation("crowd")
    assert core.group("walker").count == 20
    assert core.state.groups["rover"].neighbours.shape == (1, 20, 4)
    assert len({name for group in core.groups for name in group.names}) == 21
    core.step(idle(core))
    core.close()


def test_groups_of_different_kinds_have_their_own_tasks() -> None:
    core = simulation("kinds")
    assert core.metric_names("rover") == core.metric_names("hyperdog")
    assert core.group("walker").metric_names == ()
    assert [group.name for group in core.groups if not group.is_external] == ["walker_b"]
    core.close()
