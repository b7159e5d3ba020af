"""Motors on joints: how much they give at which speed, what holds an angle, and what the battery gives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import (
    GRAVITY_MPS2,
    MASS_KG,
    SUBSTEPS,
    TIMESTEP_S,
    WHEEL_RADIUS_M,
    Stage,
    about,
    every_backend,
    plane,
    quaternion_of,
    rover_body,
)
from simulations import act, every_engine, metric, observation, started_simulation

from dune_rl.env.simulation import VectorSimulation
from dune_rl.physics.motors import Motor, Servos, motor_power_w, servo_targets
from dune_rl.physics.robot_body import Coupling, PassiveJoint, RobotBody
from dune_rl.robots.rover_zero import RoverZeroDriveConf

# A heavy box on the ground with an arm on a hinge, and a second arm beside it.
ARM = """<?xml version="1.0"?><robot name="arm">
<link name="base"><inertial><origin xyz="0.1 0.05 0.2" rpy="0.3 -0.2 0.5"/><mass value="400"/>
<inertia ixx="40" iyy="50" izz="60" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.5"/><geometry><box size="3 3 1"/></geometry></collision></link>
<link name="one"><inertial><origin xyz="0.5 0 0"/><mass value="0.4"/>
<inertia ixx="0.001" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="two"><inertial><origin xyz="0.5 0 0"/><mass value="0.4"/>
<inertia ixx="0.001" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="first" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 2 2"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="100" velocity="100"/></joint>
<joint name="second" type="revolute"><parent link="base"/><child link="two"/><origin xyz="0 -2 2"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="100" velocity="100"/></joint>
</robot>"""
INERTIA = 0.1 + 0.4 * 0.25


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)

    def body(*motors: Motor, **parts: object) -> RobotBody:
        return RobotBody(path, motors, ground_links=(), ground_friction=1.0, hull_friction=1.0, **parts)

    return body


def standing(backend, body: RobotBody) -> Stage:
    stage = Stage(backend, robot=body)
    stage.place([0.0, 0.0, 0.001])
    return stage


def angles(stage: Stage) -> np.ndarray:
    return np.array(stage.engine.joint_angles(("first", "second")))


def test_torque_falls_in_a_straight_line_and_friction_comes_off_it():
    motor = Motor("j", 2.0, no_load_speed_radps=10.0, gear_friction_nm=0.3)
    assert motor.torque_limit_nm(5.0, 0.0) == pytest.approx(1.7)
    assert motor.torque_limit_nm(6.0, 5.0) == pytest.approx(0.7)
    assert motor.torque_limit_nm(-6.0, -5.0) == pytest.approx(0.7)
    assert motor.torque_limit_nm(20.0, 9.9) == 0.0
    # Braking, and holding still, friction helps.
    for target, speed in ((0.0, 5.0), (-3.0, 5.0), (4.0, 5.0), (0.0, 0.0)):
        assert motor.torque_limit_nm(target, speed) == pytest.approx(2.3)


def test_a_servo_goes_for_its_angle_no_faster_than_it_may():
    motor = Motor("j", 1.0, "position", position_gain_per_s=10.0, max_speed_radps=3.0)
    speeds, _ = servo_targets([motor] * 3, [1.0, 1.0, 1.0], [0.0, 0.9, 1.5], [0.0] * 3, TIMESTEP_S)
    np.testing.assert_allclose(speeds, [3.0, 1.0, -3.0])


def test_angles_are_led_to_in_equal_parts_and_speeds_told_at_once():
    motors = [Motor("j", 1.0, "position", position_gain_per_s=10.0, rest_rad=0.5), Motor("k", 1.0)]
    servos = Servos(motors, TIMESTEP_S)
    servos.set_commands([1.3, 7.0], 4)
    led = [servos.targets([0.0, 0.0], [0.0, 0.0])[0] for _ in range(6)]
    np.testing.assert_allclose(led, [[10.0 * angle, 7.0] for angle in (0.7, 0.9, 1.1, 1.3, 1.3, 1.3)])
    # The next way begins where this one has come to, and a new start where the robot is put down.
    servos.set_commands([0.9, -1.0], 2)
    np.testing.assert_allclose(servos.targets([0.0, 0.0], [0.0, 0.0])[0], [11.0, -1.0])
    servos.reset()
    np.testing.assert_allclose(servos.targets([0.0, 0.0], [0.0, 0.0])[0], [5.0, 0.0])


def test_a_rotor_bounds_how_fast_a_speed_changes():
    motor = Motor("j", 1.0, rotor_inertia_kgm2=0.01)
    (target,), _ = servo_targets([motor], [50.0], [0.0], [2.0], TIMESTEP_S)
    assert target == pytest.approx(2.0 + 1.0 * TIMESTEP_S / 0.01)


@every_backend
def test_plain_motors_need_no_look_at_each_physics_step(backend):
    # The same run with a motor that is not plain only in name gives the same.
    found = []
    for no_load in (math.inf, 1e300):
        body = rover_body()
        body = replace(
            body, motors=tuple(replace(motor, no_load_speed_radps=no_load) for motor in body.motors)
        )
        stage = Stage(backend, robot=body)
        stage.place()
        stage.step(100, [4.0, 5.0, 4.0, 5.0])
        found.append(stage.state)
    np.testing.assert_allclose(*found, atol=1e-9)


def test_full_torque_is_there_up_to_its_speed_and_falls_from_there():
    motor = Motor("j", 6.0, full_torque_speed_radps=8.0, no_load_speed_radps=20.0)
    limits = [motor.torque_limit_nm(30.0, speed) for speed in (0.0, 4.0, 8.0, 14.0, 20.0, 25.0)]
    np.testing.assert_allclose(limits, [6.0, 6.0, 6.0, 3.0, 0.0, 0.0], atol=1e-12)
    assert motor.torque_limit_nm(0.0, 14.0) == 6.0
    constant = Motor("j", 6.0, full_torque_speed_radps=8.0)
    assert constant.torque_limit_nm(30.0, 25.0) == 6.0


def test_the_speed_of_full_torque_is_below_that_without_load():
    with pytest.raises(ValueError, match=r"full_torque_speed_radps .* must be less than"):
        RoverZeroDriveConf(full_torque_speed_radps=8.0, no_load_speed_radps=8.0)


@every_backend
def test_a_wheel_without_load_reaches_the_speed_where_friction_takes_all(backend):
    body = rover_body()
    motors = tuple(
        replace(
            motor,
            max_torque_nm=2.0,
            full_torque_speed_radps=0.0,
            no_load_speed_radps=10.0,
            gear_friction_nm=0.5,
        )
        for motor in body.motors
    )
    stage = Stage(backend, robot=replace(body, motors=motors))
    stage.place([0.0, 0.0, 500.0])
    stage.step(600, [50.0, -50.0, 50.0, -50.0])
    np.testing.assert_allclose(np.abs(stage.wheel_speeds), 7.5, rtol=0.02)


@every_backend
def test_a_torque_speed_curve_bends_the_run_up(backend, arm):
    # I dw/dt = stall (1 - w / w0): an exponential.
    stall, top = 0.5, 4.0
    stage = standing(backend, arm(Motor("first", stall, no_load_speed_radps=top)))
    for _ in range(8):
        stage.step(20, [100.0])
        time = 0.0
    time = 160 * TIMESTEP_S
    expected = top * (1 - np.exp(-stall * time / (INERTIA * top)))
    assert stage.wheel_speeds[0] == pytest.approx(expected, rel=0.03)


@every_backend
@pytest.mark.parametrize("stall", [0.5, 500.0])
def test_no_motor_turns_a_joint_beyond_its_no_load_speed(backend, arm, stall):
    stage = standing(backend, arm(Motor("first", stall, no_load_speed_radps=1.0)))
    speeds = []
    for _ in range(40):
        stage.step(5, [100.0])
        speeds.append(stage.wheel_speeds[0])
    assert max(speeds) < 1.05
    assert speeds[-1] > 0.8


@every_backend
def test_a_position_motor_holds_its_angle_against_gravity_and_starts_at_its_rest(backend, arm):
    motors = [
        Motor(joint, 8.0, "position", rest_rad=rest, max_speed_radps=2.0)
        for joint, rest in (("first", 0.4), ("second", -0.3))
    ]
    stage = standing(backend, arm(*motors))
    np.testing.assert_allclose(angles(stage), [0.4, -0.3], atol=1e-9)
    stage.step(40, stage.robot.rest_commands())
    np.testing.assert_allclose(angles(stage), [0.4, -0.3], atol=1e-3)
    stage.step(40, [1.2, -0.3])
    # It takes its way at 2 rad/s, once 8 Nm have got it there, and then stays.
    assert angles(stage)[0] == pytest.approx(0.4 + 2.0 * 0.2 - 2.0**2 / (2 * 8.0 / INERTIA), abs=0.02)
    stage.step(200, [1.2, -0.3])
    np.testing.assert_allclose(angles(stage), [1.2, -0.3], atol=2e-3)


@every_backend
@pytest.mark.parametrize(
    ("friction", "damping", "fallen"),
    [
        (0.0, 0.0, 0.5 * 9.81 * 0.2**2),
        (1.0, 0.0, 0.5 * (9.81 - 1.0 / INERTIA) * 0.2**2),
        (2.5, 0.0, 0.0),
        (0.0, 2.0, 0.981 * (0.2 - 0.1 * (1 - np.exp(-2.0)))),
    ],
)
def test_an_arm_falls_against_friction_and_damping(backend, arm, friction, damping, fallen):
    body = arm(Motor("first", 5.0), passive=(PassiveJoint("second", friction, damping),))
    before, _, after = body.urdf.read_text().rpartition('<axis xyz="0 0 1"/>')
    body.urdf.write_text(f'{before}<axis xyz="0 1 0"/>{after}')
    # Lifted by its base, in place of gravity: to stand on the ground is to land on it, which jerks arms.
    stage = Stage(backend, robot=body, gravity_mps2=0.0)
    stage.place([0.0, 0.0, 20.0])
    stage.engine.apply_force([0.0, 0.0, 9.81 * 400.4])
    stage.step(40, [0.0])
    # Integrators of first order fall half a step farther.
    assert angles(stage)[1] == pytest.approx(fallen, rel=0.05, abs=1e-3)


@every_backend
@pytest.mark.parametrize("ratio", [-1.0, 1.0, 0.5, 2.0])
def test_a_coupling_turns_one_joint_with_the_other(backend, arm, ratio):
    body = arm(
        Motor("first", 5.0),
        passive=(PassiveJoint("second"),),
        couplings=(Coupling("first", "second", ratio),),
    )
    stage = standing(backend, body)
    for _ in range(10):
        stage.step(20, [1.0])
    first, second = angles(stage)
    # Both arms together take 5 Nm a while to get to 1 rad/s.
    assert first == pytest.approx(1.0 - 1.0 / (2 * 5.0 / ((1 + ratio**2) * INERTIA)), abs=0.01)
    assert second == pytest.approx(ratio * first, abs=2e-3)


@every_backend
@pytest.mark.parametrize("ratio", [-1.0, 0.5, 2.0])
def test_a_falling_arm_turns_the_one_that_it_is_coupled_to(backend, arm, ratio):
    body = arm(
        passive=(PassiveJoint("first"), PassiveJoint("second")),
        couplings=(Coupling("first", "second", ratio),),
    )
    before, _, after = body.urdf.read_text().rpartition('<axis xyz="0 0 1"/>')
    body.urdf.write_text(f'{before}<axis xyz="0 1 0"/>{after}')
    stage = Stage(backend, robot=body, gravity_mps2=0.0)
    stage.place([0.0, 0.0, 20.0])
    stage.engine.apply_force([0.0, 0.0, 9.81 * 400.4])
    stage.step(40, [])
    first, second = stage.engine.joint_angles(("first", "second"))
    # What gravity does to the one arm moves both.
    assert second == pytest.approx(0.5 * 9.81 * 0.2**2 / (1 + 1 / ratio**2), rel=0.06)
    assert first == pytest.approx(second / ratio, abs=2e-3)


@every_backend
@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_wheels_on_belts_drive_as_wheels_with_motors_do(backend, slope):
    body = rover_body()
    left, right, *belted = body.drive_joints
    belts = tuple(Coupling(*pair, 1.0) for pair in zip((left, right), belted, strict=True))
    body = replace(body, motors=body.motors[:2], passive=tuple(map(PassiveJoint, belted)), couplings=belts)
    up = np.array([-np.sin(slope), 0.0, np.cos(slope)])
    stage = Stage(backend, [plane(slope)], robot=body)
    stage.place(up * (WHEEL_RADIUS_M + 0.001), quaternion_of(0.0, slope))
    stage.step(40, [4.0, 4.0])
    start = stage.position
    for _ in range(20):
        stage.step(SUBSTEPS, [4.0, 4.0])
        wheels = np.array(stage.engine.joint_angles((left, right, *belted)))
        np.testing.assert_allclose(wheels[2:], wheels[:2], atol=0.02)
    assert np.linalg.norm(stage.position - start) == pytest.approx(4.0 * WHEEL_RADIUS_M, rel=0.03)
    # What holds it on the slope, two motors give.
    assert stage.wheel_torques.sum() == pytest.approx(
        MASS_KG * GRAVITY_MPS2 * np.sin(slope) * WHEEL_RADIUS_M, abs=1.0
    )


@every_backend
def test_what_is_told_is_the_link_s_own_frame_wherever_its_mass_is(backend, arm):
    # In free fall that turns, the centre of mass goes straight and the origin round it.
    stage = Stage(backend, robot=arm(), gravity_mps2=0.0)
    turn = about([0.0, 0.6, 0.8], 0.7)
    stage.place([1.0, 2.0, 30.0], turn)
    np.testing.assert_allclose(stage.position, [1.0, 2.0, 30.0], atol=1e-9)
    np.testing.assert_allclose(np.abs(stage.state[3:7] @ turn), 1.0, atol=1e-9)
    stage.engine.apply_force([4000.0, 0.0, 0.0])
    stage.step(1)
    centre = np.array([0.1, 0.05, 0.2])
    before = stage.position
    velocity = stage.velocity + np.cross(stage.angular, stage.rotation @ centre)
    stage.step(1)
    np.testing.assert_allclose((stage.position - before) / TIMESTEP_S, stage.velocity, atol=2e-3)
    assert velocity[0] == pytest.approx(4000.0 * TIMESTEP_S / 400.8, rel=0.02)


@every_backend
def test_names_that_the_urdf_has_not_are_told(backend, arm):
    for parts in (
        {"passive": (PassiveJoint("third"),)},
        {"couplings": (Coupling("first", "third", 1.0),)},
    ):
        with pytest.raises(Exception, match=r"arm\.urdf has no joint third; it has first, second"):
            standing(backend, arm(**parts))
    with pytest.raises(Exception, match=r"arm\.urdf has no link foot; it has base, one, two"):
        standing(backend, replace(arm(), ground_links=("foot",)))


def test_work_is_what_pushes_and_friction_takes_its_part():
    motors = [Motor("a", 1.0), Motor("b", 1.0, gear_friction_nm=0.25)]
    # Both drive; one brakes, which gives nothing back; held still, nothing is done.
    assert motor_power_w(motors, [2.0, -2.0], [1.0, -1.0]) == pytest.approx(2.0 + 2.5)
    assert motor_power_w(motors, [2.0, -2.0], [-1.0, -1.0]) == pytest.approx(2.5)
    assert motor_power_w(motors, [0.0, 0.0], [3.0, 3.0]) == 0.0


@every_backend
def test_work_told_is_the_energy_that_a_wheel_has(backend):
    stage = Stage(backend, measures_work=True, gravity_mps2=0.0)
    stage.place([0.0, 0.0, 5.0])
    assert stage.engine.work_j() == 0.0
    stage.step(40, [10.0, -10.0, 10.0, -10.0])
    # Left wheels one way and right ones the other: the body stays as it is.
    found = stage.engine.work_j()
    assert found == pytest.approx(4 * 0.5 * 0.01008 * 10.0**2, rel=0.03)
    assert stage.engine.work_j() == 0.0


@pytest.mark.slow(all_but=["dart"])
@every_engine
def test_energy_is_counted_where_it_is_asked_for(engine):
    def driven(**settings) -> VectorSimulation:
        simulation = started_simulation("flat", 2, physics=engine, **settings)
        for _ in range(20):
            act(simulation, [[0.0, 0.0], [0.8, 0.0]])
        return simulation

    measured = driven(metrics={"energy": True})
    standing_wh, driving_wh = metric(measured, "energy_wh")
    idle_w = measured.group().body.robot.description.battery.idle_w
    assert standing_wh == pytest.approx(idle_w * 20 * 0.05 / 3600, rel=0.02)
    # To bring 11 kg to 0.8 m/s alone takes 3.5 J.
    # The wheels' own turning takes a third more of it; a step's start is the dearest.
    assert driving_wh - standing_wh > 3.5 / 0.7 / 3600
    assert driving_wh - standing_wh < 2.5 * 3.5 / 0.7 / 3600
    without = driven()
    assert "energy_wh" not in without.metric_names()
    np.testing.assert_array_equal(observation(without)["lidar"], observation(measured)["lidar"])
