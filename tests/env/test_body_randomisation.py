"""Another body in each episode: heavier, top-heavy, weak, smooth-shod or late, and true to formulae."""

import math
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import tostring

import numpy as np
import pytest
from defusedxml.ElementTree import fromstring
from randomised_scenes import BODIES, drive, equal, make
from robot_fixtures import RoverOnGround, named, slope_world
from scenes import TIMESTEP_S, Backend, Stage, every_backend, rover_body, slope_stage
from scripted_physics import scripted_simulation
from simulations import act, every_engine, metric, motion_of_group, started_simulation

from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, PhysicsError
from dune_rl.env.latency import Latency
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import BodyVariation, read_urdf_body, scale_motors
from dune_rl.robots.leo_rover import LeoRover, LeoRoverConf

ROVER_KG = 11.0


def stage(backend: Backend, variation: BodyVariation, **settings: Any) -> Stage:
    made = Stage(backend, **settings)
    made.engine.set_body(variation)
    return made


@every_backend
def test_a_push_accelerates_the_whole_mass(backend):
    for factor in (0.5, 1.0, 2.0):
        made = stage(backend, BodyVariation(mass_factor=factor), gravity_mps2=0.0)
        made.place([0.0, 0.0, 5.0])
        made.engine.apply_force([30.0, 0.0, 0.0])
        made.step(10, [0.0] * 4)
        assert made.velocity[0] == pytest.approx(30.0 * 10 * TIMESTEP_S / (ROVER_KG * factor), rel=1e-3)


@every_backend
@pytest.mark.parametrize("body", [rover_body(), LeoRover(LeoRoverConf(), 1).body])
def test_the_centre_of_the_whole_robot_moves_and_its_frame_stays(backend, body):
    shift = (-0.02, 0.03, 0.08)
    variation = BodyVariation(centre_shift_b=shift)
    made = stage(backend, variation, robot=body, gravity_mps2=0.0)
    made.place([1.0, 2.0, 5.0])
    np.testing.assert_allclose(made.position, [1.0, 2.0, 5.0], atol=1e-9)
    varied = tostring(read_urdf_body(body.urdf, variation), encoding="unicode")
    before, after = centre_of(body.urdf.read_text()), centre_of(varied)
    np.testing.assert_allclose(after - before, shift, atol=1e-12)


def centre_of(text: str) -> np.ndarray:
    """Centre of mass (3,) in the base's frame of a tree of joints that do not turn their links."""
    root = fromstring(text)
    parent = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    total, moment = 0.0, np.zeros(3)
    for link in root.findall("link"):
        mass = float(link.find("inertial/mass").get("value"))
        place, name = numbers(link.find("inertial/origin")), link.get("name")
        while name in parent:
            joint = parent[name]
            assert (joint.find("origin").get("rpy") or "0 0 0") == "0 0 0"
            place, name = place + numbers(joint.find("origin")), joint.find("parent").get("link")
        total, moment = total + mass, moment + mass * place
    return moment / total


def numbers(origin: Any) -> np.ndarray:
    return np.zeros(3) if origin is None else np.array([float(x) for x in origin.get("xyz").split()])


@every_backend
def test_a_fall_that_turns_goes_round_the_shifted_centre(backend):
    shift = np.array([0.0, 0.0, 0.1])
    made = stage(backend, BodyVariation(centre_shift_b=(0.0, 0.0, 0.1)), gravity_mps2=0.0)
    made.place([0.0, 0.0, 5.0])
    made.engine.apply_force([200.0, 0.0, 0.0])
    made.step(1, [0.0] * 4)
    # The force acts at the base's centre, above that of the whole: the nose goes down, the middle is F t / m.
    assert made.angular[1] > 0.1
    whole = made.velocity + np.cross(made.angular, made.rotation @ shift)
    assert whole[0] == pytest.approx(200.0 * TIMESTEP_S / ROVER_KG, rel=0.02)


