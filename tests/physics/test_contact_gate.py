"""Contacts of any physics step are reported, and the gate that saves reading them loses none."""

from dataclasses import replace
from itertools import chain

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
    poses_of,
    rover_body,
    rover_without_tyres,
    walker,
)
from simple_robots import block, body, link

from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.contact_gate import ContactGate
from dune_rl.physics.robot_body import RobotBody, Tyre
from dune_rl.physics.shapes import KinematicCapsule

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


@pytest.mark.slow
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


def tumble(backend: Backend, folder, seed: int, rover: RobotBody) -> tuple[list[list[set[int]]], list[bytes]]:
    """Contacts and states of robots that are thrown at boxes, past a walker and each other."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-5.0, 5.0, (5, 2))
    boxes = [box(tuple(xy), *rng.uniform(0.05, 1.0, 2), 1.0, name=f"{xy}") for xy in centres.tolist()]
    terrain = ground(HeightField(np.zeros((3, 3)), 30.0, (-30.0, -30.0)))
    company = Company(backend, [rover, block(folder)], [terrain, *boxes], [walker()])
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


@pytest.mark.slow(all_but=["0-bullet", "1-dart"])
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
    gated, states = tumble(backend, tmp_path, seed, rover_without_tyres())
    monkeypatch.setattr(ContactGate, "find_contacts", expose_all)
    always, same_states = tumble(backend, tmp_path, seed, rover_without_tyres())
    assert gated == always
    assert states == same_states
    assert 10 < sum(any(found) for found in always) < len(always)
    assert exposures.count(True) > 10 and exposures.count(False) > 10


@every_backend
def test_a_robot_with_tyres_touches_only_what_the_gate_finds(backend, tmp_path, monkeypatch):
    exposures = []
    find_contacts = ContactGate.find_contacts

    def expose_all(self, *given):
        near, exposed = find_contacts(self, *given)
        exposures.extend(exposed)
        return near, [True] * len(exposed)

    monkeypatch.setattr(ContactGate, "find_contacts", expose_all)
    contacts, _ = tumble(backend, tmp_path, 5, rover_body())
    pairs = zip(chain.from_iterable(contacts), exposures, strict=True)
    touching = [is_exposed for found, is_exposed in pairs if found]
    assert len(touching) > 10 and all(touching)
    assert not all(exposures)


@every_backend
def test_tyres_meet_obstacles_alike_each_time_that_a_scene_is_reset(backend):
    walls = [box((0.75, y), 0.2, 0.2, 1.0, name=f"post {y}") for y in (-0.6, -0.3, 0.0, 0.3, 0.6)]
    stage = Stage(backend, [plane(), *walls])

    def drive() -> tuple[list[bytes], set[int]]:
        states, touched = [], set()
        stage.place([0.0, 0.1, 0.125], about([0, 0, 1], 0.3))
        for wheels in ([6.0] * 4, [-6.0] * 4, [8.0, -2.0, 8.0, -2.0], [6.0] * 4):
            for _ in range(12):
                stage.step(SUBSTEPS, wheels)
                states.append(stage.state.tobytes())
                touched |= stage.contacts()
        return states, touched

    first, touched = drive()
    assert touched
    assert all(drive()[0] == first for _ in range(3))


class Puck:
    """A robot as the gate sees it."""

    base_mass_kg = 10.0

    def __init__(self, x: float, y: float, speed_mps: float = 0.0, reach_m: float = 0.5) -> None:
        self._motion = x, y, speed_mps
        self.reach_m = reach_m

    def planar_motion(self) -> tuple[float, float, float]:
        return self._motion

    def body_state(self) -> tuple[float, ...]:
        return (*self._motion[:2], 0.125, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6)


def exposed(statics, *pucks: Puck, forces=None, kinematics=(), old=(), new=()) -> list[bool]:
    """Whether each of the pucks can touch anything in a control step of 0.05 s."""
    gate = ContactGate(tuple(statics), kinematics, [rover_without_tyres() for _ in pucks])
    return gate.find_contacts(pucks, 0.05, forces or {}, poses_of(old), poses_of(new))[1]


def test_a_robot_is_exposed_within_its_reach_of_an_obstacle_and_not_far_from_it():
    wall = [plane(), box((3.0, 0.0), 1.0, 1.0, 1.0)]
    # The motion of a control step and the contact margin; the map is too low by four cells at most.
    assert exposed(wall, Puck(2.5 - 0.5 - 0.09, 0.3)) == [True]
    assert exposed(wall, Puck(2.5 - 0.5 - 0.1 - 0.4 - 0.01, 0.3)) == [False]
    assert exposed([plane()], Puck(0.0, 0.0)) == [False]


@pytest.mark.parametrize("seed", range(5))
def test_whatever_is_within_reach_of_an_obstacle_is_exposed(seed):
    rng = np.random.default_rng(seed)
    places = rng.uniform(-4.0, 4.0, (6, 2)).tolist()
    walls = [box(tuple(xy), *rng.uniform(0.05, 2.0, 2), 1.0, name=f"{xy}") for xy in places]
    corners = np.concatenate([wall.vertices[wall.faces][..., :2] for wall in walls])
    weights = rng.dirichlet(np.ones(3), (len(corners), 20))
    points = np.einsum("fkc,fcd->fkd", weights, corners).reshape(-1, 2)
    bearing = rng.uniform(-np.pi, np.pi, len(points))
    around = points + 0.5 * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    gate = ContactGate((plane(), *walls), (), [rover_without_tyres()])
    for xy in around.tolist():
        assert gate.find_contacts([Puck(*xy)], 0.05, {}, (), ()) == ([], [True])


def test_speed_and_forces_widen_what_a_robot_can_touch():
    wall, puck = [box((3.0, 0.0), 1.0, 1.0, 1.0)], (1.3, 0.0)
    assert exposed(wall, Puck(*puck)) == [False]
    assert exposed(wall, Puck(*puck, speed_mps=20.0)) == [True]
    assert exposed(wall, Puck(*puck), forces={0: [0.0, 0.0, 8e3]}) == [True]


def test_what_cannot_be_known_counts_as_exposed():
    wall = [box((3.0, 0.0), 1.0, 1.0, 1.0)]
    assert exposed(wall, Puck(99.0, 0.0, reach_m=np.inf)) == [True]
    assert exposed(wall, Puck(99.0, 0.0, speed_mps=np.nan)) == [True]
    for lost in (np.nan, np.inf):
        assert exposed(wall, Puck(lost, 0.0)) == [True]
        assert exposed([], Puck(lost, 0.0), Puck(5.0, 0.0))[0]


def test_robots_and_kinematic_bodies_that_come_near_expose():
    assert exposed([], Puck(0.0, 0.0), Puck(1.05, 0.0), Puck(9.0, 0.0)) == [True, True, False]
    person = (KinematicCapsule("walker_0", 0.25, 1.75, 250.0),)
    for x, is_near in ((0.8, True), (1.5, False)):
        pose = [[x, 0.0, 0.0, 0.0]]
        assert exposed([], Puck(0.0, 0.0), kinematics=person, old=pose, new=pose) == [is_near]
    # It comes from where it is near.
    paces = {"old": [[0.8, 0.0, 0.0, 0.0]], "new": [[1.5, 0.0, 0.0, 0.0]]}
    assert exposed([], Puck(0.0, 0.0), kinematics=person, **paces) == [True]


@every_backend
def test_the_reach_of_a_robot_has_its_tyres_in_it(backend, tmp_path):
    wide = Tyre("front_left_wheel", 0.125, 2.0, (0.1415, 0.18, 0.0))
    company = Company(backend, [replace(rover_body(), tyres=(wide,))], [plane()])
    company.place([0.0, 0.0, 0.125])
    assert company.robots[0].reach_m > 1.0


def test_the_obstacles_near_a_place_are_those_that_can_be_touched():
    walls = (plane(), box((3.0, 0.0), 1.0, 1.0, 1.0), box((0.0, 3.0), 1.0, 1.0, 1.0, name="other"))
    gate = ContactGate(walls, (), [rover_without_tyres()])
    for place, near in (((2.2, 0.0), [1]), ((0.0, 2.2), [2]), ((2.2, 2.2), [1, 2]), ((-9.0, 0.0), [])):
        gate.find_contacts([Puck(*place, reach_m=0.3 if len(near) < 2 else 1.8)], 0.05, {}, (), ())
        assert gate.statics_near(0) == near
