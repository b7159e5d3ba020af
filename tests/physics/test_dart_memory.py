"""DART's copies of collision meshes: freed once nobody uses them, and not before."""

import gc
import signal
import zlib
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("dartpy")

import dune_rl.physics.dart.memory as memory
from dune_rl.geometry.heightfield import HeightField
from dune_rl.physics.dart.memory import MeshCopy, forget_copies, free_unused_copies
from dune_rl.physics.dart.statics import CollisionMeshes, _watch_copies
from dune_rl.physics.process_memory import read_memory
from dune_rl.physics.shapes import StaticBody

pytestmark = pytest.mark.skipif(
    not _watch_copies.is_needed, reason="this DART keeps no copies, or cannot say"
)


def terrain(seed: int, cells: int = 64) -> tuple[StaticBody, ...]:
    """Rough ground of so many cells along each side."""
    heights = np.random.default_rng(seed).random((cells + 1, cells + 1))
    vertices, faces = HeightField(heights, 0.5, (0.0, 0.0)).mesh()
    return (StaticBody("terrain", vertices, faces, 1.0, ground=True, restitution=0.0),)


@pytest.fixture
def forgotten() -> Iterator[list[MeshCopy]]:
    """The copies that nobody uses any more; none at first."""
    gc.collect()
    free_unused_copies()
    yield memory._unused
    free_unused_copies()


@pytest.fixture
def freed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The addresses of what is freed, which is freed indeed."""
    addresses: list[int] = []
    library = memory._c_library()

    class Library:
        malloc = staticmethod(library.malloc)

        @staticmethod
        def free(address: int) -> None:
            addresses.append(address)
            library.free(address)

    monkeypatch.setattr(memory, "_c_library", Library)
    return addresses


def is_whole(copy: MeshCopy) -> bool:
    content = read_memory(copy.start, copy.used)
    return content is not None and zlib.crc32(content) == copy.checksum


@pytest.mark.parametrize("cells", [3, 64])
def test_copies_are_found_and_freed_once_they_are_not_used(
    cells: int, forgotten: list[MeshCopy], freed: list[int]
) -> None:
    meshes = CollisionMeshes(terrain(0, cells))
    freed.clear()
    assert not forgotten
    del meshes
    gc.collect()
    copies = list(forgotten)
    # 3 corners of each triangle, and of 2 that make the mesh a fold: 32 bytes, and an index of 4.
    corners = 3 * (2 * cells**2 + 2)
    assert sorted(copy.used for copy in copies) == [4 * corners, 32 * corners]
    assert all(is_whole(copy) for copy in copies) and not freed
    free_unused_copies()
    assert sorted(freed) == sorted(copy.block for copy in copies) and not forgotten


def test_meshes_that_are_in_use_stay(forgotten: list[MeshCopy], freed: list[int]) -> None:
    kept, dropped = CollisionMeshes(terrain(0)), CollisionMeshes(terrain(1))
    del dropped
    gc.collect()
    assert len(forgotten) == 2
    freed.clear()
    free_unused_copies()
    assert len(freed) == 2
    del kept
    gc.collect()
    assert len(forgotten) == 2 and all(is_whole(copy) for copy in forgotten)
    assert not {copy.block for copy in forgotten} & set(freed)


def test_equal_meshes_have_copies_of_their_own(forgotten: list[MeshCopy]) -> None:
    (body,) = terrain(0, 5)
    meshes = CollisionMeshes((body, body))
    del meshes
    gc.collect()
    assert len({copy.block for copy in forgotten}) == len(forgotten) == 4


def test_memory_with_other_content_is_left_alone(forgotten: list[MeshCopy], freed: list[int]) -> None:
    array = np.ones(10_000, np.uint8)
    forget_copies([MeshCopy(array.ctypes.data, array.ctypes.data, array.nbytes, checksum=1)])
    forget_copies([MeshCopy(0, 16, 64, checksum=1)])
    free_unused_copies()
    assert not freed and array.all()


def test_nothing_is_freed_where_dart_does_so(
    monkeypatch: pytest.MonkeyPatch, forgotten: list[MeshCopy]
) -> None:
    monkeypatch.setitem(_watch_copies.__dict__, "is_needed", False)
    meshes = CollisionMeshes(terrain(2))
    del meshes
    gc.collect()
    assert not forgotten


def test_a_trial_tells_whether_copies_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    # A mesh that is not even loaded leaves nothing behind.
    assert not memory.CopyWatch(lambda corners: None).is_needed
    monkeypatch.setattr(memory, "_allocator_setter", lambda: None)
    assert not memory.CopyWatch(lambda corners: pytest.fail("there is nothing to try")).is_needed


def test_a_small_mesh_does_not_take_the_copy_of_a_large_one(forgotten: list[MeshCopy]) -> None:
    small, large = terrain(4, cells=24)[0], terrain(5)[0]
    meshes = CollisionMeshes((small, large, small))
    del meshes
    gc.collect()
    corners = sorted(3 * (2 * cells**2 + 2) for cells in (24, 64, 24))
    assert sorted(copy.used for copy in forgotten) == sorted(
        width * count for width in (4, 32) for count in corners
    )


def test_an_interrupt_waits_until_bullet_has_its_memory() -> None:
    """In Bullet's allocator an exception would leave it without memory, and end the process."""
    went_on = False
    # Processes in the background may ignore it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt), _watch_copies([], []):
        signal.raise_signal(signal.SIGINT)
        went_on = True
    assert went_on
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler
