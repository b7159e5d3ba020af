"""Equal seeds give equal bytes: again, after a reset, beside another environment, and in another process."""

import hashlib
import os
import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
from rollouts import Rollout, digest_of
from scripted_physics import scripted_simulation
from simulations import act, goals_w, metrics, motion_of_group, new_simulation, observation, state_of_group

from dune_rl.env.simulation import VectorSimulation

EXTERNAL = {"controller": "external"}
SHORT = {"terminations": {"time_limit": {"max_steps": 25}}}


def make(world: str, num_scenes: int = 2, seed: int = 8, **settings: Any) -> VectorSimulation:
    return new_simulation(world, num_scenes, seed, **({"actors": "walkers"} | settings))


def golden_of(world: str, actors: str) -> str:
    simulation = make(world, actors=actors, task=SHORT)
    found = digest_of(simulation, 60)
    simulation.close()
    return found


@pytest.mark.slow(all_but=["flat-walkers"])
@pytest.mark.parametrize("actors", ["walkers", "external_walkers"])
@pytest.mark.parametrize("world", ["flat", "inspection"])
def test_golden_rollout(world: str, actors: str) -> None:
    expected = golden_of(world, actors)
    assert golden_of(world, actors) == expected, "a second environment differs"
    simulation = make(world, seed=3, actors=actors, task=SHORT)
    assert digest_of(simulation, 37) != expected
    simulation.reseed(8)
    assert digest_of(simulation, 60) == expected, "a reset leaves something behind"
    simulation.reseed(8)
    beside = make("flat", 1, seed=5)
    rollout, other = Rollout(simulation), Rollout(beside)
    for _ in range(20):
        rollout.advance(3)
        other.advance(2)
    assert rollout.digest == expected, "another environment beside it makes a difference"
    simulation.close()
    beside.close()


@pytest.mark.slow
def test_golden_rollout_in_a_fresh_process() -> None:
    code = "from test_determinism import golden_of; print(golden_of('inspection', 'external_walkers'))"
    environ = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "PYTHONHASHSEED": "77",
    }
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == golden_of("inspection", "external_walkers")


# -- an episode is its seed and its id --------------------------------------------------------------


def start(simulation: VectorSimulation, scene: int) -> dict[str, bytes]:
    """All that the start of the scene's episode is made of, of the first rover where it has several."""
    row = scene * simulation.group("rover").count
    seen = {name: value[row] for name, value in observation(simulation, "rover").items()}
    motion = motion_of_group(simulation, "rover")
    seen |= {
        "goal_w": goals_w(simulation, "rover")[row],
        "position_w": motion.position_w[row],
        "rotation": motion.rotation[row],
    }
    for group in simulation.groups:
        if group.name != "rover":
            now = state_of_group(simulation, group.name)
            seen[group.name] = group.body.poses.reshape(simulation.num_scenes, -1)[scene]
            seen[f"{group.name}_goals"] = now.goal.position_w.reshape(simulation.num_scenes, -1)[scene]
    return {name: value.tobytes() for name, value in seen.items()}


def starts(simulation: VectorSimulation, count: int, *, play: int = 0) -> dict[int, dict[str, bytes]]:
    """The starts of the episodes 0 to `count` - 1, with `play` steps of each; closes `simulation`."""
    scenes = simulation.num_scenes
    rng = np.random.default_rng(scenes)
    simulation.reseed(simulation.seed)
    found = {}
    while len(found) < count:
        simulation.reset()
        found |= {int(simulation.episodes[scene]): start(simulation, scene) for scene in range(scenes)}
        for _ in range(play):
            act(simulation, rng.uniform(-1, 1, (scenes, 2)))
    simulation.close()
    return found


