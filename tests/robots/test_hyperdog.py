"""HyperDog: how it stands, walks and turns, what its joints take, and the figures of its description."""

from xml.etree.ElementTree import Element

import numpy as np
import pytest
from defusedxml.ElementTree import parse
from scenes import STEP_S, every_backend, plane, quaternion_of
from simulations import act, every_engine, metric, motion_of_group, observation, outcome
from walking_robots import Walk

from dune_rl.commands.engines.recording import RecordedSimulation
from dune_rl.config.build import build_robot, make_simulation, make_torchrl_env
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import assets_folder
from dune_rl.env.simulation import VectorSimulation
from dune_rl.learning.policies import built_in_policy
from dune_rl.robots.hyperdog import HyperDog, HyperDogConf

SLOPE_RAD = np.deg2rad(10.0)
LIMITS_RAD = {"hip": (-1.57, 1.57), "upper": (-1.22, 3.14), "lower": (-1.57, 2.62)}
LEGS = [f"{end}_{side}" for end in ("front", "rear") for side in ("left", "right")]


def bounds(robot) -> tuple[np.ndarray, np.ndarray]:
    actions = robot.description.actions
    return actions.low, actions.high


@every_backend
def test_it_stands_still_at_its_height(backend):
    walk = Walk(backend)
    walk.walk(0.0, 0.0, 40)
    way, turned = walk.walk(0.0, 0.0, 100)
    assert np.linalg.norm(way) < 2e-3
    assert abs(turned) < 5e-3
    # Its servos give a little under its weight.
    assert walk.stage.position[2] == pytest.approx(walk.robot.description.standing_height_m, abs=6e-3)
    assert np.linalg.norm(walk.stage.velocity) < 2e-3


@pytest.mark.slow(all_but=["0.3-*", "-0.3-*"])
@every_backend
@pytest.mark.parametrize("speed", [0.3, 0.4, 0.15, -0.3])
def test_it_walks_straight_at_the_speed_told(backend, speed):
    walk = Walk(backend, yaw=0.5)
    walk.walk(speed, 0.0, 80)
    way, turned = walk.walk(speed, 0.0, 100)
    ahead = np.array([np.cos(0.5), np.sin(0.5)])
    assert way[:2] @ ahead / 5.0 == pytest.approx(speed, rel=0.1)
    assert abs(way[0] * -ahead[1] + way[1] * ahead[0]) < 0.15
    assert abs(turned) < 0.1


@every_backend
def test_two_legs_carry_its_body_as_high_as_four(backend):
    walk = Walk(backend)
    walk.walk(0.4, 0.0, 40)
    heights = []
    for _ in range(40):
        walk.step(0.4, 0.0)
        heights.append(walk.stage.position[2])
    assert np.ptp(heights) < 3e-3
    assert np.mean(heights) == pytest.approx(walk.robot.description.standing_height_m, abs=3e-3)


@pytest.mark.slow(all_but=["0.9-*"])
@every_backend
@pytest.mark.parametrize("rate", [0.3, 0.9, -0.6])
def test_it_turns_on_the_spot_as_fast_as_told(backend, rate):
    walk = Walk(backend)
    heading = rate / HyperDogConf().heading.kp
    walk.walk(0.0, heading, 40)
    way, turned = walk.walk(0.0, heading, 80)
    assert turned / 4.0 == pytest.approx(rate, rel=0.15)
    assert np.linalg.norm(way[:2]) < 0.15


@pytest.mark.slow(all_but=["up-*"])
@every_backend
@pytest.mark.parametrize("toward", [0.0, np.pi, np.pi / 2], ids=["up", "down", "across"])
def test_it_walks_on_a_slope_of_ten_degrees(backend, toward):
    walk = Walk(
        backend,
        statics=[plane(SLOPE_RAD, toward_rad=toward)],
        quaternion=quaternion_of(0.0, SLOPE_RAD, toward),
    )
    walk.walk(0.3, 0.0, 40)
    steepest = 0.0
    start = walk.stage.position
    for _ in range(100):
        # As a policy does that keeps its course.
        walk.step(0.3, -walk.roll_pitch_yaw[2])
        steepest = max(steepest, np.abs(walk.roll_pitch_yaw[:2]).max())
    way = walk.stage.position - start
    assert np.linalg.norm(way) / 5.0 > 0.25
    assert abs(way[1]) < 0.3
    assert steepest < SLOPE_RAD + 0.12


