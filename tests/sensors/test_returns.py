"""Where beams end in the world, by the readings of LiDARs."""

import numpy as np
from plain_worlds import box, plain
from simulations import simulation_on

from dune_rl.env.requests import AgentRequest
from dune_rl.sensors.returns import find_returns

# A wall before the rover, 3 m away or so, wherever it stands.
WALL_X_M = 9.0


def test_beams_of_a_planar_lidar_end_on_the_wall_that_they_meet() -> None:
    simulation = simulation_on(
        plain(box(WALL_X_M + 0.5, 0.0, 1.0, 40.0, 3.0)),
        sensors={"lidar": {"sensor": "lidar", "n_beams": 360, "n_segments": 360}},
    )
    simulation.reset(requests={0: {"rover_0": AgentRequest((4.0, 0.0, 0.6))}})
    group = simulation.group()
    motion = group.body.motion
    reading = simulation.observe()["lidar"][0, 0]
    origin, ends = find_returns(
        group.suite.settings["lidar"], reading, motion.position_w[0], motion.rotation[0]
    )
    assert 0 < len(ends) < 360 and len(ends) == (reading < 12.0).sum()
    np.testing.assert_allclose(ends[:, 0], WALL_X_M, atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(ends - origin, axis=1), reading[reading < 12.0], atol=1e-4)
    simulation.close()


def test_points_of_a_lidar_with_rings_lie_on_the_ground_and_on_the_wall() -> None:
    simulation = simulation_on(
        plain(box(WALL_X_M + 0.5, 0.0, 1.0, 40.0, 3.0)),
        sensors={"scan": {"sensor": "lidar_3d", "n_beams": 64}},
    )
    simulation.reset(requests={0: {"rover_0": AgentRequest((4.0, 0.0, 2.0))}})
    group = simulation.group()
    motion = group.body.motion
    reading = simulation.observe()["scan_range"][0, 0]
    _, ends = find_returns(group.suite.settings["scan"], reading, motion.position_w[0], motion.rotation[0])
    on_wall, on_ground = np.abs(ends[:, 0] - WALL_X_M) < 0.02, np.abs(ends[:, 2]) < 0.02
    assert (on_wall | on_ground).all() and on_wall.sum() > 20 and on_ground.sum() > 20
    simulation.close()
