"""Sensors of several agents in a scene read what those of single agents in equal scenes do."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from cameras import AHEAD, Box, standing
from grass_samples import EVERYWHERE
from people import meshes_of
from scenes import STEP_S, about
from states import group_state, joints_from, motion_of, state_of

from dune_rl.bodies.person import PersonConf
from dune_rl.env.sensing import sensor_context
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.shared_per_scene import SharedPerScene
from dune_rl.rendering.foliage import BatchedFoliage
from dune_rl.rendering.participating_media import BeamMedia
from dune_rl.rendering.weather import Haze, WeatherConf
from dune_rl.sensors.conf import parse_sensors
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.settings import SensorSettings
from dune_rl.sensors.suite import SensorSuite
from dune_rl.sensors.wheels import DriveGeometry
from dune_rl.state import GroupState
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

AGENTS, SCENES, WHEELS = 3, 2, 4
ROWS = SCENES * AGENTS


def hilly(seed: int, *boxes: Box) -> World:
    """Uneven ground, 30 by 30 m, with boxes on it."""
    heights = np.random.default_rng(seed).uniform(-0.3, 0.1, (31, 31))
    props = [standing(f"box_{i}", box) for i, box in enumerate(boxes)]
    return World("hilly", HeightField(heights, 1.0, (-15.0, -15.0)), props, region=(-4, 4, -4, 4))


WORLDS = (
    hilly(1, AHEAD, (0.0, 4.0, 0.3, 3.0, 0.5, 2.0)),
    hilly(2, (-3.0, 0.5, 0.7, 1.0, 1.0, 0.4), (1.5, -1.0, 0.0, 0.5, 0.5, 0.3)),
)
WALKERS = (PersonConf(), PersonConf(radius_m=0.4, height_m=1.2))
CARRIER = SensorCarrier(
    scanner_b=(0.1, 0.05, 0.2),
    camera_b=(0.2, 0.0, 0.3),
    imu_b=(0.1, -0.1, 0.05),
    camera_pitch_deg=6.0,
    standing_height_m=0.12,
    num_joints=WHEELS,
    drive=DriveGeometry(0.12, 0.4, (0, 2), (1, 3)),
)
SMALL = {
    "camera": {"outputs": ["rgb", "grey", "depth", "segmentation", "normals"], "width": 12, "height": 8},
    "lidar_3d": {"outputs": ["range", "intensity", "segmentation"], "n_rings": 4, "n_beams": 24},
    **{
        "bare_ground": {"sensor": "height_scan", "source": "terrain"},
        "rear": {
            "sensor": "camera",
            "width": 6,
            "height": 4,
            "pitch_deg": 17.0,
            "realism": "raspberry_pi_v2",
        },
    },
}
KINDS = (
    ["lidar", "lidar_past"],
    ["camera"],
    ["rear"],
    ["lidar_3d"],
    ["depth_strip"],
    ["height_scan"],
    ["bare_ground"],
    ["imu"],
    ["goal"],
    ["velocity"],
    ["encoders"],
    ["odometry"],
    ["currents"],
    ["position"],
)
FAULTS = {
    "imu": "mpu6050",
    "lidar": "dune_paper",
    "lidar_3d": {"noise_m": 0.1, "dropout": 0.1},
    "depth_strip": {"each": {"noise": 0.1}},
    "camera": "raspberry_pi_v2",
    "encoders": {"turn": {"bias": 0.1}, "latency_s": 0.05},
    "odometry": {"place": {"bias_walk": 0.1}, "rate_hz": 10},
    "position": {"place": {"noise": 0.3}, "rate_hz": 10},
}


def context(worlds: tuple, rows: int, air: Callable[[int], BeamMedia] | None = None) -> SensorContext:
    sites = BatchedWorlds([(world, WeatherConf()) for world in worlds])
    found = sensor_context(sites, CARRIER, meshes_of(WALKERS), num_rows=rows, step_s=STEP_S)
    return found if air is None else replace(found, air=air(len(worlds)))


def thick_air(scenes: int) -> BeamMedia:
    """Haze, and grass in every second scene of the group."""
    grass = [EVERYWHERE if scene < scenes // 2 else None for scene in range(scenes)]
    return BeamMedia(
        Haze.from_weather(WeatherConf(fog_visibility_m=15.0)), BatchedFoliage(SharedPerScene(grass))
    )


def states(step: int, rng: np.random.Generator) -> tuple[GroupState, GroupState]:
    """The same bodies as agents of two scenes, and each alone in a scene of its own."""
    bodies = np.zeros((ROWS, 13))
    bodies[:, :2] = rng.uniform(-2.5, 2.5, (ROWS, 2))
    bodies[:, 2] = 0.12
    bodies[:, 3:7] = [about([0.1, 0.2, np.sqrt(0.95)], yaw) for yaw in rng.uniform(-3, 3, ROWS)]
    bodies[:, 7:] = rng.normal(size=(ROWS, 6))
    neighbours = rng.uniform(-4.0, 4.0, (ROWS, len(WALKERS), 4)) * [1, 1, 0, 1]
    joints = joints_from(rng.normal(size=(ROWS, 3 * WHEELS)))
    episodes = {"streams": 7 + np.arange(ROWS), "steps": np.full(ROWS, step), "seed": 3}
    together, apart = (
        group_state(motion_of(bodies, joints), neighbours, count=count, **episodes) for count in (AGENTS, 1)
    )
    return together, apart


@pytest.mark.slow(all_but=["currents-perfect", "odometry-faulty"])
@pytest.mark.parametrize("faulty", [False, True], ids=["perfect", "faulty"])
@pytest.mark.parametrize("enabled", KINDS, ids=lambda names: names[0])
def test_three_agents_in_a_scene_read_what_three_scenes_do(enabled, faulty):
    faults = FAULTS if faulty else {}
    entries = {
        name: {**entry, "realism": faults[name]} if name in enabled and name in faults else entry
        for name, entry in {**{kind: {} for kind in FAULTS}, **SMALL}.items()
    }
    assert_same(parse_sensors({**entries, "enabled": enabled}), None)


@pytest.mark.parametrize(
    "enabled", [["lidar", "lidar_past"], ["lidar_3d"], ["depth_strip"]], ids=lambda n: n[0]
)
def test_agents_of_a_scene_share_its_air(enabled):
    assert_same(parse_sensors({**SMALL, "enabled": enabled}), thick_air)


def assert_same(conf: Mapping[str, SensorSettings], air: Callable[[int], BeamMedia] | None) -> None:
    """Two scenes of three agents, and six of one agent, read the same at each begin and step."""
    scenes = SensorSuite(conf, context(WORLDS, ROWS, air))
    singles = SensorSuite(conf, context(tuple(np.repeat(np.array(WORLDS, object), AGENTS)), ROWS, air))
    rng, everywhere = np.random.default_rng(1), np.ones(ROWS, bool)
    seen = []
    for step in range(5):
        together, apart = states(step, rng)
        late = everywhere if step == 0 else np.array([False, True, False, False, False, True])
        for suite, now in ((scenes, together), (singles, apart)):
            if step in (0, 3):
                suite.begin(late, now, state_of(now))
            else:
                suite.measure(now, state_of(now))
        one, other = scenes.observe(), singles.observe()
        assert list(one) == list(other) == list(scenes.bounds)
        for name, reading in one.items():
            low, high = scenes.bounds[name]
            assert reading.shape == (ROWS, *low.shape) and reading.dtype == low.dtype
            assert (low <= reading).all() and (reading <= high).all()
            np.testing.assert_array_equal(reading, other[name], err_msg=f"{name} at step {step}")
        seen.append(one)
    # What does not change with the pose would pass for any mixture of rows.
    for name in seen[0]:
        assert name == "goal" or (seen[0][name] != seen[2][name]).any()
        assert name == "goal" or len({row.tobytes() for row in seen[2][name]}) > 1
