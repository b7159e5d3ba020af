"""What differs from episode to episode: drawn within its bounds, applied, told, and the same once more."""

import gc
import hashlib
import os
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from dune_rl.env.batch import Batch
from dune_rl.env.bounds import rover_observation_bounds
from dune_rl.env.variety import Variety
from planted.puppets import puppet_batch
from scenes import slope_stage
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensordict import TensorDict

import dune_rl
from dune_rl.config.build import build_world, make_batch, make_learning_env
from dune_rl.config.compose import compose_environment
from dune_rl.env.distributions import Choice, Integers, LogUniform, Normal, Uniform
from dune_rl.env.pictures import Pictures
from dune_rl.env.randomisation import PROPERTIES, RandomisationConf
from dune_rl.errors import ConfigError, WorldError
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.run_log import RunLog
from dune_rl.physics.bullet.scene import BulletScene
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.construction.build import ConstructionConf
from dune_rl.worlds.inspection.build import InspectionConf
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.rubicon.build import RubiconConf
from dune_rl.worlds.world import World

SMALL: dict[str, Any] = {
    "camera": {"width": 12, "height": 8, "outputs": ["rgb", "depth", "segmentation", "normals"]},
    "lidar_3d": {"n_rings": 3, "n_beams": 24, "outputs": ["range", "intensity", "segmentation"]},
}
EVERY_SENSE = {
    "enabled": [
        *("camera", "lidar", "lidar_past", "lidar_3d", "depth_strip", "height_scan", "imu", "goal"),
        *("velocity", "encoders", "odometry", "currents", "position"),
    ],
    **SMALL,
}
# Few worlds, so that scenes share some; two lights, so that they do not look alike for all that.
ISLANDS: dict[str, Any] = {
    "world": {"name": "island", "grass_cover": 0.3},
    "sensors": EVERY_SENSE,
    "actors": [{"length_range_m": [3.0, 10.0]}, {"controller": "external", "length_range_m": [3.0, 10.0]}],
    "weather": {"fog_visibility_m": 20.0},
    "randomisation": {
        "world_seed": [1, 2, 3],
        "friction": [0.4, 1.2],
        "sun_bearing_rad": {"name": "choice", "values": [0.0, 2.0]},
    },
}
YARDS: dict[str, Any] = {
    "world": "inspection",
    "actors": "none",
    "randomisation": {"world_seed": [0, 1], "layout_seed": [0, 99], "friction": [0.4, 1.2]},
}
# Another light in one world: scenes are apart for cameras alone.
EVENINGS: dict[str, Any] = {
    "world": "island",
    "sensors": {"enabled": ["camera", "lidar_3d", "goal"], **SMALL},
    "randomisation": {"sun_elevation_rad": [0.1, 1.0], "brightness": [0.5, 1.5]},
}
# Another body in one world.
BODIES: dict[str, Any] = {
    "world": "inspection",
    "actors": "none",
    "sensors": {"enabled": ["lidar", "imu", "goal", "velocity", "encoders"]},
    "randomisation": {
        "mass": [0.7, 1.5],
        "centre_x_m": [-0.05, 0.05],
        "centre_z_m": [0.0, 0.1],
        "motor_strength": [0.5, 1.0],
        "wheel_friction": [0.5, 1.0],
        "action_latency_s": [0.0, 0.2],
    },
}
# All of that, on the other engine.
DARTS: dict[str, Any] = {
    **ISLANDS,
    "physics": "dart",
    "robot": "leo_rover",
    "sensors": {"enabled": ["lidar", "lidar_past", "imu", "goal", "velocity", "encoders", "currents"]},
    "randomisation": {
        **ISLANDS["randomisation"],
        **BODIES["randomisation"],
    },
}
FAMILIES = {"islands": ISLANDS, "yards": YARDS, "evenings": EVENINGS, "darts": DARTS}


def make(scenes: int, seed: int = 5, **settings: Any) -> Batch:
    world, rest = settings["world"], {k: v for k, v in settings.items() if k != "world"}
    return make_batch(compose_environment(world, (), rest), scenes, seed)


