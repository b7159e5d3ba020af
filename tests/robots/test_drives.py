"""What physics tells of drives, on every backend: angles, speeds and torques of their joints."""

import numpy as np
import pytest
from scenes import (
    GRAVITY_MPS2,
    MASS_KG,
    TIMESTEP_S,
    WHEEL_RADIUS_M,
    Stage,
    every_backend,
    rover_body,
    slope_stage,
)

from dune_rl.robots.rover_zero import RoverZeroConf, RoverZeroDriveConf

# Every test below takes `backend`, or pytest refuses to collect it.
pytestmark = every_backend


def test_wheel_angles_start_at_nothing_and_count_whole_turns(backend):
    stage = Stage(backend)
    for _ in range(2):
        stage.place()
        np.testing.assert_array_equal(stage.wheels, 0.0)
        turned = np.zeros(4)
        for _ in range(400):
            stage.step(1, [6.0, 6.0, 6.0, 6.0])
            turned += stage.wheel_speeds * TIMESTEP_S
        np.testing.assert_allclose(stage.wheel_angles, turned, rtol=0.01)
        assert stage.wheel_angles.min() > 2 * np.pi


@pytest.mark.parametrize("torque", [0.2, 1.0])
def test_the_torque_told_is_the_one_that_speeds_a_wheel_up(backend, torque):
    stage = Stage(
        backend,
        robot=rover_body(
            RoverZeroConf(drive=RoverZeroDriveConf(no_load_speed_radps=None, max_torque_nm=torque))
        ),
    )
    stage.place([0.0, 0.0, 5.0])
    stage.step(10, [500.0, -500.0, 500.0, -500.0])
    np.testing.assert_allclose(stage.wheel_torques, [torque, -torque, torque, -torque], rtol=1e-6)
    # A wheel that turns as fast as told in the air takes nothing.
    stage.place([0.0, 0.0, 50.0])
    stage.step(200, 1.0)
    np.testing.assert_allclose(stage.wheel_torques, 0.0, atol=1e-3)


def test_the_torques_told_hold_a_rover_on_a_slope(backend):
    stage = slope_stage(backend, 0.2, 1.0)
    stage.step(100)
    held = []
    for _ in range(100):
        stage.step(1)
        held.append(stage.wheel_torques.sum())
    weight = MASS_KG * GRAVITY_MPS2 * np.sin(0.2) * WHEEL_RADIUS_M
    assert np.mean(held) == pytest.approx(weight, rel=0.05)
