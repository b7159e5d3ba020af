"""Several robots in one scene: apart they drive as if alone, together they meet, and each is an agent."""

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from batches import every_engine, real_batch
from conformance import (
    check_kept,
    check_no_leak,
    check_parallel_api,
    check_seeding,
    check_spaces,
    check_time_limit,
    check_values,
)
from dune_rl.env.batch import Batch
from dune_rl.env.scene import scene_spec, standing_pose
from pettingzoo import ParallelEnv
from scenes import Backend, every_backend
from test_determinism import golden

import dune_rl
from dune_rl.config.build import build_robot
from dune_rl.config.compose import compose, compose_environment
from dune_rl.errors import ConfigError, WorldError
from dune_rl.physics.interface import ENGINES, Engine, PhysicsConf
from dune_rl.rendering.scenery import Segment
from dune_rl.robots.robot import Robot
from dune_rl.robots.rover_zero.robot import RoverZeroConf
from dune_rl.worlds.flat import FlatConf, build_flat

BOTH = ["rover_zero", "leo_rover"]
TWINS = ["rover_zero", "rover_zero"]
SHORT = {"termination": {"max_steps": 12, "goal_distance_m": 4.0}}
STILL = (0.0, 0.0)


def batch_of(robots: list[Any], world: str = "flat", num_scenes: int = 1, **settings: Any) -> Batch:
    return real_batch(world, num_scenes, robots=robots, **settings)


def metric(batch: Batch, rover: int, name: str) -> np.ndarray:
    return batch.metrics(rover)[:, batch.metric_names.index(name)]


def distance(batch: Batch) -> np.ndarray:
    """Between the origins of the first and the second robot of each scene, seen from above (M,)."""
    one, other = (rovers.motion.position_w[:, :2] for rovers in batch.rovers)
    return np.hypot(*(one - other).T)


def actions(*each: tuple[float, float]) -> np.ndarray:
    return np.float32([[number for pair in each for number in pair]])


def at_each_other(batch: Batch, speed_mps: float = 0.5) -> np.ndarray:
    one, other = batch.rovers
    bearings = [a.motion.bearing(b.motion.position_w[:, :2]) for a, b in ((one, other), (other, one))]
    return actions(*((speed_mps if abs(to[0]) < 0.3 else 0.0, float(to[0])) for to in bearings))


# -- agents ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def make() -> Callable[[], ParallelEnv]:
    return partial(dune_rl.parallel_env, "inspection", robots=BOTH, actors="external_walkers", task=SHORT)


@pytest.mark.parametrize("check", [check_parallel_api, check_values, check_kept, check_spaces])
def test_parallel_env(check: Callable[[ParallelEnv], None], make: Callable[[], ParallelEnv]) -> None:
    env = make()
    assert env.possible_agents == ["rover_0", "rover_1", "walker_0", "walker_1"]
    top = [float(env.action_space(agent).high[0]) for agent in ("rover_0", "rover_1")]
    assert top[0] > top[1], "each has its own limits"
    check(env)
    env.close()


@pytest.mark.parametrize("check", [check_seeding, check_no_leak])
def test_parallel_env_over_resets(check: Callable[[Any], None], make: Callable[[], ParallelEnv]) -> None:
    check(make)


def test_time_limit_truncates_all() -> None:
    task = {"termination": {"max_steps": 12, "goal_distance_m": 0.1}}
    check_time_limit(partial(dune_rl.parallel_env, "flat", robots=BOTH, task=task), 12)


def test_who_arrives_waits_for_the_others() -> None:
    task = {"termination": {"max_steps": 30, "goal_distance_m": 0.3}}
    batch = batch_of(TWINS, task=task)
    batch.rovers[1].goals_w[0] = batch.rovers[1].motion.position_w[0, :2]
    first = batch.step(actions((0.5, 0.0), (0.5, 0.0)))
    assert first.others[0].reward[0] == 100.0
    assert metric(batch, 1, "success")[0] == 1.0
    final = batch.metrics(1).copy()
    for _ in range(10):
        outcome = batch.step(actions((0.5, 0.0), (0.5, 1.0)))
    here = batch.rovers[1].motion.position_w.copy()
    for _ in range(11, 29):
        outcome = batch.step(actions((0.5, 0.0), (0.5, 1.0)))
        assert outcome.others[0].reward[0] == 0.0
        assert outcome.rover_reward[0] != 0.0
        assert not (outcome.terminated | outcome.truncated)[0]
        assert not (outcome.others[0].terminated | outcome.others[0].truncated)[0]
    np.testing.assert_allclose(batch.rovers[1].motion.position_w, here, atol=1e-3)
    assert np.array_equal(batch.metrics(1), final, equal_nan=True)
    outcome = batch.step(actions((0.5, 0.0), STILL))
    assert outcome.truncated[0] and not outcome.terminated[0]
    assert outcome.others[0].terminated[0] and not outcome.others[0].truncated[0]
    batch.reset()
    assert not batch.rovers[1].done[0]
    assert metric(batch, 1, "success")[0] == 0.0
    batch.close()


