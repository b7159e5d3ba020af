"""What differs from episode to episode: drawn within its bounds, applied, told, and the same once more."""

import gc
import hashlib
import os
import subprocess
import sys
import weakref
from typing import Any

import numpy as np
import pytest
from randomised_scenes import BODIES, DARTS, FAMILIES, ISLANDS, drive, equal, make
from scenes import slope_stage
from simulations import environment_conf, state_of_group

from dune_rl.config.build import build_world, make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import WorldError
from dune_rl.env.distributions import Choice, Integers, LogUniform, Normal, Uniform
from dune_rl.env.domain_randomizer import DomainRandomizer
from dune_rl.env.pictures import Pictures
from dune_rl.env.randomisation import RANDOMISATIONS, RandomisationConf
from dune_rl.env.simulation import VectorSimulation
from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.construction.build import ConstructionConf
from dune_rl.worlds.inspection.build import InspectionConf
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.rubicon import RubiconConf
from dune_rl.worlds.world import World


# -- side by side and alone ------------------------------------------------------------------------
@pytest.mark.slow(all_but=["evenings"])
@pytest.mark.parametrize("family", FAMILIES)
def test_four_scenes_are_four_simulations_of_one(family: str) -> None:
    four, one = make(4, **FAMILIES[family]), make(1, **FAMILIES[family])
    four.reset()
    seen = drive(four, [0, 1, 2, 3], 0, 6)
    four.reset(np.array([False, True, False, True]))
    after = drive(four, [0, 5, 2, 7], 6, 5)
    pictures = [Pictures(four).from_behind(scene, 48, 36) for scene in range(4)]
    for scene in range(4):
        one.reseed(5, scene)
        one.reset()
        expected = drive(one, [scene], 0, 6)
        late = scene in (1, 3)
        if late:
            one.reseed(5, scene + 4)
            one.reset()
        expected += drive(one, [scene + 4 if late else scene], 6, 5)
        for step, (found, alone) in enumerate(zip(seen + after, expected, strict=True)):
            for name, values in alone.items():
                assert equal(found[name][scene], values[0]), (step, name)
        assert np.array_equal(pictures[scene], Pictures(one).from_behind(0, 48, 36))
        for name, values in one.randomized.items():
            assert four.randomized[name][scene] == values[0]
    assert all(len(set(values.tolist())) > 1 for values in four.randomized.values())
    four.close()
    one.close()


def rollouts() -> list[str]:
    digests = []
    for settings in (ISLANDS, BODIES, DARTS):
        simulation = make(3, **settings)
        simulation.reset()
        digest = hashlib.sha256()
        for step in drive(simulation, [0, 1, 2], 0, 5):
            for values in step.values():
                digest.update(values.tobytes())
        simulation.close()
        digests.append(digest.hexdigest())
    return digests


@pytest.mark.slow
def test_same_seed_same_bytes_in_another_process() -> None:
    command = "from test_randomisation import rollouts; print(*rollouts())"
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", command], env=environ, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[-3:] == rollouts()


@pytest.mark.slow(all_but=["evenings"])
@pytest.mark.parametrize("family", FAMILIES)
def test_the_middle_of_an_episode_comes_back_bit_for_bit(family: str) -> None:
    simulation, other = make(3, **FAMILIES[family]), make(3, 77, **FAMILIES[family])
    simulation.reset()
    drive(simulation, [0, 1, 2], 0, 4)
    simulation.reset(np.array([False, True, False]))
    drive(simulation, [0, 4, 2], 4, 3)
    other.reset()
    other.restore(simulation.save_state())
    here, there = ({k: v.tolist() for k, v in each.randomized.items()} for each in (simulation, other))
    assert here == there
    for one, two in zip(drive(simulation, [0, 4, 2], 7, 4), drive(other, [0, 4, 2], 7, 4), strict=True):
        for name, values in one.items():
            assert equal(values, two[name]), name
    simulation.close()
    other.close()


def test_spaces_are_those_of_the_family() -> None:
    def bounds(simulation: VectorSimulation) -> dict[str, np.ndarray]:
        found = {
            f"{group.name} {name} {side}": limits[side]
            for group in simulation.external
            for name, limits in group.observation_bounds.items()
            for side in (0, 1)
        }
        simulation.close()
        return found

    world = {**ISLANDS["world"], "seed": 12}
    of_one, of_another = bounds(make(1, **ISLANDS)), bounds(make(2, **{**ISLANDS, "world": world}))
    assert of_one.keys() == of_another.keys()
    for name, limit in of_one.items():
        assert np.array_equal(limit, of_another[name]), name


