"""Ground and things told apart in meshes."""

import numpy as np
import pytest
import trimesh
from world_files import (
    box,
    bumpy_ground,
    ground_height,
    write_yard,
    yard,
)

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.importing.imported_world import ImportedWorld
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh
from dune_rl.worlds.importing.topology import boundary_edges, weld_vertices


def build(tmp_path, named, **settings) -> ImportedWorld:
    return build_mesh(MeshConf(path=str(write_yard(tmp_path, "obj", named)), **settings))


def test_roofs_and_bridges_are_things_and_what_is_under_them_is_ground(tmp_path):
    canopy = trimesh.util.concatenate(
        [
            box(0, 5, 2.4, (3.0, 3.0, 0.1)),
            *(box(x, 5 + y, -0.8, (0.12, 0.12, 3.25)) for x in (-1.3, 1.3) for y in (-1.3, 1.3)),
        ]
    )
    deck = box(-4.0, 4.0, 0.9, (6.0, 2.0, 0.2))
    world = build(tmp_path, {"Terrain": bumpy_ground(), "canopy": canopy, "deck": deck})
    xy = np.array([[0.0, 5.0], [-4.0, 4.0]])
    np.testing.assert_allclose(world.terrain.height(xy), ground_height(xy), atol=0.01)
    assert {prop.name for prop in world.props} == {"canopy", "deck"}
    assert world.clearance(xy).min() > 0.5
    assert world.clearance(np.array([1.3, 6.3])) == 0.0


def test_a_roof_as_wide_as_the_floor_is_not_the_ground(tmp_path):
    floor, roof = box(0, 0, -0.2, (16, 12, 0.2)), box(0, 0, 3.0, (16.4, 12.4, 0.2))
    world = build(tmp_path, {"a": floor, "b": roof, "c": box(0, 0, 0, (0.5, 0.5, 3.1))})
    assert float(world.terrain.height([3.0, 3.0])) == pytest.approx(0.0, abs=1e-6)
    assert {prop.name for prop in world.props} == {"b", "c"}


def test_mounds_plates_and_tiles_join_the_ground(tmp_path):
    tiles = {f"tile{x}{y}": box(8 * x, 8 * y, -0.3, (8, 8, 0.3)) for x in (0, 1) for y in (0, 1)}
    mound = trimesh.creation.icosphere(3, 1.0)
    mound.vertices *= [2.5, 2.0, 0.3]
    mound.apply_translation([4.0, 4.0, -0.03])
    plate = box(8.0, 0.0, 0.0, (2.0, 1.0, 0.03))
    world = build(
        tmp_path, {**tiles, "mound": mound, "plate": plate, "block": box(0, 0, 0, (0.8, 0.8, 0.14))}
    )
    np.testing.assert_allclose(world.extent, (-4, 12, -4, 12), atol=0.06)
    assert float(world.terrain.height([4.0, 4.0])) == pytest.approx(0.27, abs=0.03)
    assert float(world.terrain.height([8.0, 0.0])) == pytest.approx(0.03, abs=1e-3)
    assert float(world.terrain.height([10.0, 10.0])) == pytest.approx(0.0, abs=1e-6)
    assert "block" in {prop.name for prop in world.props}
    assert not {"mound", "tile00", "tile11"} & {prop.name for prop in world.props}
    assert world.clearance(np.zeros(2)) == 0.0
    # A wheel takes the mound, but 0.14 m is an obstacle.
    assert world.clearance(np.array([4.0, 4.0])) > 2.0


def test_a_block_that_is_one_piece_with_the_ground_is_still_a_thing(tmp_path):
    ground = bumpy_ground(step=0.5)
    raised = (np.abs(ground.vertices[:, 0] - 3) < 0.8) & (np.abs(ground.vertices[:, 1] - 3) < 0.8)
    # Steep sides a tenth of a metre wide, as a scan would have them.
    ground.vertices[raised, 2] += 2.0
    world = build(tmp_path, {"scan": ground})
    assert world.clearance(np.array([3.0, 3.0])) == 0.0
    assert world.clearance(np.array([6.0, 3.0])) == pytest.approx(2.0, abs=0.4)
    (prop,) = world.props
    assert not len(boundary_edges(weld_vertices(prop.vertices, prop.faces))[0])