@every_backend
@pytest.mark.parametrize("height", [0.0, 0.1])
@pytest.mark.parametrize("beyond", [-0.06, 0.06])
def test_it_tips_where_its_centre_leaves_its_wheels(backend, height, beyond):
    slope = math.atan(0.18 / (0.125 + height)) + beyond
    variation = BodyVariation(centre_shift_b=(0.0, 0.0, height))
    made = slope_stage(backend, slope, 3.0, yaw=math.pi / 2, variation=variation)
    up = made.rotation[:, 2].copy()
    made.step(300)
    assert (made.rotation[:, 2] @ up < math.cos(0.3)) == (beyond > 0.0)


@every_backend
@pytest.mark.parametrize("strength", [0.5, 1.0])
@pytest.mark.parametrize("share", [0.85, 1.15])
def test_half_the_motor_strength_climbs_half_the_slope(backend, strength, share):
    torque = 1.2
    body = rover_body()
    body = replace(body, motors=tuple(replace(motor, max_torque_nm=torque) for motor in body.motors))
    slope = math.asin(share * strength * 4 * torque / 0.125 / (ROVER_KG * 9.81))
    variation = BodyVariation(motor_strength=strength)
    made = slope_stage(backend, slope, 2.0, robot=body, variation=variation)
    before = made.position[0]
    made.step(200, 3.0)
    assert (made.position[0] > before) == (share < 1.0)


def test_less_voltage_is_less_torque_and_less_speed_with_the_same_slope_between():
    full = Motor("j", 2.0, no_load_speed_radps=10.0, gear_friction_nm=0.1)
    (half,) = scale_motors([full], 0.5)
    assert (half.max_torque_nm, half.no_load_speed_radps, half.gear_friction_nm) == (1.0, 5.0, 0.1)
    assert scale_motors([Motor("j", 2.0)], 0.5)[0].is_ideal


@pytest.mark.slow(all_but=["0.4-gravel-bullet"])
@every_backend
@pytest.mark.parametrize("surface", [None, "gravel"])
@pytest.mark.parametrize("factor", [0.4, 1.0])
def test_smooth_tyres_slide_where_others_hold(backend, surface, factor):
    found = None if surface is None else named(surface)
    friction = 1.0 if found is None else found.friction
    for share, slides in ((0.85, False), (1.15, True)):
        rover = RoverOnGround(backend, slope_world(found, math.atan(share * factor * friction)), tyres=factor)
        before = rover.position.copy()
        rover.step(0.0, 20)
        assert (np.linalg.norm(rover.position - before) > 0.1) == slides


@every_backend
def test_a_heavier_rover_rolls_harder(backend):
    held = []
    for load in (1.0, 2.0):
        rover = RoverOnGround(backend, slope_world(named("sand")), load=load)
        rover.step(4.0, 10)
        held.append(float(np.linalg.norm(rover.traction.update([rover.engine], rover.motion))))
    assert held[1] == pytest.approx(2 * held[0], rel=1e-4)


# -- latency ---------------------------------------------------------------------------------------