def test_the_episode_ends_when_all_have_arrived() -> None:
    batch = batch_of(TWINS, task={"termination": {"goal_distance_m": 0.3}})
    for number, rovers in enumerate(batch.rovers):
        outcome = batch.step(actions(STILL, STILL))
        assert not outcome.terminated[0]
        rovers.goals_w[0] = rovers.motion.position_w[0, :2]
        outcome = batch.step(actions(STILL, STILL))
        assert outcome.terminated[0] == outcome.others[0].terminated[0] == (number == 1)
    batch.close()


def test_where_one_diverges_the_episode_ends_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    batch = batch_of(TWINS, num_scenes=2)
    row = np.tile(actions(STILL, STILL), (2, 1))
    batch.step(row)
    monkeypatch.setattr(batch.rovers[1].engines[0], "body_state", lambda: (np.nan,) * 13)
    outcome = batch.step(row)
    for truncated in (outcome.truncated, outcome.others[0].truncated):
        assert truncated.tolist() == [True, False]
    assert not (outcome.terminated | outcome.others[0].terminated).any()
    assert metric(batch, 1, "diverged").tolist() == [1.0, 0.0]
    assert np.isfinite(batch.observe(0)["lidar"]).all()
    batch.close()


# -- apart -----------------------------------------------------------------------------------------


def robots_of(names: list[str]) -> list[Robot]:
    return [build_robot(conf, 1) for conf in compose_environment("flat", (), {"robots": names}).all_robots]


@every_backend
@pytest.mark.parametrize("which", [0, 1])
def test_apart_each_drives_as_if_alone(which: int, backend: Backend) -> None:
    world = build_flat(FlatConf())
    robots = robots_of(BOTH)
    # Leo's rockers ask for 20 iterations: so many for both, alone and together.
    physics = PhysicsConf(solver_iterations=20)
    poses = [standing_pose(world, robot, 4.0 * index, 0.0, 0.3) for index, robot in enumerate(robots)]
    none = np.zeros((0, 4))
    wanted = [np.array([[0.3, 0.4 * (1 - 2 * index)]]) for index in range(2)]

    class Standing:
        velocity_b = angular_b = roll_pitch_yaw = np.zeros((1, 3))

    commands = [
        robot.commands(action, Standing(), 0.05)[0].tolist()
        for robot, action in zip(robots, wanted, strict=True)
    ]
    shared = backend(scene_spec(world, robots, (), physics))
    alone = backend(scene_spec(world, [robots[which]], (), physics))
    for robot, pose in zip(shared.robots, poses, strict=True):
        robot.set_start_pose(*(part.tolist() for part in pose))
    alone.robots[0].set_start_pose(*(part.tolist() for part in poses[which]))
    shared.reset(none)
    alone.reset(none)
    seen = []
    for _ in range(40):
        for robot, command in zip(shared.robots, commands, strict=True):
            robot.set_command(command)
        alone.robots[0].set_command(commands[which])
        shared.step(10, none)
        alone.step(10, none)
        seen.append(shared.robots[which].body_state())
    assert np.ptp(np.array(seen)[:, :2], axis=0).max() > 0.1
    np.testing.assert_allclose(seen[-1], alone.robots[0].body_state(), atol=1e-3)
    assert not any(robot.contacts() for robot in shared.robots)
    shared.close()
    alone.close()


def test_the_first_robot_starts_where_it_starts_alone() -> None:
    one = real_batch("inspection", 1, actors="walkers")
    several = batch_of(BOTH, "inspection", actors="walkers")
    for _ in range(6):
        assert np.array_equal(one.goals_w, several.goals_w)
        # To settle takes both of them other solver iterations than one.
        np.testing.assert_allclose(several.motion.position_w, one.motion.position_w, atol=1e-3)
        one.reset()
        several.reset()
    one.close()
    several.close()


