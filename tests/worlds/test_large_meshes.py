"""Meshes larger than Bullet takes as one: in pieces that are the same surface, and fit to drive on."""

import numpy as np
import pytest
from mesh_worlds import rover_in
from simulations import act, motion_of_group
from world_files import bumpy_ground, ground_height

from dune_rl.physics.bullet import scene as bullet
from dune_rl.physics.shapes import mesh_pieces
from dune_rl.worlds.importing.heightmap_world import HeightmapConf, build_heightmap
from dune_rl.worlds.world import World


def by_place(triangles: np.ndarray) -> np.ndarray:
    flat = triangles.reshape(len(triangles), 9)
    return flat[np.lexsort(flat.T)]


@pytest.mark.parametrize(("most_vertices", "most_faces"), [(400, 10**6), (10**6, 500), (100, 100), (3, 1)])
def test_pieces_keep_every_triangle_and_both_bounds(most_vertices, most_faces):
    mesh = bumpy_ground(5.0, 2.0)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)
    pieces = list(mesh_pieces(vertices, faces, most_vertices, most_faces))
    assert len(pieces) > 1
    assert all(len(v) <= most_vertices and len(f) <= most_faces for v, f in pieces)
    together = np.concatenate([v[f] for v, f in pieces])
    np.testing.assert_array_equal(by_place(together), by_place(vertices[faces]))


def test_a_mesh_within_the_bounds_is_left_as_it_is():
    mesh = bumpy_ground(2.0, 2.0)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)
    ((same_vertices, same_faces),) = mesh_pieces(vertices, faces, 131_072, 174_762)
    assert same_vertices is vertices and same_faces is faces


def driven(world: World, steps: int = 60) -> np.ndarray:
    """Where a rover is that drives straight on from its start, (steps, 3), never far from the ground."""
    batch = rover_in(world)
    path = []
    for _ in range(steps):
        act(batch, [1.0, 0.0])
        path.append(motion_of_group(batch).position_w[0].copy())
    batch.close()
    above = np.array(path)[:, 2] - world.terrain.height(np.array(path)[:, :2])
    assert above.min() > 0.05 and above.max() < 0.4
    return np.array(path)


def hilly_map(folder, half_m: float, side: int) -> World:
    at = np.linspace(-half_m, half_m, side)
    np.save(folder / "m.npy", 0.3 * ground_height(np.stack(np.meshgrid(at, at[::-1]), axis=-1)))
    size = (2 * half_m, 2 * half_m)
    return build_heightmap(
        HeightmapConf(path=str(folder / "m.npy"), size_m=size, region=(-5.0, 5.0, -5.0, 5.0))
    )


def test_seams_are_not_felt(tmp_path, monkeypatch):
    world = hilly_map(tmp_path, 10.0, 101)
    whole = driven(world)
    # Strips of half a metre.
    monkeypatch.setattr(bullet, "_MOST_FACES", 500)
    parted = driven(world)
    assert np.linalg.norm(whole[-1] - whole[0]) > 1.0
    assert np.linalg.norm(parted - whole, axis=1).max() < 0.1


@pytest.mark.slow
def test_a_rover_drives_on_a_map_of_600_by_600(tmp_path):
    world = hilly_map(tmp_path, 30.0, 600)
    assert world.terrain.heights.shape == (600, 600)
    path = driven(world)
    assert np.linalg.norm(path[-1] - path[0]) > 1.0
