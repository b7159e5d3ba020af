"""Kinematic agents: they move as unicycles, over the ground and not through obstacles."""

import numpy as np
import pytest
from scenes import poses_of
from scripted_physics import scripted_simulation
from simulations import act, every_engine, goals_w, motion_of_group, put_walkers, started_simulation
from yards import yard

from dune_rl.bodies.person import PersonConf
from dune_rl.env.kinematic import KinematicBody
from dune_rl.geometry.frames import wrap_angle
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

STEP_S = 0.05
PERSON = PersonConf(speed_mps=1.5)


def bodies(*poses: tuple[float, float, float], world: World | None = None) -> KinematicBody:
    """Persons of one scene at (x, y, yaw)."""
    worlds = BatchedWorlds([(world or yard(), WeatherConf())])
    made = KinematicBody(PERSON, worlds, len(poses), STEP_S)
    made.place(0, np.array([(x, y, 0.0, yaw) for x, y, yaw in poses]))
    made.read_start(np.ones(len(poses), bool))
    return made


def walk(body: KinematicBody, speed: float, heading: float, steps: int = 1) -> None:
    for _ in range(steps):
        body.command(np.tile([speed, heading], (len(body.poses), 1)), body.motion)
        body.read()


def test_an_agent_goes_where_it_turns() -> None:
    body = bodies((1.0, 1.0, 0.5))
    walk(body, 1.2, 0.1)
    expected = np.array([np.cos(0.6), np.sin(0.6)])
    np.testing.assert_allclose(body.poses[0, :4], [*(1.0 + 0.06 * expected), 0.0, 0.6], atol=1e-12)
    motion = body.motion
    np.testing.assert_allclose(motion.velocity_w[0], [*(1.2 * expected), 0.0], atol=1e-9)
    np.testing.assert_allclose(motion.velocity_b[0], [1.2, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(motion.roll_pitch_yaw[0], [0.0, 0.0, 0.6], atol=1e-12)
    np.testing.assert_array_equal(motion.position_w, body.poses[:, :3])


def test_agents_move_by_their_own_actions() -> None:
    body = bodies((0.0, 0.0, 0.0), (0.0, 5.0, 0.0))
    body.command(np.array([[1.0, 0.0], [0.5, np.pi]]), body.motion)
    np.testing.assert_allclose(body.poses[0, :4], [0.05, 0.0, 0.0, 0.0], atol=1e-12)
    turned = 3.0 * STEP_S
    x, y = 0.025 * np.cos(turned), 5.0 + 0.025 * np.sin(turned)
    np.testing.assert_allclose(body.poses[1, :4], [x, y, 0.0, turned], atol=1e-12)


@pytest.mark.parametrize("heading", [2.0, -2.0])
def test_an_agent_turns_no_faster_than_it_can(heading: float) -> None:
    body = bodies((0.0, 0.0, 3.0))
    walk(body, 0.0, heading, 4)
    expected = 3.0 + np.sign(heading) * PERSON.max_turn_radps * STEP_S * 4
    assert body.poses[0, 3] == pytest.approx(wrap_angle(np.asarray(expected)))


@pytest.mark.parametrize(("commanded", "reached"), [(9.0, 1.5), (0.7, 0.7), (-1.0, 0.0)])
def test_an_agent_keeps_its_speed_limits(commanded: float, reached: float) -> None:
    body = bodies((0.0, 0.0, 0.0))
    walk(body, commanded, 0.0, 10)
    np.testing.assert_allclose(body.poses[0, :2], [10 * reached * STEP_S, 0.0], atol=1e-9)


def test_bounds_of_actions_are_those_limits() -> None:
    low, high = bodies((0.0, 0.0, 0.0)).action_bounds()
    np.testing.assert_allclose([low, high], [[0.0, -np.pi], [1.5, np.pi]])


def test_an_agent_follows_the_ground() -> None:
    slope = HeightField(np.tile(np.arange(21) * 0.2, (21, 1)), 1.0, (-10.0, -10.0))
    body = bodies((0.0, 0.0, 0.3), world=World("slope", slope, region=(-5, 5, -5, 5)))
    walk(body, 1.0, 0.0, 30)
    x, y, z = body.poses[0, :3]
    assert x > 1.0
    assert z == pytest.approx(float(slope.height([x, y])))


def test_an_obstacle_stops_an_agent_which_may_turn_away() -> None:
    body = bodies((-4.0, 0.0, 0.0), world=yard((0.0, 0.0, 0.0, 2.0, 2.0)))
    walk(body, 1.5, 0.0, 60)
    # 0.25 m from the box's face at x = -1, as near as whole steps and the world's grid let it come.
    assert body.poses[0, 0] == pytest.approx(-1.25, abs=0.16)
    assert body.poses[0, 0] < -1.25 + 0.08
    assert body.blocked.all()
    np.testing.assert_allclose(body.motion.velocity_w, 0.0, atol=1e-12)
    walk(body, 1.5, np.pi, 30)
    assert not body.blocked.any()
    assert body.poses[0, 0] < -1.5


def test_an_agent_that_was_pushed_against_an_obstacle_comes_away_again() -> None:
    world = yard((0.0, 0.0, 0.0, 2.0, 2.0))
    for yaw, comes_away in ((np.pi, True), (0.0, False)):
        # Robots hold agents back without a look at obstacles: its middle is 0.1 m from the box's face.
        body = bodies((-1.1, 0.0, yaw), world=world)
        walk(body, 1.0, 0.0, 8)
        assert body.blocked.all() != comes_away
        assert (body.poses[0, 0] < -1.35) == comes_away
        assert body.poses[0, 0] < -1.1 + 1e-9


def test_an_agent_that_is_held_back_has_the_velocity_that_it_really_had() -> None:
    slope = HeightField(np.tile(0.1 * np.arange(-10.0, 11.0), (21, 1)), 1.0, (-10.0, -10.0))
    world = World("slope", slope, region=(-9.0, 9.0, -9.0, 9.0))
    body = bodies((0.0, 0.0, 0.0), (0.0, 3.0, 0.0), world=world)
    walk(body, 1.0, 0.0)
    before = body.poses.copy()
    body.command(np.tile([1.0, 0.0], (2, 1)), body.motion)
    commanded = body.poses.copy()
    reached = commanded.copy()
    reached[0, :2] = before[0, :2] + [0.01, -0.02]
    body.hold_back(np.array([0]), reached[None])
    body.read()
    np.testing.assert_allclose(body.poses[0, :4], [0.06, -0.02, 0.006, 0.0], atol=1e-9)
    np.testing.assert_allclose(body.motion.velocity_w[0], [0.2, -0.4, 0.02], atol=1e-9)
    # The other has got to where it went.
    np.testing.assert_array_equal(body.poses[1], commanded[1])
    np.testing.assert_allclose(body.motion.velocity_w[1], [1.0, 0.0, 0.1], atol=1e-9)
    walk(body, 1.0, 0.0)
    np.testing.assert_allclose(body.poses[:, 0], [0.11, 0.15], atol=1e-9)


def test_motion_is_the_change_of_the_pose() -> None:
    slope = HeightField(np.tile(0.1 * np.arange(-10.0, 11.0), (21, 1)), 1.0, (-10.0, -10.0))
    body = bodies((0.0, 0.0, 3.1), world=World("slope", slope, region=(-9.0, 9.0, -9.0, 9.0)))
    poses, velocities = [body.poses[0]], [np.zeros(3)]
    for speed in (0.4, 1.0, 1.0, 0.7):
        body.command(np.array([[speed, 0.1]]), body.motion)
        if speed == 0.7:
            body.hold_back(np.array([0]), body.poses[None, :, :4] + np.array([0.01, 0.02, 0.0, 0.0]))
        body.read()
        poses.append(body.poses[0])
        before, now = poses[-2:]
        velocities.append((now[:3] - before[:3]) / STEP_S)
        motion = body.motion
        np.testing.assert_allclose(motion.velocity_w[0], velocities[-1], atol=1e-9)
        np.testing.assert_allclose(motion.angular_w[0], [0.0, 0.0, 0.1 / STEP_S], atol=1e-9)
        felt = motion.rotation[0].T @ (velocities[-1] - velocities[-2]) / STEP_S
        np.testing.assert_allclose(motion.acceleration_b[0], felt, atol=1e-7)
    assert np.abs(velocities[-1][2]) > 0.01


def test_the_edge_of_the_world_stops_an_agent() -> None:
    for yaw in (0.0, np.pi / 2, np.pi, -np.pi / 2):
        body = bodies((0.0, 0.0, yaw))
        walk(body, 1.5, 0.0, 200)
        assert np.abs(body.poses[0, :2]).max() == pytest.approx(9.0, abs=0.08)
        assert np.abs(body.poses[0, :2]).max() <= 9.0
        assert body.blocked.all()


def test_a_motion_that_was_read_stays_as_it_is() -> None:
    body = bodies((0.0, 0.0, 0.0))
    walk(body, 1.0, 0.0)
    kept, position = body.motion, body.motion.position_w.copy()
    walk(body, 1.0, 0.3, 3)
    body.place(0, np.array([[5.0, 5.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(kept.position_w, position)


# -- in a simulation -------------------------------------------------------------------------------

WAY = {"waypoints": [[-3.0, 6.0], [3.0, 6.0]]}
EXTERNAL = {"controller": "external", "speed_mps": 1.5, **WAY}


def test_only_external_walkers_are_agents() -> None:
    scripted = {"length_range_m": [3.0, 8.0]}
    simulation, _ = scripted_simulation(actors=[scripted, EXTERNAL, scripted, EXTERNAL])
    assert simulation.agents == ("rover_0", "walker_0", "walker_1")
    (others,) = [group for group in simulation.groups if not group.is_external]
    assert others.count == 2 and others.name not in ("rover", "walker")


def test_an_agent_that_arrives_is_sent_to_the_other_end() -> None:
    simulation, _ = scripted_simulation(actors=[EXTERNAL])

    def goal() -> np.ndarray:
        return goals_w(simulation, "walker")[0]

    put_walkers(simulation, [2.0, 6.0, 0.0, 0.0])
    np.testing.assert_allclose(goal(), [3.0, 6.0], atol=0.06)
    for _ in range(9):
        act(simulation, walker=[1.0, 0.0])
    np.testing.assert_allclose(goal(), [3.0, 6.0], atol=0.06)
    for _ in range(3):
        act(simulation, walker=[1.0, 0.0])
    np.testing.assert_allclose(goal(), [-3.0, 6.0], atol=0.06)
    put_walkers(simulation, [-2.9, 6.0, 0.0, 0.0])
    act(simulation)
    np.testing.assert_allclose(goal(), [3.0, 6.0], atol=0.06)


def test_external_and_scripted_walkers_do_not_mix() -> None:
    walking, standing = (scripted_simulation(actors=[{}, EXTERNAL])[0] for _ in range(2))
    for _ in range(20):
        act(walking, walker=[1.5, 0.1])
        act(standing)
    (scripted,) = [group.name for group in walking.groups if not group.is_external]
    places = {
        name: [motion_of_group(simulation, name).position_w for simulation in (walking, standing)]
        for name in ("walker", scripted)
    }
    np.testing.assert_array_equal(*places[scripted])
    assert not np.array_equal(*places["walker"])


def test_scripted_walkers_have_the_velocity_that_they_walk_with() -> None:
    simulation, _ = scripted_simulation(num_scenes=3, actors=[{"speed_mps": 0.7}, {"speed_mps": 0.7}])
    for _ in range(10):
        before = motion_of_group(simulation, "walker").position_w
        act(simulation)
        motion = motion_of_group(simulation, "walker")
        walked = (motion.position_w - before)[:, :2] / STEP_S
        np.testing.assert_allclose(motion.velocity_w[:, :2], walked, atol=1e-9)
    assert np.hypot(*walked.T).max() == pytest.approx(0.7, rel=0.01)


@pytest.mark.slow(all_but=["*-bullet"])
@every_engine
@pytest.mark.parametrize("controller", ["path", "external"])
def test_a_robot_holds_a_weak_walker_back(engine: str, controller: str) -> None:
    speed = 0.8
    walker = {
        "count": 1,
        "controller": controller,
        "body": {"name": "person", "speed_mps": speed, "max_push_n": 40.0},
        "path": {"waypoints": [[-8.0, 1.0], [8.0, 1.0]]},
    }
    simulation = started_simulation("flat", 2, physics=engine, actors={"walker": walker})

    def walk(steps: int) -> np.ndarray:
        """Places (steps, 2, 2) of both walkers."""
        places = []
        for _ in range(steps):
            act(simulation, [0.0, 0.0], **({"walker": [speed, 0.0]} if controller == "external" else {}))
            motion = motion_of_group(simulation, "walker")
            steps_m = motion.position_w[:, :2] - (places[-1] if places else motion.position_w[:, :2])
            if places:
                np.testing.assert_allclose(motion.velocity_w[:, :2], steps_m / STEP_S, atol=1e-9)
            places.append(motion.position_w[:, :2].copy())
        return np.array(places)

    def put_rover(x: float, y: float) -> None:
        (robot,) = simulation.scenes.robots(0)
        robot.set_start_pose([x, y, 0.125], [0.0, 0.0, 0.0, 1.0])
        simulation.scenes.reset(0, poses_of(simulation.group("walker").body.poses[:1, :4]))

    x, y, _, yaw = simulation.group("walker").body.poses[0, :4]
    toward = np.sign(np.cos(yaw))
    put_rover(x + 1.3 * toward, y)
    places = walk(60)
    # 40 N do not move the rover, whose tyres hold 108 N, and its way was free for half a metre.
    assert toward * (places[-1, 0, 0] - x) == pytest.approx(1.3 - 0.25 - 0.31, abs=0.06)
    assert np.abs(places[-1] - places[-10])[0].max() < 0.02
    # The other scene's walker goes its way.
    assert np.hypot(*(places[-1] - places[0])[1]) == pytest.approx(59 * speed * STEP_S, rel=0.02)
    put_rover(x, y + 5.0)
    went_on = walk(20)
    assert toward * (went_on[:, 0, 0] - places[-1, 0, 0])[-1] == pytest.approx(20 * speed * STEP_S, abs=0.03)
    assert np.hypot(*np.diff(went_on[:, 0], axis=0).T).max() < 1.01 * speed * STEP_S
    simulation.close()
