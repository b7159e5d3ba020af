"""The batch core: what counts as an encounter, how near is near, and what driving earns."""

import numpy as np
import pytest
from batches import every_engine, idle, metric, real_batch
from planted.puppets import PuppetScene, puppet_batch
from scipy.spatial import cKDTree

from dune_rl.env.batch import Batch
from dune_rl.env.bounds import rover_observation_bounds, walker_observation_bounds

LENGTH_M, WIDTH_M = 0.62, 0.44


# -- encounters ------------------------------------------------------------------------------------


def steps_touching(batch: Batch, puppet: PuppetScene, touches: list[list[int]]) -> list[float]:
    """Running count of encounters after each step, in which the puppet touches what `touches` names."""
    counts = []
    for bodies in touches:
        puppet.touching = bodies
        batch.step(idle(batch))
        counts.append(float(metric(batch, "collisions")[0]))
    return counts


def test_lasting_contact_is_one_encounter() -> None:
    batch, (puppet,) = puppet_batch(actors="walkers")
    assert steps_touching(batch, puppet, [[], [1], [1], [1, 1], [1]]) == [0, 1, 1, 1, 1]


def test_bouncing_within_a_second_is_the_same_encounter() -> None:
    batch, (puppet,) = puppet_batch(actors="walkers")
    # 20 steps are a second: apart for 19 of them counts as one touch, for more as a second one.
    counts = steps_touching(batch, puppet, [[1]] + [[]] * 19 + [[1]] + [[]] * 20 + [[1]])
    assert counts[20] == 1
    assert counts[-1] == 2


def test_long_contact_does_not_become_a_second_encounter() -> None:
    batch, (puppet,) = puppet_batch(actors="walkers")
    assert steps_touching(batch, puppet, [[1]] * 50)[-1] == 1


def test_each_body_has_its_own_encounter() -> None:
    batch, (puppet,) = puppet_batch(actors="walkers")
    assert steps_touching(batch, puppet, [[1], [1, 2], [2], [1]]) == [1, 2, 2, 2]


def test_encounters_belong_to_their_scene_and_episode() -> None:
    batch, puppets = puppet_batch(num_scenes=3, actors="walkers")
    puppets[1].touching = [1, 2]
    batch.step(idle(batch))
    assert metric(batch, "collisions").tolist() == [0, 2, 0]
    batch.reset(np.array([False, True, False]))
    assert metric(batch, "collisions").tolist() == [0, 0, 0]
    puppets[1].touching = [1]
    batch.step(idle(batch))
    assert metric(batch, "collisions").tolist() == [0, 1, 0]


def test_contact_earns_the_collision_reward_and_spoils_success() -> None:
    batch, (puppet,) = puppet_batch(actors="walkers", task={"reward": {"collision": -0.5, "contact": -3.0}})
    puppet.touching = [1]
    # The encounter costs once, to be too close at every step.
    assert batch.step(idle(batch)).rover_reward[0] == -3.5
    assert batch.step(idle(batch)).rover_reward[0] == -0.5
    assert batch.clearance()[0] > 1.0
    assert metric(batch, "min_clearance")[0] == 0.0
    puppet.touching = []
    puppet.put(*batch.goals_w[0])
    outcome = batch.step(idle(batch))
    assert outcome.terminated[0]
    assert metric(batch, "reached")[0] == 1.0
    assert metric(batch, "success")[0] == 0.0


@every_engine
def test_rover_hits_a_walker_in_true_physics(engine: str) -> None:
    walker = {"waypoints": [[0.0, 9.0], [0.0, 12.0]], "speed_mps": 0.01}
    batch = real_batch(actors=[walker], physics=engine, task={"spawn": {"region": [-1.5, 1.5, 5.0, 6.6]}})
    for _ in range(240):
        bearing = batch.motion.bearing(batch.actors.poses[:, 0, :2])
        batch.step(np.stack([np.ones(1), bearing], axis=1).astype(np.float32))
        if metric(batch, "collisions")[0]:
            break
    assert metric(batch, "collisions")[0] == 1
    apart = np.hypot(*(batch.actors.poses[0, 0, :2] - batch.motion.position_w[0, :2])) - 0.25
    assert WIDTH_M / 2 - 0.05 < apart < np.hypot(LENGTH_M, WIDTH_M) / 2 + 0.05
    batch.close()


