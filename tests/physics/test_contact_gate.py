"""Contacts of any physics step are reported, and the gate that saves reading them loses none."""

import numpy as np
import pytest
from scenes import (
    SUBSTEPS,
    Backend,
    Company,
    Stage,
    about,
    box,
    every_backend,
    ground,
    plane,
    rover_without_tyres,
    walker,
)
from simple_robots import block, body, link

from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.contact_gate import ContactGate, ObstacleGrid
from dune_rl.physics.interface import StaticBody

RADIUS_M = 0.1


def graze(backend: Backend, folder, count: int, start_m: float) -> list[set[int]]:
    """Contacts of a ball that flies past the edge of a box at 2 m/s, read every `count` of 60 physics steps.

    The box is from x = 0.5 m to 0.51 m; the ball comes 0.2 mm too close to it.
    """
    ball = body(folder, link("ball", 2.0, str(RADIUS_M), "sphere"), hull_friction=0.0)
    wall = box((0.505, 1.0), 0.01, 2.0 + 4e-4, 3.0)
    stage = Stage(backend, [plane(), wall], robot=ball, gravity_mps2=0.0)
    stage.place([start_m, -RADIUS_M, 1.0])
    stage.engine.apply_force([2.0 * 2.0 / 0.05, 0.0, 0.0])
    stage.step(10)
    seen = []
    for _ in range(60 // count):
        stage.step(count)
        seen.append(stage.contacts())
    assert stage.velocity[0] == pytest.approx(2.0, rel=0.02)
    return seen


@every_backend
def test_a_touch_between_two_control_steps_is_reported(backend, tmp_path):
    found = 0
    # 1 cm are a physics step: in some of these runs the touch begins and ends within a control step.
    for start_m in np.arange(0.0, 0.1, 0.01):
        every = graze(backend, tmp_path, 1, start_m)
        last = [every[step] for step in range(SUBSTEPS - 1, 60, SUBSTEPS)]
        any_step = [set().union(*every[step : step + SUBSTEPS]) for step in range(0, 60, SUBSTEPS)]
        assert set().union(*any_step) == {1}
        assert graze(backend, tmp_path, SUBSTEPS, start_m) == any_step
        found += not any(last)
    assert found, "all touches were there at the end of a control step: the test shows nothing"


@every_backend
def test_contacts_are_those_of_the_last_step_alone(backend):
    stage = Stage(backend, [plane(), box((1.0, 0.0), 0.4, 4.0, 1.0)])
    stage.place([0.48, 0.0, 0.125])
    stage.step(SUBSTEPS, 4.0)
    stage.step(SUBSTEPS, 4.0)
    assert stage.contacts() == stage.contacts() == {1}
    for _ in range(8):
        stage.step(SUBSTEPS, -4.0)
    assert stage.contacts() == set()
    stage.step(SUBSTEPS, 4.0)
    stage.place()
    assert stage.contacts() == set()


def tumble(backend: Backend, folder, seed: int) -> tuple[list[list[set[int]]], list[bytes]]:
    """Contacts and states of robots that are thrown at boxes, past a walker and each other."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-5.0, 5.0, (5, 2))
    boxes = [box(tuple(xy), *rng.uniform(0.05, 1.0, 2), 1.0, name=f"{xy}") for xy in centres.tolist()]
    terrain = ground(HeightField(np.zeros((3, 3)), 30.0, (-30.0, -30.0)))
    company = Company(backend, [rover_without_tyres(), block(folder)], [terrain, *boxes], [walker()])
    contacts, states = [], []
    for _ in range(4):
        places = rng.uniform(-5.0, 5.0, (2, 2))
        actor = np.array([*rng.uniform(-5.0, 5.0, 2), 0.0, 0.0])
        company.place(*([x, y, 0.3] for x, y in places), quaternion=about([0, 0, 1], 1.0), actors=[actor])
        for step in range(50):
            for robot, state, newtons in zip(company.robots, company.states, (900.0, 200.0), strict=True):
                if step % 10 == 0:
                    way = centres[rng.integers(len(centres))] - state[:2]
                    robot.apply_force([*(newtons * way / np.linalg.norm(way)), rng.uniform(0.0, 100.0)])
            company.robots[0].set_command(rng.uniform(-8.0, 8.0, 4).tolist())
            actor[:2] += rng.uniform(-0.1, 0.1, 2)
            company.step(SUBSTEPS, [actor.copy()])
            contacts.append(company.contacts())
            states.append(company.states.tobytes())
    return contacts, states


@every_backend
@pytest.mark.parametrize("seed", range(3))
def test_the_gate_loses_no_contact(backend, seed, tmp_path, monkeypatch):
    exposures = []
    find_contacts = ContactGate.find_contacts

    def record(self, *given):
        near, exposed = find_contacts(self, *given)
        exposures.extend(exposed)
        return near, exposed

    def expose_all(self, *given):
        near, exposed = find_contacts(self, *given)
        return near, [True] * len(exposed)

    monkeypatch.setattr(ContactGate, "find_contacts", record)
    gated, states = tumble(backend, tmp_path, seed)
    monkeypatch.setattr(ContactGate, "find_contacts", expose_all)
    always, same_states = tumble(backend, tmp_path, seed)
    assert gated == always
    assert states == same_states
    assert 10 < sum(any(found) for found in always) < len(always)
    assert exposures.count(True) > 10 and exposures.count(False) > 10


def triangles(rng: np.random.Generator, count: int, size_m: float) -> StaticBody:
    vertices = rng.uniform(-10.0, 10.0, (count, 1, 3)) + rng.uniform(-size_m, size_m, (count, 3, 3))
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return StaticBody("triangles", vertices.reshape(-1, 3), faces, 1.0, ground=False)


@pytest.mark.parametrize(("count", "size_m", "reach_m"), [(1, 0.1, 0.3), (40, 0.5, 0.5), (6, 12.0, 1.0)])
def test_a_place_within_reach_of_an_obstacle_is_near_and_a_far_one_is_not(count, size_m, reach_m):
    rng = np.random.default_rng(count)
    body = triangles(rng, count, size_m)
    grid = ObstacleGrid([plane(), body], reach_m)
    corners = body.vertices[body.faces][..., :2]
    weights = rng.dirichlet(np.ones(3), (count, 4000))
    points = np.einsum("fkc,fcd->fkd", weights, corners).reshape(-1, 2)
    around = points + reach_m * np.stack([np.cos(points[:, 0] * 99), np.sin(points[:, 0] * 99)], axis=1)
    assert all(grid.is_near(*xy) for xy in around.tolist())
    queries = rng.uniform(-40.0, 40.0, (300, 2))
    distance = np.array([np.hypot(*(points - query).T).min() for query in queries])
    # Margins, two cells, the bounding box of a split triangle, and what lies between the samples.
    far = distance > reach_m + 0.4 + 2 * 0.36 + 2.9 + 0.7
    assert far.sum() > 30
    assert not any(grid.is_near(*query) for query in queries[far].tolist())
    assert grid.is_near(np.nan, 0.0)


def test_without_obstacles_nothing_is_near_and_without_bounds_everything():
    assert not ObstacleGrid([plane()], 0.5).is_near(0.0, 0.0)
    wall = box((3.0, 0.0), 1.0, 1.0, 1.0)
    assert ObstacleGrid([plane(), wall], np.inf).is_near(99.0, 0.0)
    assert not ObstacleGrid([plane(), wall], 0.5).is_near(99.0, 0.0)