def test_an_episodes_start_depends_on_seed_and_id_alone() -> None:
    one = starts(make("inspection", 1), 16)
    assert list(one) == list(range(16))
    for part in ("position_w", "goal_w", "walker"):
        assert len({episode[part] for episode in one.values()}) == 16
    for scenes in (4, 16):
        assert starts(make("inspection", scenes), 16, play=3) == one
    other = scripted_simulation("inspection", actors="walkers", seed=9)[0]
    assert start(other, 0)["goal_w"] != one[0]["goal_w"]


@pytest.mark.slow
def test_a_whole_episode_does_not_depend_on_its_neighbours() -> None:
    rows = []
    actions = np.random.default_rng(4).uniform([0.2, -1], [1, 1], (80, 2)).astype(np.float32)
    for scenes in (1, 4, 7):
        simulation = make("inspection", scenes)
        simulation.reset()
        row = []
        for action in actions:
            act(simulation, np.concatenate([action[None], np.full((scenes - 1, 2), 0.3, np.float32)]))
            seen = (*observation(simulation).values(), metrics(simulation))
            row.append(b"".join(value[0].tobytes() for value in seen))
        rows.append(row)
        simulation.close()
    assert rows[0] == rows[1]
    assert rows[0] == rows[2]


@pytest.mark.slow(all_but=["external"])
@pytest.mark.parametrize(
    "settings",
    [
        {"sensors": {"lidar": {"n_beams": 64, "n_segments": 16, "range_m": 5.0}}},
        {"sensors": {"enabled": ["goal"]}},
        {"actors": "none"},
        {"actors": [{}, {}, {"speed_mps": 0.4}]},
        {"actors": [EXTERNAL, EXTERNAL]},
        {"robots": ["rover_zero", "rover_zero"]},
        {"robots": ["rover_zero", "leo_rover"]},
        {"task": {"rewards": {"goal": {"weight": 1.0}}, "terminations": {"time_limit": {"max_steps": 3}}}},
        {"metrics": {"terms": {"clearance": {"max_m": 3.0}}}},
    ],
    ids=[
        *("lidar", "sensors", "no actors", "an actor more", "external"),
        *("a robot more", "another robot", "task", "metrics"),
    ],
)
def test_other_settings_do_not_move_spawns_and_goals(settings: dict[str, Any]) -> None:
    assert placed(**settings) == placed_by_default()


def placed(**settings: Any) -> list[list[bytes]]:
    """Start poses and goals of the first rover in nine episodes."""
    simulation, _ = scripted_simulation("inspection", 3, **({"actors": "walkers"} | settings))
    parts = ("goal_w", "position_w", "rotation")
    return [[episode[part] for part in parts] for episode in starts(simulation, 9).values()]


@cache
def placed_by_default() -> list[list[bytes]]:
    return placed()


def test_an_actor_more_leaves_the_first_ones_where_they_were() -> None:
    two = starts(scripted_simulation("inspection", 2, actors=[{}, {}])[0], 6)
    three = starts(scripted_simulation("inspection", 2, actors=[{}, {}, {"speed_mps": 0.4}])[0], 6)
    for episode, expected in two.items():
        assert three[episode]["walker"] == expected["walker"]


@pytest.mark.slow
def test_the_second_engine_repeats_itself_and_comes_back_from_a_state() -> None:
    simulation = make("inspection", physics="dart")
    rollout = Rollout(simulation)
    rollout.advance(25)
    saved = simulation.save_state()
    later = steps_from_here(simulation)
    simulation.reseed(8)
    assert digest_of(simulation, 25) == rollout.digest
    other = make("inspection", seed=1, physics="dart")
    other.reset()
    other.restore(saved)
    assert steps_from_here(other) == later
    simulation.close()
    other.close()


def steps_from_here(simulation: VectorSimulation) -> str:
    digest = hashlib.sha256()
    for _ in range(20):
        act(simulation, [0.5, 0.5])
        for value in (*observation(simulation).values(), metrics(simulation)):
            digest.update(value.tobytes())
    return digest.hexdigest()
