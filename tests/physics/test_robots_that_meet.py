"""Robots of one scene against formulae, on every backend: how they meet, and what is each one's own."""

import numpy as np
import pytest
from scenes import (
    GRAVITY_MPS2,
    HULL_BOTTOM_M,
    HULL_HALF_LENGTH_M,
    HULL_HALF_WIDTH_M,
    HULL_TOP_M,
    MASS_KG,
    STEP_S,
    SUBSTEPS,
    TIMESTEP_S,
    WHEEL_RADIUS_M,
    Company,
    allowed,
    box,
    every_backend,
    plane,
    quaternion_of,
    rover_body,
    rover_without_tyres,
    walker,
)
from simple_robots import block, body, link

from dune_rl.physics.robot_body import BodyVariation

pytestmark = every_backend

# Between the wheels' middles, and of a tyre.
TRACK_M, TYRE_WIDTH_M = 0.36, 0.083


# -- collisions ------------------------------------------------------------------------------------


def test_a_collision_keeps_momentum(backend, tmp_path):
    masses, sizes = np.array([2.0, 5.0]), np.array([[0.4, 0.3, 0.2], [0.3, 0.6, 0.2]])
    blocks = []
    for mass, size in zip(masses, sizes, strict=True):
        folder = tmp_path / f"{mass}"
        folder.mkdir()
        blocks.append(body(folder, link("block", mass, " ".join(map(str, size)), "box")))
    moments = masses / 12 * (sizes[:, :2] ** 2).sum(axis=1)
    company = Company(backend, blocks, [], gravity_mps2=0.0)
    for offset, turns in ((0.0, False), (0.25, True)):
        company.place([0.0, 0.0, 1.0], [0.5, offset, 1.0])
        company.robots[0].apply_force([40.0, 0.0, 0.0])
        company.step(20)
        assert company.velocities[0, 0] == pytest.approx(40.0 * 20 * TIMESTEP_S / masses[0], rel=1e-6)

        def momenta() -> np.ndarray:
            position, linear, angular = np.split(company.states[:, [0, 1, 2, 7, 8, 9, 10, 11, 12]], 3, axis=1)
            own = moments * angular[:, 2]
            about_z = np.cross(position, masses[:, None] * linear)[:, 2]
            return np.array([*(masses @ linear), (own + about_z).sum()])

        before = momenta()
        company.step(40)
        assert (np.abs(company.states[:, 12]) > 0.1).all() == turns
        np.testing.assert_allclose(momenta(), before, atol=1e-3 * before[0])
        if not turns:
            # Nothing bounces, but for what PyBullet gives them to part what has entered each other.
            together = before[0] / masses.sum()
            np.testing.assert_allclose(company.velocities[:, 0], together, rtol=allowed(backend, 0.11, 0.01))


FRICTIONS = (0.3, 0.5, 0.9)


@pytest.mark.parametrize(("below", "above"), [(0, 1), (1, 0), (0, 2), (1, 2), (2, 0)])
def test_hulls_slide_on_hulls_by_the_product_of_their_frictions(backend, below, above):
    company = Company(backend, [rover_without_tyres(hull_friction=share) for share in FRICTIONS])
    places = [[5.0 * number + 5.0, 5.0, WHEEL_RADIUS_M] for number in range(3)]
    places[below] = [0.0, 0.0, WHEEL_RADIUS_M]
    places[above] = [0.0, 0.0, WHEEL_RADIUS_M + HULL_TOP_M - HULL_BOTTOM_M + 0.001]
    company.place(*places)
    company.step(100)
    assert company.positions[above, 2] == pytest.approx(places[above][2], abs=4e-3)
    friction = FRICTIONS[below] * FRICTIONS[above] * MASS_KG * GRAVITY_MPS2
    for force, slides in ((0.85 * friction, False), (friction + 6.0, True)):
        seen = []
        for _ in range(2):
            company.robots[above].apply_force([force, 0.0, 0.0])
            # Of which the first are those in which the tyres and servos of the lower one give way.
            company.step(40)
            seen.append((*company.positions[[below, above], 0], company.velocities[above, 0]))
        gained = np.diff(seen, axis=0)[0]
        if slides:
            assert gained[2] == pytest.approx(6.0 / MASS_KG * 40 * TIMESTEP_S, rel=0.2)
        else:
            assert gained[0] == pytest.approx(gained[1], abs=1e-3)
    assert company.contacts() == [
        {1 + above} if number == below else {1 + below} if number == above else set() for number in range(3)
    ]


@pytest.mark.parametrize(
    ("robot", "between"),
    [
        (rover_body(), TRACK_M + TYRE_WIDTH_M),
        (rover_without_tyres(), 2 * HULL_HALF_WIDTH_M),
        (rover_without_tyres(ground_links_meet_obstacles=True), TRACK_M + 2 * WHEEL_RADIUS_M),
    ],
    ids=["tyres", "wheels that meet nothing", "wheels that meet obstacles"],
)
def test_tyres_and_wheels_that_meet_obstacles_meet_other_robots(backend, robot, between):
    company = Company(backend, [robot, robot], [], gravity_mps2=0.0)
    company.place([0.0, -0.4, 1.0], [0.0, 0.4, 1.0])
    for _ in range(20):
        company.robots[0].apply_force([0.0, 5.0, 0.0])
        company.robots[1].apply_force([0.0, -5.0, 0.0])
        company.step()
    assert np.ptp(company.positions[:, 1]) == pytest.approx(between, abs=0.01)
    assert company.contacts() == [{1}, {0}]