@every_backend
def test_it_stays_where_it_stands_on_a_slope(backend):
    walk = Walk(backend, statics=[plane(SLOPE_RAD)], quaternion=quaternion_of(0.0, SLOPE_RAD))
    walk.walk(0.0, 0.0, 30)
    way, _ = walk.walk(0.0, 0.0, 100)
    assert np.linalg.norm(way) < 0.02


@every_backend
def test_told_angles_its_joints_reach_them(backend):
    walk = Walk(backend, HyperDogConf(action="joints"))
    wanted = np.array(walk.robot.body.rest_commands()).reshape(4, 3) + [[0.1, 0.15, -0.2]] * 4
    low, high = np.array([(-1.57, 1.57), (-1.22, 3.14), (0.17, 2.62)]).T
    walk.step(*(2.0 * (wanted - low) / (high - low) - 1.0).ravel(), count=20)
    np.testing.assert_allclose(walk.commands.reshape(4, 3), wanted, atol=1e-12)
    np.testing.assert_allclose(walk.stage.wheel_angles.reshape(4, 3), wanted, atol=0.05)


def test_joint_actions_span_the_joints_ranges_and_end_there():
    robot = HyperDog(HyperDogConf(action="joints"), 2)
    low, high = bounds(robot)
    assert low.shape == high.shape == (12,)
    told = robot.commands(np.array([low * 3, high * 3]), None, STEP_S).reshape(2, 4, 3)
    np.testing.assert_allclose(told[0], [[-1.57, -1.22, 0.17]] * 4)
    np.testing.assert_allclose(told[1], [[1.57, 3.14, 2.62]] * 4)


def test_speeds_are_clipped_and_come_gradually():
    robot = HyperDog(HyperDogConf(), 1)
    low, high = bounds(robot)
    np.testing.assert_allclose([low, high], [[-0.4, -np.pi], [0.4, np.pi]])
    walk = HyperDog(HyperDogConf(), 1)
    still = _Still(1)
    for _ in range(30):
        np.testing.assert_array_equal(
            robot.commands(np.array([[9.0, 99.0]]), still, STEP_S),
            walk.commands(np.array([[0.4, np.pi]]), still, STEP_S),
        )


def test_no_command_leaves_the_reach_of_its_legs():
    robot = HyperDog(HyperDogConf(), 64)
    draws = np.random.default_rng(0)
    still = _Still(64)
    limits = np.tile([LIMITS_RAD[joint] for joint in ("hip", "upper", "lower")], (4, 1))
    for _ in range(200):
        still.roll_pitch_yaw = draws.uniform(-1.5, 1.5, (64, 3))
        told = robot.commands(draws.uniform(*bounds(robot), (64, 2)), still, STEP_S)
        assert (told >= limits[:, 0]).all()
        assert (told <= limits[:, 1]).all()


class _Still:
    def __init__(self, scenes: int) -> None:
        self.velocity_b = self.angular_b = self.roll_pitch_yaw = np.zeros((scenes, 3))


# -- in the environment -------------------------------------------------------------------------------


def _conf(*overrides: str):
    return compose_environment("inspection", ["robot=hyperdog", "sensors=[imu,goal,velocity]", *overrides])


def _run(conf, scenes: int, steps: int = 25, first: int = 0, every: int = 4) -> list[np.ndarray]:
    """True states after each step of the scenes whose episodes are `first`, `first + every` and so on."""
    simulation = make_simulation(conf, scenes, 3)
    simulation.reseed(3, first)
    simulation.reset()
    low, high = _action_bounds(simulation)
    draws = np.random.default_rng(0).uniform(low, high, (steps, 4, len(low))).astype(np.float32)
    states = []
    for actions in draws:
        act(simulation, actions[first : first + scenes])
        motion = motion_of_group(simulation)
        states.append(np.concatenate([motion.position_w, motion.angular_b], axis=1))
    simulation.close()
    return states