def test_each_row_has_its_commands_as_late_as_its_delay():
    line = Latency(3, [7.0], control_hz=20)
    line.set_delay(1, 0.1)
    sent = np.arange(1.0, 9.0)
    arrived = []
    for step, value in enumerate(sent):
        if step == 4:
            # A new episode of the last scene, with a longer delay than any before.
            line.set_delay(2, 0.16)
            line.reset(2)
        arrived.append(line.delayed(np.full((3, 1), value))[:, 0])
    got = np.array(arrived).T
    np.testing.assert_array_equal(got[0], sent)
    np.testing.assert_array_equal(got[1], [7, 7, 1, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(got[2], [1, 2, 3, 4, 7, 7, 7, 5])


@pytest.mark.slow
@every_engine
def test_a_rover_starts_as_many_steps_late(engine):
    def run(speed: float) -> np.ndarray:
        simulation = started_simulation(physics=engine, randomisation={"action_latency_s": [0.15, 0.15]})
        seen = []
        for _ in range(5):
            act(simulation, [speed, 0.0])
            seen.append(motion_of_group(simulation).position_w[0].copy())
        simulation.close()
        return np.array(seen)

    same = (run(0.0) == run(1.0)).all(axis=1)
    assert same.tolist() == [True, True, True, False, False]


# -- teams -----------------------------------------------------------------------------------------


def test_all_robots_of_a_scene_have_the_body_that_was_drawn():
    simulation, robots = scripted_simulation(
        "flat",
        2,
        robots=["rover_zero", "rover_zero", "leo_rover"],
        **{"randomisation": BODIES["randomisation"]},
    )
    for scene in range(2):
        drawn = {name: values[scene] for name, values in simulation.randomized.items()}
        for robot in robots[3 * scene : 3 * scene + 3]:
            assert robot.variation.mass_factor == drawn["mass"]
            assert robot.variation.motor_strength == drawn["motor_strength"]
        for group in simulation.groups:
            body = group.body
            rows = slice(scene * group.count, (scene + 1) * group.count)
            assert (body.traction.tyre_factor[rows] == drawn["wheel_friction"]).all()
            assert (body.traction.load_factor[rows] == drawn["mass"]).all()
            assert (body.latency.delays[rows] == round(drawn["action_latency_s"] * 20)).all()
            for name, value in drawn.items():
                told = metric(simulation, f"randomisation/{name}", group.name)[rows]
                np.testing.assert_allclose(told, value, rtol=1e-6)
    assert all(len(set(values.tolist())) == 2 for values in simulation.randomized.values())


# -- the same once more ----------------------------------------------------------------------------


def test_four_scenes_are_four_simulations_of_one_and_each_value_is_told():
    four, one = make(4, **BODIES), make(1, **BODIES)
    four.reset()
    seen = drive(four, [0, 1, 2, 3], 0, 5)
    for scene in range(4):
        one.reseed(5, scene)
        one.reset()
        for found, alone in zip(seen, drive(one, [scene], 0, 5), strict=True):
            for name, values in alone.items():
                assert equal(found[name][scene], values[0]), name
    for name in BODIES["randomisation"]:
        assert len(set(metric(four, f"randomisation/{name}").tolist())) == 4
    four.close()
    one.close()


def test_a_state_comes_back_amid_an_episode():
    simulation, other = make(2, **BODIES), make(2, **BODIES)
    simulation.reset()
    drive(simulation, [0, 1], 0, 4)
    simulation.reset(np.array([False, True]))
    drive(simulation, [0, 3], 4, 3)
    other.restore(simulation.save_state())
    for found, back in zip(drive(simulation, [0, 3], 7, 4), drive(other, [0, 3], 7, 4), strict=True):
        for name, values in found.items():
            assert equal(values, back[name]), name
    simulation.close()
    other.close()


# -- what cannot be --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("mass", [0.0, 1.0], "mass must lie between 0.1 and 10 (got 0 to 1)"),
        ("centre_z_m", [0.0, 2.0], "centre_z_m must lie between -0.5 and 0.5 (got 0 to 2)"),
        ("motor_strength", [-1.0, 1.0], "motor_strength must lie between 0.05 and 5 (got -1 to 1)"),
        ("action_latency_s", [-0.1, 0.1], "action_latency_s must lie between 0 and 1 (got -0.1 to 0.1)"),
    ],
)
def test_what_no_robot_has_is_refused(name, value, message):
    with pytest.raises(ConfigError) as caught:
        compose_environment("flat", (), {"randomisation": {name: value}})
    assert message in str(caught.value)


def test_a_base_that_weighs_nothing_cannot_move_the_centre(tmp_path):
    urdf = tmp_path / "ghost.urdf"
    urdf.write_text(
        '<robot name="ghost"><link name="base"/>'
        '<link name="arm"><inertial><mass value="2"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="base"/><child link="arm"/></joint></robot>'
    )
    with pytest.raises(PhysicsError, match="holds 0 of 2 kg, too little to move"):
        read_urdf_body(urdf, BodyVariation(centre_shift_b=(0.1, 0.0, 0.0)))


def test_meshes_are_found_from_another_folder(tmp_path):
    urdf = tmp_path / "meshed.urdf"
    urdf.write_text(
        '<robot name="meshed"><link name="base"><inertial><mass value="2"/></inertial><visual/>'
        '<collision><geometry><mesh filename="parts/a.stl"/></geometry></collision></link></robot>'
    )
    text = tostring(read_urdf_body(urdf, BodyVariation(mass_factor=2.0)), encoding="unicode")
    assert str(tmp_path / "parts" / "a.stl") in text
    assert "<visual" not in text
    assert 'value="4.0"' in text
