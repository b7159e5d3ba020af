"""Textbook mechanics in both engines: what happens against what a formula says.

Both engines integrate by semi-implicit Euler: after n steps of h under a
constant acceleration a, speed is exact and the way is a h n (n + 1) / 2, which
is a t h / 2 beyond the parabola. Contact solvers leave what their iterations do
not reach: PyBullet's ten, DART's tyres and soft servos. Each tolerance says
which of these it is for.
"""

import numpy as np
import pytest
from scenes import (
    GRAVITY_MPS2,
    SUBSTEPS,
    TIMESTEP_S,
    Stage,
    about,
    allowed,
    every_backend,
    ground,
    plane_field,
    quaternion_of,
)
from scipy.special import ellipk
from simple_robots import MASS_KG, ball, block, body, cart, joint, link, sled
from simulations import act, every_engine, observation, started_simulation

from dune_rl.config.build import build_robot
from dune_rl.config.compose import compose_environment
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import RobotBody


def on_slope(backend, robot: RobotBody, slope: float, height_m: float, yaw: float = 0.0) -> Stage:
    """A body on a slope, its origin `height_m` off it, in the middle of one large triangle."""
    terrain = plane_field(slope, half=4, spacing_m=5.0)
    stage = Stage(backend, [ground(terrain)], robot=robot)
    quaternion = quaternion_of(yaw, slope)
    foot = np.array([-1.5, -3.5, terrain.height([-1.5, -3.5])])
    stage.place(foot + rotation_matrices(quaternion)[:, 2] * height_m, quaternion)
    return stage


@every_backend
def test_free_fall(backend, tmp_path):
    stage = Stage(backend, robot=block(tmp_path))
    stage.place([0.0, 0.0, 50.0], about([0.6, 0.0, 0.8], 1.0))
    stage.step(200)
    time = 200 * TIMESTEP_S
    # Exact but for rounding, which PyBullet does in single precision.
    np.testing.assert_allclose(stage.velocity, [0.0, 0.0, -GRAVITY_MPS2 * time], atol=1e-5)
    fallen = GRAVITY_MPS2 * time * (time + TIMESTEP_S) / 2
    np.testing.assert_allclose(stage.position, [0.0, 0.0, 50.0 - fallen], atol=1e-4)


@every_backend
def test_a_push_gives_momentum(backend, tmp_path):
    stage = Stage(backend, robot=block(tmp_path), gravity_mps2=0.0)
    stage.place([0.0, 0.0, 5.0])
    force = np.array([3.0, -4.0, 5.0])
    stage.engine.apply_force(force.tolist())
    stage.step(20)
    # Impulse over mass, exact but for rounding; at the centre of mass it turns nothing.
    np.testing.assert_allclose(stage.velocity, force * 20 * TIMESTEP_S / MASS_KG, atol=1e-6)
    np.testing.assert_allclose(stage.angular, 0.0, atol=1e-6)
    before = stage.velocity
    stage.step(100)
    np.testing.assert_allclose(stage.velocity, before, atol=1e-6)


@every_backend
def test_a_projectile_flies_a_parabola(backend, tmp_path):
    stage = Stage(backend, robot=block(tmp_path))
    stage.place([0.0, 0.0, 50.0])
    stage.engine.apply_force([120.0, 0.0, 160.0])
    stage.step(20)
    start, speed = stage.position, stage.velocity
    stage.step(200)
    time = 200 * TIMESTEP_S
    gravity = np.array([0.0, 0.0, -GRAVITY_MPS2])
    # The integrator's own way beyond the parabola is in it; what is left is rounding.
    expected = start + speed * time + gravity * time * (time + TIMESTEP_S) / 2
    np.testing.assert_allclose(stage.position, expected, atol=1e-3)


@every_backend
@pytest.mark.parametrize("degrees", [20.0, 70.0])
def test_a_pendulum_keeps_its_energy_and_its_period(backend, tmp_path, degrees):
    # A rod's end on a base 10,000 times as heavy; at angle 0 it hangs `degrees` off the plumb line.
    length, start = 0.5, np.deg2rad(degrees)
    robot = body(
        tmp_path,
        link("base", 10_000.0, "2 2 0.5", "box"),
        link("arm", 1.0, "0.02", "sphere"),
        joint("hinge", "base", "pivot", "0 1.5 2", rpy=f"0 {-start} 0"),
        '<link name="pivot"><inertial><mass value="1e-3"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" '
        'ixy="0" ixz="0" iyz="0"/></inertial></link>',
        joint("rod", "pivot", "arm", f"0 0 {-length}", kind="fixed"),
    )
    stage = Stage(backend, robot=robot)
    stage.place([0.0, 0.0, 0.25])
    angles = []
    for _ in range(1200):
        stage.step(1)
        angles.append(stage.engine.joint_angles(["hinge"])[0] - start)
    angles = np.array(angles)
    # Amplitudes of first and last swings: energy goes with 1 - cos. Euler's semi-implicit step loses none
    # on the average; its amplitude swings by angular frequency x step / 2 = 1 %, energy by twice that.
    late = angles[-400:]
    energies = 1 - np.cos([np.abs(angles[:400]).max(), np.abs(late).max()])
    assert energies[0] == pytest.approx(1 - np.cos(start), rel=0.04)
    assert energies[1] == pytest.approx(energies[0], rel=0.04)
    crossings = np.flatnonzero(np.signbit(angles[1:]) != np.signbit(angles[:-1]))
    period = 2 * np.diff(crossings).mean() * TIMESTEP_S
    inertia_over_mass = length**2 + 0.4 * 0.02**2
    expected = 4 * np.sqrt(inertia_over_mass / (GRAVITY_MPS2 * length)) * ellipk(np.sin(start / 2) ** 2)
    # A step is 0.4 % of the period, and averages out over several.
    assert period == pytest.approx(expected, rel=0.01)


