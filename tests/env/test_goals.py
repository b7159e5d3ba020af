"""Goals that are renewed during an episode: away from the other robots and from where they go."""

from typing import Any

import numpy as np
import pytest

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.env.simulation import VectorSimulation

RENEW = {"terminations": {"goal_reached": {"distance_m": 100.0, "renew": True}}}
TEAM = ["rover_zero", "rover_zero", "leo_rover"]


def simulation(robots: list[str], num_scenes: int, **spawn: Any) -> VectorSimulation:
    """Robots whose every step reaches the goal."""
    settings = {"robots": robots, "actors": "none", "task": {**RENEW, "spawn": spawn}, "sensors": ["goal"]}
    made = make_simulation(compose_environment("flat", (), settings), num_scenes, seed=0)
    made.reset()
    return made


def idle(core: VectorSimulation) -> dict[str, np.ndarray]:
    return {
        group.name: np.zeros((core.num_scenes, group.count, group.action_size), np.float32)
        for group in core.external
    }


def by_scene(core: VectorSimulation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and goals (M, R, 2) of all robots, and their footprints' radii (R,)."""
    positions, goals, radii = [], [], []
    for group in core.groups:
        state = core.state.groups[group.name]
        positions.append(state.by_scene(state.motion.position_w[:, :2]))
        goals.append(state.by_scene(state.goal.position_w))
        radii += [group.body.robot.description.footprint_radius_m] * group.count
    return np.concatenate(positions, axis=1), np.concatenate(goals, axis=1), np.array(radii)


@pytest.mark.parametrize("apart_m", [0.5, 1.0])
def test_renewed_goals_are_away_from_other_robots_and_their_goals(apart_m: float) -> None:
    core = simulation(TEAM, 4, robots_apart_m=apart_m)
    own = np.eye(3, dtype=bool)
    for _ in range(10):
        before = by_scene(core)[1]
        core.step(idle(core))
        positions, goals, radii = by_scene(core)
        assert (goals != before).any(axis=2).all()
        needed = radii[:, None] + radii + apart_m
        to_goals = np.linalg.norm(goals[:, :, None] - goals[:, None], axis=-1)
        to_robots = np.linalg.norm(goals[:, :, None] - positions[:, None], axis=-1)
        assert (to_goals[:, ~own] >= needed[~own]).all()
        assert (to_robots[:, ~own] >= needed[~own]).all()
        assert to_robots[:, own].min() >= 2.0
    core.close()


def test_a_robot_s_goals_do_not_depend_on_other_scenes() -> None:
    one, four = simulation(TEAM, 1), simulation(TEAM, 4)
    for _ in range(3):
        for core in (one, four):
            core.step(idle(core))
    assert by_scene(one)[1][0].tobytes() == by_scene(four)[1][0].tobytes()
    for core in (one, four):
        core.close()


def test_a_renewed_goal_is_what_the_next_step_measures() -> None:
    core = simulation(["rover_zero"], 1)
    core.step(idle(core))
    goal = core.state.groups["rover"].goal
    core.step(idle(core))
    now = core.state.groups["rover"].goal
    assert now.previous_distance == pytest.approx(goal.distance)
    (observed,) = core.observe()["goal"][..., 0].ravel()
    position = core.state.groups["rover"].motion.position_w[0, :2]
    assert observed == pytest.approx(np.hypot(*(now.position_w[0] - position)), rel=1e-5)
    core.close()