def _action_bounds(simulation: VectorSimulation) -> tuple[np.ndarray, np.ndarray]:
    return simulation.group().action_bounds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "action"), [("bullet", "speed_and_heading"), ("bullet", "joints"), ("dart", "joints")]
)
def test_the_same_seed_gives_the_same_walk_and_a_batch_of_four_is_four_of_one(engine, action):
    conf = _conf(f"robot.action={action}", f"physics={engine}")
    once, again = _run(conf, 4), _run(conf, 4)
    np.testing.assert_array_equal(once, again)
    alone = [_run(conf, 1, first=scene) for scene in range(4)]
    np.testing.assert_array_equal(np.concatenate(alone, axis=1), once)


@pytest.mark.slow
@every_engine
def test_fallen_and_kicking_it_observes_within_bounds(engine):
    # Upside down is no end here, and the angles told are any.
    conf = compose_environment(
        "island",
        [
            *("robot=hyperdog", "robot.action=joints", f"physics={engine}", "actors=walkers"),
            "sensors=[lidar,lidar_past,height_scan,depth_strip,imu,goal,velocity,encoders,currents,position]",
            "task.terminations.flipped.angle_deg=180",
        ],
    )
    simulation = make_simulation(conf, 4, 2)
    simulation.reset()
    draws, bounds = np.random.default_rng(1), simulation.group().observation_bounds
    low, high = _action_bounds(simulation)
    fell = np.zeros(4, bool)
    for step in range(100):
        if step % 4 == 0:
            actions = draws.uniform(low, high, (4, 12)).astype(np.float32)
        act(simulation, actions)
        fell |= motion_of_group(simulation).tilt > np.deg2rad(100.0)
        for name, reading in observation(simulation).items():
            assert ((bounds[name][0] <= reading) & (reading <= bounds[name][1])).all(), name
    assert fell.sum() >= 2
    simulation.close()


@every_engine
def test_its_action_of_rest_stands(engine):
    conf = compose_environment(
        "flat", ["robot=hyperdog", "robot.action=joints", f"physics={engine}", "actors=none"]
    )
    simulation = make_simulation(conf, 1, 0)
    simulation.reset()
    start = motion_of_group(simulation).position_w[0].copy()
    rest = build_robot(conf.robot, 1).description.actions.rest
    for _ in range(40):
        act(simulation, rest)
    np.testing.assert_allclose(motion_of_group(simulation).position_w[0], start, atol=6e-3)
    simulation.close()


@pytest.mark.slow
@every_engine
def test_pushed_over_it_is_up_again_or_its_episode_ends(engine):
    run = RecordedSimulation("flat", engine, "hyperdog", 4, 0)
    run.simulation.reset()
    low, high = bounds(run.robot)
    draws = np.random.default_rng(0)
    lying, longest, ended = np.zeros(4), 0.0, 0
    for step in range(240):
        if step % 10 == 0:
            actions = draws.uniform(low, high, (4, 2)).astype(np.float32)
        if step % 60 == 0:
            for scene, bearing in zip(run.scenes, draws.uniform(-np.pi, np.pi, 4), strict=True):
                scene.robots[0].apply_force([200.0 * np.cos(bearing), 200.0 * np.sin(bearing), 0.0])
        terminated = outcome(run.step(actions)).terminated
        lying = np.where(run.motion.tilt > np.deg2rad(40.0), lying + 1, 0)
        longest = max(longest, lying.max())
        if terminated.any():
            ended += terminated.sum()
            run.simulation.reset(terminated)
            lying[terminated] = 0
    run.simulation.close()
    assert ended >= 4
    assert longest * STEP_S <= 2.0


@pytest.mark.slow
def test_instruments_on_joints_read_twelve_and_odometry_is_refused():
    conf = _conf("sensors=[imu,encoders,currents]")
    simulation = make_simulation(conf, 1, 0)
    simulation.reset()
    readings = observation(simulation)
    assert readings["encoders"].shape == (1, 24)
    assert readings["currents"].shape == (1, 12)
    simulation.close()
    with pytest.raises(ConfigError, match="odometry is of wheels"):
        make_simulation(_conf("sensors=[odometry]"), 1, 0)


