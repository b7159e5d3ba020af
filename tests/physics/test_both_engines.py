"""An environment on either engine: the same episodes, the same senses, and nearly the same drives."""

from typing import Any

import numpy as np
import pytest
from simulations import act, metric, motion_of_group, observation, started_simulation

from dune_rl.physics.interface import ENGINES

SENSES: dict[str, Any] = {
    "enabled": [
        *("camera", "lidar", "lidar_past", "lidar_3d", "depth_strip", "height_scan", "imu", "goal"),
        *("velocity", "encoders", "currents", "position"),
    ],
    "camera": {"width": 12, "height": 8, "outputs": ["rgb", "depth", "segmentation", "normals", "grey"]},
    "lidar_3d": {"n_rings": 3, "n_beams": 24, "outputs": ["range", "intensity", "segmentation"]},
    "realism": {"imu": "bno055", "lidar": "rplidar_a2m8"},
}
ON_WHEELS = {**SENSES, "enabled": [*SENSES["enabled"], "odometry"]}
ROBOTS = {"rover_zero": ON_WHEELS, "leo_rover": ON_WHEELS, "hyperdog": SENSES}
WANDERING: dict[str, Any] = {
    "actors": [{"length_range_m": [3.0, 10.0]}, {"controller": "external", "length_range_m": [3.0, 10.0]}],
    "randomisation": {
        "world_seed": [1, 2, 3],
        "friction": [0.5, 1.0],
        "mass": [0.8, 1.3],
        "action_latency_s": [0.0, 0.1],
    },
}


def robots_of(simulation):
    return [scene.robots[0] for scene in simulation.scenes.built]


@pytest.mark.parametrize("robot", ROBOTS)
def test_episodes_and_senses_do_not_depend_on_the_engine(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    world = {"name": "island", "grass_cover": 0.3}
    settings = {**WANDERING, "robot": robot, "sensors": ROBOTS[robot]}
    bullet, dart = (started_simulation(world, 2, 6, physics=engine, **settings) for engine in ENGINES)
    # Both have settled on their wheels or feet.
    np.testing.assert_allclose(
        motion_of_group(bullet).position_w, motion_of_group(dart).position_w, atol=0.02
    )
    # The one goes where the other does: what is drawn, seen and earned must then agree in each bit.
    for leader, engine in zip(*(robots_of(each) for each in (bullet, dart)), strict=True):
        for told in ("body_state", "drive_state", "contacts"):
            monkeypatch.setattr(engine, told, getattr(leader, told))
    dart.reseed(6)
    dart.reset()
    draws = np.random.default_rng(0)
    low, high = bullet.group().action_bounds
    for step in range(14):
        ahead = draws.uniform(low, high, (2, len(low))).astype(np.float32)
        people = draws.uniform(-1.0, 1.0, (2, 1, 2)).astype(np.float32)
        steps = [act(each, ahead, walker=people).groups for each in (bullet, dart)]
        for group in steps[0]:
            np.testing.assert_array_equal(steps[0][group].reward, steps[1][group].reward)
        np.testing.assert_array_equal(bullet.metrics(), dart.metrics())
        for group in steps[0]:
            found = observation(dart, group)
            for name, expected in observation(bullet, group).items():
                np.testing.assert_array_equal(found[name], expected, err_msg=f"{name}, step {step}")
    assert np.ptp(observation(bullet)["currents"]) > 0.0
    for batch in (bullet, dart):
        batch.close()


# Tyres that grip less sideways are beyond DART.
GRIPPING_LEO = {"name": "leo_rover", "sideways_friction_share": 1.0}


@pytest.mark.parametrize(
    ("robot", "task"), [("rover_zero", "paper"), (GRIPPING_LEO, "point_goal"), ("hyperdog", "dune_code")]
)
def test_the_same_commands_come_to_much_the_same(robot: Any, task: str) -> None:
    found = []
    for engine in ENGINES:
        batch = started_simulation(
            "flat", 4, 6, robot=robot, physics=engine, task=task, metrics={"energy": True}
        )
        start = motion_of_group(batch).position_w.copy()
        speed = 0.7 * batch.group().body.robot.max_speed_mps
        for _ in range(60):
            act(batch, [speed, 0.05])
        assert np.linalg.norm(motion_of_group(batch).position_w - start, axis=1).min() > 0.4
        found.append((motion_of_group(batch).position_w, metric(batch, "return"), metric(batch, "energy_wh")))
        batch.close()
    (here, earned, used), (there, also_earned, also_used) = found
    np.testing.assert_allclose(here, there, atol=0.2)
    np.testing.assert_allclose(earned, also_earned, rtol=0.15, atol=0.5)
    np.testing.assert_allclose(used, also_used, rtol=0.4)