def test_a_wheel_that_meets_obstacles_meets_hulls_and_no_wheels_that_do_not(backend):
    robots = [rover_without_tyres(ground_links_meet_obstacles=meet) for meet in (False, True)]
    company = Company(backend, robots, [], gravity_mps2=0.0)
    company.place([0.0, -0.4, 1.0], [0.0, 0.4, 1.0])
    for _ in range(20):
        company.robots[0].apply_force([0.0, 5.0, 0.0])
        company.robots[1].apply_force([0.0, -5.0, 0.0])
        company.step()
    between = HULL_HALF_WIDTH_M + TRACK_M / 2 + WHEEL_RADIUS_M
    assert np.ptp(company.positions[:, 1]) == pytest.approx(between, abs=0.02)


def test_each_is_told_of_what_it_touches_itself(backend, tmp_path):
    statics = [plane(), box((3.0, 0.0), 1.0, 1.0, 0.1), box((-3.0, 0.0), 1.0, 1.0, 0.1)]
    company = Company(backend, [block(tmp_path)] * 5, statics, [walker("far"), walker("near")])
    passing = [[9.0, 9.0, 0.0, 0.0], [0.0, -3.0, 0.0, 0.0]]
    # Three in a pile, one on a box, one in a walker's way: those three have nothing to do with each other.
    company.place([0, 0, 0.1], [0, 0, 0.301], [0, 0, 0.502], [3, 0, 0.201], [0.0, -2.5, 0.1], actors=passing)
    assert company.contacts() == [set()] * 5
    company.step(40)
    for step in range(1, 7):
        company.step(SUBSTEPS, [passing[0], [0.0, -3.0 + 0.5 * STEP_S * step, 0.0, 0.0]])
    assert company.contacts() == [{6}, {5, 7}, {6}, {1}, {4}]
    np.testing.assert_allclose(company.positions[:3, 2], [0.1, 0.3, 0.5], atol=5e-3)


# -- what is each one's own ------------------------------------------------------------------------


def test_a_walker_pushes_whom_it_meets(backend):
    company = Company(backend, [rover_body()] * 2, kinematics=[walker()])
    company.place([9.0, 9.0, WHEEL_RADIUS_M], [0.0, 0.0, WHEEL_RADIUS_M], actors=[[1.0, 0.0, 0.0, 0.0]])
    for step in range(1, 41):
        company.step(SUBSTEPS, [[1.0 - 0.5 * STEP_S * step, 0.0, 0.0, 0.0]])
    assert company.contacts() == [set(), {1}]
    assert company.positions[1, 0] == pytest.approx(0.0 - 0.25 - HULL_HALF_LENGTH_M, abs=0.04)
    assert company.velocities[1, 0] == pytest.approx(-0.5, abs=0.05)
    np.testing.assert_allclose(company.velocities[0], 0.0, atol=1e-3)


@pytest.mark.parametrize("slippery", [0, 1])
def test_each_has_its_own_grip(backend, slippery):
    slope = 0.3
    company = Company(backend, [rover_body()] * 2, [plane(slope)])

    def slid() -> np.ndarray:
        here = company.positions.copy()
        company.step(100)
        return np.linalg.norm(company.positions - here, axis=1)

    for told in (True, False):
        places = [[0.3, y, WHEEL_RADIUS_M / np.cos(slope) + 0.3 * np.tan(slope)] for y in (-3.3, 3.3)]
        company.place(*places, quaternion=quaternion_of(0.0, slope))
        if told:
            company.robots[slippery].set_wheel_contacts([0.1] * 4, [0.0] * 4)
        company.step(20)
        assert (slid() > 0.1).tolist() == [told and number == slippery for number in range(2)]


@pytest.mark.parametrize("heavy", [0, 1])
def test_each_has_its_own_weight_and_push(backend, heavy, tmp_path):
    company = Company(backend, [block(tmp_path)] * 2, [], gravity_mps2=0.0)
    company.robots[heavy].set_body(BodyVariation(mass_factor=2.0))
    company.place([0.0, 0.0, 1.0], [0.0, 3.0, 1.0])
    company.robots[0].apply_force([1.0, 0.0, 0.0])
    company.robots[1].apply_force([0.0, 0.0, 3.0])
    company.step(20)
    expected = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 3.0]]) * 20 * TIMESTEP_S / 2.0
    expected[heavy] /= 2.0
    np.testing.assert_allclose(company.velocities, expected, atol=1e-6)
    company.step(20)
    np.testing.assert_allclose(company.velocities, expected, atol=1e-6)


def test_no_trace_is_left_by_a_collision(backend):
    robots = [rover_body(), rover_without_tyres(ground_links_meet_obstacles=True, hull_friction=0.6)]

    def rollout(company: Company) -> bytes:
        seen, met = [], [set(), set()]
        company.place([0.0, 0.0, 0.2], [0.75, 0.1, 0.2], actors=[[0.4, -1.0, 0.0, 0.0]])
        for step in range(1, 31):
            company.robots[1].apply_force([-150.0, 0.0, 0.0])
            company.step(SUBSTEPS, [[0.4, -1.0 + 0.02 * step, 0.0, 0.0]])
            now = company.contacts()
            met = [one | other for one, other in zip(met, now, strict=True)]
            seen.append(repr((company.states.tolist(), company.robots[1].drive_state(), now)))
        assert met == [{3}, {1, 2}]
        return "".join(seen).encode()

    fresh, used = (Company(backend, robots, kinematics=[walker()]) for _ in range(2))
    first = rollout(used)
    assert rollout(used) == first
    assert rollout(fresh) == first
