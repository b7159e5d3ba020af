"""An environment on either engine: the same episodes, the same senses, and nearly the same drives."""

from typing import Any

import numpy as np
import pytest
from simulations import act, metric, metrics, motion_of_group, observation, started_simulation

from dune_rl.physics.interface import OWN_ENGINES

SENSES: dict[str, Any] = {
    "enabled": [
        *("camera", "lidar", "lidar_past", "lidar_3d", "depth_strip", "height_scan", "imu", "goal"),
        *("velocity", "encoders", "currents", "position"),
    ],
    "camera": {"width": 12, "height": 8, "outputs": ["rgb", "depth", "segmentation", "normals", "grey"]},
    "lidar_3d": {"n_rings": 3, "n_beams": 24, "outputs": ["range", "intensity", "segmentation"]},
    "imu": {"realism": "bno055"},
    "lidar": {"realism": "rplidar_a2m8"},
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


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_episodes_and_senses_do_not_depend_on_the_engine(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    world = {"name": "island", "grass_cover": 0.3}
    settings = {**WANDERING, "robot": robot, "sensors": ROBOTS[robot]}
    bullet, dart = (started_simulation(world, 2, 6, physics=engine, **settings) for engine in OWN_ENGINES)
    # Both have settled on their wheels or feet.
    np.testing.assert_allclose(
        motion_of_group(bullet).position_w, motion_of_group(dart).position_w, atol=0.02
    )
    # The one goes where the other does: what is drawn, seen and earned must then agree in each bit.
    for scene in range(2):
        (leader,), (follower,) = bullet.scenes.robots(scene), dart.scenes.robots(scene)
        for name in ("body_state", "drive_state", "contacts"):
            monkeypatch.setattr(follower, name, getattr(leader, name))
    dart.reseed(6)
    dart.reset()
    draws = np.random.default_rng(0)
    low, high = bullet.group().action_bounds
    for step in range(14):
        ahead = draws.uniform(low, high, (2, len(low)))
        people = draws.uniform(-1.0, 1.0, (2, 1, 2))
        one, other = (act(simulation, ahead, walker=people) for simulation in (bullet, dart))
        for name, expected in one.groups.items():
            np.testing.assert_array_equal(other.groups[name].reward, expected.reward)
            np.testing.assert_array_equal(metrics(dart, name), metrics(bullet, name))
            found = observation(dart, name)
            for part, value in observation(bullet, name).items():
                np.testing.assert_array_equal(found[part], value, err_msg=f"{name} {part}, step {step}")
    assert np.ptp(observation(bullet)["currents"]) > 0.0
    for simulation in (bullet, dart):
        simulation.close()


# Tyres that grip less sideways are beyond DART.
GRIPPING_LEO = {"name": "leo_rover", "sideways_friction_share": 1.0}


@pytest.mark.slow(all_but=["robot1-point_goal"])
@pytest.mark.parametrize(
    ("robot", "task"), [("rover_zero", "paper"), (GRIPPING_LEO, "point_goal"), ("hyperdog", "dune_code")]
)
def test_the_same_commands_come_to_much_the_same(robot: Any, task: str) -> None:
    found = []
    for engine in OWN_ENGINES:
        settings = {"robot": robot, "physics": engine, "task": task, "metrics": {"energy": True}}
        simulation = started_simulation("flat", 4, 6, **settings)
        start = motion_of_group(simulation).position_w.copy()
        speed = 0.7 * simulation.group().body.robot.description.max_speed_mps
        for _ in range(60):
            act(simulation, [speed, 0.05])
        position = motion_of_group(simulation).position_w
        assert np.linalg.norm(position - start, axis=1).min() > 0.4
        found.append((position, metric(simulation, "return"), metric(simulation, "energy_wh")))
        simulation.close()
    (here, earned, used), (there, also_earned, also_used) = found
    np.testing.assert_allclose(here, there, atol=0.2)
    np.testing.assert_allclose(earned, also_earned, rtol=0.15, atol=0.5)
    np.testing.assert_allclose(used, also_used, rtol=0.4)
