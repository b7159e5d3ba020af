"""Worlds from mesh files: the same from every format, in metres, and fit to drive in."""

import re

import numpy as np
import pytest
from mesh_worlds import FORMATS, rover_in
from pydantic import ValidationError
from simulations import act, metric, motion_of_group, observation
from world_files import (
    BENCH,
    CRATE,
    SHARED_WORLDS,
    dae_text,
    ground_height,
    joined,
    obj_text,
    write_yard,
    yard,
)

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.tasks.spawn import SpawnConf, Spawner
from dune_rl.worlds.importing.imported_world import ImportedWorld
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh
from dune_rl.worlds.importing.topology import boundary_edges, weld_vertices

_built: dict[str, ImportedWorld] = {}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    def of(kind: str) -> ImportedWorld:
        if kind not in _built:
            _built[kind] = build_mesh(MeshConf(path=str(write_yard(tmp_path_factory.mktemp(kind), kind))))
        return _built[kind]

    return of


@pytest.mark.parametrize("kind", FORMATS)
def test_ground_and_things_are_recovered_from_every_format(built, kind):
    world = built(kind)
    np.testing.assert_allclose(world.extent, (-10, 10, -8, 8), atol=0.06)
    xy = np.random.default_rng(0).uniform([-9.8, -7.8], [9.8, 7.8], (4000, 2))
    # Half a cell of the file's own grid, bent by 0.1 / m: a few millimetres.
    assert np.abs(world.terrain.height(xy) - ground_height(xy)).max() < 0.01
    assert len(world.props) == 2
    crate, bench = sorted(world.props, key=lambda prop: -prop.vertices[:, 0].max())
    np.testing.assert_allclose(np.ptp(crate.vertices, axis=0), [1.0, 1.0, 1.5], atol=1e-3)
    np.testing.assert_allclose(np.ptp(bench.vertices, axis=0), [2.0, 0.6, 1.1], atol=1e-3)
    np.testing.assert_allclose(crate.vertices.mean(axis=0)[:2], CRATE, atol=1e-3)
    outside = np.maximum(np.abs(xy - CRATE) - 0.5, 0.0), np.maximum(np.abs(xy - BENCH) - [1.0, 0.3], 0.0)
    true = np.minimum(np.hypot(*outside[0].T), np.hypot(*outside[1].T))
    assert np.abs(world.clearance(xy) - true).max() < 0.11
    assert world.clearance(np.array(CRATE)) == 0.0


@pytest.mark.parametrize("kind", ["obj", "glb", "dae"])
def test_names_in_the_file_become_names_and_kinds(built, kind):
    assert {(prop.name, prop.kind) for prop in built(kind).props} == {
        ("Crate_01", "crate"),
        ("Bench", "bench"),
    }


@pytest.mark.parametrize("kind", FORMATS)
def test_props_are_closed_and_face_outward(built, kind):
    for prop in built(kind).props:
        start, _ = boundary_edges(weld_vertices(prop.vertices, prop.faces))
        assert not len(start)
        a, b, c = np.moveaxis(prop.vertices[prop.faces], 1, 0)
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        assert volume == pytest.approx(np.ptp(prop.vertices, axis=0).prod(), rel=1e-3)


def test_unit_and_axis_settings_stand_in_for_what_a_file_does_not_say(tmp_path):
    turned = joined(yard()).apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    turned.apply_scale(1000.0)
    turned.export(tmp_path / "mm.stl")
    world = build_mesh(MeshConf(path=str(tmp_path / "mm.stl"), unit_m=0.001, up="y"))
    np.testing.assert_allclose(world.extent, (-10, 10, -8, 8), atol=0.06)
    assert abs(float(world.terrain.height([2.0, 1.0])) - ground_height(np.array([2.0, 1.0]))) < 0.01


def test_a_dae_in_metres_with_z_up_is_taken_as_it_is(tmp_path):
    path = tmp_path / "yard.dae"
    path.write_text(dae_text(yard(), unit='<unit name="meter" meter="1"/>', axis="Z_UP"))
    np.testing.assert_allclose(build_mesh(MeshConf(path=str(path))).extent, (-10, 10, -8, 8), atol=0.06)


def test_a_finer_grid_is_finer_and_a_huge_one_refused(tmp_path):
    path = write_yard(tmp_path, "stl")
    world = build_mesh(MeshConf(path=str(path), spacing_m=0.5))
    assert world.terrain.heights.shape == (33, 41)
    with pytest.raises(
        WorldError, match=r"world.spacing_m=0.001? makes more|world.spacing_m=0.01 makes more"
    ):
        build_mesh(MeshConf(path=str(path), unit_m=10.0, spacing_m=0.01))
    with pytest.raises(WorldError, match=r"set world.unit_m|unit is right"):
        build_mesh(MeshConf(path=str(path), unit_m=1e4))