@pytest.mark.parametrize("apart_m", [0.5, 3.0])
def test_robots_start_apart_with_goals_apart(apart_m: float) -> None:
    spawn = {"region": [-5.0, 5.0, -5.0, 5.0], "robots_apart_m": apart_m, "min_goal_distance_m": 2.0}
    batch = batch_of([*BOTH, "rover_zero"], num_scenes=8, task={"spawn": spawn})
    starts = set()
    for _ in range(5):
        for one, a in enumerate(batch.rovers):
            for b in batch.rovers[one + 1 :]:
                least = apart_m + a.robot.footprint_radius_m + b.robot.footprint_radius_m
                # They settle by some millimetres.
                between = np.hypot(*(a.motion.position_w - b.motion.position_w)[:, :2].T)
                assert (between > least - 0.01).all()
                assert (np.hypot(*(a.goals_w - b.goals_w).T) >= least).all()
            assert (np.hypot(*(a.goals_w - a.motion.position_w[:, :2]).T) > 2.0 - 0.01).all()
            starts |= set(map(tuple, a.motion.position_w[:, :2].tolist()))
        batch.reset()
    assert len(starts) == 3 * 8 * 5
    batch.close()


def test_no_room_for_another_robot() -> None:
    task = {"spawn": {"region": [-1.5, 1.5, -1.5, 1.5], "min_goal_distance_m": 1.0, "robots_apart_m": 9.0}}
    with pytest.raises(
        WorldError, match=r"no room for another robot beside 1: .*task\.spawn\.robots_apart_m"
    ):
        batch_of(BOTH, task=task)


# -- together --------------------------------------------------------------------------------------


@every_engine
def test_robots_that_meet_both_have_a_collision(engine: Engine) -> None:
    task = {"spawn": {"region": [-2.0, 2.0, -2.0, 2.0]}, "termination": {"goal_distance_m": 0.01}}
    batch = batch_of(TWINS, task=task, physics=engine)
    nearest = np.inf
    for _ in range(200):
        apart = distance(batch)[0]
        batch.step(at_each_other(batch))
        nearest = min(nearest, float(batch.clearance()[0]))
        assert batch.clearance(0)[0] == batch.clearance(1)[0]
        if metric(batch, 0, "collisions")[0]:
            break
    # 0.62 m long and 0.44 m wide, each.
    assert 0.44 - 0.03 < distance(batch)[0] < 0.77 + 0.03
    assert apart < 1.0 and nearest < 0.1
    for rover in range(2):
        assert metric(batch, rover, "collisions")[0] == 1
        assert metric(batch, rover, "min_clearance")[0] == 0.0
    for _ in range(40):
        batch.step(at_each_other(batch))
    assert distance(batch)[0] > 0.44 - 0.03, "they drive through each other"
    batch.close()


@every_engine
def test_a_collision_leaves_no_trace_in_the_next_episode(engine: Engine) -> None:
    task = {"spawn": {"region": [-2.0, 2.0, -2.0, 2.0]}, "termination": {"goal_distance_m": 0.01}}
    batch = batch_of(BOTH, task=task, physics=engine)

    def drives() -> list[bytes]:
        batch.reseed(0)
        batch.reset()
        states = []
        while not metric(batch, 1, "collisions")[0]:
            batch.step(at_each_other(batch, 0.4))
            states += [engine.body_state() for rovers in batch.rovers for engine in rovers.engines]
        return [np.array(state).tobytes() for state in states]

    first = drives()
    assert len(first) > 20
    # They are still pushing at each other.
    assert drives() == first
    batch.close()


def test_clearance_is_the_distance_of_the_hulls() -> None:
    batch = batch_of(TWINS, num_scenes=32, task={"spawn": {"region": [-2.5, 2.5, -2.5, 2.5]}})
    found = batch.clearance()
    assert np.array_equal(found, batch.clearance(1))
    between = distance(batch)
    assert (found <= between - 0.44 + 1e-6).all()
    assert (found >= between - 2 * np.hypot(0.31, 0.22) - 1e-6).all()
    batch.close()


