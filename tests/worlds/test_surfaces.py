"""Surfaces, their maps and files: what is where, what the figures mean, and bad maps refused."""

import numpy as np
import pytest
import trimesh
from defusedxml.ElementTree import parse
from PIL import Image
from scipy import integrate
from simulations import act, motion_of_group, started_simulation
from world_digest import digest

from dune_rl.config.build import build_world
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import WorldError
from dune_rl.core.paths import assets_folder
from dune_rl.geometry.heightfield import HeightField
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.worlds.appearance import build_scenery
from dune_rl.worlds.importing.heightmap_world import HeightmapConf, build_heightmap
from dune_rl.worlds.props import upright_box
from dune_rl.worlds.surfaces import (
    SURFACE_NAMES,
    SURFACES,
    Soil,
    Surface,
    SurfaceMap,
    WheelLoad,
    contact_table,
)
from dune_rl.worlds.world import Prop, World

EXTENT = (-4.0, 4.0, -2.0, 2.0)
GENERATED = {
    "flat": set(SURFACE_NAMES),
    "inspection": {"grass", "gravel", "mud"},
    "construction": {"concrete", "sand", "gravel"},
    "rubicon": {"grass", "gravel", "rock"},
    "island": {"sand", "rock", "mud"},
}


def world_of(name: str, **settings) -> World:
    return build_world(compose_environment({"name": name} | settings, ()).world)


# -- figures ---------------------------------------------------------------------------------------


def test_the_seven_surfaces_are_in_order_and_have_sources():
    assert tuple(surface.name for surface in SURFACES) == SURFACE_NAMES
    for surface in SURFACES:
        assert "friction:" in surface.source or surface.source.startswith("chosen")
        assert (surface.soil is None) == ("soil:" not in surface.source)


def test_the_robot_is_as_heavy_as_its_description():
    root = parse(RoverZero(RoverZeroConf(), 1).body.urdf).getroot()
    masses = [float(mass.get("value", "")) for mass in root.iter("mass")]
    assert sum(masses) == pytest.approx(RoverZero.description.mass_kg)
    tyre = trimesh.load_mesh(assets_folder() / "robots" / "rover_zero" / "meshes" / "tyre.stl")
    assert tyre.extents[1] == pytest.approx(RoverZero.description.contact_width_m, abs=2e-3)


@pytest.mark.parametrize(
    "soil", [Soil(0.99e3, 1528.43e3, 1.1), Soil(2.56e3, 43.12e3, 0.2), Soil(0, 1e6, 1.0)]
)
def test_a_wheel_sinks_until_the_soil_s_pressure_carries_it(soil):
    load, diameter, width = 27.0, 0.25, 0.083
    depth = soil.sinkage_m(load, diameter, width)
    # Bekker's wheel: at x from its lowest point it is z - x^2 / D deep, to where it leaves the ground.
    edge = np.sqrt(depth * diameter)
    carried, _ = integrate.quad(
        lambda x: (soil.k_c + width * soil.k_phi) * (depth - x * x / diameter) ** soil.n, 0.0, edge
    )
    # His (3 - n) / 3 stands for the integral, exact for n = 0 and 1.
    assert carried == pytest.approx(load, rel=0.02 if soil.n == 1.0 else 0.06)
    work, _ = integrate.quad(lambda z: (soil.k_c + width * soil.k_phi) * z**soil.n, 0.0, depth)
    assert soil.compaction_n(load, diameter, width) == pytest.approx(work)


def test_sinkage_softens_soils_alone():
    wheel = WheelLoad(27.0, 0.25, 0.083)
    firm, firm_rolling = contact_table(SURFACES, wheel, sinkage=False)
    soft, soft_rolling = contact_table(SURFACES, wheel, sinkage=True)
    soils = [surface.soil is not None for surface in SURFACES]
    np.testing.assert_array_equal((soft[:, 2] < 0.5 * firm[:, 2]), soils)
    np.testing.assert_array_equal((soft != firm).any(axis=1), soils)
    np.testing.assert_array_equal(soft_rolling != firm_rolling, soils)
    assert firm[0].tolist() == [0.5, 0.30, 2.2e5, 4.4e3]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"friction": 0.0}, "friction of surface 'ice' must be positive"),
        ({"stiffness_npm": float("nan")}, "stiffness_npm of surface 'ice' must be positive"),
        ({"restitution": 1.1}, "restitution of surface 'ice' must be between 0 and 1"),
        ({"rolling_resistance": -0.1}, "rolling_resistance of surface 'ice' must not be negative"),
    ],
)
def test_impossible_surfaces_are_refused(change, message):
    figures = {
        "friction": 0.1,
        "restitution": 0.0,
        "stiffness_npm": 1e6,
        "damping_nspm": 1e4,
        "rolling_resistance": 0.0,
    }
    with pytest.raises(ValueError, match=message):
        Surface("ice", **(figures | change))