# -- draws -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distribution", "mean", "whole"),
    [
        (Uniform(low=-1.0, high=3.0), 1.0, False),
        (LogUniform(low=0.5, high=2.0), 1.5 / np.log(4.0), False),
        (Normal(mean=1.0, deviation=0.2, low=0.9, high=1.1), 1.0, False),
        (Choice(values=(1.0, 2.0, 6.0)), 3.0, True),
        (Integers(low=3, high=5), 4.0, True),
    ],
)
def test_draws_keep_to_their_distribution(distribution: Any, mean: float, whole: bool) -> None:
    rng = np.random.default_rng(0)
    drawn = np.array([distribution.draw(rng) for _ in range(4000)])
    low, high = distribution.limits
    assert low <= drawn.min() and drawn.max() <= high
    assert drawn.mean() == pytest.approx(mean, abs=4 * drawn.std() / np.sqrt(4000))
    if whole:
        assert (drawn == np.round(drawn)).all() and {low, high} <= set(drawn.tolist())
    else:
        assert len(set(drawn.tolist())) > 500


def test_each_property_has_a_stream_of_its_own() -> None:
    def friction(seed: int, episode: int, **more: Any) -> float:
        conf = RandomisationConf(friction=Uniform(low=0.5, high=1.5), **more)
        randomizer = DomainRandomizer(InspectionConf(), WeatherConf(), conf, build_world)
        return randomizer.draw(seed, episode)[randomizer.names.index("friction")]

    alone = friction(3, 8)
    assert friction(3, 8, world_seed=Integers(low=0, high=9), brightness=Uniform(low=1, high=2)) == alone
    assert len({friction(3, 9), friction(4, 8), alone}) == 3


def test_every_property_is_a_setting_and_the_other_way_round() -> None:
    assert [*RANDOMISATIONS.own, "episodes_per_world"] == list(RandomisationConf.model_fields)


@pytest.mark.slow(all_but=["construction", "island"])
@pytest.mark.parametrize(
    "conf",
    [InspectionConf(seed=3), ConstructionConf(seed=3), RubiconConf(seed=3), IslandConf(seed=3)],
    ids=lambda conf: conf.name,
)
def test_another_layout_stands_on_the_same_ground(conf: Any) -> None:
    def places(world: World) -> list[tuple[str, float]]:
        return [(prop.name, float(prop.vertices[:, :2].sum())) for prop in world.props if prop.solid]

    same, other = (conf.model_copy(update={"layout_seed": seed}) for seed in (3, 4))
    worlds = [build_world(each) for each in (conf, same, other)]
    assert all(np.array_equal(world.terrain.heights, worlds[0].terrain.heights) for world in worlds)
    assert places(worlds[0]) == places(worlds[1]) != places(worlds[2])


# -- what is drawn is applied ----------------------------------------------------------------------


@pytest.mark.slow
def test_worlds_and_weather_are_those_drawn() -> None:
    simulation = make(3, **ISLANDS)
    simulation.reset()
    drawn = simulation.randomized
    for scene in range(3):
        expected = build_world(IslandConf(seed=int(drawn["world_seed"][scene]), grass_cover=0.3))
        assert np.array_equal(simulation.worlds.worlds[scene].terrain.heights, expected.terrain.heights)
        light = simulation.worlds.appearances[scene].weather.light
        assert light.sun_bearing_deg == drawn["sun_bearing_deg"][scene]
    simulation.close()


def slid(ground_friction: float, factor: float) -> float:
    """How far a rover with braked wheels slides in a second on a slope of 0.5 rad [m]."""
    stage = slope_stage(BulletScene, 0.5, ground_friction)
    start = stage.state
    stage.place(start[:3], start[3:7])
    stage.engine.set_wheel_contacts([factor] * 4, [0.0] * 4)
    for _ in range(20):
        stage.step()
    return float(np.linalg.norm(stage.position - start[:3]))


def test_scaled_friction_is_that_of_so_much_smoother_ground() -> None:
    # It slides where tan(0.5) is above the friction, and holds where it is below.
    assert slid(1.0, 0.25) == pytest.approx(slid(0.25, 1.0), rel=1e-3)
    assert slid(1.0, 0.25) > 1.0
    assert slid(1.0, 1.0) < 0.05
    assert slid(0.25, 4.0) == pytest.approx(slid(1.0, 1.0), abs=1e-3)