@pytest.mark.parametrize("rover", [0, 1])
def test_each_sees_the_other(rover: int) -> None:
    settings = {
        "sensors": {
            "enabled": ["goal", "lidar", "lidar_3d"],
            # In the middle of the hull: above it, beams pass over the other's.
            "lidar": {"mount_b": [0.0, 0.0, 0.0]},
            "lidar_3d": {"mount_b": [0.0, 0.0, 0.0], "outputs": ["segmentation"]},
        },
        "task": {"spawn": {"region": [-2.0, 2.0, -2.0, 2.0]}},
    }
    batch = batch_of(BOTH, num_scenes=4, **settings)
    seen = batch.observe(rover)
    between = distance(batch)
    nearest = seen["lidar"].min(axis=1)
    # Round the other's origin its wheels reach to 0.38 m, and its hull is 0.1 m at least.
    assert (nearest > between - 0.39).all() and (nearest < between - 0.1).all()
    ahead = batch.rovers[rover].motion.bearing(batch.rovers[1 - rover].motion.position_w[:, :2])
    segment = 2 * np.pi / batch.sensors.lidar.n_segments
    bearing = -np.pi + (seen["lidar"].argmin(axis=1) + 0.5) * segment
    # Seen from the middle of one, the other is no wider than this.
    assert (np.abs((bearing - ahead + np.pi) % (2 * np.pi) - np.pi) < 0.39 / nearest + segment).all()
    robots = seen["lidar_3d_segmentation"].reshape(4, -1) == Segment.ROBOT
    assert robots.any(axis=1).all()
    batch.close()
    alone = real_batch("flat", 1, **settings)
    assert not (alone.observe()["lidar_3d_segmentation"] == Segment.ROBOT).any()
    assert (alone.observe()["lidar"] == 12.0).all()
    alone.close()


def test_a_dog_by_joints_that_is_done_stays_on_its_feet() -> None:
    batch = batch_of(["rover_zero", {"name": "hyperdog", "action": "joints"}])
    dog = batch.rovers[1]
    dog.done[:] = True
    start = dog.motion.position_w.copy()
    kicking = np.concatenate([np.zeros(2), np.ones(12)]).astype(np.float32)[None]
    for _ in range(30):
        batch.step(kicking)
    np.testing.assert_allclose(dog.motion.position_w, start, atol=6e-3)
    batch.close()


# 0.2 m over the ground, which is in the hull of each.
LOW = [
    {"name": name, "mounts": {"scanner_b": [0.2, 0.0, height_m]}}
    for name, height_m in (("rover_zero", 0.075), ("leo_rover", 0.0), ("hyperdog", -0.04))
]


@pytest.mark.parametrize("low", [True, False])
def test_scanners_that_are_mounted_low_see_all_kinds_of_robots(low: bool) -> None:
    names = [conf["name"] for conf in LOW]
    region = {"region": [-2.0, 2.0, -2.0, 2.0]}
    seen = np.zeros((3, 8))
    batch = batch_of(LOW if low else names, num_scenes=8, sensors=["lidar", "goal"], task={"spawn": region})
    for index in range(3):
        seen[index] = batch.observe(index)["lidar"].min(axis=1)
    batch.close()
    assert (seen < 5.0).all() == low


def test_a_camera_shows_the_other() -> None:
    sensors = {"enabled": ["camera"], "camera": {"outputs": ["segmentation", "depth"]}}
    spawn = {"region": [-2.0, 2.0, -2.0, 2.0]}
    batch = batch_of(TWINS, sensors=sensors, task={"spawn": spawn, "termination": {"goal_distance_m": 0.01}})
    for _ in range(60):
        batch.step(at_each_other(batch, 0.0))
    for rover in range(2):
        seen = batch.observe(rover)
        shown = seen["camera_segmentation"][0] == Segment.ROBOT
        assert shown.sum() > 20
        assert abs(seen["camera_depth"][0][shown].min() - (distance(batch)[0] - 0.2 - 0.31)) < 0.15
    batch.close()


def test_a_walker_is_told_of_the_nearest_rover() -> None:
    walker = {"controller": "external"}
    batch = batch_of(BOTH, "inspection", num_scenes=8, actors=[walker, walker])
    position = np.stack([rovers.motion.position_w for rovers in batch.rovers], axis=1)
    offset = batch.actors.poses[:, :, None, :2] - position[:, None, :, :2]
    apart = np.hypot(offset[..., 0], offset[..., 1])
    assert len(set(apart.argmin(axis=2).ravel())) == 2
    # At the start each actor keeps its distance from all of them.
    assert (apart > 2.0 - 0.01).all()
    np.testing.assert_allclose(batch.observe_walkers()["rover"][..., 0], apart.min(axis=2), atol=1e-5)
    batch.close()


# -- equal seeds -----------------------------------------------------------------------------------


