"""Another body in each episode: heavier, top-heavy, weak, smooth-shod or late, and true to formulae for it."""

import hashlib
import math
import os
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from batches import real_batch
from defusedxml.ElementTree import fromstring
from rigs import Rig, named, slope_world
from scenes import TIMESTEP_S, Stage, rover_body, slope_stage
from test_randomisation import drive, make

from dune_rl.config.compose import compose_environment
from dune_rl.env.latency import Latency
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.errors import ConfigError, PhysicsError
from dune_rl.physics.bullet import BulletScene
from dune_rl.physics.motors import Motor
from dune_rl.physics.varied_body import BodyVariation, motors_at, varied_urdf
from dune_rl.robots.leo_rover import LeoRover, LeoRoverConf

ROVER_KG = 11.0
BODIES: dict[str, Any] = {
    "world": "inspection",
    "actors": "none",
    "sensors": {"enabled": ["lidar", "imu", "goal", "velocity", "encoders"]},
    "randomisation": {
        "mass": [0.7, 1.5],
        "centre_x_m": [-0.05, 0.05],
        "centre_z_m": [0.0, 0.1],
        "motor_strength": [0.5, 1.0],
        "wheel_friction": [0.5, 1.0],
        "action_latency_s": [0.0, 0.2],
    },
}


def stage(variation: BodyVariation, **settings: Any) -> Stage:
    made = Stage(BulletScene, **settings)
    made.scene.set_body(variation)
    return made


def test_a_push_accelerates_the_whole_mass():
    for factor in (0.5, 1.0, 2.0):
        made = stage(BodyVariation(mass_factor=factor), gravity_mps2=0.0)
        made.place([0.0, 0.0, 5.0])
        made.scene.push([30.0, 0.0, 0.0])
        made.step(10, [0.0] * 4)
        assert made.velocity[0] == pytest.approx(30.0 * 10 * TIMESTEP_S / (ROVER_KG * factor), rel=1e-3)


@pytest.mark.parametrize("shift", [(0.04, 0.0, 0.0), (-0.02, 0.03, 0.08)])
@pytest.mark.parametrize("body", [rover_body(), LeoRover(LeoRoverConf(), 1).body])
def test_the_whole_robot_s_centre_moves_and_the_frame_stays(body, shift):
    # Pulled aside at the base's own centre a free body turns about that of the whole.
    made = stage(BodyVariation(centre_shift_b=shift), robot=body, gravity_mps2=0.0)
    made.place([1.0, 2.0, 5.0])
    np.testing.assert_allclose(made.position, [1.0, 2.0, 5.0], atol=1e-9)
    np.testing.assert_allclose(centre_of(varied_urdf(body.urdf, made_of(shift))), shift_of(body, shift))


def made_of(shift: tuple[float, float, float]) -> BodyVariation:
    return BodyVariation(centre_shift_b=shift)


def shift_of(body: Any, shift: tuple[float, float, float]) -> np.ndarray:
    return centre_of(body.urdf.read_text()) + shift


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


def test_a_fall_that_turns_goes_round_the_shifted_centre():
    shift = np.array([0.0, 0.0, 0.1])
    own = shift * ROVER_KG / 6.0
    made = stage(BodyVariation(centre_shift_b=(0.0, 0.0, 0.1)), gravity_mps2=0.0)
    made.place([0.0, 0.0, 5.0])
    made.scene.push([200.0, 0.0, 0.0])
    made.step(1, [0.0] * 4)
    # The force acts at the base's centre, above that of the whole: the nose goes down, the middle is F t / m.
    assert made.angular[1] > 0.1
    whole = made.velocity + np.cross(made.angular, made.rotation @ shift)
    assert whole[0] == pytest.approx(200.0 * TIMESTEP_S / ROVER_KG, rel=0.02)
    assert own[2] > shift[2]


@pytest.mark.parametrize("height", [0.0, 0.1, 0.2])
def test_it_tips_where_the_centre_leaves_the_wheels(height):
    # Across the slope, locked and on tyres that do not slip; the centre is 0.125 m and more above the ground.
    def tips(slope: float) -> bool:
        made = slope_stage(
            BulletScene, slope, toward_rad=math.pi / 2, friction=3.0, variation=BodyVariation(centre_shift_b=(0.0, 0.0, height))
        )
        made.step(300, [0.0] * 4)
        return bool(made.rotation[2, 2] < math.cos(slope + 0.3))

    expected = math.atan(0.18 / (0.125 + height))
    assert not tips(expected - 0.06)
    assert tips(expected + 0.06)