def test_a_region_is_chosen_where_there_is_room_and_a_user_s_is_kept(built, tmp_path):
    world = built("obj")
    xmin, xmax, ymin, ymax = world.region
    assert (xmax - xmin, ymax - ymin) == pytest.approx((8.0, 8.0))
    spawner = Spawner(world, SpawnConf(), 0.45)
    for seed in range(20):
        place = spawner.sample(np.random.default_rng(seed))
        assert world.clearance(np.array([place.x, place.y])) > 0.45
    path = write_yard(tmp_path, "stl")
    assert build_mesh(MeshConf(path=str(path), region=(-9, -7, 3, 5))).region == (-9, -7, 3, 5)
    with pytest.raises(WorldError, match=r"world.region must be"):
        build_mesh(MeshConf(path=str(path), region=(2, 1, 0, 1)))


def test_a_rover_stands_and_its_lidar_sees_the_things(tmp_path):
    path = write_yard(tmp_path, "glb")
    # Beside the crate, which is the nearest thing from all of it.
    world = build_mesh(MeshConf(path=str(path), region=(1.0, 3.0, 2.0, 4.0)))
    simulation = rover_in(world)
    for _ in range(30):
        act(simulation)
    position = motion_of_group(simulation).position_w[0]
    assert 0.0 < float(position[2] - world.terrain.height(position[:2])) < 0.4
    assert np.abs(motion_of_group(simulation).velocity_w[0]).max() < 0.02
    assert metric(simulation, "collisions")[0] == 0
    away = np.maximum(np.abs(position[:2] - CRATE) - 0.5, 0.0)
    # The LiDAR sits 0.2 m from the rover's middle, and its beams are some 11 degrees apart.
    assert observation(simulation)["lidar"].min() == pytest.approx(np.hypot(*away), abs=0.35)
    simulation.close()


def test_a_mesh_far_from_its_origin_is_moved_there(tmp_path):
    mesh = joined(yard())
    mesh.apply_translation([500_000.0, 5_000_000.0, 1200.0])
    (tmp_path / "utm.obj").write_text(obj_text({"Terrain": mesh}))
    with pytest.warns(WorldWarning, match="is far from its origin and is moved there"):
        world = build_mesh(MeshConf(path=str(tmp_path / "utm.obj")))
    np.testing.assert_allclose(world.extent, (-10, 10, -8, 8), atol=1.0)
    assert np.ptp(world.terrain.heights) < 1.0


@pytest.mark.parametrize(
    "wrong", [{"path": ""}, {"spacing_m": 0}, {"unit_m": -1}, {"up": "w"}, {"friction": 0}, {"pathh": "x"}]
)
def test_bad_settings_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        MeshConf(**({"path": "x"} | wrong))


def test_the_same_file_gives_the_same_world(built, tmp_path):
    again = build_mesh(MeshConf(path=str(write_yard(tmp_path, "glb"))))
    np.testing.assert_array_equal(again.terrain.heights, built("glb").terrain.heights)
    for first, second in zip(again.props, built("glb").props, strict=True):
        np.testing.assert_array_equal(first.vertices, second.vertices)


@pytest.mark.slow
@pytest.mark.skipif(not SHARED_WORLDS.is_dir(), reason="the worlds of others are not here")
def test_the_agriculture_world():
    path = SHARED_WORLDS / "agriculture_world.dae"
    with pytest.warns(WorldWarning) as caught:
        world = build_mesh(MeshConf(path=str(path)))
    assert all(re.search(r"\.jpg is missing; its faces have a plain colour", str(w.message)) for w in caught)
    assert len({str(w.message) for w in caught}) == len(caught) == 6
    np.testing.assert_allclose(np.diff(world.extent)[[0, 2]], [120, 160], atol=0.5)
    assert world.terrain.heights.min() == pytest.approx(-4.84, abs=0.05)
    assert world.terrain.heights.max() == pytest.approx(1.70, abs=0.05)
    kinds = [prop.kind for prop in world.props]
    assert kinds.count("solar panels") == 43
    assert "barn" in kinds
    # Through the barn's door, and not through its walls.
    assert world.clearance(np.array([-1.5, 4.8])) > 2.0
    assert world.clearance(np.array([-10.0, 4.8])) < 0.1
    assert world.clearance(np.array([-1.5, 20.0])) > 5.0
    place = Spawner(world, SpawnConf(), 0.45).sample(np.random.default_rng(0))
    assert world.clearance(np.array([place.x, place.y])) > 0.45
