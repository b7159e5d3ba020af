"""Worlds kept on disk: the same as built ones, whatever becomes of the disk."""

import errno
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from world_digest import digest
from world_files import write_yard

from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import cache_folder
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.light import LightConf
from dune_rl.worlds.appearance import bake_world, precompute_appearance
from dune_rl.worlds.cache import store as module
from dune_rl.worlds.cache.folder import CacheFolder, CacheWarning
from dune_rl.worlds.cache.serialization import state_of
from dune_rl.worlds.cache.store import WorldStore, shared_store, world_key
from dune_rl.worlds.construction.build import ConstructionConf
from dune_rl.worlds.flat import FlatConf
from dune_rl.worlds.importing.heightmap_world import HeightmapConf
from dune_rl.worlds.importing.mesh_world import MeshConf
from dune_rl.worlds.importing.sdf.build import SdfConf
from dune_rl.worlds.inspection.build import InspectionConf
from dune_rl.worlds.island import IslandConf
from dune_rl.worlds.registry import build_uncached
from dune_rl.worlds.rubicon import RubiconConf
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World

QUICK = IslandConf(seed=4, grass_cover=0.3)
SDF = """<sdf version="1.9"><world name="w">
<light name="sun" type="directional"><direction>-0.5 0.1 -0.9</direction></light>
<model name="ground"><static>1</static><link name="l"><collision name="c"><geometry>
<plane><normal>0 0 1</normal><size>40 40</size></plane></geometry></collision></link></model>
<model name="crate"><static>1</static><pose>3 2 0.5 0 0 0</pose>
<link name="l"><collision name="c"><geometry>{shape}</geometry>
</collision></link></model></world></sdf>"""
BOX = "<box><size>1 1 1</size></box>"
MESH = "<mesh><uri>crate.stl</uri></mesh>"


def family(name: str, folder: Path) -> WorldSettings:
    generated: dict[str, Any] = {
        "inspection": InspectionConf(seed=2, grass_cover=0.2),
        "construction": ConstructionConf(seed=2),
        "rubicon": RubiconConf(seed=2),
        "island": QUICK,
    }
    if name in generated:
        return generated[name]
    if name == "mesh":
        return MeshConf(path=str(write_yard(folder, "glb")))
    if name == "sdf":
        (folder / "w.sdf").write_text(SDF.format(shape=BOX))
        return SdfConf(path=str(folder / "w.sdf"))
    x = np.linspace(0.0, 9.0, 64)
    np.save(folder / "map.npy", np.sin(x) * np.cos(x[:, None]))
    return HeightmapConf(path=str(folder / "map.npy"), size_m=(30.0, 30.0))


def parts(value: Any) -> Iterator[Any]:
    """All that a world is made of, down to numbers and bytes, in one order."""
    if isinstance(value, np.ndarray):
        yield value.dtype.str, value.shape, value.tobytes()
    elif isinstance(value, list | tuple):
        yield type(value)
        for item in value:
            yield from parts(item)
    elif isinstance(value, World | HeightField) or type(value).__module__.startswith("dune_rl.worlds"):
        yield type(value)
        for name, held in sorted(state_of(value).items()):
            yield name
            yield from parts(held)
    else:
        yield value


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[WorldSettings]:
    """The settings of every world that is built."""
    built: list[WorldSettings] = []

    def counting(conf: WorldSettings) -> World:
        built.append(conf)
        return build_uncached(conf)

    monkeypatch.setattr(module, "build_uncached", counting)
    return built


@pytest.mark.slow(all_but=["construction", "mesh", "sdf", "island"])
@pytest.mark.parametrize(
    "name", ["inspection", "construction", "rubicon", "island", "mesh", "sdf", "heightmap"]
)
def test_a_kept_world_is_the_built_one(tmp_path: Path, name: str, counted: list[WorldSettings]) -> None:
    conf = family(name, tmp_path)
    fresh = build_uncached(conf)
    _ = fresh.clearance_field
    store = WorldStore(tmp_path / "cache")
    first, second = store.get(conf), WorldStore(tmp_path / "cache").get(conf)
    assert len(counted) == 1
    assert digest(first) == digest(second) == digest(fresh)
    assert list(parts(second)) == list(parts(first)) == list(parts(fresh))
    points = np.random.default_rng(0).uniform(-10.0, 10.0, (500, 2))
    np.testing.assert_array_equal(second.clearance(points), fresh.clearance(points))
    np.testing.assert_array_equal(second.terrain.normal(points), fresh.terrain.normal(points))
    if fresh.grass is not None:
        assert second.grass is not None and second.grass.terrain is second.terrain
        ground = np.column_stack([points, np.zeros(len(points))])
        np.testing.assert_array_equal(second.grass.drag(ground, 0.3), fresh.grass.drag(ground, 0.3))


