"""What robots make of their readings: the goal's direction, tracks of walkers, ways over what was seen."""

from typing import Any

import numpy as np
import pytest
from plain_worlds import box, plain
from simulations import act, put_walkers, simulation_on, started_simulation

from dune_rl.core.errors import ConfigError
from dune_rl.env.requests import AgentRequest
from dune_rl.env.simulation import VectorSimulation
from dune_rl.sensors.perception.low_obstacles import LowObstacles

SENSORS = {
    "lidar": {"n_segments": 64},
    "velocity": {},
    "goal_direction": {},
    "agent_tracks": {},
    "way_left": {},
}
WALKER = {"body": "person", "controller": "external"}


def readings(simulation: VectorSimulation, row: int = 0) -> dict[str, Any]:
    return {name: values[row, 0] for name, values in simulation.observe("rover").items()}


def test_the_direction_of_the_goal_and_bounded_distances() -> None:
    simulation = started_simulation(sensors=SENSORS)
    found = readings(simulation)["goal_direction"]
    goal = simulation.state.groups["rover"].goal
    distance, bearing = float(goal.distance[0]), float(goal.bearing[0])
    expected = [np.cos(bearing), np.sin(bearing), min(distance / 7.0, 1.0), min(distance / 1.5, 1.0)]
    assert found == pytest.approx(expected, abs=1e-5)
    simulation.close()


def test_a_walker_is_tracked_by_scans_alone() -> None:
    simulation = simulation_on(plain(), sensors=SENSORS, actors={"walker": {**WALKER, "count": 1}})
    simulation.reset()
    motion = simulation.state.groups["rover"].motion
    start, yaw = motion.position_w[0, :2], float(motion.yaw[0])
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    # Three metres ahead, from left to right at 1 m/s.
    put_walkers(simulation, [[*(start + 3.0 * ahead + 0.7 * left), 0.0, yaw - np.pi / 2]])
    for _ in range(20):
        simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[1.0, 0.0]]])})
    found = readings(simulation)
    x, y, velocity_x, velocity_y, inverse, share = found["agent_tracks"][:6]
    assert (x, abs(y)) == pytest.approx((1.0, 0.0), abs=0.15)
    assert (velocity_x, velocity_y) == pytest.approx((0.0, -1.0), abs=0.4)
    assert inverse == pytest.approx(1 / 3.0, rel=0.2) and share == pytest.approx(1 - 3 / 8, rel=0.2)
    assert not found["agent_tracks"][6:].any()
    tangential = found["agent_tracks_tangential"]
    assert tangential.min() < -0.5 and np.count_nonzero(tangential) <= 8
    simulation.close()


def test_nothing_that_rests_is_tracked() -> None:
    simulation = simulation_on(plain(box(3.0, 3.0, 0.4, 0.4, 1.0)), sensors=SENSORS)
    simulation.reset()
    for _ in range(40):
        act(simulation)
    assert not readings(simulation)["agent_tracks"].any()
    simulation.close()


def test_ways_lead_round_what_was_seen() -> None:
    simulation = simulation_on(plain(box(0.0, 0.0, 0.4, 6.0, 1.0)), sensors=SENSORS)
    simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (3.0, 0.0))}})
    ahead, left, right = 8, 12, 4
    first = readings(simulation)["way_left"].reshape(3, 16)
    assert first[2, ahead] == pytest.approx(-2.4, abs=0.1)
    assert first[0, ahead] == first[0].min()
    # Two scans make an obstacle, and ways are found every ten steps.
    for _ in range(12):
        simulation.step({"rover": np.zeros((1, 1, 2))})
    ways = readings(simulation)["way_left"].reshape(3, 16)
    # Straight on is the wall; the way leads round one of its ends.
    assert min(ways[1, left], ways[1, right]) < ways[1, ahead] - 0.2
    simulation.close()


GROUND = {**SENSORS, "imu": {}, "ground_profile": {}, "low_obstacles": {}, "imu_6axis": {}}


def on_ground(*boxes: Any, heights: Any = None, **settings: Any) -> VectorSimulation:
    """A rover at (-2, 0) that faces along x, after some steps at rest."""
    settings = {"sensors": GROUND, **settings}
    simulation = simulation_on(plain(*boxes, heights=heights), **settings)
    simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (3.0, 0.0))}})
    for _ in range(5):
        act(simulation)
    return simulation


