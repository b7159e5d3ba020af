"""Goal, nearest agent, planar velocity, and a scanner on a walker."""

import numpy as np
import pytest
from people import meshes_of
from scanning import flat_with
from sensor_contexts import carrier_of, context_of, rays_of
from sensors_of_rover_zero import lidar_conf
from states import begin, group_state, measure, resting, state_of, write

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.frames import wrap_angle
from dune_rl.sensors.lidar import LidarSensor
from dune_rl.sensors.neighbours import NearestAgent, NearestAgentConf
from dune_rl.sensors.own_motion import Goal, GoalConf, PlanarVelocity, PlanarVelocityConf
from dune_rl.state import GoalState, GroupState, Motion
from dune_rl.state.sensor_carrier import SensorCarrier

SCENES, WALKERS, ROBOTS = 4, 3, 2


def nearest_agent(
    rows: int, farthest_m: float, max_closing_mps: float, *groups: str, name: str = "nearest_agent"
) -> NearestAgent:
    carrier = carrier_of(max_speed_mps=max_closing_mps - 10.0)
    return NearestAgent(
        name, context_of(rows, farthest_m=farthest_m, carrier=carrier), NearestAgentConf(groups=groups)
    )


def walking(rng: np.random.Generator, count: int, name: str, **settings) -> GroupState:
    """`count` upright bodies in each scene, somewhere, at up to 2 m/s."""
    rows = SCENES * count
    angles = np.zeros((rows, 3))
    angles[:, 2] = rng.uniform(-np.pi, np.pi, rows)
    velocity = np.zeros((rows, 3))
    velocity[:, :2] = rng.uniform(-2.0, 2.0, (rows, 2)) / np.sqrt(2)
    position = rng.uniform(-9.0, 9.0, (rows, 3))
    motion = Motion(position, angles, velocity, np.zeros((rows, 3)), np.zeros(rows, bool))
    return group_state(motion, count=count, name=name, **settings)


def walker_observation(poses, velocity_w, goals_w, robot_position_w, robot_velocity_w, far_m, fast_mps):
    """Readings of walkers (M, E, n) as their task once computed them; robots are the nearest."""
    yaw = poses[..., 3]
    cos, sin = np.cos(yaw), np.sin(yaw)

    def polar(offset):
        distance = np.minimum(np.hypot(offset[..., 0], offset[..., 1]), far_m)
        return np.stack([distance, wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - yaw)], axis=-1)

    def to_own_frame(vector):
        x, y = vector[..., 0], vector[..., 1]
        return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)

    robot = polar(robot_position_w[..., :2] - poses[..., :2])
    closing = np.clip(to_own_frame(robot_velocity_w[..., :2] - velocity_w), -fast_mps, fast_mps)
    return {
        "goal": polar(goals_w - poses[..., :2]).astype(np.float32),
        "rover": np.concatenate([robot, closing], axis=-1).astype(np.float32),
        "velocity": to_own_frame(velocity_w).astype(np.float32),
    }


