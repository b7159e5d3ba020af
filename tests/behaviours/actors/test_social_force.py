"""The social force model: its terms by hand, people who meet, and PySocialForce where it is installed."""

from pathlib import Path

import numpy as np
import pytest
from stages import RADIUS_M, Stage, gaps, turns
from yards import yard

from dune_rl.behaviours.social_force_loops import add_social_forces, interact, repel


def interaction(apart: list[float], own: list[float], other: list[float]) -> np.ndarray:
    force = np.zeros(2)
    interact(np.array(apart, float), np.array(own, float), np.array(other, float), 1.0, force)
    return force


def test_a_person_ahead_slows_and_does_not_turn_whoever_walks_straight_at_them() -> None:
    # D = 2 (1, 0) + (1, 0): of length 3, so that B is 0.35 * 3, and theta is 0.
    np.testing.assert_allclose(
        interaction([2.0, 0.0], [1.0, 0.0], [0.0, 0.0]), [-np.exp(-2.0 / 1.05), 0.0], atol=1e-12
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_person_aside_is_passed_on_the_other_side(side: float) -> None:
    force = interaction([2.0, 0.5 * side], [1.0, 0.0], [0.0, 0.0])
    assert force[0] < 0.0 and force[1] * side < 0.0


def test_the_interaction_is_that_of_moussaid_by_hand() -> None:
    apart, own, other = np.array([1.5, 0.4]), np.array([0.9, 0.1]), np.array([-0.5, 0.2])
    distance = np.hypot(*apart)
    direction = apart / distance
    towards = 2.0 * (own - other) + direction
    length = np.hypot(*towards)
    tangent, reach = towards / length, 0.35 * length
    theta = np.arctan2(direction[1], direction[0]) - np.arctan2(tangent[1], tangent[0])
    slow = np.exp(-distance / reach - (3.0 * reach * theta) ** 2)
    turn = np.sign(theta) * np.exp(-distance / reach - (2.0 * reach * theta) ** 2)
    expected = -slow * tangent - turn * np.array([-tangent[1], tangent[0]])
    np.testing.assert_allclose(
        interaction(apart.tolist(), own.tolist(), other.tolist()), expected, atol=1e-12
    )


def angle(vector: np.ndarray) -> float:
    return float(np.arctan2(vector[1], vector[0]))


def test_forces_are_those_of_the_library_pysocialforce(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # It writes a log to where it is loaded.
    monkeypatch.chdir(tmp_path)
    pysocialforce = pytest.importorskip("pysocialforce")
    draws, compared = np.random.default_rng(1), 0
    for _ in range(60):
        position, velocity = draws.uniform(-2.0, 2.0, (2, 2)), draws.uniform(-1.0, 1.0, (2, 2))
        theirs = pysocialforce.Simulator(np.concatenate([position, velocity, position + 5.0], axis=1))
        (force,) = (each for each in theirs.forces if type(each).__name__ == "SocialForce")
        expected = force.get_force() / force.factor
        for me, other in ((0, 1), (1, 0)):
            apart, closing = position[other] - position[me], velocity[me] - velocity[other]
            towards = 2.0 * closing + apart / np.hypot(*apart)
            # Theirs does not wrap the angle between the two, ours does.
            if abs(angle(towards) - angle(apart)) > np.pi or abs(angle(-towards) - angle(-apart)) > np.pi:
                continue
            found = interaction(apart.tolist(), velocity[me].tolist(), velocity[other].tolist())
            np.testing.assert_allclose(found, expected[me], atol=1e-9)
            compared += 1
    assert compared > 60


def test_the_wanted_velocity_is_taken_on_and_walls_repel() -> None:
    force = np.zeros(2)
    repel(0.2, np.array([1.0, 0.0]), force)
    np.testing.assert_allclose(force, [-10.0 * np.exp(-1.0), 0.0], atol=1e-12)
    found, one = np.zeros((1, 1, 2)), np.zeros((1, 1, 2))
    free = np.full((1, 1), 1e6), np.zeros((1, 1, 2))
    wanted = np.array([[[1.0, 0.5]]])
    add_social_forces(one, one, np.full(1, 0.25), np.zeros(1, bool), 0, *free, wanted, (2.0, 2.1), found)
    np.testing.assert_allclose(found[0, 0], [4.0, 2.0], atol=1e-12)


def test_two_people_head_on_pass_each_other_without_touching_or_trembling() -> None:
    poses = [[[-4.0, 0.1, 0.0], [4.0, -0.1, np.pi]]]
    settings = {"name": "social_force", "places": [[4.0, 0.1], [-4.0, -0.1]], "pause_s": [99.0, 99.0]}
    track = Stage(settings, poses).run(14.0)[:, 0]
    assert track[-1, 0, 0] > 3.4 and track[-1, 1, 0] < -3.4
    assert gaps(track).min() > 1.8 * RADIUS_M
    assert np.mean(np.concatenate([turns(track[:, agent]) for agent in range(2)]) > np.radians(10.0)) < 0.02


def test_nobody_is_pressed_into_a_wall_or_stands_there_for_ever() -> None:
    draws = np.random.default_rng(3)
    poses = np.concatenate(
        [draws.uniform(-8.0, -4.0, (2, 6, 2)), draws.uniform(-3.0, 3.0, (2, 6, 1))], axis=-1
    )
    world = yard((0.0, 0.0, 0.5, 2.0, 1.0), (4.0, -5.0, 1.0, 3.0, 0.4))
    stage = Stage({"name": "social_force", "pause_s": [0.0, 1.0]}, poses, world=world)
    track = stage.run(30.0)
    assert stage.worlds.clearance(np.moveaxis(track, 0, 1)).min() > RADIUS_M - 0.08
    moved = np.linalg.norm(track[200::100] - track[:-200:100], axis=-1)
    assert (moved.max(axis=0) > 1.0).all()