# -- maps ------------------------------------------------------------------------------------------


def test_a_map_is_looked_up_by_place():
    numbers = np.arange(8).reshape(2, 4) % 7
    found = SurfaceMap(numbers, EXTENT)
    assert found.at([-3.9, -1.9]) == 0
    assert found.at([[-1.9, -0.1], [3.9, -1.0], [-3.0, 0.1], [3.9, 1.9]]).tolist() == [1, 3, 4, 0]
    # Beyond the edge, the edge.
    assert found.at([[-99.0, -99.0], [99.0, -99.0]]).tolist() == [0, 3]
    assert found.at(np.zeros((3, 4, 2))).shape == (3, 4)
    assert found.number("mud") == 2
    with pytest.raises(ValueError, match="has no surface 'lava'; it has grass, gravel"):
        found.number("lava")


@pytest.mark.parametrize("numbers", [[[7]], [[-1]], [[0.5]], [0, 1]])
def test_maps_of_other_than_surface_numbers_are_refused(numbers):
    with pytest.raises(ValueError, match="numbers"):
        SurfaceMap(numbers, EXTENT)


@pytest.mark.slow(all_but=["inspection-expected1", "island-expected4"])
@pytest.mark.parametrize(("name", "expected"), GENERATED.items())
def test_natural_worlds_have_their_surfaces_and_keep_all_else(name, expected):
    plain, natural = world_of(name), world_of(name, surfaces="natural")
    assert plain.surfaces is None
    assert digest(natural) == digest(plain)
    found = natural.surfaces
    shares = np.bincount(found.numbers.ravel(), minlength=len(SURFACES)) / found.numbers.size
    assert {SURFACE_NAMES[number] for number in np.flatnonzero(shares)} == expected
    assert shares[shares > 0].min() > 0.09
    again = build_world.__wrapped__(compose_environment({"name": name, "surfaces": "natural"}, ()).world)
    np.testing.assert_array_equal(again.surfaces.numbers, found.numbers)


@pytest.mark.slow
def test_seeds_move_surfaces_and_steep_ground_is_rock():
    worlds = [world_of("rubicon", seed=seed, surfaces="natural") for seed in (0, 1)]
    assert (worlds[0].surfaces.numbers != worlds[1].surfaces.numbers).mean() > 0.3
    xy = np.random.default_rng(0).uniform(-20.0, 20.0, (4000, 2))
    for world in worlds:
        rock = world.surfaces.at(xy) == SURFACE_NAMES.index("rock")
        slope = world.terrain.slope(xy)
        assert slope[rock].mean() > 1.2 * slope[~rock].mean()


@pytest.mark.slow
def test_the_bridge_is_of_wood_and_stones_are_rock():
    for name, kind, surface in (("inspection", "bridge", "wood"), ("rubicon", "stones", "rock")):
        world = world_of(name, surfaces="mud")
        decks = [prop.vertices for prop in world.props if prop.kind == kind and prop.drivable]
        tops = np.array([vertices[vertices[:, 2].argmax()] for vertices in decks])
        middles = np.array([vertices.mean(axis=0) for vertices in decks])
        # A little within the edge.
        tops[:, :2] += (
            0.05 * (middles - tops)[:, :2] / np.linalg.norm((middles - tops)[:, :2], axis=1)[:, None]
        )
        numbers, height = world.surface_below(tops)
        over = height > world.terrain.height(tops[:, :2]) + 0.01
        assert over.any()
        assert {SURFACE_NAMES[number] for number in numbers[over]} == {surface}
        below, _ = world.surface_below(tops - [0.0, 0.0, 3.0])
        assert {SURFACE_NAMES[number] for number in below} == {"mud"}


