"""Physics against formulae, on every backend."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scenes import (
    GRAVITY_MPS2,
    HULL_HALF_LENGTH_M,
    HULL_HALF_WIDTH_M,
    STEP_S,
    TIMESTEP_S,
    WHEEL_RADIUS_M,
    Stage,
    about,
    allowed,
    box,
    every_backend,
    ground,
    mixed_stage,
    plane,
    plane_field,
    quaternion_of,
    rollout,
    rover_body,
    rover_without_tyres,
    slope_stage,
    walker,
    with_joints,
)

from dune_rl.core.errors import PhysicsError
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.physics.interface import PhysicsConf, SceneSpec, step_scene
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf, RoverZeroDriveConf

# Every test below takes `backend`, or pytest refuses to collect it.
pytestmark = every_backend

FAR_AWAY = [15.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("gravity", [GRAVITY_MPS2, 1.62])
def test_free_fall(backend, gravity):
    stage = Stage(backend, gravity_mps2=gravity)
    stage.place([0.0, 0.0, 5.0], about([0.6, 0.0, 0.8], 1.0))
    upright = stage.rotation
    stage.step(100)
    time = 100 * TIMESTEP_S
    np.testing.assert_allclose(stage.velocity, [0.0, 0.0, -gravity * time], atol=1e-6)
    # Integrators of first order are one step's worth of speed off the parabola, no more.
    assert 5.0 - stage.position[2] == pytest.approx(gravity * time**2 / 2, abs=gravity * time * TIMESTEP_S)
    np.testing.assert_allclose(stage.position[:2], 0.0, atol=1e-6)
    np.testing.assert_allclose(stage.rotation, upright, atol=1e-6)


@pytest.mark.parametrize("torque", [0.2, 1.0])
def test_a_drive_gives_the_torque_it_may_and_no_more(backend, torque):
    # Off the ground, a drive turns its wheel one way and the body the other.
    stage = Stage(
        backend,
        robot=rover_body(
            RoverZeroConf(drive=RoverZeroDriveConf(max_torque_nm=torque, no_load_speed_radps=None))
        ),
    )
    stage.place([0.0, 0.0, 5.0])
    stage.step(10, 500.0)
    body_inertia = 0.1088 + 1.25 * (RoverZero.description.contact_centres_b[:, 0] ** 2).sum()
    expected = torque / 0.01008 + 4 * torque / body_inertia
    np.testing.assert_allclose(stage.wheel_speeds / (10 * TIMESTEP_S), expected, rtol=0.02)


@pytest.mark.parametrize(
    ("slope", "toward", "yaw"), [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.3, 0.7, 1.1), (0.35, -2.0, 0.4)]
)
def test_a_rover_at_rest_stands_on_the_terrain(backend, slope, toward, yaw):
    terrain = plane_field(slope, toward)
    stage = Stage(backend, [ground(terrain)])
    quaternion = quaternion_of(yaw, slope, toward)
    up = rotation_matrices(quaternion)[:, 2]
    stage.place(up * (WHEEL_RADIUS_M + 0.003), quaternion)
    stage.step(200)
    normal = terrain.normal([0.0, 0.0])
    contacts = (
        stage.position + RoverZero.description.contact_centres_b @ stage.rotation.T - WHEEL_RADIUS_M * normal
    )
    # DART's tyres give by up to a millimetre, and it takes seconds to undo what a landing left.
    np.testing.assert_allclose(
        contacts[:, 2], terrain.height(contacts[:, :2]), atol=allowed(backend, 1e-3, 1.6e-3)
    )
    assert stage.rotation[:, 2] @ normal == pytest.approx(1.0, abs=allowed(backend, 1e-6, 1e-5))
    # Brakes are servos, which give way by millimetres a second.
    assert np.linalg.norm(stage.velocity) < 0.02


@pytest.mark.parametrize("heading", [0.0, np.pi], ids=["uphill", "downhill"])
@pytest.mark.parametrize("friction", [0.3, 0.6, 0.9])
def test_locked_wheels_slide_iff_the_slope_exceeds_friction(backend, friction, heading):
    # 5 % either side of tan(theta) = mu: a friction pyramid is exact along its axes, hence the two
    # headings; what is left is the iterations that the solver does not take. Wheels have friction 1, so
    # that engines that multiply the two coefficients and those that take the lesser agree.
    for share, slides in ((0.95, False), (1.05, True)):
        slope = np.arctan(share * friction)
        stage = slope_stage(backend, slope, friction, heading)
        stage.step(100)
        position, speed = stage.position, np.linalg.norm(stage.velocity)
        stage.step(100)
        # Between creep with no acceleration and sliding lies a factor of three at the least.
        slid = np.linalg.norm(stage.position - position)
        assert (slid > 0.035) if slides else (slid < 0.012)
        assert (np.linalg.norm(stage.velocity) > speed + 0.02) == slides


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_a_slide_is_as_fast_as_friction_lets_it(backend, friction):
    slope = np.arctan(1.3 * friction)
    stage = slope_stage(backend, slope, friction)
    stage.step(40)
    speed = np.linalg.norm(stage.velocity)
    stage.step(80)
    acceleration = (np.linalg.norm(stage.velocity) - speed) / (80 * TIMESTEP_S)
    expected = GRAVITY_MPS2 * (np.sin(slope) - friction * np.cos(slope))
    assert acceleration == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("wheel_friction", [0.4, 0.8])
def test_wheel_friction_counts_like_the_ground_s(backend, wheel_friction):
    body = rover_body(RoverZeroConf(wheel_friction=wheel_friction))
    stage = slope_stage(backend, 0.5, 1.0, robot=body)
    stage.step(40)
    speed = np.linalg.norm(stage.velocity)
    stage.step(60)
    acceleration = (np.linalg.norm(stage.velocity) - speed) / (60 * TIMESTEP_S)
    expected = max(0.0, GRAVITY_MPS2 * (np.sin(0.5) - wheel_friction * np.cos(0.5)))
    assert acceleration == pytest.approx(expected, rel=0.1, abs=0.01)


@pytest.mark.parametrize("wheels", [2.0, 5.0, -5.0, 8.0])
def test_rolling_wheels_give_speed_omega_r(backend, wheels):
    stage = Stage(backend)
    stage.place()
    stage.step(100, wheels)
    start = stage.position[0]
    stage.step(200, wheels)
    assert stage.position[0] - start == pytest.approx(wheels * WHEEL_RADIUS_M, rel=0.01)
    np.testing.assert_allclose(stage.wheel_speeds, wheels, rtol=0.01)


def test_wheels_are_commanded_in_the_order_of_their_names(backend):
    stage = Stage(backend)
    stage.place([0.0, 0.0, 5.0])
    stage.step(40, [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(stage.wheel_speeds, [1.0, 2.0, 3.0, 4.0], atol=0.01)
    turned = with_joints(stage.robot, *stage.robot.drive_joints[::-1])
    stage = Stage(backend, robot=turned)
    stage.place()
    stage.step(100, [4.0, -4.0, 4.0, -4.0])
    # Reversed, the first is a right wheel: the rover turns left.
    assert stage.angular[2] > 0.5


def test_a_walker_stops_a_rover_and_is_touched(backend):
    stage = Stage(backend, [plane(), box((5.0, 5.0), 1.0, 1.0, 1.0)], [walker("bystander"), walker("wall")])
    stage.place(actors=[FAR_AWAY, [1.0, 0.0, 0.0, 0.0]])
    touched = []
    for _ in range(40):
        stage.step(10, 0.6 / WHEEL_RADIUS_M)
        touched.append(stage.contacts())
    arrival = 1.0 - 0.25 - HULL_HALF_LENGTH_M
    # People are soft: PyBullet's give by 5 mm.
    assert stage.position[0] == pytest.approx(arrival, abs=0.015)
    assert stage.position[1] == pytest.approx(0.0, abs=0.02)
    assert touched[0] == set()
    # Statics are numbered first: terrain 0, box 1, then the walkers 2 and 3.
    assert touched[-1] == {3}


def test_a_walker_pushes_a_rover_at_its_speed(backend):
    stage = Stage(backend, kinematics=[walker()])
    stage.place(actors=[[1.0, 0.0, 0.0, 0.0]])
    for step in range(1, 41):
        stage.step(10, 0.0, [[1.0 - 0.5 * STEP_S * step, 0.0, 0.0, 0.0]])
    assert stage.contacts() == {1}
    assert stage.position[0] == pytest.approx(0.0 - 0.25 - HULL_HALF_LENGTH_M, abs=0.04)
    assert stage.velocity[0] == pytest.approx(-0.5, abs=0.05)


def test_a_walker_moves_through_a_step_and_does_not_jump(backend):
    # It ends where it touches nothing; only on its way, through where the rover stands, is the rover. By its
    # tyres, pushed from the side, a rover would jam between the walker and the ground.
    stage = Stage(backend, kinematics=[walker()], robot=rover_without_tyres())
    stage.place(actors=[[0.0, -0.6, 0.0, 0.0]])
    stage.step(300, 0.0, [[0.0, 0.6, 0.0, 0.0]])
    assert stage.position[1] == pytest.approx(0.6 + 0.25 + HULL_HALF_WIDTH_M, abs=0.2)


def test_a_walker_stands_on_the_ground_under_it(backend):
    # One that floats a metre up lets the rover, 0.25 m high, pass beneath.
    stage = Stage(backend, kinematics=[walker()])
    stage.place(actors=[[1.0, 0.0, 0.3, 0.0]])
    for _ in range(60):
        stage.step(10, 0.6 / WHEEL_RADIUS_M)
    assert stage.contacts() == set()
    assert stage.position[0] > 1.5


def test_a_prop_stops_a_rover_and_is_touched(backend):
    stage = Stage(backend, [plane(), box((3.0, 3.0), 1.0, 1.0, 1.0), box((1.0, 0.0), 0.4, 4.0, 1.0)])
    stage.place()
    for _ in range(40):
        stage.step(10, 0.6 / WHEEL_RADIUS_M)
    assert stage.position[0] == pytest.approx(0.8 - HULL_HALF_LENGTH_M, abs=0.02)
    assert stage.contacts() == {2}
    stage.place()
    assert stage.contacts() == set()


def test_what_may_be_driven_on_is_not_touched(backend):
    deck = box((0.0, 0.0), 2.0, 2.0, 0.05, drivable=True)
    stage = Stage(backend, [plane(), deck, box((0.0, 4.0), 1.0, 1.0, 1.0)])
    stage.place([0.0, 0.0, 0.2])
    stage.step(100)
    assert stage.position[2] == pytest.approx(0.05 + WHEEL_RADIUS_M, abs=2e-3)
    assert stage.contacts() == set()


def test_a_hull_on_the_ground_rests_there_untouched(backend):
    stage = Stage(backend)
    stage.place([0.0, 0.0, 0.3], about([1, 0, 0], np.pi))
    stage.step(200)
    # Upside down it stands on its lid, 0.129 m from the chassis centre.
    assert stage.position[2] == pytest.approx(0.129, abs=2e-3)
    assert stage.contacts() == set()


def test_walkers_take_no_notice_of_ground_and_props(backend):
    stage = Stage(backend, [plane(), box((3.0, 0.0), 1.0, 1.0, 1.0)], [walker()])
    stage.place(actors=[[3.0, 0.0, -0.5, 0.0]])
    stage.step(50)
    assert stage.contacts() == set()


def test_no_trace_is_left_by_what_was_before(backend):
    stage = mixed_stage(backend)
    first = rollout(stage)
    for number in range(1, 4):
        stage.step(7 * number, [9.0, -3.0, 1.0, 4.0], [[0.2, 0.1 * number, 0.0, 0.0]])
        assert rollout(stage) == first
    assert rollout(mixed_stage(backend)) == first


def test_scenes_leave_each_other_alone(backend):
    alone = rollout(mixed_stage(backend))
    other = Stage(backend, [plane(0.1), box((1.0, 0.0), 0.4, 4.0, 1.0)], [walker(), walker()])
    other.place()
    assert rollout(mixed_stage(backend), after=lambda: other.step(3, [3.0, -1.0, 2.0, 5.0])) == alone
    # Nor does it matter that others begin anew.
    assert rollout(mixed_stage(backend), after=other.place) == alone


@pytest.mark.slow
def test_another_process_gives_the_same_bytes(backend):
    code = f"import scenes; scenes.print_rollout({backend.__module__!r}, {backend.__qualname__!r})"
    told = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:] = {sys.path!r}; {code}"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout.split()[-1] == rollout(mixed_stage(backend))


def test_a_joint_that_the_robot_has_not_is_named(backend):
    body = with_joints(rover_body(), "front_left_wheel_joint", "sail_joint")
    with pytest.raises(PhysicsError, match=r"has no joint sail_joint; it has front_left_wheel_joint"):
        Stage(backend, robot=body).place()


def test_a_robot_that_is_not_there_is_named(backend, tmp_path):
    with pytest.raises(PhysicsError, match=r"nowhere\.urdf"):
        Stage(backend, robot=replace(rover_body(), urdf=tmp_path / "nowhere.urdf")).place()


def test_closing_twice_is_harmless(backend):
    stage = Stage(backend)
    stage.place()
    stage.scene.close()
    stage.scene.close()


def test_a_control_rate_that_does_not_divide_is_refused(backend):
    with pytest.raises(ValueError, match=r"30 does not divide 200"):
        PhysicsConf(control_hz=30)
    assert PhysicsConf(physics_hz=240, control_hz=24).substeps == 10


def test_a_scene_without_robots_steps(backend):
    spec = SceneSpec((plane(),), (walker(),), (), timestep_s=TIMESTEP_S, solver_iterations=10)
    scene = backend(spec)
    assert (len(scene.robots), spec.robot_number(0)) == (0, 2)
    scene.reset(np.zeros((1, 6)))
    step_scene(scene, 10, np.array([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    scene.step_passive(2)
    scene.close()
