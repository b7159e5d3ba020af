"""The height scan against heights worked out by other means."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scanning import flat_with
from sensor_contexts import context_of, rays_of
from sensors_of_rover_zero import height_scan_conf
from states import begin, measure, state_at

from dune_rl.geometry.heightfield import HeightField
from dune_rl.sensors.height_scan import HeightScan, HeightScanConf
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

STANDING = np.array([0.0, 0.0, 0.125])
every_source = pytest.mark.parametrize("source", ["terrain", "solid"])


def scan_in(world: World, scenes: int = 1, **conf: object) -> HeightScan:
    context = context_of(scenes, solid=rays_of(world), terrain=world.terrain)
    return HeightScan("height_scan", context, height_scan_conf(**conf))


def heights(scan: HeightScan, position: np.ndarray = STANDING, yaw: float = 0.0) -> np.ndarray:
    """Of one rover, (rows, columns)."""
    found = scan.heights(position[None], np.array([yaw]))[0]
    return found.reshape(scan.conf.rows, scan.conf.columns)


def hilly(*props: Prop, rise: float = 0.1) -> World:
    """Ground that rises by `rise` toward x and falls by half as much toward y."""
    x, y = np.meshgrid(np.arange(-20.0, 21.0), np.arange(-20.0, 21.0))
    field = HeightField(rise * x - rise / 2 * y, 1.0, (-20.0, -20.0))
    return World("hilly", field, props, region=(-4, 4, -4, 4))


@every_source
def test_level_ground_reads_zero_where_the_rover_stands(source):
    scan = scan_in(build_flat(FlatConf()), source=source)
    np.testing.assert_allclose(heights(scan, np.array([3.0, -2.0, 0.125]), 1.0), 0.0, atol=1e-6)
    np.testing.assert_allclose(heights(scan, np.array([3.0, -2.0, 0.325])), -0.2, atol=1e-6)


@every_source
def test_the_first_row_is_the_nearest_and_columns_run_from_right_to_left(source):
    scan = scan_in(hilly(), source=source, rows=4, columns=5, spacing_m=0.5, ahead_m=1.0)
    ahead = 1.0 + 0.5 * np.arange(4)[:, None]
    left = 0.5 * np.arange(-2, 3)[None]
    np.testing.assert_allclose(heights(scan), 0.1 * ahead - 0.05 * left, atol=1e-5)
    # Heading along y, what is to the left lies toward -x.
    np.testing.assert_allclose(heights(scan, yaw=np.pi / 2), -0.1 * left - 0.05 * ahead, atol=1e-5)


@every_source
def test_an_even_number_of_columns_leaves_the_middle_between_two(source):
    scan = scan_in(hilly(), source=source, rows=1, columns=2, spacing_m=1.0, ahead_m=0.0)
    np.testing.assert_allclose(heights(scan)[0], [0.025, -0.025], atol=1e-5)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
def test_both_sources_agree_on_bare_ground(yaw):
    world = build_inspection(InspectionConf(seed=4))
    bare = World("bare", world.terrain, region=world.region)
    scans = [scan_in(bare, source=source) for source in ("terrain", "solid")]
    for xy in np.random.default_rng(1).uniform(-25, 25, (10, 2)):
        position = np.array([*xy, bare.terrain.height(xy) + 0.125])
        terrain, solid = (heights(scan, position, yaw) for scan in scans)
        np.testing.assert_allclose(solid, terrain, atol=1e-4)
        expected = bare.terrain.height(
            scans[0].points(position[None], np.array([yaw]))[0]
        ) - bare.terrain.height(xy)
        np.testing.assert_allclose(terrain.ravel(), np.clip(expected, -1.0, 1.0), atol=1e-5)


def boxed(bottom: float, top: float) -> World:
    box = Prop("box", "box", *upright_box((1.4, 0.4), 0.0, bottom, top, 0.41, 0.41))
    return World("test", build_flat(FlatConf()).terrain, [box], region=(-4, 4, -4, 4))


@pytest.mark.parametrize(
    ("bottom", "top", "seen"),
    [
        (-0.1, 0.3, 0.3),
        (-0.1, 0.95, 0.95),
        (-0.1, 1.5, 1.0),
        (-0.1, 8.0, 1.0),
        (0.5, 0.8, 0.8),
        (0.5, 3.0, 1.0),
        (1.1, 3.0, 0.0),
    ],
    ids=["step", "tall", "over the start", "wall", "shelf", "hangs low", "overhead"],
)
def test_things_are_as_high_as_their_tops(bottom, top, seen):
    found = heights(scan_in(boxed(bottom, top)))
    expected = np.zeros((11, 11))
    # Rows at 0.4, 0.6, ... and columns at -1.0, -0.8, ...: the box covers three by three.
    expected[4:7, 6:9] = seen
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_bare_terrain_knows_no_things():
    np.testing.assert_array_equal(heights(scan_in(boxed(-0.1, 0.3), source="terrain")), 0.0)


def test_a_deck_is_ground_and_water_is_not():
    deck = Prop("deck", "bridge", *upright_box((1.4, 0.0), 0.0, -0.05, 0.15, 1.0, 4.0), drivable=True)
    lake = Prop("lake", "water", *upright_box((1.4, 0.0), 0.0, -0.05, 0.4, 2.5, 4.0), solid=False)
    world = World("test", build_flat(FlatConf()).terrain, [deck, lake], region=(-4, 4, -4, 4))
    found = heights(scan_in(world, limit_m=0.5))
    np.testing.assert_allclose(found[3:8], 0.15, atol=1e-5)
    np.testing.assert_allclose(found[[0, 1, 9, 10]], 0.0, atol=1e-5)


def test_a_steep_hill_reads_the_limit_though_rays_start_inside_it():
    found = heights(scan_in(hilly(rise=2.0), columns=1, ahead_m=0.0))[:, 0]
    np.testing.assert_allclose(found, np.minimum(0.4 * np.arange(11), 1.0), atol=1e-4)
    down = heights(scan_in(hilly(rise=2.0), columns=1, ahead_m=0.0), yaw=np.pi)[:, 0]
    np.testing.assert_allclose(down, -found, atol=1e-4)


def test_beyond_the_edge_is_a_drop():
    world = build_flat(FlatConf(size_m=20.0))
    found = heights(scan_in(world), np.array([8.9, 0.0, 0.125]))
    np.testing.assert_allclose(found[:4], 0.0, atol=1e-6)
    np.testing.assert_array_equal(found[4:], -1.0)
    # The bare height field goes on as at its edge.
    assert (heights(scan_in(world, source="terrain"), np.array([8.9, 0.0, 0.125])) == 0.0).all()


@every_source
def test_the_grid_stays_level_when_the_rover_pitches(source):
    scan = scan_in(hilly(), 2, source=source)
    positions = np.array([[0.0, 0.0, 0.125], [2.0, 1.0, 0.275]])
    yaws = np.array([0.4, -1.0])
    begin(scan, np.array([True, True]), state_at(positions, yaws))
    level = scan.read()["height_scan"]
    measure(scan, state_at(positions, yaws, pitch=0.4))
    np.testing.assert_allclose(scan.read()["height_scan"], level, atol=1e-5)
    for scene in range(2):
        alone = heights(scan, positions[scene], yaws[scene])
        np.testing.assert_array_equal(level[scene], alone.ravel())


def test_the_reading_has_the_shape_and_type_of_its_bounds():
    scan = scan_in(flat_with((1.5, 0.0, 0.0, 0.4, 0.4)), 3, rows=4, columns=7)
    measure(scan, state_at(np.stack([STANDING] * 3), np.zeros(3)))
    ((name, (low, high)),) = scan.bounds().items()
    reading = scan.read()[name]
    assert name == "height_scan"
    assert reading.shape == (3, 28) == (3, *low.shape)
    assert reading.dtype == low.dtype == high.dtype == np.float32
    reading[:] = 5.0
    assert scan.read()[name].max() <= 1.0


_LUMPY = World(
    "lumpy",
    HeightField(np.random.default_rng(0).normal(0.0, 0.5, (13, 13)), 1.0, (-6.0, -6.0)),
    flat_with((1.0, 1.0, 0.3, 2.0, 0.5)).props,
    region=(-4, 4, -4, 4),
)
_SCANS = [scan_in(_LUMPY, source=source, limit_m=0.7) for source in ("terrain", "solid")]


@settings(max_examples=60, deadline=None)
@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3), st.floats(-4, 4))
def test_whatever_the_pose_heights_are_within_the_limit(x, y, z, yaw):
    for scan in _SCANS:
        found = heights(scan, np.array([x, y, z]), yaw)
        low, high = scan.bounds()["height_scan"]
        assert (found.ravel() >= low).all()
        assert (found.ravel() <= high).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rows": 0}, r"rows[\s\S]*greater than or equal to 1"),
        ({"columns": 0}, r"columns[\s\S]*greater than or equal to 1"),
        ({"spacing_m": 0.0}, r"spacing_m[\s\S]*greater than 0"),
        ({"limit_m": -1.0}, r"limit_m[\s\S]*greater than 0"),
        ({"above_m": -1.0}, r"above_m[\s\S]*greater than 0"),
        ({"above_m": 0.5}, r"above_m \(0.5\) must be at least limit_m \(1.0\)"),
        ({"standing_height_m": -0.1}, r"standing_height_m[\s\S]*greater than or equal to 0"),
        ({"source": "mesh"}, r"source[\s\S]*'terrain' or 'solid'"),
    ],
)
def test_faulty_settings_are_refused(wrong, message):
    with pytest.raises(ValidationError, match=message):
        HeightScanConf(**wrong)


def test_bare_terrain_needs_no_height_to_look_from():
    assert height_scan_conf(source="terrain", limit_m=3.0).above_m == 1.0
