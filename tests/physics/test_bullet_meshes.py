"""Collision meshes of PyBullet: scenes that are built one after another get the mesh that they were given."""

import gc
import weakref

import numpy as np
import pybullet
import pytest

from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.bullet.client import create_mesh_shape, release_mesh_lists


def ground(cells: int, height_m: float) -> tuple[np.ndarray, np.ndarray]:
    """A level square of 10 m with two triangles a cell."""
    return HeightField(np.full((cells + 1, cells + 1), height_m), 10.0 / cells, (-5.0, -5.0)).mesh()


@pytest.fixture
def client():
    number = pybullet.connect(pybullet.DIRECT)
    yield number
    pybullet.disconnect(number)


def height_below(client: int) -> float:
    hit = pybullet.rayTest([1.03, 2.07, 50.0], [1.03, 2.07, -50.0], physicsClientId=client)[0]
    return hit[3][2]


def add(client: int, mesh: tuple[np.ndarray, np.ndarray]) -> None:
    shape = create_mesh_shape(*mesh, client)
    assert shape >= 0
    pybullet.createMultiBody(0.0, shape, physicsClientId=client)


# 2 * 120 * 120 triangles are a large mesh, 2 * 4 * 4 a small one.
@pytest.mark.slow(all_but=["4"])
@pytest.mark.parametrize("cells", [4, 120])
def test_each_scene_gets_its_own_mesh(client: int, cells: int) -> None:
    low, high = ground(cells, 1.0), ground(cells, 2.0)
    others = [pybullet.connect(pybullet.DIRECT) for _ in range(3)]
    add(client, low)
    add(others[0], low)
    add(others[1], high)
    add(others[2], low)
    found = [height_below(number) for number in (client, *others)]
    assert found == pytest.approx([1.0, 1.0, 2.0, 1.0])
    for number in others:
        pybullet.disconnect(number)


@pytest.mark.slow
def test_a_small_mesh_between_two_scenes_leaves_the_large_one(client: int) -> None:
    large = ground(120, 1.0)
    second = pybullet.connect(pybullet.DIRECT)
    for number in (client, second):
        add(number, large)
        add(number, ground(4, -3.0))
    assert [height_below(number) for number in (client, second)] == pytest.approx([1.0, 1.0])
    pybullet.disconnect(second)


def test_a_large_mesh_is_held_until_scenes_are_built_no_more(client: int) -> None:
    vertices, faces = ground(120, 1.0)
    held = weakref.ref(vertices)
    add(client, (vertices, faces))
    del vertices, faces
    assert held() is not None
    release_mesh_lists()
    gc.collect()
    assert held() is None