@pytest.mark.parametrize("robots", [1, ROBOTS])
def test_walkers_read_what_their_task_has_always_told(robots):
    rng = np.random.default_rng(robots)
    goals = rng.uniform(-9.0, 9.0, (SCENES, WALKERS, 2))
    walkers, rovers = walking(rng, WALKERS, "walker"), walking(rng, robots, "rover")
    motion = walkers.motion
    poses = walkers.by_scene(np.column_stack([motion.position_w, motion.yaw]))
    offset = rovers.by_scene(rovers.motion.position_w)[:, None, :, :2] - poses[:, :, None, :2]
    nearest = np.hypot(offset[..., 0], offset[..., 1]).argmin(axis=2)[..., None]
    told = walker_observation(
        poses,
        walkers.by_scene(motion.velocity_w[:, :2]),
        goals,
        np.take_along_axis(rovers.by_scene(rovers.motion.position_w), nearest, 1),
        np.take_along_axis(rovers.by_scene(rovers.motion.velocity_w), nearest, 1),
        10.0,
        1.5,
    )
    away = goals.reshape(-1, 2) - motion.position_w[:, :2]
    distance = np.hypot(away[:, 0], away[:, 1])
    bearing = (np.arctan2(away[:, 1], away[:, 0]) - motion.yaw + np.pi) % (2 * np.pi) - np.pi
    rows = SCENES * WALKERS
    now = group_state(
        motion,
        count=WALKERS,
        name="walker",
        goal=GoalState(goals.reshape(-1, 2), distance, distance, bearing),
    )
    sensors = {
        "goal": Goal("goal", context_of(rows, farthest_m=10.0), GoalConf()),
        "rover": nearest_agent(rows, 10.0, 1.5, "rover", name="rover"),
        "velocity": PlanarVelocity(
            "velocity", context_of(rows, carrier=carrier_of(max_speed_mps=2.0)), PlanarVelocityConf()
        ),
    }
    for name, sensor in sensors.items():
        sensor.measure(now, state_of(now, rovers))
        found = sensor.read()[name]
        np.testing.assert_array_equal(found, told[name].reshape(rows, -1), err_msg=name)
        low, high = sensor.bounds()[name]
        assert (low <= found).all() and (found <= high).all()


def test_the_nearest_of_all_other_groups_is_read_where_none_is_named():
    here, near, far = (group_state(resting(SCENES), name=name) for name in ("a", "b", "c"))
    write(far.motion.position_w, (slice(None), 0), 3.0)
    write(near.motion.position_w, (slice(None), 1), 2.0)
    write(near.motion.velocity_w, (slice(None), 0), 0.7)
    sensor = nearest_agent(SCENES, 100.0, 10.0)
    sensor.measure(here, state_of(here, far, near))
    np.testing.assert_allclose(
        sensor.read()["nearest_agent"], [[2.0, np.pi / 2, 0.7, 0.0]] * SCENES, rtol=1e-6
    )


def test_in_its_own_group_an_agent_does_not_see_itself():
    team = group_state(resting(6), count=3, name="team")
    write(team.motion.position_w, (slice(None), 0), [0.0, 1.0, 5.0, 0.0, 10.0, 13.0])
    sensor = nearest_agent(6, 100.0, 10.0, "team")
    measure(sensor, team)
    found = sensor.read()["nearest_agent"]
    np.testing.assert_allclose(found[:, 0], [1, 1, 4, 10, 3, 3])
    np.testing.assert_allclose(np.abs(found[:, 1]), [0, np.pi, np.pi, 0, 0, np.pi], rtol=1e-6)


def test_without_another_agent_it_is_as_far_as_can_be():
    alone = group_state(resting(2), name="alone")
    for groups in ((), ("alone",)):
        sensor = nearest_agent(2, 42.0, 10.0, *groups)
        begin(sensor, np.ones(2, bool), alone)
        np.testing.assert_array_equal(sensor.read()["nearest_agent"], [[42.0, 0, 0, 0]] * 2)


def test_a_kinematic_body_carries_a_lidar():
    # A walker's scanner at breast height; its motion has a place and a yaw alone.
    carrier = SensorCarrier(scanner_b=(0.0, 0.0, 1.2), camera_b=(0.0, 0.0, 1.6), imu_b=(0.0, 0.0, 1.0))
    world, other = flat_with((4.0, 0.0, 0.0, 0.2, 12.0)), meshes_of((PersonConf(radius_m=0.3),))
    conf = lidar_conf(mount_b=carrier.scanner_b, n_segments=4, n_beams=4)
    sensor = LidarSensor("lidar", context_of(solid=rays_of(world), meshes=other), conf)
    zero = np.zeros((1, 3))
    motion = Motion(zero, np.array([[0.0, 0.0, np.pi / 2]]), zero, zero, np.zeros(1, bool))
    measure(sensor, group_state(motion, np.array([[[-2.0, 0.0, 0.0, 0.0]]])))
    # The box is 1 m high, so that the beam to the right passes over it; behind it, in -y, there is nothing.
    np.testing.assert_allclose(sensor.read()["lidar"], [[12.0, 12.0, 12.0, 1.7]], atol=0.01)
