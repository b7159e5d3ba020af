"""The LiDAR against geometry worked out by other means."""

import numpy as np
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from poses import seen_at
from pydantic import ValidationError
from scanning import flat_with, lidar_in, turned
from scenes import about
from sensor_contexts import context_of, rays_of
from sensors_of_rover_zero import lidar_conf
from simulations import rest, started_simulation
from states import group_state, measure, standing_at

from dune_rl.bodies.person import PersonConf
from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.heightfield import HeightField
from dune_rl.sensors.lidar import LidarSensor, beam_angles
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.inspection.build import InspectionConf
from dune_rl.worlds.world import World

CONF = lidar_conf()
LEVEL = np.eye(3)
STANDING = np.array([0.0, 0.0, 0.125])
NOBODY = np.zeros((1, 0, 7))
PERSON = PersonConf()
MAST_M = 0.125 + CONF.mount_b[2]


def mount(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    return position + rotation @ np.asarray(CONF.mount_b)


def beams_w(rotation: np.ndarray) -> np.ndarray:
    bearing = -np.pi + 2 * np.pi / 128 * np.arange(128)
    return np.array([rotation @ [np.cos(a), np.sin(a), 0.0] for a in bearing])


def range_to_box(origin: np.ndarray, direction: np.ndarray, shape: tuple[float, ...]) -> float:
    """Slabs: the last entry is before the first exit."""
    x, y, yaw, length, width = shape
    into = turned(yaw).T
    start, along = into @ (origin - [x, y, 0.0]), into @ direction
    with np.errstate(divide="ignore"):
        times = (np.array([[-length / 2, length / 2], [-width / 2, width / 2]]) - start[:2, None]) / along[
            :2, None
        ]
    entry, leave = times.min(axis=1).max(), times.max(axis=1).min()
    return entry if 0.0 < entry < leave else np.inf


def range_to_pole(origin: np.ndarray, direction: np.ndarray, centre: np.ndarray, radius: float) -> float:
    offset = centre[:2] - origin[:2]
    along = offset @ direction[:2]
    aside = offset @ offset - along**2
    return along - np.sqrt(radius**2 - aside) if aside < radius**2 and along > 0 else np.inf


def test_a_full_circle_leaves_out_its_last_beam():
    angles = beam_angles(CONF)
    assert angles.shape == (128,)
    assert angles[0] == pytest.approx(-np.pi)
    np.testing.assert_allclose(np.diff(angles), 2 * np.pi / 128)
    assert angles[-1] + 2 * np.pi / 128 == pytest.approx(np.pi)


def test_part_of_a_circle_has_beams_at_both_ends():
    angles = beam_angles(lidar_conf(n_beams=5, n_segments=5, fov_deg=np.rad2deg(2.0)))
    np.testing.assert_allclose(angles, [-1.0, -0.5, 0.0, 0.5, 1.0])


@pytest.mark.parametrize("yaw", [0.0, 1.0])
def test_nothing_returns_on_a_plane_not_even_the_rover(yaw):
    ranges = lidar_in(build_flat(FlatConf())).ranges(STANDING[None], turned(yaw)[None], NOBODY)
    assert ranges.shape == (1, 128)
    np.testing.assert_array_equal(ranges, np.float32(12.0))


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.0, 0.0, 0.0), (-1.0, 2.0, 0.7), (1.5, -2.0, -2.9)])
def test_boxes_stand_where_geometry_says(x, y, yaw):
    boxes = [
        (4.0, 0.0, 0.0, 1.0, 2.0),
        (-3.0, 4.0, 0.6, 2.0, 0.3),
        (0.0, -6.0, 1.2, 3.0, 3.0),
        (11.0, 0, 0, 1, 9),
    ]
    position, rotation = np.array([x, y, 0.125]), turned(yaw)
    ranges = lidar_in(flat_with(*boxes)).ranges(position[None], rotation[None], NOBODY)[0]
    origin = mount(position, rotation)
    expected = [
        min(12.0, *(range_to_box(origin, beam, shape) for shape in boxes)) for beam in beams_w(rotation)
    ]
    assert 20 < np.sum(np.array(expected) < 12.0) < 120
    np.testing.assert_allclose(ranges, expected, atol=1e-3)