@every_backend
@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_a_sled_slides_on_a_slope_iff_it_exceeds_friction(backend, tmp_path, friction):
    # Straight down the slope: along an axis of the world a friction pyramid is exact.
    for share, slides in ((0.95, False), (1.05, True)):
        slope = np.arctan(share * friction)
        stage = on_slope(backend, sled(tmp_path, friction, 0.2, 0.05), slope, 0.0505)
        stage.step(100)
        before, place = np.linalg.norm(stage.velocity), stage.position
        stage.step(100)
        pull = GRAVITY_MPS2 * (np.sin(slope) - friction * np.cos(slope))
        gained = np.linalg.norm(stage.velocity) - before
        if slides:
            # What the solver does not reach is a few thousandths of the weight, here of a difference.
            assert gained / (100 * TIMESTEP_S) == pytest.approx(pull, rel=0.1)
        else:
            # Creep of the solver, millimetres a second.
            assert np.linalg.norm(stage.position - place) < 4e-3


@every_backend
@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_wheels_that_grip_less_along_their_axles_slide_across_a_slope_and_hold_along_it(
    backend, tmp_path, shape
):
    friction, share = 0.8, 0.4
    robot = cart(tmp_path, friction, 0.3, 0.1, shape, sideways_friction_share=share)
    for yaw, limit in ((np.pi / 2, share * friction), (0.0, friction)):
        for part, slides in ((0.93, False), (1.2, True)):
            slope = np.arctan(part * limit)
            stage = on_slope(backend, robot, slope, 0.1005, yaw)
            stage.step(60)
            before, place = stage.velocity, stage.position
            stage.step(60)
            if slides:
                pull = GRAVITY_MPS2 * (np.sin(slope) - limit * np.cos(slope))
                gained = np.linalg.norm(stage.velocity - before) / (60 * TIMESTEP_S)
                # In DART, balls that slide along their axles have to be set rolling: a sixteenth.
                assert gained == pytest.approx(pull, rel=0.15)
            else:
                # Creep of servos that brake, and of the solver.
                assert np.linalg.norm(stage.position - place) < 2e-2


@every_backend
@pytest.mark.parametrize("slope", [0.1, 0.3])
def test_a_ball_rolls_down_without_slipping(backend, tmp_path, slope):
    radius = 0.1
    stage = on_slope(backend, ball(tmp_path, radius), slope, radius)
    stage.step(100)
    before = np.linalg.norm(stage.velocity)
    stage.step(100)
    speed = np.linalg.norm(stage.velocity)
    # m r² 2/5 of inertia takes two sevenths of the pull; 2 %: contact normals on a mesh are that good.
    expected = GRAVITY_MPS2 * np.sin(slope) / (1 + 2 / 5)
    assert (speed - before) / (100 * TIMESTEP_S) == pytest.approx(expected, rel=0.02)
    assert np.linalg.norm(stage.angular) * radius == pytest.approx(speed, rel=0.02)


@every_backend
@pytest.mark.parametrize("friction", [0.4, 0.8])
def test_a_stop_takes_v_squared_over_two_mu_g(backend, tmp_path, friction):
    stage = on_slope(backend, sled(tmp_path, friction, 0.2, 0.05), 0.0, 0.05)
    stage.engine.apply_force([10.0 * MASS_KG * GRAVITY_MPS2, 0.0, 0.0])
    stage.step(6)
    start, speed = stage.position[0], stage.velocity[0]
    stage.step(200)
    assert speed > 2.0
    # The last step's way is v h / 2 long; 3 %: the push also rocks the sled a little.
    distance = speed**2 / (2 * friction * GRAVITY_MPS2)
    assert stage.position[0] - start == pytest.approx(distance, rel=0.03, abs=speed * TIMESTEP_S)
    # PyBullet's ten iterations leave millimetres a second.
    assert np.linalg.norm(stage.velocity) < 4e-3