def digest_of_several(engine: Engine) -> str:
    """A rollout of two scenes in which robots are driven at random, close together, with walkers."""
    task = {"spawn": {"region": [-3.0, 3.0, -3.0, 3.0]}, "termination": {"max_steps": 25}}
    batch = batch_of(
        BOTH, num_scenes=2, physics=engine, actors="walkers", task=task, metrics={"energy": True}
    )
    rng, found = np.random.default_rng(2), hashlib.sha256()
    for _ in range(60):
        outcome = batch.step(rng.uniform([0.2, -1.0] * 2, [1.0, 1.0] * 2, (2, 4)).astype(np.float32))
        ended = outcome.terminated | outcome.truncated
        if ended.any():
            batch.reset(ended)
        for rover in range(2):
            for value in (*batch.observe(rover).values(), batch.metrics(rover)):
                found.update(value.tobytes())
        found.update(outcome.rover_reward.tobytes() + outcome.others[0].reward.tobytes())
    batch.close()
    return found.hexdigest()


def test_equal_seeds_give_equal_bytes_in_any_process() -> None:
    expected = [digest_of_several(engine) for engine in ENGINES]
    environ = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "PYTHONHASHSEED": "77",
    }
    code = "from test_several_robots import *; print(*map(digest_of_several, reversed(ENGINES)))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[: -len(expected) - 1 : -1] == expected


@every_engine
def test_a_restored_moment_goes_on_as_it_did(engine: Engine) -> None:
    batch = batch_of(BOTH, num_scenes=2, actors="walkers", physics=engine)
    rng = np.random.default_rng(0)
    rows = rng.uniform(-1.0, 1.0, (30, 2, 4)).astype(np.float32)
    for step, row in enumerate(rows[:20]):
        if step == 7:
            batch.reset(np.array([False, True]))
        batch.step(row)
    again = batch_of(BOTH, num_scenes=2, actors="walkers", physics=engine)
    again.restore(batch.state())
    for row in rows[20:]:
        batch.step(row)
        again.step(row)
    for rover in range(2):
        for name, value in batch.observe(rover).items():
            assert value.tobytes() == again.observe(rover)[name].tobytes()
        assert batch.metrics(rover).tobytes() == again.metrics(rover).tobytes()
    batch.close()
    again.close()


def test_a_list_of_one_is_the_one_robot() -> None:
    digests = [
        golden(real_batch("flat", 2, **chosen), 20)
        for chosen in ({"robots": ["leo_rover"]}, {"robot": "leo_rover"})
    ]
    assert digests[0] == digests[1]


# -- settings and refusals -------------------------------------------------------------------------


def test_robots_by_name_with_values_that_differ() -> None:
    conf = compose_environment(
        "flat", (), {"robots": ["leo_rover", {"name": "rover_zero", "wheel_friction": 0.8}]}
    )
    words = compose_environment("flat", ["robots=[leo_rover,{name: rover_zero, wheel_friction: 0.8}]"])
    assert conf.robots == words.robots
    assert conf.all_robots[1] == RoverZeroConf(wheel_friction=0.8)
    assert compose_environment("flat").all_robots == (RoverZeroConf(),)


@pytest.mark.parametrize(
    ("robots", "message"),
    [
        ("[rover_zro]", "there is no robot 'rover_zro'; choose "),
        ("[]", "robots must be a list of at least 1 (got [])"),
        ("[{wheel_friction: 1.0}]", "robots: each is a name or has one: choose "),
        (
            "[rover_zero, {name: leo_rover, wheel_frictio: 1.0}]",
            "robots.1.wheel_frictio is not a setting; did you mean robots.1.wheel_friction?",
        ),
        (
            "[{name: rover_zero, drive: {effective_track_m: -1.0}}]",
            "robots.0.drive.effective_track_m must be above 0.0 (got -1.0)",
        ),
    ],
)
def test_faulty_robots_are_told_in_one_line(robots: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_environment("flat", [f"robots={robots}"])
    (line,) = str(error.value).splitlines()
    assert line.startswith(message)


@pytest.mark.parametrize(
    "ask",
    [
        lambda: compose(["+world=flat", "robots=[rover_zero,leo_rover]"]),
        lambda: dune_rl.gym_env("flat", robots=BOTH),
        lambda: dune_rl.make("flat", 2, robots=BOTH),
    ],
    ids=["train", "gymnasium", "torchrl"],
)
def test_learners_of_one_robot_refuse_several(ask: Callable[[], Any]) -> None:
    with pytest.raises(ConfigError, match="robots are agents of parallel_env alone; choose one here: robot="):
        ask()