def test_level_ground_has_no_height_and_no_steps() -> None:
    simulation = on_ground()
    found = readings(simulation)
    assert np.abs(found["ground_profile"]).max() < 0.03
    assert (found["low_obstacles"] == found["low_obstacles"].max()).all()
    assert found["imu_6axis"].tolist() == found["imu"][:8].tolist()
    simulation.close()


def test_a_brick_below_the_scan_is_a_step_that_is_remembered() -> None:
    # Its near face is 1.1 m before the LiDAR's mount, which is 0.17 m before the rover's origin.
    brick = box(-2.0 + 0.174 + 1.2, 0.0, 0.2, 0.5, 0.15)
    simulation = on_ground(brick, task={"terminations": {}})
    found = readings(simulation)
    ahead = slice(29, 35)
    assert found["lidar"][ahead].min() > 3.0
    assert found["low_obstacles"][ahead].min() == pytest.approx(1.15, abs=0.15)
    assert np.count_nonzero(found["low_obstacles"][ahead] < 3.0) >= 2
    assert (found["low_obstacles"][[0, 16, 48]] == 3.0).all()
    assert found["ground_profile"].max() == pytest.approx(0.15, abs=0.03)
    # Turned to the left, the rover no longer sees the brick, and knows where it is: to its right.
    for _ in range(60):
        bearing = float(simulation.state.groups["rover"].motion.yaw[0])
        act(simulation, [0.0, np.clip(np.pi / 2 - bearing, -0.7, 0.7)])
    found = readings(simulation)
    assert found["ground_profile"].max() < 0.05
    yaw = float(simulation.state.groups["rover"].motion.yaw[0])
    bearing = np.arctan2(-0.174 * np.sin(yaw), 1.374 - 0.174 * np.cos(yaw)) - yaw
    segment = round((bearing + np.pi) / (2 * np.pi) * 64 - 0.5) % 64
    distance = np.hypot(1.374 - 0.174 * np.cos(yaw), 0.174 * np.sin(yaw))
    assert found["low_obstacles"][segment - 1 : segment + 2].min() == pytest.approx(distance, abs=0.3)
    simulation.close()


@pytest.mark.parametrize("fov_deg", [120.0, 180.0])
def test_low_obstacles_are_in_the_segments_of_a_narrow_scan(fov_deg: float) -> None:
    brick = box(-2.0 + 0.174 + 1.2, 0.0, 0.2, 0.5, 0.15)
    simulation = on_ground(brick, sensors={**GROUND, "lidar": {"n_segments": 64, "fov_deg": fov_deg}})
    found = readings(simulation)["low_obstacles"]
    assert found[31:33] == pytest.approx(1.15, abs=0.15)
    # It is 0.5 m wide, and nothing is beside it.
    half = np.rad2deg(np.arctan2(0.25 + 0.1, 1.0)) / fov_deg * 64 + 1.0
    assert (np.abs(np.flatnonzero(found < 3.0) - 31.5) <= half).all()
    simulation.close()


def test_where_the_ground_ends_is_a_step() -> None:
    """The ground ends at x = 10, the LiDAR's mount is 0.17 m before the rover's origin."""
    for x, yaw, is_near in ((9.35, 0.0, True), (9.35, np.pi, False), (6.0, 0.0, False)):
        simulation = simulation_on(plain(), sensors=GROUND, task={"terminations": {}})
        simulation.reset(requests={0: {"rover_0": AgentRequest((x, 0.0, yaw), (0.0, 0.0))}})
        act(simulation, [0.0, 0.0])
        ahead = readings(simulation)["low_obstacles"][28:36].min()
        assert ahead == pytest.approx(0.6 if is_near else 3.0, abs=0.2)
        simulation.close()


@pytest.mark.parametrize(
    ("sizes_m", "is_known"),
    [((0.15, 0.15, 0.07), True), ((0.15, 0.15, 0.02), False), ((0.09, 1.2, 0.045), True)],
    ids=["stone", "pebble", "plank"],
)
def test_a_stone_or_a_plank_stands_out_of_the_ground_around(
    sizes_m: tuple[float, float, float], is_known: bool
) -> None:
    simulation = on_ground(box(-2.0 + 0.174 + 1.2, 0.0, *sizes_m), task={"terminations": {}})
    ahead = []
    for _ in range(60):
        act(simulation, [0.3, 0.0])
        ahead.append(readings(simulation)["low_obstacles"][28:36].min() < 1.5)
    assert all(ahead[-8:]) if is_known else not any(ahead)
    simulation.close()


