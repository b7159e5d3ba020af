"""Worlds built ahead by another process."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from world_digest import digest

from dune_rl.worlds.cache.folder import CacheWarning
from dune_rl.worlds.cache.store import WorldStore
from dune_rl.worlds.flat import FlatConf
from dune_rl.worlds.importing.mesh_world import MeshConf
from dune_rl.worlds.island import IslandConf
from dune_rl.worlds.registry import build_uncached

CONFS = [IslandConf(seed=seed) for seed in range(3)]
PATIENCE_S = 60.0


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def alive(pid: int) -> bool:
    # One that has ended and that nobody has waited for still has a number.
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def kept(store: WorldStore) -> int:
    return sum(store.is_cached(conf) for conf in CONFS)


@pytest.mark.slow
def test_another_process_fills_the_cache_and_ends_with_the_store(tmp_path: Path) -> None:
    store = WorldStore(tmp_path)
    store.prepare([FlatConf()])
    assert store.builder_pid is None
    store.prepare(CONFS)
    child = store.builder_pid
    assert child is not None
    store.prepare(CONFS)
    assert store.builder_pid == child
    wait_for(lambda: kept(store) == len(CONFS))
    assert os.getpriority(os.PRIO_PROCESS, child) > os.getpriority(os.PRIO_PROCESS, 0)
    assert [digest(store.get(conf)) for conf in CONFS] == [digest(build_uncached(conf)) for conf in CONFS]
    store.close()
    assert not alive(child) and store.builder_pid is None
    # With all there, none is started.
    store.prepare(CONFS)
    assert store.builder_pid is None


@pytest.mark.slow
def test_what_cameras_need_is_worked_out_if_asked(tmp_path: Path) -> None:
    store, plane = WorldStore(tmp_path), FlatConf(size_m=20.0)
    wanted = [plane, CONFS[0]]
    store.get(CONFS[0])
    store.prepare(wanted, with_appearance=True)
    wait_for(lambda: all(store.is_cached(conf, with_appearance=True) for conf in wanted))
    assert not any(store.is_cached(conf, with_appearance=True) for conf in CONFS[1:])
    store.close()


@pytest.mark.slow
def test_a_killed_process_is_replaced_and_a_warning_says_so(tmp_path: Path) -> None:
    store = WorldStore(tmp_path)
    store.prepare(CONFS)
    killed = store.builder_pid
    assert killed is not None
    os.kill(killed, signal.SIGKILL)
    wait_for(lambda: store.builder_pid is None)
    with pytest.warns(CacheWarning, match="ended with code -9; another is started"):
        store.prepare(CONFS)
    assert store.builder_pid not in (None, killed)
    wait_for(lambda: kept(store) == len(CONFS))
    store.close()


@pytest.mark.slow
def test_what_cannot_be_built_does_not_stop_the_rest(tmp_path: Path) -> None:
    store = WorldStore(tmp_path)
    store.prepare([MeshConf(path=str(tmp_path / "missing.obj")), MeshConf(path="x" * 5000), *CONFS])
    wait_for(lambda: kept(store) == len(CONFS))
    store.close()


@pytest.mark.slow
@pytest.mark.parametrize("end", ["return", "interrupt", "kill", "kill with a fork alive"])
def test_it_ends_with_its_parent_however_that_ends(tmp_path: Path, end: str) -> None:
    code = """
import os, signal, sys, time
# Where tests run in the background, Ctrl-C is ignored from the start.
signal.signal(signal.SIGINT, signal.default_int_handler)
from pathlib import Path
from dune_rl.worlds.island import IslandConf
from dune_rl.worlds.cache.folder import CacheWarning
from dune_rl.worlds.cache.store import WorldStore
store = WorldStore(Path(sys.argv[1]))
store.prepare([IslandConf(seed=seed) for seed in range(200)])
fork = os.fork() if "fork" in sys.argv[2] else 0
if "fork" in sys.argv[2] and not fork:
    os.close(1)
    time.sleep(60)
    os._exit(0)
print(store.builder_pid, fork, flush=True)
if sys.argv[2] != "return":
    time.sleep(60)
"""
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-W", "error", "-c", code, str(tmp_path), end]
    parent = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environ, start_new_session=True
    )
    assert parent.stdout is not None
    child, fork = (int(word) for word in parent.stdout.readline().split())
    try:
        if end == "interrupt":
            # As a terminal does it: to the whole group.
            os.killpg(parent.pid, signal.SIGINT)
        elif end != "return":
            parent.kill()
        wait_for(lambda: not alive(child))
    finally:
        for pid in filter(None, (fork,)):
            os.kill(pid, signal.SIGKILL)
        _, said = parent.communicate()
    assert end != "return" or (parent.returncode == 0 and not said)


def test_a_fork_starts_its_own(tmp_path: Path) -> None:
    store = WorldStore(tmp_path)
    store.prepare(CONFS[:1])
    reader, writer = os.pipe()
    pid = os.fork()
    if not pid:
        os.write(writer, str(store.builder_pid).encode())
        os._exit(0)
    os.waitpid(pid, 0)
    os.close(writer)
    with os.fdopen(reader) as told:
        assert told.read() == "None"
    assert store.builder_pid is not None
    store.close()
