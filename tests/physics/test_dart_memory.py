"""DART's copies of collision meshes: given back once nobody uses them, and not before."""

import gc
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("dartpy")

import dune_rl.physics.dart.memory as memory
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.dart.memory import MeshCopy, forget_copies, return_unused_copies
from dune_rl.physics.dart.statics import CollisionMeshes
from dune_rl.physics.interface import StaticBody
from dune_rl.physics.process_memory import PAGE, read_memory

pytestmark = pytest.mark.skipif(memory._bullets_allocator_setter() is None, reason="DART tells no addresses")


def terrain(seed: int, cells: int = 64) -> tuple[StaticBody, ...]:
    """Rough ground of so many cells along each side."""
    heights = np.random.default_rng(seed).random((cells + 1, cells + 1))
    vertices, faces = HeightField(heights, 0.5, (0.0, 0.0)).mesh()
    return (StaticBody("terrain", vertices, faces, 1.0, ground=True, restitution=0.0),)


@pytest.fixture
def forgotten(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[MeshCopy]]:
    """The copies that nobody uses any more; none at first."""
    return_unused_copies()
    yield memory._unused
    return_unused_copies()


def is_zero(copy: MeshCopy) -> bool:
    content = read_memory(copy.address, copy.pages * PAGE)
    assert content is not None
    return not any(content)


def test_copies_are_found_and_given_back_once_they_are_not_used(forgotten: list[MeshCopy]) -> None:
    meshes = CollisionMeshes(terrain(0))
    assert not forgotten
    del meshes
    gc.collect()
    copies = list(forgotten)
    # Vertices and indices of 8194 triangles: 3 corners of 32 and 4 bytes each.
    assert sorted(copy.used // PAGE for copy in copies) == [23, 191]
    assert not any(is_zero(copy) for copy in copies)
    another = CollisionMeshes(terrain(1))
    assert all(is_zero(copy) for copy in copies) and not forgotten
    del another
    gc.collect()


def test_meshes_that_are_in_use_stay(forgotten: list[MeshCopy]) -> None:
    kept, dropped = CollisionMeshes(terrain(0)), CollisionMeshes(terrain(1))
    del dropped
    gc.collect()
    gone = list(forgotten)
    return_unused_copies()
    assert all(is_zero(copy) for copy in gone)
    del kept
    gc.collect()
    assert len(forgotten) == 2 and not any(is_zero(copy) for copy in forgotten)


def test_memory_with_other_content_is_left_alone(forgotten: list[MeshCopy]) -> None:
    array = np.ones(8 * PAGE, np.uint8)
    start = -(-array.ctypes.data // PAGE) * PAGE
    forget_copies([MeshCopy(start, 4, 4 * PAGE, checksum=1)])
    return_unused_copies()
    assert array.all()


def test_memory_that_is_gone_is_no_fault() -> None:
    forget_copies([MeshCopy(0, 1, PAGE, checksum=0)])
    return_unused_copies()


def test_small_meshes_are_let_be(forgotten: list[MeshCopy]) -> None:
    meshes = CollisionMeshes(terrain(0, cells=4))
    del meshes
    gc.collect()
    assert not forgotten


def test_nothing_is_watched_where_bullet_cannot_be_asked(
    monkeypatch: pytest.MonkeyPatch, forgotten: list[MeshCopy]
) -> None:
    monkeypatch.setattr(memory, "_bullets_allocator_setter", lambda: None)
    meshes = CollisionMeshes(terrain(2))
    del meshes
    gc.collect()
    assert not forgotten