def drive(batch: Batch, episodes: list[int], first: int, steps: int) -> list[dict[str, np.ndarray]]:
    """What is seen, earned and measured; commands depend on an episode's id and step alone."""
    seen = []
    for step in range(first, first + steps):
        draws = [np.random.default_rng((episode, step)) for episode in episodes]
        walkers = len(batch.actors.external)
        rover = np.array([rng.uniform([0.2, -1.0], [1.0, 1.0]) for rng in draws], np.float32)
        people = np.array([rng.uniform(-1.0, 1.0, (walkers, 2)) for rng in draws], np.float32)
        outcome = batch.step(rover, people)
        seen.append(
            {
                **batch.observe(),
                **(batch.observe_walkers() if walkers else {}),
                "reward": outcome.rover_reward,
                "walkers": outcome.walker_reward,
                "ends": outcome.terminated | outcome.truncated,
                "metrics": batch.metrics(),
                "clearance": batch.clearance(),
            }
        )
    return seen


# -- side by side and alone ------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_a_batch_of_four_is_four_batches_of_one(family: str) -> None:
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
                assert np.array_equal(found[name][scene], values[0], equal_nan=True), (step, name)
        assert np.array_equal(pictures[scene], Pictures(one).from_behind(0, 48, 36))
        for name, values in one.drawn.items():
            assert four.drawn[name][scene] == values[0]
    assert all(len(set(values.tolist())) > 1 for values in four.drawn.values())
    four.close()
    one.close()


def rollouts() -> list[str]:
    digests = []
    for settings in (ISLANDS, BODIES, DARTS):
        batch = make(3, **settings)
        batch.reset()
        digest = hashlib.sha256()
        for moment in drive(batch, [0, 1, 2], 0, 5):
            for values in moment.values():
                digest.update(values.tobytes())
        batch.close()
        digests.append(digest.hexdigest())
    return digests


def test_same_seed_same_bytes_in_another_process() -> None:
    command = "from test_randomisation import rollouts; print(*rollouts())"
    environ = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", command], env=environ, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[-3:] == rollouts()


@pytest.mark.parametrize("family", FAMILIES)
def test_the_middle_of_an_episode_comes_back_bit_for_bit(family: str) -> None:
    batch, other = make(3, **FAMILIES[family]), make(3, 77, **FAMILIES[family])
    batch.reset()
    drive(batch, [0, 1, 2], 0, 4)
    batch.reset(np.array([False, True, False]))
    drive(batch, [0, 4, 2], 4, 3)
    other.reset()
    other.restore(batch.state())
    assert {k: v.tolist() for k, v in other.drawn.items()} == {k: v.tolist() for k, v in batch.drawn.items()}
    ahead = zip(drive(batch, [0, 4, 2], 7, 4), drive(other, [0, 4, 2], 7, 4), strict=True)
    for here, there in ahead:
        for name, values in here.items():
            assert np.array_equal(values, there[name], equal_nan=True), name
    batch.close()
    other.close()


def test_spaces_are_those_of_the_family() -> None:
    of_one = rover_observation_bounds(make(1, **ISLANDS))
    world = {**ISLANDS["world"], "seed": 12}
    for name, (low, high) in rover_observation_bounds(make(2, **{**ISLANDS, "world": world})).items():
        assert np.array_equal(low, of_one[name][0]) and np.array_equal(high, of_one[name][1]), name


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
        variety = Variety(InspectionConf(), WeatherConf(), conf, build_world)
        return variety.draw(seed, episode)[variety.names.index("friction")]

    alone = friction(3, 8)
    assert friction(3, 8, world_seed=Integers(low=0, high=9), brightness=Uniform(low=1, high=2)) == alone
    assert len({friction(3, 9), friction(4, 8), alone}) == 3


def test_every_property_is_a_setting_and_the_other_way_round() -> None:
    assert list(PROPERTIES) == list(RandomisationConf.model_fields)


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