def test_open_sheets_are_made_closed_and_block(tmp_path):
    wall = trimesh.Trimesh([[2, -4, -1], [2, 4, -1], [2, 4, 2], [2, -4, 2]], [[0, 1, 2], [0, 2, 3]])
    awning = trimesh.Trimesh([[-8, -2, 2], [-4, -2, 2], [-4, 2, 2], [-8, 2, 2]], [[0, 1, 2], [0, 2, 3]])
    shed = box(-3, -5, -1.0, (1.5, 1.5, 2.5))
    shed.update_faces(shed.face_normals[:, 2] > -0.5)
    world = build(tmp_path, {"Terrain": bumpy_ground(), "wall": wall, "awning": awning, "shed": shed})
    for prop in world.props:
        assert not len(boundary_edges(weld_vertices(prop.vertices, prop.faces))[0]), prop.name
    assert world.clearance(np.array([2.0, 0.0])) < 0.05
    # Under the awning is free, and a box without a bottom is solid all the same.
    assert world.clearance(np.array([-6.0, 0.0])) > 1.0
    assert world.clearance(np.array([-3.0, -5.0])) == 0.0


def test_wires_thinner_than_a_cell_count_and_faces_on_each_other_do_not_block(tmp_path):
    wire = box(0, -4, -0.6, (0.01, 0.01, 3.0))
    lintel, roof = box(0, 4, 2.0, (4, 0.1, 0.4)), box(0, 4, 2.4, (6, 3, 0.2))
    world = build(tmp_path, {"Terrain": bumpy_ground(), "wire": wire, "lintel": lintel, "roof": roof})
    assert world.clearance(np.array([0.0, -4.0])) < 0.05
    x = np.linspace(-1.9, 1.9, 200)
    assert world.clearance(np.stack([x, np.full(200, 4.0)], axis=1)).min() > 1.0


def test_a_dome_for_the_sky_is_left_out_and_costs_nothing(tmp_path):
    dome = trimesh.creation.icosphere(2, 5000.0)
    with pytest.warns(WorldWarning, match="'dome' reaches far beyond the ground"):
        world = build(tmp_path, yard() | {"dome": dome, "sail": box(30, 0, -1, (60, 0.05, 40))})
    assert {prop.name for prop in world.props} == {"Crate_01", "Bench", "sail"}
    assert world.clearance(np.array([5.0, 0.0])) < 0.05
    assert world.clearance(np.array([-5.0, 4.0])) > 2.0


def test_holes_are_filled_smoothly_and_warned_of(tmp_path):
    ground = bumpy_ground()
    centre = ground.triangles_center
    ground.update_faces(np.hypot(centre[:, 0] + 4, centre[:, 1] - 2) > 1.5)
    path = write_yard(tmp_path, "obj", {"Terrain": ground})
    with pytest.warns(WorldWarning, match=r"yard.obj: 2\.\d% of its rectangle of 20 by 16 m has no ground"):
        world = build_mesh(MeshConf(path=str(path)))
    xy = np.stack(np.meshgrid(np.linspace(-5.5, -2.5, 30), np.linspace(0.5, 3.5, 30)), axis=-1)
    assert np.abs(world.terrain.height(xy) - ground_height(xy)).max() < 0.2
    assert np.rad2deg(world.terrain.slope(xy)).max() < 30.0


def test_names_of_the_ground_can_be_given(tmp_path):
    named = {"low": box(0, 0, -1, (20, 20, 1)), "high": box(0, 0, 4, (12, 12, 1))}
    assert build(tmp_path, named).terrain.heights.max() == pytest.approx(0.0, abs=1e-6)
    assert build(tmp_path, named, ground=("hi*",)).terrain.heights.max() == pytest.approx(5.0, abs=1e-6)
    with pytest.raises(WorldError, match="names none of the file's parts; it has high, low"):
        build(tmp_path, named, ground=("mid*",))