@every_backend
@pytest.mark.parametrize("turn", [1.0, 3.0])
def test_a_differential_drive_turns_with_the_radius_v_over_omega(backend, tmp_path, turn):
    # Two wheels on one axle and a caster without friction: nothing has to slip.
    radius, track = 0.1, 0.5
    robot = body(
        tmp_path,
        link("base", 5.0, "0.3", "sphere", origin="0 0 2"),
        link("caster", 0.5, "0.1", "sphere"),
        joint("mount", "base", "caster", "-0.3 0 0", kind="fixed"),
        *(link(f"{side}_wheel", 0.5, str(radius), "sphere") for side in ("left", "right")),
        joint("left", "base", "left_wheel", f"0 {track / 2} 0"),
        joint("right", "base", "right_wheel", f"0 {-track / 2} 0"),
        motors=(Motor("left", 5.0), Motor("right", 5.0)),
        ground_links=("left_wheel", "right_wheel"),
        hull_friction=0.0,
    )
    stage = Stage(backend, robot=robot)
    stage.place([0.0, 0.0, radius + 0.001])
    wheels = [6.0 - turn, 6.0 + turn]
    for _ in range(20):
        stage.step(10, wheels)
    rate = 2 * turn * radius / track
    track_points = []
    for _ in range(round(2 * np.pi / rate / (10 * TIMESTEP_S))):
        track_points.append(stage.position[:2])
        stage.step(10, wheels)
    # 3 %: servos lag, and a point contact of ten iterations creeps, by a percent each.
    width, height = np.ptp(track_points, axis=0)
    expected = 6.0 * radius / rate
    np.testing.assert_allclose([width / 2, height / 2], expected, rtol=0.03)
    assert stage.angular[2] == pytest.approx(rate, rel=0.03)


@every_backend
def test_a_cart_tips_when_its_centre_of_mass_leaves_its_base(backend, tmp_path):
    # Four degrees either side, as tyres of one engine lean by one. 10 kg are 0.3 m up, wheels of
    # 2 kg 0.05 m.
    centre = (10.0 * 0.3 + 2.0 * 0.05) / 12.0
    tipping = np.arctan(0.2 / centre)
    for off, tips in ((-4.0, False), (4.0, True)):
        slope = tipping + np.deg2rad(off)
        stage = on_slope(backend, cart(tmp_path, 1.5, 0.2, 0.3), slope, 0.3, np.pi / 2)
        upright = stage.rotation[:, 2]
        stage.step(300)
        leaning = np.arccos(np.clip(stage.rotation[:, 2] @ upright, -1.0, 1.0))
        assert (leaning > 0.3) == tips


@every_backend
@pytest.mark.parametrize("groove", [0.2, 0.5])
def test_a_ball_in_a_groove_lies_at_the_height_that_geometry_says(backend, tmp_path, groove):
    radius, places = 0.15, np.arange(-4, 4.5)
    heights = np.tile(np.tan(groove) * np.abs(places), (len(places), 1))
    stage = Stage(backend, [ground(HeightField(heights, 1.0, (-4.0, -4.0)))], robot=ball(tmp_path, radius))
    height = radius / np.cos(groove)
    stage.place([0.0, 0.2, height + 0.002])
    stage.step(600)
    # Contacts sink by what their solvers allow: a millimetre.
    assert stage.position[2] == pytest.approx(height, abs=1e-3)
    assert stage.position[0] == pytest.approx(0.0, abs=2e-3)


@pytest.mark.slow
@every_engine
def test_an_inertial_unit_at_rest_feels_gravity(engine):
    simulation = started_simulation("flat", 2, physics=engine)
    felt = []
    for _ in range(30):
        act(simulation)
        felt.append(observation(simulation)["imu"][:, :3])
    simulation.close()
    # After a landing; what is left is the creep of brakes that are servos.
    np.testing.assert_allclose(np.mean(felt[15:], axis=(0, 1)), [0.0, 0.0, GRAVITY_MPS2], atol=0.02)


@pytest.mark.slow(all_but=["rover_zero-0.129-bullet", "leo_rover-0.005-dart"])
@every_backend
@pytest.mark.parametrize(
    ("name", "top_m"), [("rover_zero", 0.129), ("leo_rover", 0.005), ("hyperdog", 0.035)]
)
def test_a_robot_on_its_back_lies_still(backend, name, top_m):
    robot = build_robot(compose_environment("flat", [f"robot={name}"]).robot, 1).body
    stage = Stage(backend, robot=robot)
    # Engines hold boxes up to a millimetre off triangles, or let them in by as much. What has come down hard
    # has gone in, and DART has it out by a millimetre a second.
    for x, y, drop_m, off_m in ((0.3, 0.2, 0.02, 1.2e-3), (0.0, 0.0, 0.2, allowed(backend, 1.2e-3, 0.015))):
        stage.place((x, y, top_m + drop_m), (1.0, 0.0, 0.0, 0.0))
        for _ in range(200):
            stage.step(SUBSTEPS, robot.rest_commands())
        assert stage.position[2] == pytest.approx(top_m, abs=off_m)
        np.testing.assert_allclose(stage.position[:2], (x, y), atol=0.02)
        np.testing.assert_allclose(stage.state[7:], 0.0, atol=6e-3)
