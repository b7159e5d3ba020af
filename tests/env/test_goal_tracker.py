"""Goals of agents: how far and in which direction they are, from step to step."""

import numpy as np
import pytest
from scenes import about
from states import motion_of

from dune_rl.env.goal_tracker import GoalTracker
from dune_rl.state import Motion

BOTH = np.array([True, True])


class FixedGoals:
    """Goals that a test chooses; another one is 10 m further along x."""

    def __init__(self, *goals: tuple[float, float]) -> None:
        self.goals_w = np.array(goals)

    def renew(self, mask: np.ndarray) -> None:
        self.goals_w = self.goals_w + np.where(mask[:, None], [10.0, 0.0], 0.0)


def bodies_at(*places: tuple[float, float], yaw: float = 0.0) -> Motion:
    states = np.zeros((len(places), 13))
    states[:, :2] = places
    states[:, 3:7] = about([0, 0, 1], yaw)
    return motion_of(states)


@pytest.mark.parametrize(
    ("goal", "bearing"),
    [((1, 5), 0.0), ((-3, 1), np.pi / 2), ((5, 1), -np.pi / 2), ((2, 2), -np.pi / 4), ((1, -5), np.pi)],
)
def test_a_goal_s_bearing_is_from_the_heading_to_the_left(goal: tuple[float, float], bearing: float) -> None:
    tracker = GoalTracker(FixedGoals(goal), 1)
    found = tracker.begin(np.array([True]), bodies_at((1, 1), yaw=np.pi / 2)).bearing[0]
    # Behind is half a turn, by either side.
    assert (abs(found) if bearing == np.pi else found) == pytest.approx(bearing)
    assert -np.pi <= found < np.pi


def test_the_previous_distance_is_that_of_the_step_before() -> None:
    tracker = GoalTracker(FixedGoals((5, 0), (0, 5)), 2)
    now = tracker.begin(BOTH, bodies_at((0, 0), (0, 0)))
    np.testing.assert_allclose([now.distance, now.previous_distance], [[5, 5], [5, 5]])
    now = tracker.measure(bodies_at((1, 0), (0, -2)))
    np.testing.assert_allclose([now.distance, now.previous_distance], [[4, 7], [5, 5]])
    now = tracker.measure(bodies_at((3, 0), (0, 0)))
    np.testing.assert_allclose([now.distance, now.previous_distance], [[2, 5], [4, 7]])


def test_progress_is_measured_from_a_renewed_goal() -> None:
    tracker = GoalTracker(FixedGoals((5, 0), (5, 0)), 2)
    tracker.begin(BOTH, bodies_at((0, 0), (0, 0)))
    here = bodies_at((5, 0), (1, 0))
    now = tracker.renew(np.array([True, False]), here, tracker.measure(here))
    np.testing.assert_allclose(now.position_w, [[15, 0], [5, 0]])
    np.testing.assert_allclose(now.distance, [10, 4])
    now = tracker.measure(bodies_at((6, 0), (2, 0)))
    np.testing.assert_allclose(now.previous_distance - now.distance, [1, 1])


def test_a_new_episode_leaves_the_others_progress() -> None:
    source = FixedGoals((5, 0), (5, 0))
    tracker = GoalTracker(source, 2)
    tracker.begin(BOTH, bodies_at((0, 0), (0, 0)))
    tracker.measure(bodies_at((1, 0), (1, 0)))
    source.goals_w = np.array([[8.0, 0.0], [5.0, 0.0]])
    tracker.begin(np.array([True, False]), bodies_at((0, 0), (1, 0)))
    now = tracker.measure(bodies_at((2, 0), (2, 0)))
    np.testing.assert_allclose(now.previous_distance - now.distance, [2, 1])