def test_the_first_beam_looks_back_and_they_run_counter_clockwise():
    for beam, (x, y) in {0: (-3.0, 0.0), 32: (0.174, -3.0), 64: (3.0, 0.0), 96: (0.174, 3.0)}.items():
        ranges = lidar_in(flat_with((x, y, 0.0, 0.2, 0.2))).ranges(STANDING[None], LEVEL[None], NOBODY)[0]
        assert np.argmin(ranges) == beam
        assert ranges[beam] == pytest.approx(np.hypot(x - 0.174, y) - 0.1, abs=1e-3)


@pytest.mark.parametrize("pitch", [0.1, 0.3, -0.2])
def test_a_tilted_lidar_sees_the_ground(pitch):
    rotation = rotation_matrices(about([0, 1, 0], pitch))
    ranges = lidar_in(build_flat(FlatConf())).ranges(STANDING[None], rotation[None], NOBODY)[0]
    with np.errstate(divide="ignore"):
        to_ground = -mount(STANDING, rotation)[2] / beams_w(rotation)[:, 2]
    expected = np.where((to_ground > 0) & (to_ground < 12.0), to_ground, 12.0)
    assert (expected < 12.0).sum() > 20
    np.testing.assert_allclose(ranges, expected, atol=1e-2)


@pytest.mark.parametrize(
    "people", [[(4.0, 0.0)], [(0.0, 3.0), (0.0, 5.0)], [(-2.0, -2.0), (1.0, 1.0), (6.0, 0.1)]]
)
def test_people_stand_where_geometry_says(people):
    poses = np.array([[x, y, 0.0, 0.3 * i] for i, (x, y) in enumerate(people)])
    lidar = lidar_in(build_flat(FlatConf()), (PERSON,) * len(people))
    ranges = lidar.ranges(STANDING[None], LEVEL[None], seen_at(poses[None]))[0]
    origin = mount(STANDING, LEVEL)
    # Between the circle and the sixteen sides that are drawn for it lie up to 5 mm.
    near, far = (
        np.array(
            [
                min(12.0, *(range_to_pole(origin, beam, pose, radius) for pose in poses))
                for beam in beams_w(LEVEL)
            ]
        )
        for radius in (0.25, 0.25 * np.cos(np.pi / 16))
    )
    assert (ranges < 12.0).any()
    assert ((ranges > near - 1e-3) & (ranges < far + 1e-3)).all()
    straight = near < 12.0
    assert np.median(np.abs(ranges - near)[straight]) < 0.01


def test_actors_of_two_sizes_keep_their_own_shapes():
    thin, tall = PersonConf(radius_m=0.1, height_m=0.25), PersonConf(radius_m=0.5, height_m=2.0)
    poses = np.array([[0.174, 3.0, 0, 0], [3.0, 0, 0, 0], [0.174, -3.0, 0, 0], [-3.0, 0, 0, 0.0]])
    lidar = lidar_in(build_flat(FlatConf()), (tall, thin, tall, thin))
    ranges = lidar.ranges(STANDING[None], LEVEL[None], seen_at(poses[None]))[0]
    # The thin ones are lower than the mast, which meets the tall ones in their rounded feet.
    tall_range = 3.0 - np.sqrt(0.5**2 - (0.5 - MAST_M) ** 2)
    np.testing.assert_allclose(ranges[[96, 64, 32, 0]], [tall_range, 12.0, tall_range, 12.0], atol=0.01)


def test_an_actor_stands_on_its_ground_height():
    lidar = lidar_in(build_flat(FlatConf()), (PERSON,))
    for height, seen in ((0.0, True), (MAST_M - 1.74, True), (MAST_M - 1.76, False), (MAST_M + 0.01, False)):
        ranges = lidar.ranges(STANDING[None], LEVEL[None], seen_at([[[3.0, 0.0, height, 0.0]]]))[0]
        # Near its ends a capsule is narrow, so its middle is all that is asked for.
        assert (ranges[64] < 12.0) == seen


def test_boxes_hide_actors_and_actors_boxes():
    world = flat_with((4.0, 0.0, 0.0, 1.0, 1.0))
    lidar = lidar_in(world, (PERSON,))
    for x, expected in ((6.0, 3.5), (2.0, 1.75)):
        ranges = lidar.ranges(STANDING[None], LEVEL[None], seen_at([[[x, 0.0, 0.0, 0.0]]]))[0]
        assert ranges[64] == pytest.approx(expected - 0.174, abs=2e-3)


