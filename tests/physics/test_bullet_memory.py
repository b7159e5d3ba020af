"""PyBullet's clients: what is given back of their memory changes nothing, nor does using one again."""

import mmap
import os
import subprocess
import sys
import threading
from contextlib import nullcontext

import numpy as np
import pybullet
import pytest
from scenes import SUBSTEPS, Company, box, plane, rover_body, walker

import dune_rl.physics.bullet.clients as clients
import dune_rl.physics.bullet.memory as memory
from dune_rl.physics.bullet.memory import returned_zero_pages
from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.physics.process_memory import return_free_memory

MIB = 2**20
on_linux = pytest.mark.skipif(not memory.IS_SUPPORTED, reason="other systems keep all memory")


def allocate(size: int) -> tuple[mmap.mmap, np.ndarray]:
    """Private memory of so many bytes that is resident, all zeros."""
    block = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    array = np.frombuffer(block, np.uint8)
    array[:] = 0
    return block, array


def resident(array: np.ndarray) -> np.ndarray:
    """Which of the pages of an array are resident."""
    start = array.ctypes.data
    return memory._resident(start, start + array.nbytes)


@pytest.fixture
def no_spare_client():
    """No client waits to be used again."""
    while clients._spare:
        pybullet.disconnect(clients._spare.pop())


# -- pages of zeros ----------------------------------------------------------------------------------


@pytest.fixture
def no_other_threads(monkeypatch):
    """Threads that other tests have left, which write nothing, do not count."""
    monkeypatch.setattr(threading, "active_count", lambda: 1)


