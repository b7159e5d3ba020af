"""Cameras as sensors: many scenes at once, readings, and environments with them."""

import hashlib
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from cameras import EVERYTHING, PERSON, camera_in, look, standing
from conformance import check_gymnasium, check_kept, check_parallel_api, check_seeding, check_torchrl
from hypothesis import given, settings
from hypothesis import strategies as st
from poses import seen_at
from sensor_contexts import context_of
from simulations import rest, started_simulation
from states import begin, measure, state_at

import dune_rl
from dune_rl.bodies.person import PersonConf
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.geometry.frames import rotation_matrices, wrap_angle
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.shared_per_scene import SharedPerScene
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import Camera, Cameras
from dune_rl.sensors.camera_sensor import CameraSensor
from dune_rl.worlds.world import World


def rough() -> World:
    heights = np.random.default_rng(0).normal(0.0, 0.3, (31, 31))
    props = [
        standing("one", (3.0, 1.0, 0.3, 1.0, 1.0, 1.5), (0.8, 0.2, 0.1)),
        standing("two", (-3.0, -2.0, 1.0, 2.0, 0.3, 1.0), (0.1, 0.2, 0.7)),
        standing("lake", (0.0, 4.0, 0.0, 4.0, 2.0, 0.1), (0.2, 0.4, 0.5), solid=False),
    ]
    return World("rough", HeightField(heights, 1.0, (-15.0, -15.0)), props, region=(-4, 4, -4, 4))


CROWD = (PERSON, PersonConf(radius_m=0.4, height_m=1.6), PERSON)


def poses_in(scenes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    positions = np.column_stack([rng.uniform(-4, 4, (scenes, 2)), rng.uniform(0.3, 1.0, scenes)])
    quaternions = rng.normal(0.0, 0.15, (scenes, 4)) + np.column_stack(
        [np.zeros((scenes, 2)), rng.normal(size=(scenes, 2))]
    )
    rotations = rotation_matrices(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    actors = np.concatenate(
        [rng.uniform(-6, 6, (scenes, 3, 2)), np.zeros((scenes, 3, 1)), rng.uniform(-3, 3, (scenes, 3, 1))],
        axis=-1,
    )
    return positions, rotations, seen_at(actors)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(16, 16), (21, 13)])
def test_pictures_of_a_batch_are_those_of_single_scenes(size):
    camera = camera_in(rough(), CROWD, width=size[0], height=size[1])
    positions, rotations, actors = poses_in(9)
    together = camera.frames(positions, rotations, actors)
    assert (together["segmentation"] == Segment.ACTOR).any()
    for i in range(9):
        one = slice(i, i + 1)
        alone = camera.frames(positions[one], rotations[one], actors[one])
        for name in EVERYTHING:
            assert alone[name].tobytes() == together[name][one].tobytes()
    assert len({picture.tobytes() for picture in together["rgb"]}) == 9


def digest() -> str:
    camera = camera_in(rough(), CROWD)
    frames = camera.frames(*poses_in(4))
    return hashlib.sha256(b"".join(frame.tobytes() for frame in frames.values())).hexdigest()


@pytest.mark.slow
def test_another_process_takes_the_same_pictures():
    environ = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "PYTHONHASHSEED": "77",
    }
    command = [sys.executable, "-c", "from test_camera import digest; print(digest())"]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == digest()


def test_actors_that_are_not_there_change_nothing():
    positions, rotations, actors = poses_in(3)
    seen = camera_in(rough()).frames(positions, rotations, actors[:, :0])
    away = actors.copy()
    away[..., 0] += 500.0
    for name, frame in camera_in(rough(), CROWD).frames(positions, rotations, away).items():
        np.testing.assert_array_equal(frame, seen[name])


@settings(max_examples=50)
@given(
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(-2, 3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-1, 1), st.floats(-4, 4)),
    st.sampled_from(["pinhole", "fisheye"]),
)
def test_whatever_the_pose_readings_are_within_their_bounds(x, y, z, quaternion, actor, projection):
    camera = camera_in(ROUGH, (PERSON,), width=12, height=9, range_m=8.0, projection=projection)
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    found = look(camera, [x, y, z], rotation, [actor])
    for name, (low, high) in camera_sensor(camera, 1).bounds().items():
        frame = found[name.removeprefix("camera_")]
        assert frame.dtype == low.dtype == high.dtype
        assert frame.shape == low.shape == high.shape
        assert (frame >= low).all() and (frame <= high).all()
    length = np.linalg.norm(found["normals"], axis=-1)
    seen = found["depth"][..., 0] < 8.0
    np.testing.assert_allclose(length, seen, atol=1e-3)
    np.testing.assert_array_equal(seen, found["segmentation"][..., 0] != Segment.SKY)


ROUGH = rough()


def sensor_of(scenes: int) -> CameraSensor:
    return camera_sensor(camera_in(ROUGH, (PERSON,), width=8, height=6), scenes)


def camera_sensor(camera: Camera, scenes: int) -> CameraSensor:
    """One agent with this camera in each of some scenes."""
    cameras = Cameras(SharedPerScene([camera] * scenes))
    return CameraSensor("camera", context_of(scenes, make_cameras=lambda _: cameras), camera.conf)


def at(scenes: int, x: float) -> object:
    """A moment of rovers side by side, `x` m ahead, each with an actor before it."""
    places = np.column_stack([np.full(scenes, x), np.arange(scenes) - 1.0, np.full(scenes, 0.6)])
    actors = np.concatenate([places + np.array([2.0, 0.0, -0.6]), np.zeros((scenes, 1))], axis=1)
    return state_at(places, np.zeros(scenes), actors[:, None])


def test_an_episode_s_beginning_leaves_the_other_scenes_their_pictures():
    sensor = sensor_of(3)
    begin(sensor, np.array([True, True, True]), at(3, 0.0))
    first = sensor.read()
    begin(sensor, np.array([False, True, False]), at(3, 1.0))
    second = sensor.read()
    measure(sensor, at(3, 1.0))
    third = sensor.read()
    assert list(first) == [f"camera_{name}" for name in EVERYTHING]
    for name in ("camera_rgb", "camera_depth"):
        np.testing.assert_array_equal(second[name][[0, 2]], first[name][[0, 2]])
        np.testing.assert_array_equal(second[name][1], third[name][1])
        assert all((third[name][i] != first[name][i]).any() for i in range(3))


def test_no_episode_s_beginning_changes_nothing():
    sensor = sensor_of(2)
    begin(sensor, np.array([True, True]), at(2, 0.0))
    before = sensor.read()
    begin(sensor, np.array([False, False]), at(2, 2.0))
    assert all((sensor.read()[name] == before[name]).all() for name in before)


def test_a_reading_is_the_reader_s_own():
    sensor = sensor_of(2)
    begin(sensor, np.array([True, True]), at(2, 0.0))
    kept = sensor.read()
    copies = {name: value.copy() for name, value in kept.items()}
    for value in sensor.read().values():
        value[:] = 0
    for name, value in sensor.read().items():
        np.testing.assert_array_equal(value, copies[name])
    measure(sensor, at(2, 1.0))
    for name, value in kept.items():
        np.testing.assert_array_equal(value, copies[name])


@pytest.mark.slow
def test_a_rover_s_camera_sees_what_lies_before_the_rover():
    walk = {"waypoints": ((2.5, -5.0), (2.5, 5.0)), "speed_mps": 3.0}
    scenes = started_simulation("flat", 6, actors=[walk], sensors=SEEING)
    seen, unseen = 0, 0
    for _ in range(25):
        scenes.step(rest(scenes))
        rover = scenes.state.groups["rover"]
        offset = rover.neighbours[:, 0, :2] - rover.motion.position_w[:, :2]
        bearing = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - rover.motion.yaw)
        apart = np.hypot(*offset.T)
        there = (scenes.observe()["camera_segmentation"] == Segment.ACTOR).any(axis=(1, 2, 3, 4))
        ahead, aside = (np.abs(bearing) < 0.4) & (apart < 5.0), (np.abs(bearing) > 1.0) & (apart > 1.0)
        assert there[ahead].all()
        assert not there[aside].any()
        seen, unseen = seen + ahead.sum(), unseen + aside.sum()
    scenes.close()
    assert seen > 5 and unseen > 5


SEEING = {
    "enabled": ["camera", "goal"],
    "camera": {"width": 16, "height": 12, "outputs": ["rgb", "depth", "segmentation"]},
}


SHORT = {"terminations": {"time_limit": {"max_steps": 6}}}


@pytest.fixture(scope="module")
def parallel():
    env = dune_rl.parallel_env("flat", sensors=SEEING, task=SHORT, actors="walkers")
    yield env
    env.close()


def test_the_pettingzoo_environment_with_a_camera_keeps_the_rules(parallel):
    check_parallel_api(parallel, 20)
    check_kept(parallel, 8)
    space = parallel.observation_space("rover_0")
    assert set(space) == {"camera_rgb", "camera_depth", "camera_segmentation", "goal"}
    assert space["camera_rgb"] == gymnasium.spaces.Box(0, 255, (12, 16, 3), np.uint8)
    assert space["camera_depth"] == gymnasium.spaces.Box(0.0, 100.0, (12, 16, 1), np.float32)
    observed = parallel.reset(seed=2)[0]["rover_0"]
    assert space.contains(observed)
    assert observed["camera_rgb"].dtype == observed["camera_segmentation"].dtype == np.uint8
    assert np.ptp(observed["camera_rgb"]) > 50


def test_equal_seeds_take_equal_pictures():
    check_seeding(lambda: dune_rl.parallel_env("flat", sensors=SEEING, task=SHORT), 14)


@pytest.mark.slow
def test_the_gymnasium_environment_with_a_camera_keeps_the_rules():
    env = gymnasium.make("dune_rl/Flat-v0", sensors=SEEING, task=SHORT).unwrapped
    check_gymnasium(env)
    assert env.observation_space["camera_rgb"].dtype == np.uint8
    env.close()


@pytest.mark.parametrize("scenes", [1, 3])
def test_the_torchrl_environment_with_a_camera_keeps_the_rules(scenes):
    env = dune_rl.make(
        "flat", scenes, sensors=SEEING, task={"terminations": {"time_limit": {"max_steps": 2}}}
    )
    check_torchrl(env)
    spec = env.observation_spec["rover", "observation", "camera_rgb"]
    assert str(spec.dtype) == "torch.uint8"
    assert spec.shape == (scenes, 1, 12, 16, 3)
    assert (int(spec.low.min()), int(spec.high.max())) == (0, 255)
    env.close()


@pytest.mark.slow
def test_a_list_of_sensors_is_short_for_those_enabled():
    short, long = (
        compose(Conf, ["+world=flat", f"{name}=[camera,lidar]"]).sensors
        for name in ("sensors", "sensors.enabled")
    )
    assert short == long
    assert list(short) == ["camera", "lidar"]
    envs = [
        dune_rl.parallel_env("flat", **words)
        for words in (
            {"sensors": ["camera", "goal"]},
            {"sensors": {"enabled": ["camera", "goal"]}},
            {"overrides": ["sensors=[camera,goal]"]},
        )
    ]
    spaces = [env.observation_space("rover_0") for env in envs]
    assert list(spaces[0]) == ["camera_rgb", "goal"]
    assert spaces[0]["camera_rgb"].shape == (64, 64, 3)
    first, *others = (env.reset(seed=3)[0]["rover_0"] for env in envs)
    for space, other in zip(spaces[1:], others, strict=True):
        assert space == spaces[0]
        assert all(other[name].tobytes() == first[name].tobytes() for name in first)
    for env in envs:
        env.close()