def test_scenes_do_not_see_each_other_s_actors():
    world = flat_with((4.0, 1.0, 0.0, 1.0, 1.0))
    lidar = lidar_in(world, (PERSON, PERSON))
    rng = np.random.default_rng(0)
    positions = np.column_stack([rng.uniform(-3, 3, (6, 2)), np.full(6, 0.125)])
    rotations = np.array([turned(yaw) for yaw in rng.uniform(-3, 3, 6)])
    poses = np.concatenate([rng.uniform(-5, 5, (6, 2, 2)), np.zeros((6, 2, 2))], axis=-1)
    poses = seen_at(poses)
    together = lidar.ranges(positions, rotations, poses)
    assert len({row.tobytes() for row in together}) == 6
    for i in range(6):
        alone = lidar.ranges(positions[i : i + 1], rotations[i : i + 1], poses[i : i + 1])
        np.testing.assert_array_equal(alone[0], together[i])


def test_a_return_inside_the_least_range_reads_the_least_range():
    ranges = lidar_in(flat_with((0.244, 0.0, 0.0, 0.04, 1.0))).ranges(STANDING[None], LEVEL[None], NOBODY)
    assert ranges[0, 64] == np.float32(0.1)


def test_a_segment_is_the_nearest_of_its_four_beams():
    lidar = lidar_in(build_flat(FlatConf()))
    ranges = np.random.default_rng(0).uniform(0.1, 12.0, (3, 128)).astype(np.float32)
    segments = lidar.segments(ranges)
    assert segments.shape == (3, 32)
    for scene in range(3):
        for k in range(32):
            assert segments[scene, k] == min(ranges[scene, 4 * k : 4 * k + 4])


def test_faulty_lidar_settings_are_refused():
    with pytest.raises(ValidationError, match="n_segments must divide n_beams"):
        lidar_conf(n_segments=33)
    with pytest.raises(ValidationError, match="min_range_m"):
        lidar_conf(min_range_m=12.0)


@pytest.fixture(scope="module")
def inspection_in_bullet():
    """The inspection site as PyBullet's own triangles, to cast PyBullet's own rays at."""
    world = build_world(InspectionConf(seed=3))
    client = pybullet.connect(pybullet.DIRECT)
    meshes = [world.terrain.mesh(), *((p.vertices, p.faces) for p in world.props if p.solid)]
    for vertices, faces in meshes:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=vertices.tolist(),
            indices=faces.ravel().tolist(),
            flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            physicsClientId=client,
        )
        pybullet.createMultiBody(0.0, shape, physicsClientId=client)
    yield world, client
    pybullet.disconnect(client)


def test_rays_agree_with_the_physics_engine_s(inspection_in_bullet):
    world, client = inspection_in_bullet
    lidar = lidar_in(world)
    rng = np.random.default_rng(5)
    xmin, xmax, ymin, ymax = world.region
    returns = 0
    for _ in range(8):
        xy = rng.uniform([xmin, ymin], [xmax, ymax])
        rotation = rotation_matrices(about([0, 0, 1], rng.uniform(-3, 3))) @ rotation_matrices(
            about([1, 0, 0], rng.uniform(-0.2, 0.2))
        )
        position = np.array([*xy, world.terrain.height(xy) + 0.2])
        ranges = lidar.ranges(position[None], rotation[None], NOBODY)[0]
        origin, beams = mount(position, rotation), beams_w(rotation)
        slow = pybullet.rayTestBatch(
            [origin.tolist()] * 128, (origin + 12.0 * beams).tolist(), physicsClientId=client
        )
        expected = np.maximum([12.0 * hit[2] for hit in slow], CONF.min_range_m)
        # A ray within rounding of an edge may go either way: one of 128 is forgiven.
        assert np.sum(np.abs(ranges - expected) > 0.01) <= 1
        returns += np.sum(expected < 12.0)
    assert returns > 200


