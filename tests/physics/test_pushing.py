"""Kinematic bodies push robots no harder than they may, on every backend."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import (
    MASS_KG,
    STEP_S,
    SUBSTEPS,
    TIMESTEP_S,
    WHEEL_RADIUS_M,
    Company,
    Stage,
    box,
    every_backend,
    plane,
    quaternion_of,
    rover_body,
    walker,
)
from simple_robots import body, joint, link

from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import RobotBody

pytestmark = every_backend

HULL_M = (0.99, 0.6, 0.6)
HUSKY_KG = 46.0 + 4 * 2.6


def husky(folder) -> RobotBody:
    """57 kg on four wheels, braked by motors that hold 480 N, which is less than friction does."""
    wheels = [(f"wheel{x:+}{y:+}", x, y) for x in (0.256, -0.256) for y in (0.25, -0.25)]
    return body(
        folder,
        link("base", 46.0, " ".join(map(str, HULL_M)), "box", origin=f"0 0 {HULL_M[2] / 2}"),
        *(link(name, 2.6, "0.165", "sphere") for name, _, _ in wheels),
        *(joint(f"to_{name}", "base", name, f"{x} {y} 0.03") for name, x, y in wheels),
        motors=tuple(Motor(f"to_{name}", 20.0) for name, _, _ in wheels),
        ground_links=tuple(name for name, _, _ in wheels),
        hull_friction=0.3,
        ground_links_meet_obstacles=True,
    )


def block(folder, mass_kg: float) -> RobotBody:
    return body(folder, link("block", mass_kg, "1 1 1", "box"), hull_friction=0.3)


@pytest.mark.parametrize("side", [0, 1], ids=["from ahead", "from the side"])
@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_a_walker_does_not_move_a_heavy_robot(backend, speed, side, tmp_path):
    stage = Stage(backend, [plane()], [walker()], robot=husky(tmp_path))
    start, toward = np.eye(4)[side] * 1.2, -np.eye(2)[side]
    stage.place((0.0, 0.0, 0.135), actors=[start])
    stage.step(40)
    height = stage.position[2]
    seen, touched = [], set()
    for _ in range(round(1.6 / (speed * STEP_S))):
        stage.walk(speed * toward)
        touched |= stage.contacts()
        seen.append((*stage.position, stage.rotation[2, 2], np.linalg.norm(stage.velocity)))
    *positions, upright, fastest = np.array(seen).T
    assert touched == {1}
    # 250 N are less than its brakes hold, but a blow shakes it, and servos that brake creep.
    assert np.hypot(*positions[:2]).max() < 0.2
    assert np.abs(positions[2] - height).max() < 0.02
    assert upright.min() > np.cos(np.deg2rad(4.0))
    assert fastest.max() < 0.8
    # It has come to a halt in front of the hull.
    reached = np.abs(stage.actors[0, side] - stage.position[side])
    assert reached == pytest.approx(HULL_M[side] / 2 + 0.25, abs=0.06)


@pytest.mark.parametrize("limit_n", [100.0, 250.0])
def test_a_push_that_does_not_suffice_is_that_of_the_limit(backend, limit_n, tmp_path):
    mass = 1000.0
    person = replace(walker(), max_push_n=limit_n)
    stage = Stage(backend, [], [person], robot=block(tmp_path, mass), gravity_mps2=0.0)
    # Its lower edge is above the rounded end of the capsule: all of the push is horizontal.
    stage.place((0.0, 0.0, 0.9), actors=[[-0.8, 0.0, 0.0, 0.0]])
    for _ in range(10):
        stage.walk((1.0, 0.0))
    before = stage.velocity[0]
    for _ in range(20):
        stage.walk((1.0, 0.0))
    assert stage.velocity[0] - before == pytest.approx(limit_n * 20 * STEP_S / mass, rel=0.05)
    # Until the block is as fast, it is the block that says how fast the two of them go.
    assert stage.actors[0, 0] == pytest.approx(stage.position[0] - 0.75, abs=0.02)
    assert stage.contacts() == {0}


def test_a_strong_robot_pushes_a_walker_away_that_slows_it_down_by_the_limit(backend, tmp_path):
    mass = 1000.0
    stage = Stage(backend, [], [walker()], robot=block(tmp_path, mass), gravity_mps2=0.0)
    stage.place((0.0, 0.0, 0.9), actors=[[1.0, 0.0, 0.0, 0.7]])
    stage.engine.apply_force([mass / (20 * TIMESTEP_S), 0.0, 0.0])
    stage.step(20)
    assert stage.velocity[0] == pytest.approx(1.0, rel=1e-3)
    for _ in range(8):
        stage.walk((0.0, 0.0))
    before = stage.velocity[0]
    for _ in range(20):
        stage.walk((0.0, 0.0))
    assert before - stage.velocity[0] == pytest.approx(250.0 * 20 * STEP_S / mass, rel=0.1)
    x, y, z, yaw, *_ = stage.actors[0]
    assert x == pytest.approx(stage.position[0] + 0.75, abs=0.03)
    assert x > 1.5
    assert (y, z, yaw) == pytest.approx((0.0, 0.0, 0.7), abs=1e-3)


@pytest.mark.parametrize("speed", [0.4, 0.8])
def test_a_walker_moves_a_light_robot_along(backend, speed):
    stage = Stage(backend, [plane()], [walker()])
    stage.place((0.0, 0.0, WHEEL_RADIUS_M), actors=[[0.8, 0.0, 0.0, 0.0]])
    for _ in range(40):
        stage.walk((-speed, 0.0))
    # 108 N of friction are less than the walker's 250 N.
    assert walker().max_push_n > MASS_KG * 9.81
    assert stage.velocity[0] == pytest.approx(-speed, rel=0.1)
    assert stage.actors[0, 0] == pytest.approx(0.8 - speed * 40 * STEP_S, abs=0.15)


def test_bodies_that_touch_no_robot_go_where_they_are_told(backend, tmp_path):
    stage = Stage(backend, [plane(), box((0.0, 2.0), 1.0, 1.0, 1.0)], [walker("a"), walker("b")])
    stage.place(actors=[[0.7, 0.0, 0.0, 0.0], [0.0, 0.9, 0.0, 0.0]])
    assert stage.scene.held_back_poses() is None
    for step in range(1, 11):
        # One walks off, the other into a box: only robots are in its way.
        stage.step(SUBSTEPS, 0.0, [[0.7 + 0.05 * step, 0.0, 0.0, 0.0], [0.0, 0.9 + 0.1 * step, 0.0, 0.0]])
        assert stage.scene.held_back_poses() is None
    stage.step(SUBSTEPS, 0.0, [[0.3, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]])
    held_back = stage.scene.held_back_poses()
    # What was held back is told with all others.
    assert held_back[0, 0] > 0.35
    np.testing.assert_array_equal(held_back[1], [0.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    stage.place()
    assert stage.scene.held_back_poses() is None


@pytest.mark.parametrize("aside", [0.0, 0.03])
def test_a_walker_between_two_robots_stays_between_them(backend, aside):
    company = Company(backend, [rover_body()] * 2, [plane()], [walker()])
    places = [[-1.0, aside, WHEEL_RADIUS_M], [1.0, -aside, WHEEL_RADIUS_M]]
    for robot, place, yaw in zip(company.robots, places, (0.0, np.pi), strict=True):
        robot.set_start_pose(place, quaternion_of(yaw).tolist())
    where = np.zeros((1, 6))
    company.scene.reset(where)
    steps = []
    for _ in range(50):
        for robot in company.robots:
            robot.set_command([8.0] * 4)
        company.step(SUBSTEPS, where)
        reached = company.scene.held_back_poses()
        before, where = where, where if reached is None else reached
        steps.append(np.hypot(*(where - before)[0, :2]))
    # They drive at 1 m/s.
    assert max(steps) < 1.2 * STEP_S
    assert np.hypot(*where[0, :2]) < 1.0