def test_ways_lead_round_stones_that_were_seen() -> None:
    wall = box(-2.0 + 0.174 + 1.2, 0.0, 0.3, 1.0, 0.15)
    found = {}
    for low in (None, "low_obstacles"):
        simulation = simulation_on(plain(wall), sensors={**GROUND, "way_left": {"low_obstacles": low}})
        simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (3.0, 0.0))}})
        for _ in range(20):
            act(simulation, [0.3, 0.0])
        found[low] = readings(simulation)["way_left"].reshape(3, 16)[1]
        simulation.close()
    ahead, aside = 8, (6, 10)
    assert found[None][ahead] == found[None].min()
    assert found["low_obstacles"][ahead] > found[None][ahead] + 0.2
    assert found["low_obstacles"][list(aside)].min() < found["low_obstacles"][ahead]


def test_a_slope_has_no_steps_and_walkers_leave_none() -> None:
    slope = np.broadcast_to(np.linspace(-2.0, 2.0, 11), (11, 11)).copy()
    simulation = on_ground(heights=slope)
    for _ in range(20):
        act(simulation, [0.3, 0.0])
    assert (readings(simulation)["low_obstacles"] == 3.0).all()
    simulation.close()
    simulation = on_ground(actors={"walker": {**WALKER, "count": 1}})
    put_walkers(simulation, [[0.0, 1.2, 0.0, -np.pi / 2]])
    for _ in range(60):
        simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[1.0, 0.0]]])})
    # A trace of where the walker was before it had a track may be left; nothing of where it is and goes.
    assert np.count_nonzero(readings(simulation)["low_obstacles"] < 3.0) <= 8
    simulation.close()


def test_a_brick_is_a_step_when_a_walker_has_gone_by() -> None:
    brick = box(-2.0 + 0.174 + 1.2, 0.0, 0.2, 0.5, 0.15)
    simulation = simulation_on(plain(brick), sensors=GROUND, actors={"walker": {**WALKER, "count": 1}})
    simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (3.0, 0.0))}})
    # Along the far side of the brick, at 1 m/s, until he is 2 m aside of it.
    put_walkers(simulation, [[-0.2, 1.2, 0.0, -np.pi / 2]])
    for _ in range(64):
        simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[1.0, 0.0]]])})
    assert readings(simulation)["low_obstacles"][31:33] == pytest.approx(1.1, abs=0.15)
    simulation.close()


def test_a_map_of_low_obstacles_climbs_with_a_robot_that_slips_down_a_slope() -> None:
    slope = np.broadcast_to(np.linspace(-2.0, 2.0, 11), (11, 11)).T.copy()
    simulation = on_ground(heights=slope, task={"terminations": {}})
    suite = simulation.external[0].suite
    assert suite is not None
    sensor = suite.sensors["low_obstacles"]
    assert isinstance(sensor, LowObstacles)
    height, before = simulation.state.groups["rover"].motion.position_w[0, 2], sensor._climbed_m[0]
    slipped_m = 0.0
    for _ in range(200):
        act(simulation, [0.4, -0.5])
        motion = simulation.state.groups["rover"].motion
        slipped_m += 0.05 * abs(float(motion.velocity_b[0, 1]))
    assert slipped_m > 0.3
    assert float(sensor._climbed_m[0]) - before == pytest.approx(motion.position_w[0, 2] - height, abs=0.03)
    assert (readings(simulation)["low_obstacles"] == 3.0).all()
    simulation.close()


def test_a_reset_of_one_scene_leaves_the_others_as_they_are() -> None:
    brick = box(-2.0 + 0.174 + 1.2, 0.0, 0.2, 0.5, 0.15)
    simulation = simulation_on(plain(brick), 2, sensors=GROUND, task={"terminations": {}})
    here = {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (3.0, 0.0))}
    simulation.reset(requests={0: here, 1: here})
    for _ in range(15):
        act(simulation, [0.3, 0.0])
    suite = simulation.external[0].suite
    assert suite is not None
    maps = suite.sensors["low_obstacles"]
    before = readings(simulation), maps._heights[0].copy(), maps._steps[0].copy()
    assert maps._steps[0].any()
    simulation.reset(np.array([False, True]), requests={1: here})
    for name, values in before[0].items():
        np.testing.assert_array_equal(readings(simulation)[name], values, err_msg=name)
    np.testing.assert_array_equal(maps._heights[0], before[1])
    np.testing.assert_array_equal(maps._steps[0], before[2])
    simulation.close()


