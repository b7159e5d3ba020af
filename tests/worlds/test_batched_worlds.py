"""Scenes in worlds of their own: what is asked of all at once is what each world would say alone."""

import gc
import weakref

import numpy as np
import pytest

from dune_rl.config.build import build_world
from dune_rl.geometry.shared_per_scene import (
    BatchedHeightFields,
    BatchedRayScenes,
    SharedPerScene,
    query_grouped,
)
from dune_rl.rendering.foliage import BatchedFoliage, Foliage
from dune_rl.rendering.light import Light, LightConf
from dune_rl.rendering.scenery import BatchedBeamSurfaces
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.appearance import bake_world, beam_surface
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.world import World

CLEAR, LOW_SUN = WeatherConf(), WeatherConf(light=LightConf(sun_elevation_deg=11.0))
# Of five scenes: two share the first world, two the third.
ORDER = (2, 0, 2, 1, 0)


@pytest.fixture(scope="module")
def islands() -> list[World]:
    return [build_world(IslandConf(seed=seed, grass_cover=0.3 if seed else 0.0)) for seed in range(3)]


@pytest.fixture(scope="module")
def sites(islands: list[World]) -> BatchedWorlds:
    return BatchedWorlds([(islands[which], CLEAR) for which in ORDER])


def rays(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One origin a scene, and its `count` rays with their ranges."""
    rng = np.random.default_rng(seed)
    origins = np.column_stack([rng.uniform(-5, 5, (5, 2)), np.full(5, 1.6)]).astype(np.float32)
    directions = rng.normal(size=(5 * count, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return origins, directions, rng.uniform(3.0, 20.0, 5 * count).astype(np.float32)


# -- groups ----------------------------------------------------------------------------------------


def test_groups_are_of_equal_things_in_the_order_of_their_scenes() -> None:
    first, second = object(), object()
    things = SharedPerScene([first] * 3)
    assert things.groups == ((first, slice(None)),)
    things.put(1, second)
    (one, rows), (other, others) = things.groups
    assert (one, rows.tolist(), other, others.tolist()) == (first, [0, 2], second, [1])
    before = things.groups
    things.put(1, second)
    assert things.groups is before
    (one, rows), (other, others) = things.select_groups(np.array([1, 2]))
    assert (one, rows.tolist(), other, others.tolist()) == (second, [0], first, [1])


def test_what_is_made_of_a_thing_is_made_once_and_forgotten_with_it() -> None:
    made: list[str] = []

    def make(text: str) -> str:
        made.append(text)
        return text.upper()

    a, b = "a", "b"
    things = SharedPerScene([a, b, a])
    upper = things.map(make)
    assert [upper[scene] for scene in range(3)] == ["A", "B", "A"]
    assert [(name, rows.tolist()) for name, rows in upper.groups] == [("A", [0, 2]), ("B", [1])]
    assert made == ["a", "b"]
    things.put(1, a)
    assert upper.groups == (("A", slice(None)),)
    things.put(1, b)
    assert upper[1] == "B"
    assert made == ["a", "b", "b"]


@pytest.mark.slow
def test_a_world_goes_when_no_scene_is_in_it() -> None:
    worlds = [build_island(IslandConf(seed=seed)) for seed in (7, 8)]
    sites = BatchedWorlds([(worlds[0], CLEAR), (worlds[1], CLEAR)])
    sites.clearance(np.zeros((2, 1, 2)))
    gone = weakref.ref(worlds[1])
    sites.put(1, worlds[0], CLEAR)
    del worlds[1]
    sites.height(np.zeros((2, 2)))
    gc.collect()
    assert gone() is None


# -- queries ---------------------------------------------------------------------------------------


def test_ground_and_clearance_are_those_of_each_world(sites: BatchedWorlds) -> None:
    xy = np.random.default_rng(1).uniform(-8, 8, (5, 40, 2))
    height, clearance = sites.height(xy), sites.clearance(xy)
    terrain = BatchedHeightFields(sites.worlds.map(lambda world: world.terrain)).height(xy)
    for scene in range(5):
        world = sites.worlds[scene]
        assert np.array_equal(height[scene], world.terrain.height(xy[scene]))
        assert np.array_equal(terrain[scene], height[scene])
        assert np.array_equal(clearance[scene], world.clearance(xy[scene]))
        assert tuple(sites.extents[scene]) == world.extent
    assert np.ptp(height[:, 0]) > 0


@pytest.mark.parametrize("scenes", [None, [3, 0], [2]])
def test_rays_meet_what_is_in_their_own_world(sites: BatchedWorlds, scenes: list[int] | None) -> None:
    origins, directions, ranges = rays(37)
    everywhere = BatchedRayScenes(sites.worlds.map(lambda world: world.rays))
    looks = BatchedBeamSurfaces(sites.worlds.map(beam_surface))
    if scenes is not None:
        rows = np.array(scenes)
        everywhere, looks = everywhere.select_scenes(rows), looks.select_scenes(rows)
        origins = origins[rows]
        directions, ranges = directions.reshape(5, 37, 3)[rows].reshape(-1, 3), ranges.reshape(5, 37)[rows]
    ranges = ranges.ravel()
    shortened = ranges.copy()
    everywhere.shorten_ranges(origins, directions, shortened)
    hits = everywhere.hits(origins, directions, ranges.copy())
    blocked = everywhere.any_hit(origins, directions)
    segments, luminance = looks.look_up(hits.face)
    assert 0.2 < (shortened < ranges).mean() < 1.0
    for place, scene in enumerate(scenes or range(5)):
        world, part = sites.worlds[scene], slice(37 * place, 37 * place + 37)
        origin, towards = origins[place : place + 1], directions[part]
        alone = world.rays.hits(origin, towards, ranges[part].copy())
        for found, own in zip(hits, alone, strict=True):
            assert np.array_equal(found[part], own)
        assert np.array_equal(shortened[part], alone.range)
        assert np.array_equal(blocked[part], world.rays.any_hit(origin, towards))
        surface = beam_surface(world).look_up(alone.face)
        assert np.array_equal(segments[part], surface[0]) and np.array_equal(luminance[part], surface[1])


def test_grass_is_that_of_the_own_world_or_none(sites: BatchedWorlds) -> None:
    def foliage(world: World) -> Foliage | None:
        return None if world.grass is None else world.grass.foliage

    grown = BatchedFoliage(sites.worlds.map(foliage))
    origins, directions, ranges = rays(50)
    origins[:, 2] = 1.2
    depths = np.full(len(directions), 0.4, np.float32)
    beams = grown.beam_ranges(origins, directions, ranges, depths).reshape(5, 50)
    median = grown.median_ranges(origins, directions, ranges).reshape(5, 50)
    for scene in range(5):
        own, part = foliage(sites.worlds[scene]), slice(50 * scene, 50 * scene + 50)
        if own is None:
            assert np.isinf(beams[scene]).all() and np.isinf(median[scene]).all()
            continue
        alone = (origins[scene : scene + 1], directions[part], ranges[part])
        assert np.array_equal(beams[scene], own.beam_ranges(*alone, depths[part]))
        assert np.array_equal(median[scene], own.median_ranges(*alone))
    assert np.isfinite(beams).any() and not grown.none


def test_one_answer_for_all_is_asked_once() -> None:
    calls = []

    def ask(thing: str, values: np.ndarray) -> np.ndarray:
        calls.append(thing)
        return values * 2

    values = np.arange(6.0).reshape(3, 2)
    assert query_grouped(SharedPerScene(["a"] * 3).groups, ask, values).tolist() == (values * 2).tolist()
    assert calls == ["a"]


# -- looks -----------------------------------------------------------------------------------------


def test_scenes_that_look_alike_share_a_look(islands: list[World]) -> None:
    first, second = islands[:2]
    sites = BatchedWorlds([(first, CLEAR), (second, CLEAR), (first, LOW_SUN), (first, WeatherConf())])
    looks = [sites.appearances[scene] for scene in range(4)]
    assert looks[0] is looks[3]
    assert len({id(look) for look in looks}) == 3
    assert [len(np.arange(4)[rows]) for _, rows in sites.worlds.groups] == [3, 1]
    sites.put(2, first, CLEAR)
    assert sites.appearances[2] is looks[0]


@pytest.mark.slow
def test_another_light_on_a_known_world_is_that_of_a_new_one() -> None:
    light = LightConf(sun_bearing_deg=-57.0, sun_elevation_deg=17.0, brightness=0.8)
    known, new = (build_island(IslandConf(seed=4)) for _ in range(2))
    before = bake_world(known, LightConf()).ground.copy()
    relit, fresh = bake_world(known, light), bake_world(new, light)
    for name in ("ground", "faces", "sky"):
        assert np.array_equal(getattr(relit, name), getattr(fresh, name)), name
    assert relit.rays is bake_world(known, LightConf()).rays
    assert np.array_equal(bake_world(known, LightConf()).ground, before)
    assert (relit.ground != before).any()


def test_brightness_scales_sun_and_sky() -> None:
    full, half = Light.from_conf(LightConf()), Light.from_conf(LightConf(brightness=0.5))
    for name in ("sun", "zenith", "horizon"):
        np.testing.assert_allclose(getattr(half, name), getattr(full, name) / 2, rtol=1e-6)