@on_linux
@pytest.mark.usefixtures("no_other_threads")
def test_pages_of_zeros_are_returned_and_read_and_take_values_as_before():
    with returned_zero_pages():
        _block, array = allocate(8 * MIB)
        array[3 * MIB : 3 * MIB + 5] = [1, 2, 3, 4, 5]
        assert resident(array).all()
    kept = resident(array)
    assert kept[3 * MIB // mmap.PAGESIZE]
    assert kept.sum() < 0.1 * len(kept)
    assert array[3 * MIB : 3 * MIB + 5].tolist() == [1, 2, 3, 4, 5]
    assert array.sum() == 15
    array[:] = 7
    assert (array == 7).all()


@on_linux
@pytest.mark.usefixtures("no_other_threads")
def test_memory_from_before_and_shared_memory_are_left_alone():
    _block, array = allocate(8 * MIB)
    with returned_zero_pages():
        shared = np.frombuffer(mmap.mmap(-1, 8 * MIB), np.uint8)
        shared[:] = 0
    assert resident(array).all()
    assert resident(shared).all()


@on_linux
def test_nothing_is_returned_while_other_threads_run():
    stop = threading.Event()
    other = threading.Thread(target=stop.wait)
    with returned_zero_pages():
        _block, late = allocate(8 * MIB)
        other.start()
    with returned_zero_pages():
        _block_too, early = allocate(8 * MIB)
    stop.set()
    other.join()
    assert resident(late).all() and resident(early).all()


@on_linux
def test_a_system_without_the_means_returns_nothing(monkeypatch):
    monkeypatch.setattr(memory, "IS_SUPPORTED", False)
    with returned_zero_pages():
        _block, array = allocate(8 * MIB)
    return_free_memory()
    assert resident(array).all()

    def refuse(*_given):
        raise PermissionError

    monkeypatch.setattr(memory, "IS_SUPPORTED", True)
    for part in ("private_ranges", "_resident"):
        with monkeypatch.context() as patch:
            patch.setattr(memory, part, refuse)
            with returned_zero_pages():
                _block, array = allocate(8 * MIB)
        assert resident(array).all()


# -- free lists --------------------------------------------------------------------------------------


def link(array: np.ndarray, stride: int, count: int) -> np.ndarray:
    """Make a free list at the array's start of so many elements of `stride` words; where its links are."""
    words = array.view(np.uint64)
    places = stride * np.arange(count)
    words[places[:-1]] = array.ctypes.data + 8 * places[1:]
    words[places[-1]] = 0
    return places


def walk(array: np.ndarray) -> int:
    """Elements that can be taken from a free list at the array's start."""
    words, count, place = array.view(np.uint64), 1, 0
    while words[place]:
        count, place = count + 1, int(words[place] - np.uint64(array.ctypes.data)) // 8
    return count


@on_linux
@pytest.mark.usefixtures("no_other_threads")
@pytest.mark.parametrize("stride", [35, 196, 512])
def test_a_long_free_list_ends_earlier_and_its_elements_can_be_used(stride):
    with returned_zero_pages():
        _block, array = allocate(32 * MIB)
        link(array, stride, 4096)
    kept = walk(array)
    assert memory._KEPT_ELEMENTS <= kept < 2 * memory._KEPT_ELEMENTS
    assert resident(array).sum() <= 8 * stride * kept // mmap.PAGESIZE + 20
    array[:] = 7
    assert (array == 7).all()


def _holds_something(words, places):
    words[places + 1] = 5


def _does_not_end(words, places):
    words[places[-1]] = 5


def _leads_back(words, places):
    words[places[-1]] = words[places[0]]


def _is_short(words, places):
    words[places[memory._LEAST_ELEMENTS - 2] :] = 0


@on_linux
@pytest.mark.usefixtures("no_other_threads")
@pytest.mark.parametrize("change", [_holds_something, _does_not_end, _leads_back, _is_short])
def test_what_looks_like_a_long_free_list_but_is_none_keeps_its_content(change):
    with returned_zero_pages():
        _block, array = allocate(16 * MIB)
        words = array.view(np.uint64)
        change(words, link(array, 196, 4096))
        before = words.copy()
    assert (words == before).all()


def test_an_error_in_the_block_comes_through():
    with pytest.raises(KeyError), returned_zero_pages():
        raise KeyError


def test_what_regions_have_beyond_known_ones():
    least = memory._LEAST_REGION
    known = [(2 * least, 3 * least), (5 * least, 6 * least)]
    found = memory.subtract_ranges([(0, 8 * least), (9 * least, 9 * least + 10)], known, least)
    assert list(found) == [(0, 2 * least), (3 * least, 5 * least), (6 * least, 8 * least)]
    assert not list(memory.subtract_ranges(known, known, least))
    # One that has grown upward and downward.
    grown = memory.subtract_ranges([(0, 9 * least)], [(2 * least, 3 * least)], least)
    assert list(grown) == [(0, 2 * least), (3 * least, 9 * least)]
    assert list(memory.subtract_ranges([(0, 9 * least)], [], least)) == [(0, 9 * least)]


def test_runs_of_pages():
    flags = np.zeros(100, bool)
    flags[5:30] = flags[40:43] = flags[80:] = True
    assert list(memory._runs(flags)) == [(5, 25), (80, 20)]


# -- simulations -------------------------------------------------------------------------------------


def drive(size_m: float = 0.4, boxes: int = 1) -> tuple[bytes, int]:
    """States of a rover that drives into a box, or many in one another, and the client that it did so in."""
    walls = [plane(), *(box((1.0, 0.1), size_m, 2.0, 1.0) for _ in range(boxes))]
    company = Company(BulletScene, [rover_body()], walls, [walker()])
    company.place([0.0, 0.0, 0.13], actors=[[0.0, 0.9, 0.0, 0.0]])
    states = []
    for step in range(40):
        company.robots[0].set_command([4.0, 5.0, 4.0, 5.0])
        company.step(SUBSTEPS, [[0.0, 0.9 - 0.02 * step, 0.0, 0.0]])
        states.append(company.states.tobytes())
    client = company.scene._client
    company.scene.close()
    return b"".join(states), client


def test_a_scene_in_a_used_client_gives_the_same_bytes_as_in_a_fresh_one(no_spare_client):
    fresh, client = drive()
    # It was kept, and others were in it in the meantime.
    different, same = drive(size_m=0.9)
    assert same == client and different != fresh
    again, same = drive()
    assert same == client
    assert again == fresh


def test_returned_memory_changes_no_simulation(no_spare_client, monkeypatch):
    returned, _ = drive()
    pybullet.disconnect(clients._spare.pop())
    monkeypatch.setattr(clients, "returned_zero_pages", nullcontext)
    assert drive()[0] == returned


def drive_with_short_pools() -> None:
    """Drives in a client whose pools are cut to a few elements and in one whose are whole are the same.

    For a fresh process: in memory that others have used nothing is cut.
    """
    cut: list[int] = []
    find = memory._free_lists

    def spied(*given):
        for found in find(*given):
            cut.append(found[-1])
            yield found

    memory._free_lists, memory._KEPT_ELEMENTS = spied, 4
    clients._spare.append(clients.open_client())
    assert sorted(cut) == [4096, 4096]
    # Each box is in contact with the hull and two tyres.
    short, client = drive(boxes=40)
    # The client is used again: what was in it is gone, and its pools are whole.
    assert drive(boxes=40) == (short, client)
    print("same")


@pytest.mark.slow
@on_linux
def test_more_contacts_than_a_cut_pool_has_change_no_simulation():
    code = "from test_bullet_memory import drive_with_short_pools; drive_with_short_pools()"
    environ = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=environ, capture_output=True, text=True)
    assert done.stdout.split()[-1:] == ["same"], done.stderr


def test_one_client_is_kept_and_others_are_closed(no_spare_client):
    opened = [clients.open_client() for _ in range(3)]
    for client in opened:
        clients.release_client(client)
        clients.release_client(client)
    assert clients._spare == opened[:1]
    assert [bool(pybullet.isConnected(client)) for client in opened] == [True, False, False]
    assert clients.open_client() == opened[0]
    pybullet.disconnect(opened[0])


def test_a_spare_client_that_was_closed_elsewhere_is_not_used(no_spare_client):
    client = clients.open_client()
    clients.release_client(client)
    pybullet.disconnect(client)
    other = clients.open_client()
    assert pybullet.isConnected(other)
    pybullet.disconnect(other)