def test_readings_depend_on_no_other_scene() -> None:
    found = {}
    for scenes in (1, 3):
        simulation = started_simulation(
            num_scenes=scenes,
            actors="walkers",
            sensors=GROUND,
            task={"terminations": {"time_limit": {"max_steps": 30}}},
        )
        for step in range(20):
            act(simulation)
            if scenes == 3 and step == 9:
                simulation.reset(np.array([False, True, True]))
        found[scenes] = readings(simulation)
        simulation.close()
    for name, values in found[1].items():
        np.testing.assert_allclose(values, found[3][name], atol=1e-6, err_msg=name)


def test_a_lidar_of_another_name_is_tracked() -> None:
    sensors = {"low": {"sensor": "lidar", "n_segments": 16}, "agent_tracks": {"lidar": "low"}, "velocity": {}}
    simulation = started_simulation(sensors=sensors)
    assert readings(simulation)["agent_tracks_radial"].shape == (16,)
    simulation.close()


@pytest.mark.parametrize("realism", [{"lidar": {"realism": "rplidar_a2m8"}}, {"imu": {"realism": "bno055"}}])
def test_with_realism_the_goal_is_that_of_the_receiver(realism: dict[str, Any]) -> None:
    found = []
    for changes in ({}, realism):
        simulation = started_simulation(sensors={**SENSORS, **changes})
        for _ in range(5):
            act(simulation, [0.5, 0.2])
        found.append(readings(simulation))
        simulation.close()
    for name in ("goal_direction", "way_left"):
        assert np.abs(found[0][name] - found[1][name]).max() > 1e-6


@pytest.mark.parametrize(
    ("sensors", "said"),
    [
        (
            {"agent_tracks": {"lidar": "velocity"}, "velocity": {}},
            r"sensors.agent_tracks.lidar must be .* LiDAR",
        ),
        ({"goal_direction": {"far_m": 1.0}}, r"far_m \(1\) must be above near_m \(1.5\)"),
        ({"agent_tracks": {"lidar": "lidr"}}, r"no sensor 'lidr' to read; did you mean lidar"),
        ({"lidar": {}, "way_left": {"tracks": "lidar"}}, r"sensors.way_left.tracks must be .* agent_tracks"),
        ({"lidar": {}, "way_left": {"low_obstacles": "lidar"}}, r"way_left.low_obstacles must be .* low_obs"),
        (
            {"lidar": {}, "low_obstacles": {"profile": "lidar"}},
            r"low_obstacles.profile must be .* ground_profile",
        ),
        (
            {"lidar": {}, "low_obstacles": {"tracks": "lidar"}},
            r"low_obstacles.tracks must be .* agent_tracks",
        ),
    ],
)
def test_other_sensors_are_refused(sensors: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        started_simulation(sensors=sensors)


def test_way_left_avoids_where_a_walker_was_tracked() -> None:
    ways = []
    for speed in (0.0, 1.0):
        simulation = simulation_on(plain(), sensors=SENSORS, actors={"walker": {**WALKER, "count": 1}})
        simulation.reset(requests={0: {"rover_0": AgentRequest((-4.0, 0.0, 0.0), (3.0, 0.0))}})
        put_walkers(simulation, [[-2.8, -1.5, 0.0, np.pi / 2]])
        # From the right to the left, 1.2 m ahead, and away; who stands is an obstacle, who walked is none.
        for _ in range(120):
            simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[speed, 0.0]]])})
        ways.append(readings(simulation)["way_left"].reshape(3, 16))
        simulation.close()
    # From 2.4 m ahead the way is as before; that from here leads through the trail, some 0.8 m at 2 a metre.
    assert ways[0][2, 8] == pytest.approx(-2.4, abs=0.2)
    assert ways[1][2, 8] < ways[0][2, 8] - 0.8


def test_ground_that_is_seen_again_corrects_the_height_of_the_map() -> None:
    simulation = on_ground(task={"terminations": {}})
    suite = simulation.external[0].suite
    assert suite is not None
    sensor = suite.sensors["low_obstacles"]
    assert isinstance(sensor, LowObstacles)
    # As after a while of faulty pitch.
    sensor._climbed_m += 0.3
    for _ in range(3):
        act(simulation)
    assert abs(sensor._climbed_m[0]) < 0.03
    assert (readings(simulation)["low_obstacles"] == 3.0).all()
    simulation.close()
