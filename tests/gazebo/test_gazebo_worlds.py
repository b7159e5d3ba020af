"""Worlds exported for Gazebo: libsdformat finds no fault in them, and they are read back as they were."""

import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from libsdformat import assert_valid
from simulations import started_simulation
from textured_files import write_textured_yard

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.env.simulation import VectorSimulation
from dune_rl.gazebo.mesh_folder import MeshFolder
from dune_rl.gazebo.scene import SURFACES, WORLD, write_scene
from dune_rl.gazebo.world import make_world
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_texture import TextureSampler
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.clearance import SurfaceClearance
from dune_rl.worlds.importing.imported_world import ImportedWorld
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf
from dune_rl.worlds.surfaces import SURFACES as KINDS
from dune_rl.worlds.world import Prop, World

# Of texts with nine digits, read in single precision, at the edges of steep objects.
HEIGHT_M, RANGE_M = 1e-4, 2e-3
# Clearances are sampled on a grid of 5 cm.
CLEARANCE_M = 0.03


def export(
    folder: Path, simulation: VectorSimulation, *, duration_s: float = 1.0, robots: bool = False
) -> World:
    write_scene(folder, "site", simulation, duration_s, with_robots=robots)
    return simulation.scenes.worlds.worlds[0]


def read_back(folder: Path, world: World, **settings: object) -> ImportedWorld:
    conf = {"spacing_m": world.terrain.spacing_m, "region": world.region, **settings}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WorldWarning)
        return build_sdf(SdfConf(path=str(folder / WORLD), **conf))


def points_in(world: World, count: int = 4_000, margin_m: float = 0.5) -> np.ndarray:
    xmin, xmax, ymin, ymax = world.extent
    low, high = (xmin + margin_m, ymin + margin_m), (xmax - margin_m, ymax - margin_m)
    return np.random.default_rng(0).uniform(low, high, (count, 2))


def assert_equal(read: World, world: World) -> None:
    """Equal heights, clearances, ranges of level beams, frictions and decks."""
    xy = points_in(world)
    assert read.extent == pytest.approx(world.extent)
    np.testing.assert_allclose(read.terrain.height(xy), world.terrain.height(xy), rtol=0, atol=HEIGHT_M)
    solid = [prop for prop in world.props if prop.solid]
    # Of imported worlds, which see what is thinner than a cell, too.
    clearance = SurfaceClearance(
        world.terrain,
        [prop.mesh for prop in solid if not prop.drivable],
        [prop.mesh for prop in solid if prop.drivable],
    )
    np.testing.assert_allclose(read.clearance(xy), clearance(xy), rtol=0, atol=CLEARANCE_M)
    turn = np.random.default_rng(1).uniform(0.0, 2 * np.pi, len(xy))
    beams = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(xy))]).astype(np.float32)
    from_w = np.column_stack([xy, world.terrain.height(xy) + 0.3]).astype(np.float32)
    farthest = np.full(len(xy), 20.0, np.float32)
    ranges, expected = (each.rays.hits(from_w, beams, farthest.copy()).range for each in (read, world))
    # A beam along a surface may just miss it.
    assert (np.abs(ranges - expected) > RANGE_M).mean() < 1e-3
    assert read.friction == world.friction
    decks, expected_decks = (
        sorted(prop.vertices[:, 2].max() for prop in each.props if prop.drivable) for each in (read, world)
    )
    assert decks == pytest.approx(expected_decks, abs=1e-6)


@pytest.mark.slow(all_but=["obstacle_course"])
@pytest.mark.parametrize(
    "name", ["flat", "inspection", "construction", "rubicon", "island", "obstacle_course"]
)
def test_a_world_is_read_back_as_it_was(name: str, tmp_path: Path) -> None:
    light = {"sun_bearing_deg": 40.0, "sun_elevation_deg": 25.0, "sun_colour": [1.0, 0.8, 0.6]}
    simulation = started_simulation(name, weather={"light": light})
    world = export(tmp_path, simulation)
    assert_valid(tmp_path / WORLD, tmp_path)
    read = read_back(tmp_path, world)
    assert_equal(read, world)
    assert read.light is not None
    expected = LightConf.model_validate(light)
    assert read.light.sun_colour == expected.sun_colour
    for side in ("sun_bearing_deg", "sun_elevation_deg"):
        assert getattr(read.light, side) == pytest.approx(getattr(expected, side), abs=1e-3)
    simulation.close()


@pytest.mark.slow
def test_without_its_spacing_the_ground_is_a_few_centimetres_off(tmp_path: Path) -> None:
    simulation = started_simulation("island")
    world = export(tmp_path, simulation)
    simulation.close()
    xy = points_in(world)
    away = np.abs(read_back(tmp_path, world, spacing_m=None).terrain.height(xy) - world.terrain.height(xy))
    assert 1e-3 < away.max() < 0.05