def test_the_buried_part_of_a_stone_is_ground():
    terrain = HeightField(np.zeros((5, 5)), 2.0, (-4.0, -4.0))
    stone = upright_box((0.0, 0.0), 0.0, -0.5, -0.05, 1.0, 1.0)
    slab = upright_box((2.0, 0.0), 0.0, -0.5, 0.05, 1.0, 1.0)
    props = [
        Prop(f"{x}", "stones", *x_mesh, drivable=True, surface="rock")
        for x, x_mesh in ((0, stone), (2, slab))
    ]
    surfaces = SurfaceMap([[SURFACE_NAMES.index("mud")]], terrain.extent)
    world = World("stones", terrain, props, region=(-1, 1, -1, 1), surfaces=surfaces)
    numbers, height = world.surface_below(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    assert [SURFACE_NAMES[number] for number in numbers] == ["mud", "rock", "mud"]
    np.testing.assert_allclose(height, [0.0, 0.05, 0.0], atol=1e-6)


def test_one_surface_everywhere():
    surfaces = world_of("flat", surfaces="sand").surfaces
    assert SURFACE_NAMES[int(surfaces.at([12.0, -7.0]))] == "sand"


def test_sinkage_needs_surfaces():
    with pytest.raises(
        WorldError, match=r"world\.sinkage=true needs a surface material: set world\.surfaces"
    ):
        world_of("flat", sinkage=True)


def test_ground_shows_its_surfaces():
    plain = build_scenery(world_of("flat", size_m=20.0)).ground.mean(axis=(0, 1))
    shown = {
        name: build_scenery(world_of("flat", size_m=20.0, surfaces=name)).ground.mean(axis=(0, 1))
        for name in SURFACE_NAMES
    }
    means = np.array([plain, *shown.values()])
    apart = np.linalg.norm(means[:, None] - means, axis=-1) + np.eye(len(means))
    assert apart.min() > 0.02
    assert shown["mud"].sum() < 0.5 * shown["sand"].sum()


# -- files -----------------------------------------------------------------------------------------


@pytest.fixture
def heights(tmp_path):
    np.save(tmp_path / "level.npy", np.zeros((9, 17)))

    def build(**settings) -> World:
        return build_heightmap(
            HeightmapConf(path=str(tmp_path / "level.npy"), size_m=(16.0, 8.0), **settings)
        )

    return build


NORTH_WEST = np.array([[1, 0, 0, 0], [0, 0, 0, 2]], np.uint8)


@pytest.mark.parametrize("kind", ["npy", "grey.png", "palette.png"])
def test_files_have_the_north_first(heights, tmp_path, kind):
    path = tmp_path / kind
    if kind == "npy":
        path = tmp_path / "map.npy"
        np.save(path, NORTH_WEST.astype(float))
    else:
        image = Image.fromarray(NORTH_WEST)
        if kind == "palette.png":
            image.putpalette([200, 30, 30, 30, 200, 30, 30, 30, 200])
        image.save(path)
    world = heights(surface_map=str(path), surface_legend=("rock", "mud", "wood"), sinkage=True)
    found = world.surfaces
    names = [found.names[number] for number in found.at([[-7, 3], [7, 3], [-7, -3], [7, -3]])]
    assert names == ["mud", "rock", "rock", "wood"]
    assert found.sinkage


def test_imported_worlds_may_be_of_one_surface_or_of_none(heights):
    assert heights().surfaces is None
    found = heights(surface_map="gravel").surfaces
    assert found.names[int(found.at([3.0, 3.0]))] == "gravel"


@pytest.mark.parametrize(
    ("name", "values", "legend", "message"),
    [
        ("lava", None, (), r"world\.surface_map=lava must be one of grass, .* \.npy: it is neither"),
        ("none.png", None, (), r"none\.png must be one of .*: there is no such file"),
        (
            "map.npy",
            [[3, 0]],
            ("rock", "mud"),
            r"has the number 3, .* names the numbers 0 to 1 \(rock, mud\)",
        ),
        ("map.npy", [[-1, 0]], (), r"has the number -1"),
        ("map.npy", [[0.5, 0.0]], (), r"map\.npy holds float64 of shape \(1, 2\): .* whole numbers"),
        ("map.npy", [0, 1], (), r"of shape \(2,\)"),
        ("map.npy", [["a"]], (), r"map\.npy is no map of surfaces that can be read"),
        ("map.png", b"no picture", (), r"map\.png is no map of surfaces that can be read"),
        ("map.png", "RGB", (), r"its pixels are RGB colours; save it as grey or with a palette"),
    ],
)
def test_bad_files_are_refused(heights, tmp_path, name, values, legend, message):
    path = tmp_path / name
    if isinstance(values, bytes):
        path.write_bytes(values)
    elif values == "RGB":
        Image.new("RGB", (4, 4)).save(path)
    elif values is not None:
        np.save(path, np.array(values))
    settings = {"surface_legend": legend} if legend else {}
    with pytest.raises(WorldError, match=message):
        heights(surface_map=name if name == "lava" else str(path), **settings)


def test_imported_sinkage_needs_a_map(heights):
    with pytest.raises(WorldError, match=r"set world\.surface_map to a file"):
        heights(sinkage=True)


@pytest.mark.slow
def test_a_rover_drives_over_a_natural_world():
    simulation = started_simulation(
        {"name": "inspection", "surfaces": "natural", "sinkage": True}, num_scenes=2
    )
    start = motion_of_group(simulation).position_w.copy()
    for _ in range(40):
        act(simulation, [0.8, 0.0])
    assert np.linalg.norm(motion_of_group(simulation).position_w - start, axis=1).min() > 0.5
    assert not motion_of_group(simulation).diverged.any()
