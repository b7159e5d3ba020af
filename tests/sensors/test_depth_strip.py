"""The depth strip against geometry worked out by other means."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from people import meshes_of
from poses import seen_at
from pydantic import ValidationError
from scanning import flat_with, turned
from scenes import about
from sensor_contexts import context_of, rays_of
from sensors_of_rover_zero import depth_strip_conf
from states import begin, measure, state_at

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.sensors.depth_strip import DepthStrip, DepthStripConf
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

STANDING = np.array([0.0, 0.0, 0.125])
LEVEL = np.eye(3)
NOBODY = np.zeros((1, 0, 7))
PERSON = PersonConf()
# The middles of 32 columns over 86 degrees, and the lowest elevation.
BEARINGS = np.deg2rad(86.0) * ((np.arange(32) + 0.5) / 32 - 0.5)
LOWEST = np.deg2rad(-3.4)


def strip_in(
    world: World, actors: tuple[PersonConf, ...] = (), scenes: int = 1, **conf: object
) -> DepthStrip:
    context = context_of(scenes, solid=rays_of(world), meshes=meshes_of(actors))
    return DepthStrip("depth_strip", context, depth_strip_conf(**conf))


def depths(
    strip: DepthStrip,
    position: np.ndarray = STANDING,
    rotation: np.ndarray = LEVEL,
    actors: np.ndarray = NOBODY,
) -> np.ndarray:
    return strip.depths(position[None], rotation[None], seen_at(actors))[0]


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_on_level_ground_nothing_is_near(yaw):
    found = depths(strip_in(build_flat(FlatConf())), rotation=turned(yaw))
    np.testing.assert_array_equal(found, np.float32(5.0))


def test_a_wall_ahead_is_as_far_as_geometry_says():
    found = depths(strip_in(flat_with((3.0, 0.0, 0.0, 0.2, 20.0))))
    np.testing.assert_allclose(found, (2.9 - 0.174) / np.cos(BEARINGS), rtol=1e-4)


def test_depth_is_level_whichever_ray_meets_the_wall():
    wall = Prop("wall", "wall", *upright_box((3.0, 0.0), 0.0, 0.6, 2.0, 0.2, 20.0))
    world = World("test", build_flat(FlatConf()).terrain, [wall], region=(-4, 4, -4, 4))
    # Only the upper rays reach a wall that hangs over the ground.
    found = depths(strip_in(world))
    np.testing.assert_allclose(found[12:20], (2.9 - 0.174) / np.cos(BEARINGS[12:20]), rtol=1e-4)
    level = depths(strip_in(world, rows=1, lowest_elevation_deg=0.0, highest_elevation_deg=0.0))
    np.testing.assert_array_equal(level, np.float32(5.0))


def test_a_low_step_is_seen_by_the_lowest_row():
    step = Prop("step", "box", *upright_box((2.5, 0.0), 0.0, -0.1, 0.24, 0.4, 20.0))
    world = World("test", build_flat(FlatConf()).terrain, [step], region=(-4, 4, -4, 4))
    found = depths(strip_in(world))
    # 2.126 m ahead, the lowest ray is 0.321 - 2.126 tan 3.4° = 0.195 m over the ground.
    np.testing.assert_allclose(found[15:17], 2.3 - 0.174, atol=0.01)


def test_columns_run_counter_clockwise():
    found = depths(strip_in(flat_with((2.0, 0.7, 0.0, 0.4, 0.4))))
    seen = np.flatnonzero(found < 5.0)
    left = np.arctan2(0.7, 2.0 - 0.174)
    assert len(seen) >= 4
    assert abs(BEARINGS[seen].mean() - left) < 0.05


def test_one_column_looks_ahead_and_a_full_circle_repeats_none():
    world = flat_with((2.0, 0.0, 0.0, 0.4, 0.4))
    assert depths(strip_in(world, columns=1))[0] == pytest.approx(1.8 - 0.174, abs=1e-3)
    round_about = strip_in(flat_with((-2.0, 0.0, 0.0, 0.4, 0.4)), columns=4, fov_deg=360.0)
    # Columns look 135 degrees to the right, 45 to the right, 45 and 135 to the left.
    spots = [(-1.5, -1.5), (1.5, -1.5), (1.5, 1.5), (-1.5, 1.5)]
    for column, (x, y) in enumerate(spots):
        world = flat_with((x + 0.174, y, 0.0, 0.6, 0.6))
        found = depths(strip_in(world, columns=4, fov_deg=360.0))
        assert np.flatnonzero(found < 5.0).tolist() == [column]
    np.testing.assert_array_equal(depths(round_about), np.float32(5.0))


def test_a_rover_that_dips_its_nose_sees_the_ground():
    rotation = rotation_matrices(about([0, 1, 0], 0.2))
    found = depths(strip_in(build_flat(FlatConf())), rotation=rotation)
    mast = 0.125 - np.sin(0.2) * 0.174 + np.cos(0.2) * 0.196
    # In the middle, rays that fall by 0.2 and by their own elevation: the lowest is the nearest.
    bearing = BEARINGS[16]
    down = np.sin(0.2) * np.cos(LOWEST) * np.cos(bearing) - np.cos(0.2) * np.sin(LOWEST)
    assert found[16] == pytest.approx(mast / down * np.cos(LOWEST), rel=1e-3)


def test_people_are_seen_and_the_nearest_counts():
    strip = strip_in(flat_with((4.0, 0.0, 0.0, 0.2, 20.0)), (PERSON, PERSON))
    wall = (3.9 - 0.174) / np.cos(BEARINGS)
    for order in ([0, 1], [1, 0]):
        people = np.array([[2.5, 0.0, 0.0, 0.3], [1.5, 0.0, 0.0, 0.0]])[order]
        found = depths(strip, actors=people[None])
        assert found[15:17].max() == pytest.approx(1.5 - 0.25 - 0.174, abs=0.02)
        assert (found <= wall + 1e-3).all()
        np.testing.assert_allclose(found[[0, 31]], wall[[0, 31]], rtol=1e-4)
    gone = depths(strip, actors=np.full((1, 2, 3), 30.0))
    np.testing.assert_allclose(gone, wall, rtol=1e-4)


def test_scenes_are_independent_and_the_reading_fits_its_bounds():
    strip = strip_in(flat_with((3.0, 0.5, 0.4, 1.0, 1.0)), (PERSON,), scenes=3)
    rng = np.random.default_rng(1)
    positions = np.column_stack([rng.uniform(-1, 1, (3, 2)), np.full(3, 0.125)])
    yaws = np.array([0.0, 0.3, -0.2])
    actors = np.concatenate([rng.uniform(0, 3, (3, 1, 2)), np.zeros((3, 1, 2))], axis=-1)
    begin(strip, np.ones(3, bool), state_at(positions, yaws, actors))
    ((name, (low, high)),) = strip.bounds().items()
    reading = strip.read()[name]
    assert name == "depth_strip"
    assert reading.shape == (3, 32) == (3, *low.shape)
    assert reading.dtype == low.dtype == high.dtype == np.float32
    for scene in range(3):
        alone = depths(strip, positions[scene], turned(yaws[scene]), actors[[scene]])
        np.testing.assert_allclose(reading[scene], alone, atol=1e-5)
    assert len({row.tobytes() for row in reading}) == 3
    reading[:] = -1.0
    assert strip.read()[name].min() >= 0.0
    measure(strip, state_at(positions + 0.2, yaws, actors))
    assert (strip.read()[name] != reading).any()


_STRIP = strip_in(flat_with((2.0, 1.0, 0.3, 1.0, 1.0)), (PERSON,))


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-1, 3)),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-1, 1), st.floats(-4, 4)),
)
def test_whatever_the_pose_depths_are_within_range(position, quaternion, actor):
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    found = depths(_STRIP, np.array(position), rotation, np.array([[actor]]))
    low, high = _STRIP.bounds()["depth_strip"]
    assert (found >= low).all()
    assert (found <= high).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"columns": 0}, r"columns[\s\S]*greater than or equal to 1"),
        ({"rows": 0}, r"rows[\s\S]*greater than or equal to 1"),
        ({"range_m": -5.0}, r"range_m[\s\S]*greater than 0"),
        ({"fov_deg": 0.0}, r"fov_deg[\s\S]*greater than 0"),
        ({"lowest_elevation_deg": -91.0}, r"lowest_elevation_deg[\s\S]*greater than or equal to -90"),
        ({"highest_elevation_deg": 91.0}, r"highest_elevation_deg[\s\S]*less than or equal to 90"),
        ({"highest_elevation_deg": -3.4}, r"lowest_elevation_deg \(-3.4\) must be less than"),
        ({"rows": 1}, r"must equal highest_elevation_deg \(13.8\) where rows=1"),
    ],
)
def test_faulty_settings_are_refused(wrong, message):
    with pytest.raises(ValidationError, match=message):
        DepthStripConf(**wrong)
