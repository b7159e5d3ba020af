"""Behaviours that go about by themselves: random way-points, patrol, herd, follow, flee, crossing."""

import numpy as np
import pytest
from stages import RADIUS_M, ROBOT_REACH_M, STEP_S, Stage, gaps, turns
from yards import BOXES, yard

SPREAD = np.array([[[-7.0, -4.0, 0.0], [-3.0, -3.0, 1.0], [2.0, 4.0, 2.0], [6.0, 2.0, 3.0]]])
OWN_WAY = ["random_waypoint", "herd", "social_force", "orca"]


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN_WAY)
def test_the_same_seed_gives_the_same_bytes_and_another_one_another_way(name: str) -> None:
    first, again, other = (Stage({"name": name}, SPREAD, seed=seed).run(8.0) for seed in (1, 1, 2))
    assert first.tobytes() == again.tobytes()
    assert np.abs(first - other).max() > 0.1


@pytest.mark.slow(all_but=["social_force"])
@pytest.mark.parametrize("name", [*OWN_WAY, "crossing", "follow", "flee"])
def test_a_scene_among_others_goes_as_it_does_alone(name: str) -> None:
    shifts = np.array([[[0.0, 0.0, 0.0]], [[0.5, 0.0, 0.0]], [[0.0, -0.5, 0.0]]])
    three = SPREAD + shifts
    moves = {"robots": [[0.0, 0.0]], "robot_velocity": (0.5, 0.1), "world": yard(*BOXES[1:])}
    together = Stage({"name": name}, three, first_episode=4, **moves).run(8.0)
    alone = Stage({"name": name}, three[1:2], first_episode=5, **moves).run(8.0)
    np.testing.assert_allclose(together[:, 1], alone[:, 0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["random_waypoint", "orca"])
def test_random_places_are_reached_round_no_corner(name: str) -> None:
    stage = Stage({"name": name, "pause_s": [0.0, 0.5]}, SPREAD, world=yard(*BOXES))
    track = stage.run(40.0)
    assert stage.worlds.clearance(np.moveaxis(track, 0, 1)).min() > RADIUS_M - 0.06
    assert gaps(track).min() > 2 * RADIUS_M
    walked = np.linalg.norm(np.diff(track, axis=0), axis=-1).sum(axis=0)
    # Seldom stopped: at 1 m/s, with pauses and turns.
    assert walked.min() > 20.0
    assert (
        np.mean(np.concatenate([turns(track[:, 0, agent]) for agent in range(4)]) > np.radians(10.0)) < 0.03
    )


def test_a_patrol_visits_its_places_in_turn_and_waits() -> None:
    places = [[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0]]
    stage = Stage({"name": "patrol", "places": places, "wait_s": [1.0, 1.0]}, [[[-4.0, -2.0, 0.0]]])
    track = stage.run(25.0)[:, 0, 0]
    near = np.linalg.norm(track[:, None] - np.array(places), axis=-1) < 0.6
    visits = [place for place in near.argmax(axis=1)[near.any(axis=1)].tolist()]
    order = [place for place, before in zip(visits, [-1, *visits[:-1]], strict=True) if place != before]
    assert order[:5] == [0, 1, 2, 0, 1]
    still = np.linalg.norm(np.diff(track, axis=0), axis=-1) < 1e-6
    # A second at each, and less than another to turn round.
    waits = len(order) - 1
    assert waits - 0.5 < still.sum() * STEP_S < 2.0 * (waits + 1)


def test_members_of_a_patrol_begin_at_different_places() -> None:
    places = [[-4.0, 0.0], [4.0, 0.0]]
    stage = Stage({"name": "patrol", "places": places}, [[[0.0, 0.5, 0.0], [0.0, -0.5, 0.0]]])
    track = stage.run(3.0)[:, 0]
    assert track[-1, 0, 0] < -1.5 and track[-1, 1, 0] > 1.5


@pytest.mark.slow
def test_a_herd_gathers_stays_together_and_comes_along() -> None:
    draws = np.random.default_rng(0)
    poses = np.concatenate(
        [draws.uniform(-6.0, 6.0, (2, 8, 2)), draws.uniform(-3.0, 3.0, (2, 8, 1))], axis=-1
    )
    stage = Stage({"name": "herd", "pause_s": [1.0, 2.0]}, poses)
    track = stage.run(60.0)
    middle = track.mean(axis=2, keepdims=True)
    spread = np.linalg.norm(track - middle, axis=-1).max(axis=2)
    assert spread[400:].max() < 4.0 < spread[0].min()
    assert gaps(track[200:]).min() > 2 * RADIUS_M
    assert np.linalg.norm(middle[-1] - middle[400], axis=-1).max() > 1.0


def test_a_herd_runs_from_a_robot() -> None:
    poses = [[[0.0, 0.6 * member, 0.0] for member in range(4)]]
    stage = Stage({"name": "herd"}, poses, robots=[[-3.0, 1.0]], robot_velocity=(1.0, 0.0))
    track = stage.run(6.0)
    robot = np.array([-3.0 + 6.0, 1.0])
    assert np.linalg.norm(track[-1, 0] - robot, axis=-1).min() > 1.0


@pytest.mark.slow(all_but=["start1-1.5"])
@pytest.mark.parametrize("ttc", [1.5, 3.0])
@pytest.mark.parametrize("start", [(5.0, 3.0), (6.0, -4.0), (2.0, 2.0)])
def test_the_way_is_cut_at_the_time_to_contact(ttc: float, start: tuple[float, float]) -> None:
    speed, began = 0.5, -4.0
    settings = {"name": "crossing", "time_to_contact_s": ttc, "range_m": 15.0}
    stage = Stage(settings, [[[*start, 0.0]]], robots=[[began, 0.0]], robot_velocity=(speed, 0.0))
    track = stage.run(20.0)[:, 0, 0]
    (crossed, *_) = np.flatnonzero(np.sign(track[1:, 1]) != np.sign(track[:-1, 1]))
    robot_x = began + speed * STEP_S * (crossed + 1)
    assert (track[crossed, 0] - robot_x) / speed == pytest.approx(ttc, abs=0.25)
    # It goes on behind the line.
    assert np.abs(track[crossed + 60 :, 1]).max() > 2.0


def test_nobody_crosses_the_way_of_a_robot_that_stands() -> None:
    stage = Stage({"name": "crossing"}, [[[3.0, 2.0, 0.0]]], robots=[[0.0, 0.0]])
    np.testing.assert_allclose(stage.run(3.0)[-1, 0, 0], [3.0, 2.0], atol=1e-9)


def test_a_follower_stays_behind_its_robot_round_a_wall() -> None:
    wall = yard((0.0, 2.0, 0.0, 0.4, 6.0))
    stage = Stage(
        {"name": "follow", "distance_m": 1.5}, [[[-3.5, 2.0, 0.0]]], robots=[[-2.0, 2.0]], world=wall
    )
    track = []
    for velocity, duration in (((0.0, -0.7), 6.0), ((0.7, 0.0), 6.0), ((0.0, 0.7), 5.0), ((0.0, 0.0), 5.0)):
        stage.robot_velocity = np.array(velocity)
        track.append(stage.run(duration)[:, 0, 0])
    gap = np.linalg.norm(stage.robots[0, 0] - track[-1][-1])
    assert gap == pytest.approx(1.5, abs=0.2)
    assert track[-1][-1, 0] > 0.5
    assert stage.worlds.clearance(np.concatenate(track)[None]).min() > RADIUS_M - 0.06


def test_a_follower_of_a_group_that_has_only_itself_stands() -> None:
    stage = Stage({"name": "follow", "target": "people"}, [[[1.0, 1.0, 0.0]]])
    np.testing.assert_allclose(stage.run(2.0)[-1, 0, 0], [1.0, 1.0], atol=1e-9)


def test_who_flees_stands_until_the_robot_is_near_and_gets_away() -> None:
    stage = Stage(
        {"name": "flee", "range_m": 3.0}, [[[0.0, 0.3, 0.0]]], robots=[[-6.0, 0.0]], robot_velocity=(1.0, 0.0)
    )
    before = stage.run(2.9)
    np.testing.assert_allclose(before[-1, 0, 0], [0.0, 0.3], atol=1e-9)
    stage.run(4.0)
    assert np.linalg.norm(stage.robots[0, 0] - stage.places[0, 0]) > 2.0


def test_who_flees_runs_along_a_wall_not_into_it() -> None:
    stage = Stage(
        {"name": "flee"}, [[[1.6, 0.3, 0.0]]], robots=[[-0.5, 0.0]], robot_velocity=(0.4, 0.0),
        world=yard((2.5, 0.0, 0.0, 0.4, 12.0)),
    )  # fmt: skip
    track = stage.run(5.0)[:, 0, 0]
    assert abs(track[-1, 1]) > 2.0
    assert stage.worlds.clearance(track[None]).min() > RADIUS_M - 0.06
    assert np.linalg.norm(track[-1] - stage.robots[0, 0]) > ROBOT_REACH_M + RADIUS_M