@pytest.mark.slow
def test_no_world_without_room_is_entered() -> None:
    asked: list[int] = []

    def make_world(conf: IslandConf) -> World:
        asked.append(conf.seed)
        if conf.seed % 2:
            raise WorldError("no room")
        return build_world(conf)

    conf = compose_environment("island", (), {"actors": "none", "randomisation": {"world_seed": [0, 9]}})
    simulation = make_simulation(conf, 4, 1, make_world=make_world)
    simulation.reset()
    assert any(seed % 2 for seed in asked)
    drawn = simulation.randomized["world_seed"].tolist()
    assert not any(seed % 2 for seed in drawn)
    alone = make_simulation(conf, 1, 1, make_world=make_world)
    for episode in range(4):
        alone.reseed(1, episode)
        alone.reset()
        assert alone.randomized["world_seed"].tolist() == [drawn[episode]]
    none = compose_environment("island", (), {"actors": "none", "randomisation": {"world_seed": [1, 1]}})
    hopeless = make_simulation(none, 1, 1, make_world=make_world)
    with pytest.raises(WorldError, match="no room"):
        hopeless.reset()
    for each in (simulation, alone, hopeless):
        each.close()


def test_the_next_worlds_are_named_while_the_present_ones_are_in_use() -> None:
    asked: list[Any] = []
    named: list[list[Any]] = []

    def make_world(conf: IslandConf) -> World:
        asked.append(conf)
        return build_world(conf)

    conf = compose_environment("island", (), {"actors": "none", "randomisation": {"world_seed": [0, 999]}})
    simulation = make_simulation(
        conf, 2, 0, make_world=make_world, prepare=lambda confs: named.append(list(confs))
    )
    simulation.reset()
    asked.clear()
    simulation.reset()
    assert asked == named[0]
    simulation.reset(np.array([False, True]))
    assert [len(confs) for confs in named] == [2, 2, 1]
    assert asked[2:] == named[1][1:]
    simulation.close()


def test_a_scene_keeps_its_world_for_some_of_its_episodes() -> None:
    announced: list[int] = []
    drawn = {"world_seed": [0, 999], "friction": [0.5, 1.5], "episodes_per_world": 2}
    conf = environment_conf("island", sensors={"enabled": ["goal"]}, randomisation=drawn)

    def make_it() -> VectorSimulation:
        return make_simulation(
            conf, 2, 3, prepare=lambda confs: announced.extend(conf.seed for conf in confs)
        )

    simulation, other = make_it(), make_it()
    seeds, frictions, engines, places = [], [], [], []
    for _ in range(4):
        simulation.reset()
        seeds.append(simulation.randomized["world_seed"].astype(int).tolist())
        frictions += simulation.randomized["friction"].tolist()
        engines.append(simulation.scenes.built)
        places.append(state_of_group(simulation).motion.position_w)
    assert seeds[0] == seeds[1] != seeds[2] == seeds[3] and len({*seeds[0], *seeds[2]}) == 4
    assert len(set(frictions)) == 8
    assert [one is two for one, two in zip(engines[0], engines[1], strict=True)] == [True, True]
    assert announced[:4] == seeds[2] * 2
    # An episode by itself, and one that is restored, are in the worlds of the others.
    other.reseed(3, 2)
    other.reset()
    assert other.randomized["world_seed"].tolist() == seeds[1]
    assert other.randomized["friction"].tolist() == frictions[2:4]
    assert np.array_equal(state_of_group(other).motion.position_w, places[1])
    other.restore(simulation.save_state())
    assert other.randomized["world_seed"].tolist() == seeds[3]
    for each in (simulation, other):
        each.close()


@pytest.mark.slow
def test_a_world_that_has_been_left_takes_no_memory() -> None:
    conf = environment_conf(**{**ISLANDS, "randomisation": {"world_seed": [0, 999]}})
    simulation = make_simulation(conf, 2, 0, make_world=lambda island: build_island(island))
    simulation.reset()
    drive(simulation, [0, 1], 0, 2)
    left = [weakref.ref(simulation.worlds.worlds[scene]) for scene in range(2)]
    # At once, and not when the collector of cycles comes by.
    gc.disable()
    try:
        simulation.reset()
        drive(simulation, [2, 3], 0, 1)
        assert [world() for world in left] == [None, None]
    finally:
        gc.enable()
    simulation.close()
