"""Equal seeds give equal bytes: again, after a reset, beside another environment, and in another process."""

import hashlib
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from planted.puppets import puppet_batch

from dune_rl.config.build import make_batch
from dune_rl.config.compose import compose_environment
from dune_rl.env.batch import Batch

WORLDS = ("flat", "inspection")
EXTERNAL = {"controller": "external"}


def make(world: str, num_scenes: int = 2, seed: int = 8, **settings: Any) -> Batch:
    return make_batch(compose_environment(world, (), settings), num_scenes, seed)


class Golden:
    """A rollout that is advanced in parts: a hash of all that is seen, earned and measured."""

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._rng = np.random.default_rng(1)
        self._hash = hashlib.sha256()
        batch.reset()

    def advance(self, steps: int) -> None:
        batch, rng = self._batch, self._rng
        scenes, walkers = batch.num_scenes, len(batch.actors.external)
        for _ in range(steps):
            # Mostly ahead, so that obstacles are met.
            rover = rng.uniform([0.2, -1.0], [1.0, 1.0], (scenes, 2)).astype(np.float32)
            outcome = batch.step(rover, rng.uniform(-1.0, 1.0, (scenes, walkers, 2)).astype(np.float32))
            ended = outcome.terminated | outcome.truncated
            if ended.any():
                batch.reset(ended)
            seen = [*batch.observe().values(), outcome.rover_reward, batch.metrics(), ended]
            if walkers:
                seen += [*batch.observe_walkers().values(), outcome.walker_reward]
            for value in seen:
                self._hash.update(value.tobytes())

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()


def golden(batch: Batch, steps: int = 60) -> str:
    rollout = Golden(batch)
    rollout.advance(steps)
    return rollout.digest


def golden_of(world: str, actors: str) -> str:
    batch = make(world, actors=actors, task={"termination": {"max_steps": 25}})
    found = golden(batch)
    batch.close()
    return found


@pytest.mark.parametrize("actors", ["walkers", "external_walkers"])
@pytest.mark.parametrize("world", WORLDS)
def test_golden_rollout(world: str, actors: str) -> None:
    settings: dict[str, Any] = {"actors": actors, "task": {"termination": {"max_steps": 25}}}
    expected = golden_of(world, actors)
    assert golden_of(world, actors) == expected, "a second environment differs"
    batch = make(world, seed=3, **settings)
    assert golden(batch, 37) != expected
    batch.reseed(8)
    assert golden(batch) == expected, "a reset leaves something behind"
    batch.reseed(8)
    rollout, other = Golden(batch), Golden(make("flat", 1, seed=5))
    for _ in range(20):
        rollout.advance(3)
        other.advance(2)
    assert rollout.digest == expected, "another environment beside it makes a difference"
    batch.close()


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


def start(batch: Batch, scene: int) -> dict[str, bytes]:
    """All that the start of the scene's episode is made of."""
    seen = {name: value[scene] for name, value in batch.observe().items()}
    seen |= {
        "goal_w": batch.goals_w[scene],
        "position_w": batch.motion.position_w[scene],
        "rotation": batch.motion.rotation[scene],
        "actors": batch.actors.poses[scene],
        "actors_goals": batch.actors.goals_w[scene],
    }
    return {name: value.tobytes() for name, value in seen.items()}


def starts(batch: Batch, count: int, *, play: int = 0) -> dict[int, dict[str, bytes]]:
    """The starts of the episodes 0 to `count` - 1, with `play` steps of each; closes `batch`."""
    rng = np.random.default_rng(batch.num_scenes)
    batch.reseed(batch.seed)
    found = {}
    while len(found) < count:
        batch.reset()
        found |= {int(batch.episodes[scene]): start(batch, scene) for scene in range(batch.num_scenes)}
        for _ in range(play):
            batch.step(rng.uniform(-1, 1, (batch.num_scenes, 2)).astype(np.float32))
    batch.close()
    return found


def test_an_episodes_start_depends_on_seed_and_id_alone() -> None:
    world = "inspection"
    one = starts(make(world, 1, actors="walkers"), 16)
    assert list(one) == list(range(16))
    for part in ("position_w", "goal_w", "actors"):
        assert len({episode[part] for episode in one.values()}) == 16
    for scenes in (4, 16):
        assert starts(make(world, scenes, actors="walkers"), 16, play=3) == one
    other = puppet_batch(world, actors="walkers", seed=9)[0]
    assert start(other, 0)["goal_w"] != one[0]["goal_w"]


def test_a_whole_episode_does_not_depend_on_its_neighbours() -> None:
    rows = []
    actions = np.random.default_rng(4).uniform([0.2, -1], [1, 1], (80, 2)).astype(np.float32)
    for scenes in (1, 4, 7):
        batch = make("inspection", scenes, actors="walkers")
        batch.reset()
        row = []
        for action in actions:
            batch.step(np.concatenate([action[None], np.full((scenes - 1, 2), 0.3, np.float32)]))
            row.append(b"".join(value[0].tobytes() for value in (*batch.observe().values(), batch.metrics())))
        rows.append(row)
        batch.close()
    assert rows[0] == rows[1]
    assert rows[0] == rows[2]


@pytest.mark.parametrize(
    "settings",
    [
        {"sensors": {"lidar": {"n_beams": 64, "n_segments": 16, "range_m": 5.0}}},
        {"sensors": {"enabled": ["goal"]}},
        {"actors": "none"},
        {"actors": [{}, {}, {"speed_mps": 0.4}]},
        {"actors": [EXTERNAL, EXTERNAL]},
        {"task": {"reward": {"goal": 1.0}, "termination": {"max_steps": 3}}},
        {"metrics": {"max_clearance_m": 3.0}},
    ],
    ids=["lidar", "sensors", "no actors", "an actor more", "external", "reward", "metrics"],
)
def test_other_settings_do_not_move_spawns_and_goals(settings: dict[str, Any]) -> None:
    parts = ("goal_w", "position_w", "rotation")

    def placed(**chosen: Any) -> list[list[bytes]]:
        batch, _ = puppet_batch("inspection", 3, **({"actors": "walkers"} | chosen))
        return [[episode[part] for part in parts] for episode in starts(batch, 9).values()]

    assert placed(**settings) == placed()


def test_an_actor_more_leaves_the_first_ones_where_they_were() -> None:
    two = starts(puppet_batch("inspection", 2, actors=[{}, {}])[0], 6)
    three = starts(puppet_batch("inspection", 2, actors=[{}, {}, {"speed_mps": 0.4}])[0], 6)
    for episode, expected in two.items():
        found = np.frombuffer(three[episode]["actors"]).reshape(3, 4)
        assert found[:2].tobytes() == expected["actors"]


def test_the_second_engine_repeats_itself_and_comes_back_from_a_state() -> None:
    batch = make("inspection", physics="dart")
    rollout = Golden(batch)
    rollout.advance(25)
    state = batch.state()
    later = golden_from_here(batch)
    batch.reseed(8)
    assert golden(batch, 25) == rollout.digest
    other = make("inspection", seed=1, physics="dart")
    other.reset()
    other.restore(state)
    assert golden_from_here(other) == later


def golden_from_here(batch: Batch) -> str:
    digest = hashlib.sha256()
    for _ in range(20):
        batch.step(np.full((batch.num_scenes, 2), 0.5, np.float32))
        for value in (*batch.observe().values(), batch.metrics()):
            digest.update(value.tobytes())
    return digest.hexdigest()
