"""ORCA: the half-planes, people who meet, and the library RVO2 where it is installed."""

import numpy as np
import pytest
from stages import RADIUS_M, STEP_S, Stage, circle, gaps, turns
from yards import yard

from dune_rl.behaviours.orca_loops import avoid_collisions, fit_velocity


def fitted(planes: list[list[float]], wanted: list[float], hard: int = 0, limit: float = 1.0) -> np.ndarray:
    found, lines = np.zeros(2), np.array(planes, float).reshape(-1, 4)
    fit_velocity(lines, hard, len(lines), limit, np.array(wanted, float), np.empty((12, 4)), found)
    return found


def avoided(
    position: np.ndarray, velocity: np.ndarray, wanted: np.ndarray, *, reach: float = 0.3, share: float = 0.5
) -> np.ndarray:
    """New velocities (G, 2) of agents at `position` (G, 2), all alike, of one scene."""
    count, found = len(position), np.zeros((1, len(position), 2))
    nothing = np.full((1, count), np.inf), np.zeros((1, count, 2))
    avoid_collisions(
        position[None], velocity[None], np.full(count, reach), np.full(count, share), 0, *nothing,
        wanted[None], np.full((1, count), 1.3), 100.0, (2.0, 1.0), STEP_S, found,
    )  # fmt: skip
    return found[0]


@pytest.mark.slow
def test_a_velocity_within_the_half_planes_is_kept_and_others_are_moved_the_least() -> None:
    # To the left of the y axis, walked upwards: x at most 0.
    left = [0.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(fitted([left], [-0.5, 0.3]), [-0.5, 0.3], atol=1e-12)
    np.testing.assert_allclose(fitted([left], [0.5, 0.3]), [0.0, 0.3], atol=1e-12)
    np.testing.assert_allclose(fitted([], [3.0, 4.0]), [0.6, 0.8], atol=1e-12)
    # And below the x axis: the corner.
    np.testing.assert_allclose(fitted([left, [0.0, 0.0, -1.0, 0.0]], [0.5, 0.3]), [0.0, 0.0], atol=1e-12)


def test_where_no_velocity_fits_the_violation_is_shared_and_obstacles_hold() -> None:
    # x at most -0.2 and x at least 0.4: the middle between the two.
    apart = [[-0.2, 0.0, 0.0, 1.0], [0.4, 0.0, 0.0, -1.0]]
    np.testing.assert_allclose(fitted(apart, [0.9, 0.0])[0], 0.1, atol=1e-9)
    np.testing.assert_allclose(fitted(apart, [0.9, 0.0], hard=1)[0], -0.2, atol=1e-9)


@pytest.mark.slow
def test_two_agents_head_on_share_the_least_change() -> None:
    # Legs of the velocity obstacle of reach R at distance d: the sine of their angle is R / d.
    position = np.array([[0.0, 0.0], [4.0, 0.0]])
    velocity = np.array([[1.0, 0.0], [-1.0, 0.0]])
    found = avoided(position, velocity, velocity)
    slope = np.arcsin(0.6 / 4.0)
    # The relative velocity 2 is moved to the leg, at a right angle, half of it by each.
    change = 2.0 * np.sin(slope) / 2 * np.array([-np.sin(slope), np.cos(slope)])
    np.testing.assert_allclose(np.abs(found[0] - velocity[0]), np.abs(change), atol=1e-9)
    np.testing.assert_allclose(found[0], -found[1], atol=1e-9)


def test_agents_far_apart_for_their_horizon_do_as_they_want() -> None:
    position, wanted = np.array([[0.0, 0.0], [6.0, 0.0]]), np.array([[1.0, 0.0], [-1.0, 0.0]])
    np.testing.assert_allclose(avoided(position, wanted, wanted), wanted, atol=1e-12)


def test_velocities_are_those_of_the_library_rvo2() -> None:
    pyrvo = pytest.importorskip("pyrvo")
    draws, different = np.random.default_rng(0), []
    for _ in range(200):
        count = int(draws.integers(2, 8))
        position = draws.uniform(-3.0, 3.0, (count, 2))
        velocity, wanted = draws.uniform(-0.9, 0.9, (2, count, 2))
        theirs = pyrvo.RVOSimulator(STEP_S, 100.0, 10, 2.0, 1.0, 0.3, 1.3)
        for agent in range(count):
            theirs.add_agent(tuple(position[agent]))
            theirs.set_agent_velocity(agent, tuple(velocity[agent]))
            theirs.set_agent_pref_velocity(agent, tuple(wanted[agent]))
        theirs.do_step()
        found = [theirs.get_agent_velocity(agent) for agent in range(count)]
        expected = np.array([[each.x, each.y] for each in found])
        different.append(np.abs(avoided(position, velocity, wanted) - expected).max())
    # Theirs are of single precision.
    assert np.median(different) < 1e-5 and np.mean(np.array(different) > 1e-3) < 0.02


@pytest.mark.slow
def test_eight_people_on_a_circle_swap_places_without_touching() -> None:
    poses = circle(8, 4.0)
    opposite = [(-x, -y) for x, y, _ in poses[0].tolist()]
    stage = Stage({"name": "orca", "places": opposite, "pause_s": [100.0, 100.0]}, poses)
    track = stage.run(25.0)[:, 0]
    assert gaps(track).min() > 2 * RADIUS_M
    assert np.linalg.norm(track[-1] - np.array(opposite), axis=-1).max() < 0.6
    # Nobody trembles: whoever walks turns by less than 10 degrees in nearly every step.
    assert np.mean(np.concatenate([turns(track[:, agent]) for agent in range(8)]) > np.radians(10.0)) < 0.02


@pytest.mark.slow
def test_people_pass_each_other_in_a_corridor_and_keep_off_its_walls() -> None:
    walls = yard((0.0, 1.2, 0.0, 12.0, 0.4), (0.0, -1.2, 0.0, 12.0, 0.4))
    poses = [[[-4.0, 0.05, 0.0], [4.0, -0.05, np.pi]]]
    stage = Stage(
        {"name": "orca", "places": [[4.0, 0.0], [-4.0, 0.0]], "pause_s": [99.0, 99.0]}, poses, world=walls
    )
    track = stage.run(16.0)[:, 0]
    assert track[-1, 0, 0] > 3.4 and track[-1, 1, 0] < -3.4
    assert gaps(track).min() > 2 * RADIUS_M
    assert np.abs(track[..., 1]).max() < 1.0 - RADIUS_M + 0.05