@settings(max_examples=60)
@given(
    st.floats(-6, 6),
    st.floats(-6, 6),
    st.floats(-1, 3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-1, 1), st.floats(-4, 4)),
)
def test_whatever_the_pose_ranges_are_within_range(x, y, z, quaternion, actor):
    heights = np.random.default_rng(0).normal(0.0, 0.5, (13, 13))
    world = World("lumpy", HeightField(heights, 1.0, (-6.0, -6.0)), region=(-4, 4, -4, 4))
    lidar = lidar_in(world, (PERSON,))
    unit = np.array(quaternion) / np.linalg.norm(quaternion)
    ranges = lidar.ranges(np.array([[x, y, z]]), rotation_matrices(unit)[None], seen_at([[actor]]))
    assert ranges.dtype == np.float32
    assert (ranges >= np.float32(0.1)).all()
    assert (ranges <= np.float32(12.0)).all()
    segments = lidar.segments(ranges)
    assert (segments <= ranges.reshape(1, 32, 4).max(axis=2)).all()
    assert set(segments.ravel()) <= set(ranges.ravel())


def test_a_moving_actor_is_seen_where_it_is_at_that_instant():
    walk = {"waypoints": ((3.0, -4.0), (3.0, 4.0)), "speed_mps": 2.0}
    scenes = started_simulation("flat", 2, seed=4, actors=[walk])
    seen = 0
    for _ in range(60):
        scenes.step(rest(scenes))
        lidar = scenes.observe()["lidar"][:, 0]
        rover = scenes.state.groups["rover"]
        for scene in range(2):
            origin = mount(rover.motion.position_w[scene], rover.motion.rotation[scene])
            offset = rover.neighbours[scene, 0, :2] - origin[:2]
            apart = np.hypot(*offset)
            if not 1.0 < apart < 6.0:
                continue
            seen += 1
            # 0.1 m of walking lies between this step and the one before; beams lie 0.05 rad apart.
            assert lidar[scene].min() == pytest.approx(apart - 0.25, abs=0.02)
    scenes.close()
    assert seen > 30


RINGS_DEG = (-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0)


def test_a_lidar_of_rings_sees_what_stands_on_ground_and_not_the_ground() -> None:
    """Nose down by 10 degrees, a level ring meets the ground 1.9 m ahead."""
    world = flat_with((4.0, 0.0, 0.0, 1.0, 12.0))
    context = context_of(solid=rays_of(world))
    now = group_state(standing_at(np.array([STANDING]), np.zeros(1), pitch=np.deg2rad(10.0)))
    ahead = {}
    for rings_deg in ((), RINGS_DEG):
        sensor = LidarSensor("lidar", context, lidar_conf(n_segments=128, rings_deg=rings_deg))
        measure(sensor, now)
        ahead[rings_deg] = sensor.read()["lidar"][0, 64]
    mount_x = mount(STANDING, now.motion.rotation[0])[0]
    assert ahead[()] < 2.1
    assert ahead[RINGS_DEG] == pytest.approx(3.5 - mount_x, abs=1e-3)


@pytest.mark.parametrize("rings_deg", [[0.0], [4.0, 2.0], [1.0, 1.0]])
def test_the_elevations_of_rings_rise(rings_deg: list[float]) -> None:
    with pytest.raises(ValidationError, match="rings_deg must be at least two rising elevations, or none"):
        lidar_conf(rings_deg=rings_deg)


def test_rings_have_no_more_rays_than_a_machine_can_cast() -> None:
    with pytest.raises(ValidationError, match=r"17 rings of n_beams=16384 are more than 262,144 rays"):
        lidar_conf(n_beams=16_384, n_segments=16_384, rings_deg=list(range(17)))


def test_rings_with_faults_and_in_haze_stay_within_bounds() -> None:
    words = ["sensors=perception_3d", "sensors.lidar.realism=rplidar_a2m8", "weather=fog", "actors=walkers"]
    conf = compose_environment("inspection", [*words, "+sensors.command_costs={}"])
    simulation = make_simulation(conf, 2, 0)
    simulation.reset()
    for _ in range(8):
        simulation.step({"rover": np.zeros((2, 1, 2))})
    bounds = simulation.group("rover").observation_bounds
    found = simulation.observe("rover")
    for name, reading in found.items():
        low, high = bounds[name]
        assert ((reading >= low - 1e-5) & (reading <= high + 1e-5)).all(), name
    assert found["lidar"].min() < 12.0
    simulation.close()