def test_a_new_episode_forgets_which_way_a_walker_went() -> None:
    walker = {"controller": "external", "waypoints": [[6.0, 6.0], [7.5, 6.0]]}
    batch, _ = puppet_batch(actors=[walker])

    def way_points() -> list[float]:
        """Where the walker goes, one after the other, when it walks on until its third arrival."""
        seen = [float(batch.actors.goals_w[0, 0, 0])]
        for _ in range(400):
            pose, goal = batch.actors.poses[0, 0], batch.actors.goals_w[0, 0]
            turn = np.arctan2(goal[1] - pose[1], goal[0] - pose[0]) - pose[3]
            turn = (turn + np.pi) % (2 * np.pi) - np.pi
            batch.step(idle(batch), np.float32([[[0.5 if abs(turn) < 0.5 else 0.0, turn]]]))
            left = batch.actors.goals_w[0, 0] - batch.actors.poses[0, 0, :2]
            assert np.hypot(*left) >= 0.5, "it is where it is going"
            if batch.actors.goals_w[0, 0, 0] != seen[-1]:
                seen.append(float(batch.actors.goals_w[0, 0, 0]))
            if len(seen) == 4:
                break
        return seen

    first = way_points()
    assert len(first) == 4
    assert first[0] == first[2] != first[1] == first[3]
    batch.reset()
    assert way_points() == first


# -- clearance -------------------------------------------------------------------------------------


def hull_distance(points: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """Distance from points (n, 2) to the rectangle of a rover at (x, y, yaw), 0 inside, (n,)."""
    offset = points - [x, y]
    along = np.abs(offset @ [np.cos(yaw), np.sin(yaw)]) - LENGTH_M / 2
    across = np.abs(offset @ [-np.sin(yaw), np.cos(yaw)]) - WIDTH_M / 2
    return np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))


def test_clearance_of_walkers_is_that_of_the_hull() -> None:
    batch, puppets = puppet_batch(num_scenes=64, actors="walkers")
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-3, 3, (64, 2)), rng.uniform(-np.pi, np.pi, 64)])
    for puppet, pose in zip(puppets, poses, strict=True):
        puppet.put(*pose)
    batch.step(idle(batch))
    walkers = batch.actors.poses[:, :, :2]
    true = np.array([hull_distance(walkers[i], *poses[i]).min() - 0.25 for i in range(64)]).clip(0.0)
    found = batch.clearance()
    # The circles that stand for the hull hold all of it, and reach 0.14 m beyond its ends.
    assert (found <= true + 1e-9).all()
    assert (found >= true - 0.145).all()
    assert np.ptp(found) > 1.0


def test_clearance_of_props_is_that_of_the_hull() -> None:
    batch, puppets = puppet_batch("inspection", num_scenes=48)
    world = batch.world
    rng = np.random.default_rng(1)
    surface = []
    for prop in world.props:
        if prop.solid and not prop.drivable:
            a, b, c = np.moveaxis(prop.vertices[prop.faces], 1, 0)
            area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2
            faces = rng.choice(len(area), size=int(600 * area.sum()), p=area / area.sum())
            u, v = rng.uniform(size=(2, len(faces), 1))
            u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
            points = a[faces] + u * (b - a)[faces] + v * (c - a)[faces]
            above = points[:, 2] - world.terrain.height(points[:, :2])
            surface.append(points[(above > 0.03) & (above < 0.45), :2])
    points = np.concatenate(surface)
    near = cKDTree(points)
    # On and under a bridge, what stands in the way depends on which of the two it is.
    decks = np.concatenate([prop.vertices[:, :2] for prop in world.props if prop.drivable])
    poses: list[list[float]] = []
    while len(poses) < 48:
        xy = rng.uniform(-25, 25, 2)
        # Outside every prop, so that the distance to a surface is the distance to the solid.
        if 0.5 < world.clearance(xy) < 3.0 and np.hypot(*(decks - xy).T).min() > 8.0:
            poses.append([*xy, rng.uniform(-np.pi, np.pi)])
    for puppet, pose in zip(puppets, poses, strict=True):
        puppet.put(*pose, z=float(world.terrain.height(np.array(pose[:2]))) + 0.125)
    batch.step(idle(batch))
    around = [points[near.query_ball_point(pose[:2], 4.0)] for pose in poses]
    true = np.array([hull_distance(some, *pose).min() for some, pose in zip(around, poses, strict=True)])
    found = batch.clearance()
    # Half a cell of the distance field, and the sampling of the surface.
    assert (found <= true + 0.08).all()
    assert (found >= true - 0.145 - 0.08).all()


def test_clearance_without_obstacles_is_infinite_and_measured_as_the_range() -> None:
    batch, _ = puppet_batch()
    batch.step(idle(batch))
    assert np.isinf(batch.clearance()).all()
    assert metric(batch, "clearance")[0] == 12.0


# -- observations of extreme states ----------------------------------------------------------------


def test_observations_keep_their_bounds_whatever_the_motion() -> None:
    batch, puppets = puppet_batch(num_scenes=64, actors="external_walkers")
    rng = np.random.default_rng(3)
    for puppet in puppets:
        quaternion = rng.normal(size=4)
        # As fast as a state may be without counting as diverged.
        puppet.state = np.concatenate(
            [
                rng.uniform(-90, 90, 3),
                quaternion / np.linalg.norm(quaternion),
                rng.uniform(-49.0, 49.0, 3),
                rng.uniform(-199.0, 199.0, 3),
            ]
        )
    outcome = batch.step(idle(batch), np.tile(np.float32([1.0, 3.0]), (64, 2, 1)))
    assert not metric(batch, "diverged").any()
    assert np.isfinite(outcome.rover_reward).all() and np.isfinite(outcome.walker_reward).all()
    seen = [(batch.observe(), rover_observation_bounds(batch))]
    seen.append((batch.observe_walkers(), walker_observation_bounds(batch)))
    for observation, bounds in seen:
        assert observation.keys() == bounds.keys()
        for name, value in observation.items():
            low, high = bounds[name]
            assert value.dtype == np.float32
            assert ((low <= value) & (value <= high)).all(), f"{name} leaves its bounds"


