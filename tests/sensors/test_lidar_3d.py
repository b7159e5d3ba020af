"""The LiDAR of rings against geometry worked out by other means, and against the planar one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from people import meshes_of
from poses import seen_at
from pydantic import ValidationError
from scanning import SIZE_M, flat_with, lidar_in, turned
from scenes import about
from sensor_contexts import context_of, rays_of
from sensors_of_rover_zero import lidar_3d_conf, lidar_conf
from states import begin, measure, state_at

from dune_rl.bodies.person import PersonConf
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.scenery import Segment, luminance
from dune_rl.sensors.lidar_3d import Lidar3d, Lidar3dConf
from dune_rl.worlds.appearance import beam_surface
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.world import Prop, World

EVERYTHING = ("range", "intensity", "segmentation")
STANDING = np.array([0.0, 0.0, 0.125])
LEVEL = np.eye(3)
NOBODY = np.zeros((1, 0, 7))
PERSON = PersonConf()
# The mount's height over ground on which the rover stands.
MAST_M = 0.125 + 0.196


def lidar_3d_in(
    world: World, actors: tuple[PersonConf, ...] = (), scenes: int = 1, **conf: object
) -> Lidar3d:
    context = context_of(scenes, solid=rays_of(world), surfaces=beam_surface(world), meshes=meshes_of(actors))
    return Lidar3d("lidar_3d", context, lidar_3d_conf(**{"outputs": EVERYTHING, **conf}))


def scan(
    lidar: Lidar3d, position: np.ndarray = STANDING, rotation: np.ndarray = LEVEL, actors: np.ndarray = NOBODY
) -> dict[str, np.ndarray]:
    """Each output of one rover as (n_rings, n_beams)."""
    found = lidar.scan(position[None], rotation[None], seen_at(actors))
    return {name.removeprefix("lidar_3d_"): values[0, ..., 0] for name, values in found.items()}


def test_its_level_ring_is_the_planar_lidar():
    world = build_inspection(InspectionConf(seed=2))
    actors = (PERSON, PersonConf(radius_m=0.4))
    conf = lidar_conf(n_beams=180, n_segments=180, range_m=20.0, fov_deg=230.0)
    planar = lidar_in(world, actors, conf)
    rings = lidar_3d_in(
        world,
        actors,
        n_rings=3,
        n_beams=180,
        range_m=20.0,
        fov_deg=230.0,
        lowest_elevation_deg=-11.0,
        highest_elevation_deg=11.0,
    )
    rng = np.random.default_rng(0)
    for _ in range(10):
        xy = rng.uniform(-27, -19, 2)
        position = np.array([*xy, world.terrain.height(xy) + 0.2])
        rotation = turned(rng.uniform(-3, 3)) @ rotation_matrices(about([1, 0, 0], rng.uniform(-0.2, 0.2)))
        poses = np.column_stack([xy + rng.uniform(-4, 4, (2, 2)), [position[2] - 0.3] * 2, [0.3, 2.0]])
        expected = planar.ranges(position[None], rotation[None], seen_at(poses[None]))[0]
        found = scan(rings, position, rotation, poses[None])["range"][1]
        assert np.mean(np.abs(found - expected) < 1e-3) > 0.98


def test_the_first_ring_is_the_highest_and_beams_run_counter_clockwise():
    high = Prop("beam", "box", *upright_box((3.0, 0.0), 0.0, 0.8, 1.5, 0.2, 0.2))
    left = Prop("low", "box", *upright_box((0.174, 3.0), 0.0, -0.1, 0.25, 0.2, 0.2))
    world = World("test", build_flat(FlatConf(size_m=SIZE_M)).terrain, [high, left], region=(-4, 4, -4, 4))
    ranges = scan(lidar_3d_in(world, n_rings=17, range_m=10.0))["segmentation"]
    ring, beam = np.nonzero(ranges == Segment.OBSTACLE)
    ahead = np.abs(beam - 256) < 20
    assert ahead.any()
    assert (~ahead).any()
    # The rings are 0.03275 rad apart, the ninth level; a quarter turn to the left is 128 beams.
    assert set(ring[ahead]) <= set(range(4))
    assert (np.abs(beam[~ahead] - 384) < 20).all()
    assert ring[~ahead].min() > 8


@pytest.mark.slow(all_but=["0.15"])
@pytest.mark.parametrize("pitch", [0.0, 0.15])
def test_rings_below_the_horizon_meet_the_ground_where_geometry_says(pitch):
    rotation = rotation_matrices(about([0, 1, 0], pitch))
    found = scan(lidar_3d_in(build_flat(FlatConf(size_m=SIZE_M))), np.array([0.4, 0.7, 0.125]), rotation)
    elevation = np.deg2rad(np.linspace(15.0, -15.0, 16))[:, None]
    bearing = (-np.pi + 2 * np.pi / 512 * np.arange(512))[None]
    x, z = np.cos(elevation) * np.cos(bearing), np.sin(elevation)
    down = x * np.sin(pitch) - z * np.cos(pitch)
    mast = 0.125 - np.sin(pitch) * 0.174 + np.cos(pitch) * 0.196
    with np.errstate(divide="ignore"):
        to_ground = np.where(down > 0, mast / down, np.inf)
    met = to_ground < 30.0
    assert 0.3 < met.mean() < 0.6
    np.testing.assert_allclose(found["range"], np.where(met, to_ground, 30.0), rtol=1e-3)
    np.testing.assert_array_equal(found["segmentation"] == Segment.GROUND, met)
    np.testing.assert_array_equal(found["segmentation"] == Segment.SKY, ~met)
    # Over flat ground the cosine of incidence is the beam's downward part; gravel has few shades.
    brightness = found["intensity"][met] * (1 + (to_ground[met] / 10.0) ** 2) / down[met]
    assert 0.15 < brightness.min() <= brightness.max() < 0.45
    assert (found["intensity"][~met] == 0.0).all()


@pytest.mark.slow
def test_intensity_is_albedo_by_incidence_by_range():
    for colour, distance in (((0.9, 0.2, 0.1), 3.0), ((0.5, 0.5, 0.5), 8.0)):
        box = Prop(
            "wall", "box", *upright_box((distance + 0.274, 0.0), 0.0, -0.1, 3.0, 0.2, 8.0), colour=colour
        )
        world = World("test", build_flat(FlatConf(size_m=SIZE_M)).terrain, [box], region=(-4, 4, -4, 4))
        found = scan(lidar_3d_in(world, n_rings=3, half_intensity_m=6.0))
        r, g, b = srgb_to_linear(np.array(colour))
        albedo = 0.2126 * r + 0.7152 * g + 0.0722 * b
        for beam in (256, 256 + 20):
            bearing = 2 * np.pi / 512 * (beam - 256)
            expected = albedo * np.cos(bearing) / (1 + (distance / np.cos(bearing) / 6.0) ** 2)
            assert found["intensity"][1, beam] == pytest.approx(expected, rel=1e-3)


def test_at_the_half_intensity_range_a_return_is_half_as_bright():
    world = flat_with((5.274, 0.0, 0.0, 0.2, 8.0))
    near, far = (
        scan(lidar_3d_in(world, n_rings=3, half_intensity_m=half))["intensity"][1, 256]
        for half in (1000.0, 5.0)
    )
    assert near == pytest.approx(2 * far, rel=1e-3)


def test_decks_obstacles_and_water_have_their_segments():
    deck = Prop("deck", "bridge", *upright_box((3.0, 0.0), 0.0, 0.0, 0.2, 1.0, 1.0), drivable=True)
    wall = Prop("wall", "wall", *upright_box((-3.0, 0.0), 0.0, -0.1, 1.0, 0.2, 2.0))
    lake = Prop("lake", "water", *upright_box((0.0, 3.0), 0.0, -0.1, 0.1, 2.0, 2.0), solid=False)
    # Water is between the others, so that faces would be mistaken if it counted.
    world = World(
        "test", build_flat(FlatConf(size_m=SIZE_M)).terrain, [deck, lake, wall], region=(-4, 4, -4, 4)
    )
    segments = scan(lidar_3d_in(world))["segmentation"]
    assert Segment.DECK in segments[:, 256]
    assert Segment.OBSTACLE in segments[:, 0]
    assert set(segments.ravel()) == {Segment.SKY, Segment.GROUND, Segment.DECK, Segment.OBSTACLE}
    assert set(segments[:, 384]) == {Segment.SKY, Segment.GROUND}


def test_a_world_s_look_follows_its_solid_faces():
    world = build_inspection(InspectionConf(seed=1))
    owner = world.solid_mesh().owner
    look = beam_surface(world)
    assert len(look.segments) == len(look.luminance) == len(owner) + 1
    assert look.segments[-1] == Segment.SKY
    assert look.luminance[-1] == 0.0
    assert (look.segments[:-1][owner < 0] == Segment.GROUND).all()
    for index in np.unique(owner[owner >= 0]):
        prop, of = world.props[index], np.flatnonzero(owner == index)
        assert (look.segments[of] == (Segment.DECK if prop.drivable else Segment.OBSTACLE)).all()
        np.testing.assert_allclose(
            look.luminance[of], luminance(srgb_to_linear(np.array(prop.colour))), rtol=1e-5
        )
    ground = look.luminance[:-1][owner < 0]
    # Grass and earth differ, and neither is black or white.
    assert 0.05 < ground.min() < 0.9 * ground.max() < 0.5


@pytest.mark.slow
def test_people_are_seen_at_their_pose_of_that_instant():
    lidar = lidar_3d_in(build_flat(FlatConf(size_m=SIZE_M)), (PERSON, PERSON), range_m=10.0)
    for x, y in ((3.0, 0.0), (3.0, 0.5), (0.174, -2.0)):
        poses = np.array([[[x, y, 0.0, 0.4], [x + 40.0, y, 0.0, 0.0]]])
        found = scan(lidar, actors=poses)
        at = np.nonzero(found["segmentation"] == Segment.ACTOR)
        assert len(at[0]) > 100
        bearing = -np.pi + 2 * np.pi / 512 * at[1]
        offset = np.array([x, y]) - [0.174, 0.0]
        towards = np.arctan2(offset[1], offset[0])
        assert np.abs(bearing - towards).max() <= np.arcsin(0.25 / np.linalg.norm(offset)) + 1e-6
        level = found["range"][at] * np.cos(np.deg2rad(np.linspace(15.0, -15.0, 16))[at[0]])
        assert level.min() == pytest.approx(np.linalg.norm(offset) - 0.25, abs=0.01)
        assert (found["intensity"][at] > 0.0).any()
        assert found["intensity"].max() < 1.0


def test_the_nearer_of_two_people_hides_the_other_whatever_their_order():
    lidar = lidar_3d_in(build_flat(FlatConf(size_m=SIZE_M)), (PERSON, PERSON, PersonConf(radius_m=0.2)))
    people = np.array([[4.0, 0.0, 0.0, 0.0], [2.0, 0.05, 0.0, 0.0], [6.0, 0.0, 0.0, 0.0]])
    seen = [scan(lidar, actors=people[None, [a, b, 2]])["range"] for a, b in ((0, 1), (1, 0))]
    np.testing.assert_array_equal(*seen)
    assert seen[0][8, 256] == pytest.approx(2.0 - 0.25 - 0.174, abs=0.02)


@pytest.mark.slow
def test_walls_hide_people():
    lidar = lidar_3d_in(flat_with((2.0, 0.0, 0.0, 0.2, 4.0)), (PERSON,), n_rings=3, outputs=EVERYTHING)
    found = scan(lidar, actors=np.array([[[4.0, 0.0, 0.0, 0.0]]]))
    assert found["segmentation"][1, 256] == Segment.OBSTACLE
    assert found["range"][1, 256] == pytest.approx(1.9 - 0.174, abs=1e-3)


def test_range_alone_is_the_range_of_a_full_scan():
    world = build_inspection(InspectionConf(seed=2))
    lidars = [lidar_3d_in(world, (PERSON, PERSON), outputs=outputs) for outputs in (EVERYTHING, ("range",))]
    position = np.array([-23.0, -23.0, world.terrain.height([-23.0, -23.0]) + 0.2])
    poses = position + np.array([[2.0, 1.0, -0.2], [-3.0, 0.5, -0.2]])
    poses = np.column_stack([poses, [0.5, -1.0]])
    full, alone = (scan(lidar, position, turned(0.4), poses[None]) for lidar in lidars)
    assert list(alone) == ["range"]
    np.testing.assert_array_equal(full["range"], alone["range"])
    assert len(np.unique(full["segmentation"])) >= 4


def test_scenes_are_independent_and_only_those_that_begin_scan_anew():
    lidar = lidar_3d_in(flat_with((4.0, 1.0, 0.0, 1.0, 1.0)), (PERSON,), scenes=3)
    rng = np.random.default_rng(0)
    positions = np.column_stack([rng.uniform(-2, 2, (3, 2)), np.full(3, 0.125)])
    yaws = np.array([0.3, -2.0, 1.0])
    rotations = np.array([turned(yaw) for yaw in yaws])
    actors = np.concatenate([rng.uniform(-4, 4, (3, 1, 2)), np.zeros((3, 1, 2))], axis=-1)
    now = state_at(positions, yaws, actors)
    measure(lidar, now)
    whole = lidar.read()
    for scene in range(3):
        alone = lidar.scan(*(of[[scene]] for of in (positions, rotations, seen_at(actors))))
        for name, values in alone.items():
            np.testing.assert_array_equal(whole[name][scene], values[0])
    begin(lidar, np.array([False, True, False]), state_at(positions + 0.1, yaws, actors))
    changed = [(lidar.read()["lidar_3d_range"][i] != whole["lidar_3d_range"][i]).any() for i in range(3)]
    assert changed == [False, True, False]
    begin(lidar, np.zeros(3, bool), now)


@pytest.mark.slow
def test_readings_have_the_shapes_and_types_of_their_bounds():
    lidar = lidar_3d_in(build_flat(FlatConf(size_m=SIZE_M)), scenes=2, n_rings=4, n_beams=30, fov_deg=115.0)
    bounds = lidar.bounds()
    assert list(bounds) == ["lidar_3d_range", "lidar_3d_intensity", "lidar_3d_segmentation"]
    measure(lidar, state_at(np.stack([STANDING] * 2), np.zeros(2)))
    for name, values in lidar.read().items():
        low, high = bounds[name]
        assert values.shape == (2, *low.shape) == (2, 4, 30, 1)
        assert values.dtype == low.dtype == high.dtype
        assert (values >= low).all()
        assert (values <= high).all()
    first = lidar.read()["lidar_3d_range"]
    first[:] = 0.0
    assert lidar.read()["lidar_3d_range"].min() > 0.0


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-1, 3)),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
    st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-1, 1), st.floats(-4, 4)),
)
def test_whatever_the_pose_readings_are_within_bounds(position, quaternion, actor):
    lidar = _LUMPY
    rotation = rotation_matrices(np.array(quaternion) / np.linalg.norm(quaternion))
    for name, values in lidar.scan(np.array([position]), rotation[None], seen_at([[actor]])).items():
        low, high = lidar.bounds()[name]
        assert (values >= low).all()
        assert (values <= high).all()


_LUMPY = lidar_3d_in(flat_with((2.0, 1.0, 0.3, 1.0, 1.0)), (PERSON,), n_beams=64)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"n_rings": 0}, r"n_rings[\s\S]*greater than or equal to 1"),
        ({"n_beams": 0}, r"n_beams[\s\S]*greater than or equal to 1"),
        ({"range_m": -1.0}, r"range_m[\s\S]*greater than 0"),
        ({"min_range_m": -0.1}, r"min_range_m[\s\S]*greater than or equal to 0"),
        ({"min_range_m": 30.0}, r"min_range_m \(30.0\) must be less than range_m \(30.0\)"),
        ({"fov_deg": 361.0}, r"fov_deg[\s\S]*less than or equal to 360"),
        ({"lowest_elevation_deg": -91.0}, r"lowest_elevation_deg[\s\S]*greater than or equal to -90"),
        ({"highest_elevation_deg": 91.0}, r"highest_elevation_deg[\s\S]*less than or equal to 90"),
        (
            {"lowest_elevation_deg": 17.0},
            r"lowest_elevation_deg \(17\) must be less than highest_elevation_deg \(15\)",
        ),
        ({"n_rings": 1}, r"must equal highest_elevation_deg \(15\) where n_rings=1"),
        ({"half_intensity_m": 0.0}, r"half_intensity_m[\s\S]*greater than 0"),
        ({"outputs": ()}, r"outputs[\s\S]*at least 1"),
        ({"outputs": ("range", "colour")}, r"'range', 'intensity' or 'segmentation'"),
        ({"outputs": ("range", "range")}, r"outputs must differ"),
        ({"rings": 4}, r"rings[\s\S]*not permitted"),
    ],
)
def test_faulty_settings_are_refused(wrong, message):
    with pytest.raises(ValidationError, match=message):
        Lidar3dConf(**wrong)