def test_worlds_and_weather_are_those_drawn() -> None:
    batch = make(3, **ISLANDS)
    batch.reset()
    for scene in range(3):
        seed = int(batch.drawn["world_seed"][scene])
        expected = build_world(IslandConf(seed=seed, grass_cover=0.3))
        assert np.array_equal(batch.sites.worlds[scene].terrain.heights, expected.terrain.heights)
        light = batch.sites.appearances[scene].weather.light
        assert light.sun_bearing_rad == batch.drawn["sun_bearing_rad"][scene]
    batch.close()


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


def test_no_world_without_room_is_entered() -> None:
    asked: list[int] = []

    def world_of(conf: IslandConf) -> World:
        asked.append(conf.seed)
        if conf.seed % 2:
            raise WorldError("no room")
        return build_world(conf)

    conf = compose_environment("island", (), {"actors": "none", "randomisation": {"world_seed": [0, 9]}})
    batch = make_batch(conf, 4, 1, world_of=world_of)
    batch.reset()
    assert any(seed % 2 for seed in asked)
    assert not (batch.drawn["world_seed"] % 2).any()
    drawn = batch.drawn["world_seed"].tolist()
    alone = make_batch(conf, 1, 1, world_of=world_of)
    for episode in range(4):
        alone.reseed(1, episode)
        alone.reset()
        assert alone.drawn["world_seed"].tolist() == [drawn[episode]]
    none = compose_environment("island", (), {"actors": "none", "randomisation": {"world_seed": [1, 1]}})
    hopeless = make_batch(none, 1, 1, world_of=world_of)
    with pytest.raises(WorldError, match="no room"):
        hopeless.reset()
    for each in (batch, alone, hopeless):
        each.close()


def test_the_next_worlds_are_named_while_the_present_ones_are_in_use() -> None:
    asked: list[Any] = []
    named: list[list[Any]] = []

    def world_of(conf: IslandConf) -> World:
        asked.append(conf)
        return build_world(conf)

    conf = compose_environment("island", (), {"actors": "none", "randomisation": {"world_seed": [0, 999]}})
    batch = make_batch(conf, 2, 0, world_of=world_of, prepare=lambda confs: named.append(list(confs)))
    batch.reset()
    asked.clear()
    batch.reset()
    assert asked == named[0]
    batch.reset(np.array([False, True]))
    assert [len(confs) for confs in named] == [2, 2, 1]
    assert asked[2:] == named[1][1:]
    batch.close()


def test_a_world_that_has_been_left_takes_no_memory() -> None:
    settings = {k: v for k, v in ISLANDS.items() if k != "world"}
    settings["randomisation"] = {"world_seed": [0, 999]}
    conf = compose_environment(ISLANDS["world"], (), settings)
    batch = make_batch(conf, 2, 0, world_of=lambda island: build_island(island))
    batch.reset()
    drive(batch, [0, 1], 0, 2)
    left = [weakref.ref(batch.sites.worlds[scene]) for scene in range(2)]
    # At once, and not when the collector of cycles comes by.
    gc.disable()
    try:
        batch.reset()
        drive(batch, [2, 3], 0, 1)
        assert [world() for world in left] == [None, None]
    finally:
        gc.enable()
    batch.close()


# -- what is drawn is told -------------------------------------------------------------------------


def test_info_tells_what_was_drawn() -> None:
    settings = {"randomisation": {"world_seed": [0, 3], "friction": [0.5, 0.7]}, "actors": "none"}
    env = dune_rl.gym_env("island", **settings)
    seen = set()
    for _ in range(4):
        _, info = env.reset()
        assert 0.5 <= info["randomisation/friction"] <= 0.7
        assert info["randomisation/world_seed"] in range(4)
        after = env.step(np.float32([0.5, 0.0]))[-1]
        assert after["randomisation/friction"] == info["randomisation/friction"]
        assert "randomisation/brightness" not in info
        seen.add(info["randomisation/friction"])
    assert len(seen) == 4
    env.close()