# -- long episodes ---------------------------------------------------------------------------------


def test_history_grows_with_the_episode() -> None:
    task = {"termination": {"goal_distance_m": 0.01, "stuck_steps": 2000}}
    batch = real_batch(num_scenes=2, task=task)
    rng = np.random.default_rng(0)
    actions = rng.uniform([-1, -1], [1, 1], (300, 2, 2)).astype(np.float32)
    for step in range(300):
        if step == 170:
            batch.reset(np.array([False, True]))
        batch.step(actions[step])
    state = batch.state()
    assert [len(history) for history in state["actions"]] == [300, 130]
    assert np.array_equal(np.float32(state["actions"][0]), actions[:, 0])
    assert np.array_equal(np.float32(state["actions"][1]), actions[170:, 1])
    again = real_batch(num_scenes=2, seed=9, task=task)
    again.restore(state)
    assert np.array_equal(again.motion.position_w, batch.motion.position_w)
    assert np.array_equal(again.metrics(), batch.metrics(), equal_nan=True)
    batch.close()
    again.close()


# -- driving ---------------------------------------------------------------------------------------


@every_engine
def test_driving_at_the_goal_arrives_in_time_and_earns_what_the_paper_says(engine: str) -> None:
    batch = real_batch(num_scenes=6, seed=3, physics=engine)
    conf = batch.task.reward
    distance = np.hypot(*(batch.goals_w - batch.motion.position_w[:, :2]).T)
    first = distance.copy()
    bearing = np.abs(batch.motion.bearing(batch.goals_w))
    total, expected, running = np.zeros(6), np.zeros(6), np.ones(6, bool)
    took = np.zeros(6)
    for step in range(1, 300):
        action = np.stack([np.ones(6), batch.motion.bearing(batch.goals_w)], axis=1).astype(np.float32)
        outcome = batch.step(action)
        observation = batch.observe()
        distance, before = observation["goal"][:, 0].astype(float), distance
        heading, speed = np.abs(observation["goal"][:, 1]).astype(float), observation["velocity"][:, 0]
        progress = before - distance
        nearer = (progress > 0) & (heading <= np.pi / 2)
        way = np.where(nearer, conf.distance_scale * progress, conf.misaligned)
        facing = conf.heading_bonus * (1 - 2 * heading / np.pi)
        reward = conf.alpha * (way + facing) + conf.velocity_scale * speed
        reward = np.where(distance < 0.75, conf.goal, reward)
        total[running] += outcome.rover_reward[running]
        expected[running] += reward[running]
        assert not outcome.truncated.any()
        took[running & outcome.terminated] = step / 20
        if (running & outcome.terminated).any():
            ended = running & outcome.terminated
            final = batch.metrics()[ended]
            names = batch.metric_names
            terms = [index for index, name in enumerate(names) if name.startswith("reward/")]
            assert (final[:, names.index("success")] == 1).all()
            np.testing.assert_allclose(final[:, names.index("time_to_goal")], took[ended], rtol=1e-6)
            np.testing.assert_allclose(final[:, names.index("return")], total[ended], rtol=1e-5)
            np.testing.assert_allclose(final[:, terms].sum(axis=1), total[ended], rtol=1e-5)
            np.testing.assert_allclose(final[:, names.index("reward/goal")], conf.goal)
        running &= ~outcome.terminated
        if not running.any():
            break
    assert not running.any()
    np.testing.assert_allclose(total, expected, atol=0.02)
    # A metre a second for the way, and time to turn: at most 2 rad/s, with a start and an end.
    assert (took >= (first - 0.75) / 1.05).all()
    assert (took <= (first - 0.75) / 0.9 + bearing / 2.0 + 2.0).all()
    batch.close()


@every_engine
def test_the_rover_goes_as_fast_as_told_and_stays_on_the_ground(engine: str) -> None:
    batch = real_batch(physics=engine, task={"termination": {"goal_distance_m": 0.01}})
    for _ in range(60):
        batch.step(np.float32([[0.8, 0.0]]))
    assert batch.observe()["velocity"][0, 0] == pytest.approx(0.8, rel=0.05)
    assert batch.motion.position_w[0, 2] == pytest.approx(0.125, abs=0.02)
    force = batch.observe()["imu"][0, :3]
    assert np.linalg.norm(force) == pytest.approx(9.81, rel=0.05)
    batch.close()