@pytest.mark.slow
def test_every_surface_has_its_friction(tmp_path: Path) -> None:
    settings = {"name": "flat", "size_m": 20.0, "surfaces": "natural", "friction": 0.9}
    simulation = started_simulation(settings)
    world = export(tmp_path, simulation)
    simulation.close()
    assert_valid(tmp_path / WORLD, tmp_path)
    collisions = ElementTree.parse(tmp_path / WORLD).findall("world/model/link/collision")
    found = {
        each.get("name").removesuffix("_collision"): float(each.findtext("surface/friction/ode/mu"))
        for each in collisions
    }
    named = {KINDS[number].name for number in np.unique(world.surfaces.numbers)}
    assert found == {kind.name: kind.friction for kind in KINDS if kind.name in named}
    assert len(found) > 2
    read = read_back(tmp_path, world, surface_map=str(tmp_path / SURFACES))
    np.testing.assert_array_equal(read.surfaces.numbers, world.surfaces.numbers)
    # Below a point lies the mesh of its surface, but for borders along the sides of triangles.
    xy = points_in(world, 2_000, margin_m=0.1)
    lies = {
        name: np.isfinite(RayScene(mesh.vertices, mesh.faces).topmost(xy))
        for name in found
        if (mesh := trimesh.load_mesh(tmp_path / "meshes" / f"ground_{name}.obj", process=False))
    }
    assert (sum(below.astype(int) for below in lies.values()) == 1).mean() > 0.99
    names = np.array(world.surfaces.names)[world.surfaces.at(xy)]
    assert np.mean([lies[name][k] for k, name in enumerate(names.tolist())]) > 0.85


@pytest.mark.slow
def test_pictures_of_an_imported_world_come_along(tmp_path: Path) -> None:
    path = write_textured_yard(tmp_path)
    simulation = started_simulation({"name": "mesh", "path": str(path)})
    (tmp_path / "out").mkdir()
    world = export(tmp_path / "out", simulation)
    simulation.close()
    read = read_back(tmp_path / "out", world)
    # The colours of the sign's front, a quarter and three quarters of the way along both of its sides.
    found = []
    for each in (world, read):
        (sign,) = (prop for prop in each.props if prop.kind == "sign")
        assert sign.texture is not None
        ahead = sign.vertices[sign.faces].mean(axis=1)[:, 0]
        faces = np.flatnonzero(ahead < ahead.min() + 1e-6)
        low, high = sign.vertices.min(axis=0), sign.vertices.max(axis=0)
        points = np.array([[low[0], *(low + share * (high - low))[1:]] for share in (0.25, 0.75)], np.float32)
        sampler = TextureSampler(sign.texture)
        found.append(
            np.array([sampler.albedo(np.full(2, face), points, 0.01) for face in faces]).mean(axis=0)
        )
    np.testing.assert_allclose(found[0], found[1], atol=0.02)
    xy = points_in(world, 500)
    share = (xy - np.array(world.extent)[[0, 2]]) / np.ptp(np.reshape(world.extent, (2, 2)), axis=1)
    shown, expected = (
        picture[tuple((share[:, ::-1] * picture.shape[:2]).astype(int).T)]
        for picture in (read.picture.colours, world.picture.colours)
    )
    # Of pictures of other sizes: most texels are alike.
    assert np.median(np.abs(shown - expected)) < 0.03
    shuffled = np.random.default_rng(0).permutation(expected)
    assert np.median(np.abs(shown - shuffled)) > 0.03


@pytest.mark.slow
def test_the_same_scene_has_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        simulation = started_simulation("island", seed=3, actors="walkers")
        export(tmp_path / name, simulation, robots=True)
        simulation.close()
    files = sorted(path for path in (tmp_path / "one").rglob("*") if path.is_file())
    assert len(files) > 20
    for file in files:
        assert file.read_bytes() == (tmp_path / "two" / file.relative_to(tmp_path / "one")).read_bytes()


def test_no_object_has_the_name_of_an_agent(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    names = ("sun", "Rover_0", "a/../../b", "wall #2", "wall #2", "world")
    props = [Prop(name, "wall", np.asarray(box.vertices), np.asarray(box.faces, np.int32)) for name in names]
    world = World("w", HeightField(np.zeros((5, 5)), 1.0, (-2.0, -2.0)), props, region=(-1, 1, -1, 1))
    element = make_world("w", world, WeatherConf(), PhysicsConf(), MeshFolder(tmp_path), ["rover_0"])
    found = [model.get("name") for model in element.findall("model")]
    assert found == ["ground", "sun_2", "Rover_0_2", "a_.._.._b", "wall_2", "wall_2_2", "world_2"]
    written = {path.name for path in (tmp_path / "meshes").iterdir()}
    assert {f"{name}.obj" for name in found} <= written
    assert [path.name for path in tmp_path.iterdir()] == ["meshes"]


def test_an_unknown_role_is_refused(tmp_path: Path) -> None:
    (tmp_path / "w.sdf").write_text(
        '<sdf version="1.9" xmlns:d="urn:dune_rl"><model name="m" d:role="pond"/></sdf>'
    )
    with pytest.raises(WorldError, match="must be one of ground, deck, obstacle, robot"):
        build_sdf(SdfConf(path=str(tmp_path / "w.sdf")))
