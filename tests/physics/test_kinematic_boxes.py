"""Kinematic boxes stop, push and lean against robots, on every backend."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import (
    BACKENDS,
    HULL_HALF_LENGTH_M,
    STEP_S,
    SUBSTEPS,
    TIMESTEP_S,
    WHEEL_RADIUS_M,
    Company,
    Stage,
    box,
    every_backend,
    plane,
    poses_of,
    rover_body,
    walker,
)
from simple_robots import body, link

from dune_rl.physics.contact_gate import ContactGate
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.shapes import KinematicBox

CAR = KinematicBox("car", length_m=3.0, width_m=1.6, height_m=1.5, clearance_m=0.1, max_push_n=2000.0)


def cube(folder, mass_kg: float, friction: float = 0.0) -> RobotBody:
    return body(folder, link("block", mass_kg, "1 1 1", "box"), hull_friction=friction)


def still(*pose: float) -> list[list[float]]:
    return [[*pose, *[0.0] * (6 - len(pose))]]


def drive(stage: Stage, steps: int, wheel_radps: float, pose: list[list[float]]) -> set[int]:
    """Drive toward a box that stays at `pose`; returns what was touched."""
    touched: set[int] = set()
    for _ in range(steps):
        stage.step(SUBSTEPS, wheel_radps, pose)
        touched |= stage.contacts()
    return touched


@every_backend
@pytest.mark.parametrize("yaw", [0.0, np.pi / 2])
def test_a_robot_that_drives_into_a_parked_box_stops_and_reports_it(backend, yaw):
    stage = Stage(backend, [plane()], [walker(), CAR])
    parked = [[0.0, 9.0], [3.0, 0.0, 0.0, yaw]]
    stage.place(actors=parked)
    assert drive(stage, 20, 8.0, parked) == set()
    assert drive(stage, 50, 8.0, parked) == {2}
    front = (CAR.length_m if yaw == 0.0 else CAR.width_m) / 2
    assert 3.0 - stage.position[0] == pytest.approx(front + HULL_HALF_LENGTH_M, abs=0.06)
    assert abs(stage.velocity[0]) < 0.1
    # It is as good as not moved by a robot that is weaker than it may push.
    held_back = stage.scene.held_back_poses()
    assert held_back is None or np.abs(held_back - poses_of(parked)).max() < 1e-3


def test_a_box_is_at_the_end_of_its_way_in_the_last_physics_step():
    # DART looks for contacts before it moves bodies.
    stage = Stage(BACKENDS["bullet"], [plane()], [CAR])
    touching = HULL_HALF_LENGTH_M + CAR.length_m / 2
    stage.place(actors=still(touching + 0.95))
    # Of 1 m in a control step, the last 5 cm are beyond the robot: a physics step earlier nothing touches.
    stage.step(SUBSTEPS, 0.0, still(touching - 0.05))
    assert stage.contacts() == {1}


@every_backend
def test_a_robot_passes_below_a_box_that_begins_above_it(backend):
    lorry = replace(CAR, clearance_m=0.6, height_m=2.0)
    stage = Stage(backend, [plane()], [lorry])
    parked = still(2.5)
    stage.place(actors=parked)
    assert drive(stage, 120, 8.0, parked) == set()
    assert stage.position[0] > 4.0


@pytest.mark.slow(all_but=["100.0-bullet"])
@every_backend
@pytest.mark.parametrize("limit_n", [100.0, 400.0])
def test_a_box_pushes_with_its_limit_and_no_more(backend, limit_n, tmp_path):
    mass = 1000.0
    ram = replace(CAR, max_push_n=limit_n)
    stage = Stage(backend, [], [ram], robot=cube(tmp_path, mass), gravity_mps2=0.0)
    stage.place((0.0, 0.0, 0.8), actors=still(-2.05))
    for _ in range(10):
        stage.walk((1.0, 0.0))
    before = stage.velocity[0]
    for _ in range(20):
        stage.walk((1.0, 0.0))
    assert stage.velocity[0] - before == pytest.approx(limit_n * 20 * STEP_S / mass, rel=0.05)
    assert stage.actors[0, 0] == pytest.approx(stage.position[0] - 2.0, abs=0.02)
    assert stage.contacts() == {0}


@every_backend
def test_a_box_pushes_a_light_robot_aside(backend):
    stage = Stage(backend, [plane()], [CAR])
    stage.place((0.0, 0.0, WHEEL_RADIUS_M), actors=still(-2.2))
    for _ in range(40):
        stage.walk((1.0, 0.0))
    # The limit is far above the rover's weight.
    assert stage.position[0] == pytest.approx(stage.actors[0, 0] + CAR.length_m / 2 + 0.31, abs=0.1)
    assert stage.actors[0, 0] == pytest.approx(-2.2 + 40 * STEP_S, abs=0.05)


@every_backend
def test_a_box_that_turns_sweeps_a_robot_along(backend, tmp_path):
    bar = replace(CAR, length_m=4.0, width_m=0.4)
    stage = Stage(backend, [], [bar], robot=cube(tmp_path, 20.0), gravity_mps2=0.0)
    stage.place((1.5, 0.75, 0.8), actors=still(0.0))
    for step in range(1, 31):
        stage.step(SUBSTEPS, 0.0, still(0.0, 0.0, 0.0, 0.02 * step))
        held_back = stage.scene.held_back_poses()
        assert held_back is None or np.abs(held_back[0, :2]).max() < 0.05
    assert 0 in stage.contacts() or stage.position[1] > 0.85
    assert stage.velocity[1] > 0.2


@every_backend
def test_a_turn_over_the_seam_of_angles_is_the_short_way(backend, tmp_path):
    bar = replace(CAR, length_m=4.0, width_m=0.4)
    stage = Stage(backend, [], [bar], robot=cube(tmp_path, 20.0), gravity_mps2=0.0)
    # Beside the bar, where a turn the long way would hit.
    stage.place((0.0, 1.0, 0.8), actors=still(0.0, 0.0, 0.0, np.pi - 0.01))
    stage.step(SUBSTEPS, 0.0, still(0.0, 0.0, 0.0, -np.pi + 0.01))
    assert stage.contacts() == set()
    assert np.abs(stage.velocity).max() < 1e-6


@every_backend
def test_a_box_leans_with_the_slope_on_which_it_stands(backend, tmp_path):
    slope = 0.4
    tower = replace(CAR, length_m=1.0, width_m=1.0, height_m=3.0)
    # Where the top of a box is whose nose is down, or that leans to its right.
    away_m, up_m = 2.5 * np.sin(slope) + 0.5 * np.cos(slope) + 0.5 - 0.05, 2.5 * np.cos(slope)
    ahead, right = (away_m, 0.0, up_m), (0.0, -away_m, up_m)
    for place, roll, pitch, touches in (
        (ahead, 0.0, 0.0, False),
        (ahead, 0.0, slope, True),
        (ahead, 0.0, -slope, False),
        (right, -slope, 0.0, False),
        (right, slope, 0.0, True),
    ):
        stage = Stage(backend, [], [tower], robot=cube(tmp_path, 20.0), gravity_mps2=0.0)
        pose = still(0.0, 0.0, 0.0, 0.0, roll, pitch)
        stage.place(place, actors=pose)
        stage.step(SUBSTEPS, 0.0, pose)
        assert stage.contacts() == ({0} if touches else set())


@every_backend
def test_a_rover_stops_at_a_box_that_leans_on_a_slope(backend):
    slope = 0.2
    stage = Stage(backend, [plane(slope)], [CAR])
    up = 3.5
    # Nose up the slope is a negative pitch.
    parked = still(up, 0.0, up * np.tan(slope), 0.0, 0.0, -slope)
    quaternion = [0.0, -np.sin(slope / 2), 0.0, np.cos(slope / 2)]
    stage.place((0.0, 0.0, WHEEL_RADIUS_M / np.cos(slope)), quaternion, actors=parked)
    assert drive(stage, 100, 8.0, parked) == {1}
    along = (up - stage.position[0]) / np.cos(slope)
    assert along == pytest.approx(CAR.length_m / 2 + HULL_HALF_LENGTH_M, abs=0.08)


@every_backend
def test_a_box_is_held_back_by_a_robot_that_is_jammed(backend):
    gentle = replace(CAR, max_push_n=200.0)
    wall = box((1.5, 0.0), 1.0, 4.0, 2.0)
    stage = Stage(backend, [plane(), wall], [gentle])
    start = 1.0 - 2 * HULL_HALF_LENGTH_M - CAR.length_m / 2
    stage.place((1.0 - HULL_HALF_LENGTH_M - 0.02, 0.0, WHEEL_RADIUS_M), actors=still(start - 0.3))
    for _ in range(40):
        stage.walk((1.0, 0.0))
    # It would be 1.7 m farther.
    assert stage.actors[0, 0] == pytest.approx(start, abs=0.1)
    held_back = stage.scene.held_back_poses()
    np.testing.assert_array_equal(held_back[0, 2:], np.zeros(4))
    assert stage.contacts() == {1, 2}


@every_backend
def test_boxes_move_equally_whatever_was_before(backend):
    def run(used: bool) -> list[bytes]:
        company = Company(backend, [rover_body()] * 2, [plane()], [walker(), CAR])
        found: list[bytes] = []
        for _ in range(1 + used):
            found = []
            where = np.zeros((2, 6))
            where[:, 0] = 4.0, -2.4
            company.place([0.0, 0.0, WHEEL_RADIUS_M], [0.0, 1.0, WHEEL_RADIUS_M], actors=where)
            for _ in range(25):
                where = np.add(where, [[-0.02, *[0.0] * 5], [0.05, 0.0, 0.002, 0.02, 0.003, 0.004]])
                company.step(SUBSTEPS, where)
                reached = company.scene.held_back_poses()
                where = where if reached is None else reached
                found += [np.array(robot.body_state()).tobytes() for robot in company.robots]
                found.append(where.tobytes())
        return found

    assert run(used=False) == run(used=True)


def test_the_gate_knows_the_size_of_a_box_that_leans():
    class Puck:
        reach_m, base_mass_kg = 0.5, 10.0

        def planar_motion(self) -> tuple[float, float, float]:
            return 0.0, 0.0, 0.0

        def body_state(self) -> tuple[float, ...]:
            return (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6)

    tower = replace(CAR, length_m=1.0, width_m=1.0, height_m=3.0)
    robot = replace(rover_body(), tyres=())
    for pitch, x, is_near in ((0.0, 1.2, True), (0.0, 2.0, False), (0.4, 2.0, True), (0.4, 3.0, False)):
        pose = still(x, 0.0, 0.0, 0.0, 0.0, pitch)
        gate = ContactGate((), (tower,), [robot])
        assert gate.find_contacts([Puck()], TIMESTEP_S, {}, pose, pose) == ([0] if is_near else [], [is_near])


def test_a_box_without_height_is_refused():
    with pytest.raises(ValueError, match="'car' has no height: it is from clearance_m"):
        replace(CAR, clearance_m=1.5)