def test_evaluation_tells_what_was_drawn_whatever_the_number_of_scenes() -> None:
    settings = {
        "randomisation": {"world_seed": [0, 3], "friction": [0.5, 0.7]},
        "actors": "none",
        "task": {"termination": {"max_steps": 12}},
    }
    rows = []
    for scenes in (1, 3):
        env = make_learning_env(compose_environment("island", (), settings), scenes, 4)
        rows.append(evaluate(built_in_policy("go_to_goal", env), env, 4, 4)["rover"])
        env.close()
    assert repr(rows[0]) == repr(rows[1])
    assert len({row["randomisation/friction"] for row in rows[0]}) == 4


def test_a_run_log_shows_the_mean_of_what_was_drawn(tmp_path: Path) -> None:
    names = ("success", "randomisation/friction")
    log = RunLog(tmp_path, {"rover": ("return", "steps", *names)})
    metrics = torch.tensor([[[[0.0, 1.0, 1.0, 0.5]], [[0.0, 1.0, 0.0, 0.7]]]])
    done = torch.ones(1, 2, 1, dtype=torch.bool)
    after = TensorDict({"done": done, "rover": TensorDict({"metrics": metrics}, (1, 2, 1))}, (1, 2))
    log.collected(TensorDict({"next": after}, (1, 2)), 64, {"rover": 0})
    log.close()
    events = EventAccumulator(str(tmp_path)).Reload()
    (scalar,) = events.Scalars("randomisation/friction")
    assert (scalar.step, scalar.value) == (64, pytest.approx(0.6))


def test_without_randomisation_nothing_more_is_told() -> None:
    batch, _ = puppet_batch()
    assert not batch.drawn
    assert not [name for name in batch.metric_names if name.startswith("randomisation")]


# -- settings --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("world", "words", "message"),
    [
        (
            "flat",
            ["randomisation.world_seed=[0,9]"],
            "randomisation.world_seed: the world 'flat' has no seed; leave it null, or choose a world that "
            "is made from a seed",
        ),
        (
            "island",
            ["randomisation.friction=[2,1]"],
            "randomisation.friction: low must be at most high (got 2 and 1)",
        ),
        (
            "island",
            ["randomisation.friction=[0,1]"],
            "randomisation: friction must lie between 0.01 and 10 (got 0 to 1)",
        ),
        (
            "island",
            ["randomisation.world_seed=[0,16777216]"],
            "randomisation: world_seed must lie between 0 and 16777215 (got 0 to 16777216)",
        ),
        (
            "island",
            ["randomisation.layout_seed=[1,2.5,4]"],
            "randomisation.layout_seed: values must be whole numbers (got [1.0, 2.5, 4.0])",
        ),
        (
            "island",
            ["randomisation.friction={name: gauss, low: 1, high: 2}"],
            "randomisation.friction must be one of uniform, log_uniform, normal, choice "
            "(got {'name': 'gauss', 'low': 1, 'high': 2})",
        ),
        (
            "island",
            ["randomisation.fricton=[0.5,1]"],
            "randomisation.fricton is not a setting; did you mean randomisation.friction?",
        ),
        (
            "island",
            ["randomisation.sun_bearing_rad=[0,1]", "weather.time_of_day_h=9"],
            "randomisation.sun_bearing_rad: weather.time_of_day_h=9 says where the sun stands; set one of "
            "them to null",
        ),
    ],
)
def test_bad_settings(world: str, words: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_environment(world, words)
    assert str(error.value) == message


def test_lists_are_short_for_distributions() -> None:
    conf = compose_environment(
        "island",
        [
            "randomisation.friction=[0.5,1]",
            "randomisation.world_seed=[3,7]",
            "randomisation.layout_seed=[1,5,9]",
            "randomisation.brightness={name: log_uniform, low: 0.5, high: 2}",
        ],
    ).randomisation
    assert conf == RandomisationConf(
        friction=Uniform(low=0.5, high=1.0),
        world_seed=Integers(low=3, high=7),
        layout_seed=Choice(values=(1.0, 5.0, 9.0)),
        brightness=LogUniform(low=0.5, high=2.0),
    )
    assert list(conf.drawn) == ["world_seed", "layout_seed", "friction", "brightness"]