@pytest.mark.slow(all_but=["flat"])
@pytest.mark.parametrize("conf", [QUICK, FlatConf(size_m=20.0)], ids=lambda conf: conf.name)
def test_looks_are_kept_beside_worlds(
    tmp_path: Path, conf: WorldSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = LightConf(sun_bearing_deg=57.0)
    fresh = bake_world(build_uncached(conf), light)
    store = WorldStore(tmp_path)
    assert not store.is_cached(conf, with_appearance=True)
    precompute_appearance(store.get(conf))
    assert store.is_cached(conf, with_appearance=True)
    monkeypatch.setattr("dune_rl.rendering.baked_scenery.sky_share", None)
    monkeypatch.setattr("dune_rl.worlds.appearance.ground_texture", None)
    kept = bake_world(store.get(conf), light)
    for name in ("sky_share", "props_sky_share", "ground", "faces", "segments"):
        assert list(parts(getattr(kept, name))) == list(parts(getattr(fresh, name)))


def truncated(data: bytes) -> bytes:
    return data[: len(data) // 2]


def flipped(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 255]) + data[len(data) // 2 + 1 :]


@pytest.mark.parametrize("harm", [truncated, flipped, lambda data: b"", lambda data: b"\0" * 5000])
def test_a_damaged_entry_is_made_anew(tmp_path: Path, harm: Any, counted: list[WorldSettings]) -> None:
    store = WorldStore(tmp_path)
    good = store.get(QUICK)
    assert store.cache is not None
    entry = store.cache.entry(world_key(QUICK))
    data = entry.read_bytes()
    entry.write_bytes(harm(data))
    with pytest.warns(CacheWarning, match="damaged"):
        assert digest(store.get(QUICK)) == digest(good)
    assert entry.read_bytes() == data and len(counted) == 2
    entry.write_bytes(harm(data))
    # Warned once.
    assert digest(store.get(QUICK)) == digest(good)


def rewritten(entry: Path, change: Any) -> None:
    """The entry with other contents."""
    cache = CacheFolder(entry.parent, 10**9)
    found = cache.read(entry.stem)
    assert found is not None
    text, arrays = change(*found)
    cache.write(entry.stem, text, arrays)


def test_a_foreign_entry_is_made_anew(tmp_path: Path, counted: list[WorldSettings]) -> None:
    store, other = WorldStore(tmp_path), QUICK.model_copy(update={"seed": 5})
    assert store.cache is not None
    store.get(other)
    entry = store.cache.entry(world_key(QUICK))
    os.replace(store.cache.entry(world_key(other)), entry)
    good = digest(store.get(QUICK))
    assert counted == [other, QUICK]
    named = json.loads(json.dumps({"class": "Popen", "state": [["args", "true"]]}))
    rewritten(
        entry, lambda text, arrays: ({**text, "world": {"objects": [named], "root": {"object": 0}}}, arrays)
    )
    with pytest.warns(CacheWarning, match="unknown content"):
        assert digest(store.get(QUICK)) == good


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    store = WorldStore(tmp_path)
    good = digest(store.get(QUICK))
    assert store.cache is not None

    class Bomb:
        def __reduce__(self) -> Any:
            return (Path.touch, (tmp_path / "exploded",))

    entry = store.cache.entry(world_key(QUICK))
    with entry.open("wb") as file:
        np.savez(file, text=np.array([Bomb()], object))
    with pytest.warns(CacheWarning, match="damaged"):
        assert digest(store.get(QUICK)) == good
    assert not (tmp_path / "exploded").exists()


def test_other_settings_and_other_code_are_other_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {world_key(QUICK.model_copy(update=change)) for change in ({}, {"seed": 5}, {"friction": 0.9})}
    assert len(keys) == 3 and world_key(QUICK) in keys
    monkeypatch.setattr(module, "_code_digest", lambda: "another")
    assert world_key(QUICK) not in keys


@pytest.mark.parametrize("value", ["off", "", " OFF "])
def test_nothing_is_cached_where_that_is_off(
    value: str, monkeypatch: pytest.MonkeyPatch, counted: list[WorldSettings]
) -> None:
    monkeypatch.setenv("DUNE_RL_CACHE", value)
    assert cache_folder() is None
    store = shared_store()
    store.get(QUICK), store.get(QUICK)
    store.prepare([QUICK])
    assert len(counted) == 2 and store.builder_pid is None


def test_where_the_cache_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("DUNE_RL_CACHE", str(tmp_path / "here"))
    assert cache_folder() == tmp_path / "here"
    monkeypatch.delenv("DUNE_RL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "dune_rl"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "dune_rl"


def test_a_plane_is_not_worth_keeping(tmp_path: Path) -> None:
    store = WorldStore(tmp_path)
    store.get(FlatConf())
    assert not list(tmp_path.rglob("*.npz"))


def test_a_folder_that_cannot_be_written_stops_nothing(tmp_path: Path) -> None:
    # A file where the folder should be: even root cannot write there.
    (tmp_path / "cache").write_text("")
    store = WorldStore(tmp_path / "cache")
    with pytest.warns(CacheWarning):
        first = store.get(QUICK)
    assert digest(store.get(QUICK)) == digest(first)


def test_a_folder_that_can_no_longer_be_read_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, conf = WorldStore(tmp_path), QUICK
    store.get(conf)
    stat, denied = os.stat, PermissionError(errno.EACCES, "Permission denied")

    # Root may read whatever the rights say.
    def deny(path: Any, *args: Any, **kwargs: Any) -> Any:
        if str(path).startswith(str(tmp_path)):
            raise denied
        return stat(path, *args, **kwargs)

    monkeypatch.setattr(os, "stat", deny)
    monkeypatch.setattr("dune_rl.worlds.cache.folder.load_npz", Mock(side_effect=denied))
    monkeypatch.setattr("dune_rl.worlds.cache.folder.write_atomically", Mock(side_effect=denied))
    assert not store.is_cached(conf) and not store.is_cached(conf, with_appearance=True)
    with pytest.warns(CacheWarning, match=r"cannot be (read|written) \(Permission denied\)") as told:
        assert digest(store.get(conf)) == digest(build_uncached(conf))
    assert len(told) == 2


def test_a_full_disk_stops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    store = WorldStore(tmp_path)
    with pytest.warns(CacheWarning, match="No space left"):
        store.get(QUICK)
    store.get(QUICK)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_the_longest_unused_make_room(tmp_path: Path) -> None:
    cache = CacheFolder(tmp_path, 10_000)
    data = {"uint8": np.zeros(2_500, np.uint8)}
    for age, key in ((30, "aa"), (20, "bb"), (10, "cc")):
        cache.write(key, {}, data)
        stamp = cache.entry(key).stat().st_mtime - age
        os.utime(cache.entry(key), (stamp, stamp))
    assert cache.read("aa") is not None
    (tmp_path / "notes.txt").write_text("not ours")
    cache.write("dd", {}, data)
    assert {path.name for path in tmp_path.iterdir()} == {"aa.npz", "cc.npz", "dd.npz", "notes.txt"}
    # The newest stays, though it alone is too much.
    cache.write("ee", {}, {"uint8": np.zeros(50_000, np.uint8)})
    assert {path.name for path in tmp_path.iterdir()} == {"ee.npz", "notes.txt"}


def test_the_room_is_a_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DUNE_RL_CACHE_GB", "0.5")
    cache = shared_store().cache
    assert cache is not None and cache.limit_bytes == 2**29
    monkeypatch.setenv("DUNE_RL_CACHE_GB", "much")
    with pytest.raises(ConfigError, match="DUNE_RL_CACHE_GB must be a number of gigabytes"):
        shared_store()


def test_an_imported_world_follows_its_files(tmp_path: Path, counted: list[WorldSettings]) -> None:
    (tmp_path / "w.sdf").write_text(SDF.format(shape=MESH))
    conf, store = SdfConf(path=str(tmp_path / "w.sdf")), WorldStore(tmp_path / "cache")
    # Its mesh is missing, which is told each time, and comes.
    for _ in range(2):
        with pytest.warns(WorldWarning, match=r"crate\.stl is missing"):
            bare = store.get(conf)
    assert len(counted) == 1 and not bare.props
    stl = write_yard(tmp_path, "stl")
    os.replace(stl, tmp_path / "crate.stl")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WorldWarning)
        full = store.get(conf)
        assert len(counted) == 2 and digest(full) != digest(bare)
        assert digest(store.get(conf)) == digest(full) and len(counted) == 2
        # The mesh changes, then the file itself.
        data = (tmp_path / "crate.stl").read_bytes()
        (tmp_path / "crate.stl").write_bytes(data[:-2] + b"\1\1")
        other = store.get(conf)
        assert len(counted) == 3
        assert full.disk_cached("look", lambda: np.zeros(1)) == 0.0
        assert other.disk_cached("look", lambda: np.ones(1)) == 1.0
        assert store.get(conf).disk_cached("look", lambda: np.zeros(1)) == 1.0
        key = world_key(conf)
        (tmp_path / "w.sdf").write_text(SDF.format(shape=BOX))
        store.get(conf)
    assert len(counted) == 4 and world_key(conf) != key


@pytest.mark.slow
def test_two_processes_may_keep_the_same_world(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from dune_rl.worlds.cache.store import WorldStore;"
        "from dune_rl.worlds.island import IslandConf; from world_digest import digest;"
        "conf = IslandConf(seed=4, grass_cover=0.3);"
        "print(*{digest(WorldStore(Path(sys.argv[1])).get(conf.model_copy(update={'seed': s % 3})))"
        " for s in range(12)})"
    )
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-W", "error", "-c", code, str(tmp_path)]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, env=environ) for _ in range(2)]
    told = [process.communicate()[0].split() for process in both]
    assert all(process.returncode == 0 for process in both)
    truth = {digest(build_uncached(QUICK.model_copy(update={"seed": seed}))) for seed in range(3)}
    assert [set(map(bytes.decode, words)) for words in told] == [truth, truth]
    assert len(list(tmp_path.rglob("*.npz"))) == 3 and not list(tmp_path.rglob("*.tmp"))
