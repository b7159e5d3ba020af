"""The regions that importers choose for starts and goals: between the objects of a site."""

import warnings

import numpy as np
import pytest
import trimesh
from rich.console import Console
from scipy import ndimage
from sites import CRATES_INSIDE, HOUSE, HOUSE_INSIDE, MAZE_INSIDE, ORCHARD_INSIDE, write_site
from world_files import SHARED_WORLDS

import dune_rl
from dune_rl.commands.command_line import print_world_notes
from dune_rl.config.build import describe_world
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.cache.serialization import deserialize_world, serialize_world
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf
from dune_rl.worlds.world import BETWEEN_OBJECTS, OPEN_GROUND, Rectangle, World, describe_choice

RADIUS_M = 0.4


def build(folder, name: str, **settings) -> World:
    return build_sdf(SdfConf(path=str(write_site(folder, name)), **settings))


def is_within(inner: Rectangle, outer: Rectangle) -> bool:
    return inner[0] >= outer[0] and inner[1] <= outer[1] and inner[2] >= outer[2] and inner[3] <= outer[3]


@pytest.mark.slow(all_but=["crates-inside3-50.0"])
@pytest.mark.parametrize(
    ("name", "inside", "least_m2"),
    [
        ("maze", MAZE_INSIDE, 40.0),
        ("house", HOUSE_INSIDE, 25.0),
        ("orchard", ORCHARD_INSIDE, 80.0),
        ("crates", CRATES_INSIDE, 50.0),
    ],
)
def test_the_first_region_is_within_the_site_and_connected(tmp_path, name, inside, least_m2):
    world = build(tmp_path, name)
    first = world.region_candidates[0]
    assert world.region == first.rectangle
    assert first.place == BETWEEN_OBJECTS and first.free_m2 >= least_m2
    assert is_within(world.region, inside)
    spawner = Spawner(world, SpawnConf(), RADIUS_M)
    drawn = np.array([[p.x, p.y] for p in (spawner.sample(np.random.default_rng(s)) for s in range(60))])
    assert is_within((*np.sort(drawn[:, 0])[[0, -1]], *np.sort(drawn[:, 1])[[0, -1]]), inside)
    # Nearly all places that starts are drawn from can be reached from each other without leaving the site.
    free = spawner.free_space
    rows = (free.y >= inside[2]) & (free.y <= inside[3])
    columns = (free.x >= inside[0]) & (free.x <= inside[1])
    parts, _ = ndimage.label(free.traversable & rows[:, None] & columns)
    column, row = np.rint((spawner.cells - [free.x[0], free.y[0]]) / free.cell_m).astype(int).T
    assert np.bincount(parts[row, column]).max() > 0.97 * len(spawner.cells)


@pytest.mark.parametrize("has_roof", [False, True])
def test_a_building_of_a_mesh_file_has_its_region_in_its_rooms(tmp_path, has_roof):
    def add(name: str, x: float, y: float, bottom: float, size: tuple[float, float, float], yaw: float = 0.0):
        mesh = trimesh.creation.box(size)
        mesh.apply_transform(trimesh.transformations.rotation_matrix(yaw, [0, 0, 1]))
        mesh.apply_translation([x, y, bottom + size[2] / 2])
        scene.add_geometry(mesh, node_name=name)

    scene = trimesh.Scene()
    add("apron", 0.0, 0.0, -0.5, (60.0, 60.0, 0.5))
    add("floor", 6.0, 4.5, -0.1, (12.0, 9.0, 0.12))
    for number, (x0, y0, x1, y1) in enumerate(HOUSE):
        size = (float(np.hypot(x1 - x0, y1 - y0)) + 0.15, 0.15, 2.6)
        add(f"Wall_{number}", (x0 + x1) / 2, (y0 + y1) / 2, 0.0, size, float(np.arctan2(y1 - y0, x1 - x0)))
    if has_roof:
        add("roof", 6.0, 4.5, 2.6, (12.6, 9.6, 0.2))
    scene.export(tmp_path / "building.glb")
    world = build_mesh(MeshConf(path=str(tmp_path / "building.glb"), up="z"))
    assert world.region_candidates[0].place == BETWEEN_OBJECTS
    assert is_within(world.region, (-0.3, 12.0, 0.0, 9.0))


def test_without_objects_the_region_is_open_ground_in_the_middle(tmp_path):
    world = build(tmp_path, "plane")
    (only,) = world.region_candidates
    assert only.place == OPEN_GROUND
    np.testing.assert_allclose(world.region, (-4, 4, -4, 4), atol=0.11)


@pytest.mark.slow
def test_a_number_chooses_another_region_and_a_rectangle_any(tmp_path):
    candidates = build(tmp_path, "maze").region_candidates
    assert [each.place for each in candidates] == [BETWEEN_OBJECTS, OPEN_GROUND]
    assert build(tmp_path, "maze", region=2).region == candidates[1].rectangle
    assert build(tmp_path, "maze", region=(-9, -5, 3, 8)).region == (-9, -5, 3, 8)
    with pytest.raises(WorldError, match=r"world.region=7: maze.sdf has regions 1 to 2 to choose from"):
        build(tmp_path, "maze", region=7)
    path = f"world.path={write_site(tmp_path, 'maze')}"
    with pytest.raises(ConfigError, match=r"world\.region must be"):
        compose_environment("sdf", [path, "world.region=0"])


@pytest.mark.slow
def test_the_choice_is_told_in_one_line(tmp_path):
    conf = compose_environment("sdf", [f"world.path={write_site(tmp_path, 'maze')}"])
    (line,) = describe_world(conf)
    assert line.startswith("Starts and goals: x 4")
    assert "between objects" in line and "world.region=2 chooses another of 2; view=map shows them" in line
    console = Console(record=True, width=80)
    print_world_notes(console, conf)
    assert console.export_text() == f"{line}\n"
    elsewhere = compose_environment(
        "sdf", [f"world.path={write_site(tmp_path, 'maze')}", "task.spawn.region=anywhere"]
    )
    assert describe_world(elsewhere) == []
    assert describe_world(compose_environment("flat")) == []


def test_candidates_are_kept_in_the_cache(tmp_path):
    world = build(tmp_path, "house")
    again = deserialize_world(*serialize_world(world))
    assert again.region_candidates == world.region_candidates
    assert describe_choice(again.region, again.region_candidates) is not None


@pytest.mark.slow
def test_the_same_file_has_the_same_regions(tmp_path):
    assert build(tmp_path, "crates").region_candidates == build(tmp_path, "crates").region_candidates


@pytest.mark.slow
@pytest.mark.parametrize("name", ["maze", "house"])
def test_an_environment_of_rooms_and_corridors_starts_with_its_default_actors(tmp_path, name):
    env = dune_rl.parallel_env(world={"name": "sdf", "path": str(write_site(tmp_path, name))}, seed=1)
    try:
        for seed in range(3):
            env.reset(seed=seed)
    finally:
        env.close()


@pytest.mark.slow
@pytest.mark.skipif(not SHARED_WORLDS.exists(), reason="needs the shared worlds")
def test_on_a_farm_the_first_region_is_between_the_solar_arrays():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        world = build_mesh(MeshConf(path=str(SHARED_WORLDS / "agriculture_world.dae")))
    assert is_within(world.region, (-20.0, 75.0, -45.0, -10.0))