def test_go_to_goal_refuses_joints():
    env = make_torchrl_env(_conf("robot.action=joints"), 1, 0)
    with pytest.raises(
        ConfigError, match="it outputs a speed and a heading, and the action has 12 components"
    ):
        built_in_policy("go_to_goal", env)
    env.close()


@every_engine
def test_its_battery_lasts_about_the_fifty_minutes_that_its_authors_state(engine):
    conf = compose_environment(
        "flat",
        ["robot=hyperdog", "actors=none", "sensors=[imu]", "metrics.energy=true", f"physics={engine}"],
    )
    simulation = make_simulation(conf, 1, 0)
    simulation.reset()
    for _ in range(100):
        act(simulation, [0.3, 0.0])
    share, range_km = metric(simulation, "battery_share")[0], metric(simulation, "range_km")[0]
    simulation.close()
    assert 40.0 < 5.0 / share / 60.0 < 60.0
    # 0.3 m/s for that long, less what it takes to get going.
    assert range_km == pytest.approx(0.3 * 5.0 / share / 1000.0, rel=0.15)


# -- its description ----------------------------------------------------------------------------------

ROOT = parse(assets_folder() / "robots" / "hyperdog" / "hyperdog.urdf").getroot()
LINKS = {link.get("name"): link for link in ROOT.findall("link")}
JOINTS = {joint.get("name"): joint for joint in ROOT.findall("joint")}


def _mass(link: Element) -> float:
    return float(link.find("inertial/mass").get("value"))


def _triple(element: Element, name: str = "xyz") -> np.ndarray:
    return np.array([float(word) for word in element.get(name).split()])


def test_it_weighs_five_kilograms_in_the_shares_of_its_authors():
    assert sum(_mass(link) for link in LINKS.values()) == pytest.approx(5.0, abs=1e-3)
    shares = {"base_link": 3.0, "rear_left_hip": 0.3, "front_right_upper": 0.5, "front_left_lower": 0.3}
    for name, share in shares.items():
        assert _mass(LINKS[name]) == pytest.approx(share * 5.0 / 7.4, abs=1e-4)


def test_inertias_are_those_of_bodies():
    for link in LINKS.values():
        x, y, z = (float(link.find("inertial/inertia").get(name)) for name in ("ixx", "iyy", "izz"))
        assert min(x, y, z) > 0.0
        # No moment about an axis is above the sum of the two others.
        assert max(x, y, z) <= (x + y + z) / 2 + 1e-9
        # Nor is any part farther out than the size of a link.
        assert np.sqrt(max(x, y, z) / _mass(link)) < 0.12


@pytest.mark.parametrize("leg", LEGS)
def test_joints_are_where_its_authors_have_them_with_their_limits(leg):
    ahead, left = (1 if leg.startswith("front") else -1), (1 if leg.endswith("left") else -1)
    places = {"hip": (0.175 * ahead, 0.066 * left, 0), "upper": (0, 0.104 * left, 0), "lower": (0, 0, -0.15)}
    for joint, place in places.items():
        told = JOINTS[f"{leg}_{joint}_joint"]
        np.testing.assert_allclose(_triple(told.find("origin")), place)
        limit = told.find("limit")
        assert (float(limit.get("lower")), float(limit.get("upper"))) == LIMITS_RAD[joint]
        assert float(limit.get("effort")) == 10.0
    foot = LINKS[f"{leg}_lower"].find("collision")
    assert float(foot.find("geometry/sphere").get("radius")) == 0.02
    assert 0.14 <= -_triple(foot.find("origin"))[2] <= 0.15


def test_standing_it_is_as_high_as_its_authors_state():
    robot = build_robot(HyperDogConf(), 1)
    assert robot.description.standing_height_m == pytest.approx(0.24)
    lowest = robot.description.contact_centres_b[:, 2] - robot.description.contact_radius_m
    np.testing.assert_allclose(lowest, -robot.description.standing_height_m)
