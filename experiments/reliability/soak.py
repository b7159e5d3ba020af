"""Long driving over all worlds, robots, kinds of actors and engines, and what grows or breaks in it.

`python experiments/reliability/soak.py FOLDER [steps=10000000] [rounds=10] [scenes=64] [turn=1000]` drives
until `FOLDER/soak.csv` has so many control steps of all scenes, and goes on with what it has.

A segment is a process of one engine that drives `rounds` rounds; the engines take turns. In a round every
kind of actors has its turn of `turn` steps in a world, with a robot and a driver, which differ from round to
round. The first turn is the same in every round of a segment, so that its memory and speed can be compared.
Each episode has a new body and light, and with Bullet a new site.
"""

import gc
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

# Before NumPy and PyTorch are loaded, which read them.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))

import numpy as np
import torch
from combinations import ROOMY_WORLD, Combination, every_option, write_world_files

from dune_rl.commands.benchmark.measuring import memory_mib
from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.core.errors import DuneError, WorldError
from dune_rl.core.files import read_csv, write_csv
from dune_rl.core.machine import short_commit
from dune_rl.evaluation.policies import RandomByEpisode
from dune_rl.learning.checkpoint import read_policy_file
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.saved_policies import load_policy
from dune_rl.physics.interface import OWN_ENGINES
from dune_rl.physics.process import return_free_memory

_SCENES, _STEPS = 64, 1_000
# The longest episode's share of a turn, so that each scene has new episodes in every turn.
_LONGEST = 0.96
_POLICY = Path(__file__).parents[1] / "policies" / "all_worlds_1" / "policy.pt"
_DRIVERS = ("random", "go_to_goal", "random", "oracle", "random", "mppi", "go_to_goal", "planner")
# The published policy is of this robot.
_POLICY_ROBOT, _POLICY_DRIVERS = "rover_zero", ("policy", "policy", "random", "oracle", "policy", "mppi")
_REPEATED, _REPEATED_DRIVER = ("inspection", "rover_zero", "pedestrians"), "go_to_goal"
# Deeper below the terrain than sinkage or a steep ditch can account for.
_FALLEN_M = 0.5


@dataclass
class Turn:
    """A row of `soak.csv`: what drove, and what the process held after it.

    `steps` are control steps of all scenes, `cpu_s` this process's processor time for them, `made_s` the time
    of the clock until the environment was made and reset. `rss_mib` is measured after it was closed,
    `open_mib` before, `held_mib` after what the process had freed was returned to the system. `nan` counts
    steps with a number that is not finite in an observation, a reward or a motion, `fallen` bodies below the
    ground, `diverged` bodies whose physics was given up. `fault` is the error that ended a turn.
    """

    segment: int
    engine: str
    round: int
    world: str
    robot: str
    actors: str
    driver: str
    scenes: int
    steps: int = 0
    episodes: int = 0
    cpu_s: float = 0.0
    made_s: float = 0.0
    open_mib: float = 0.0
    rss_mib: float = 0.0
    files: int = 0
    processes: int = 0
    threads: int = 0
    nan: int = 0
    fallen: int = 0
    diverged: int = 0
    fault: str = ""
    commit: str = ""
    held_mib: float = 0.0


def main() -> None:
    """Drive segments until there are enough steps."""
    folder = Path(sys.argv[1])
    given = dict(word.split("=", 1) for word in sys.argv[2:])
    if "segment" in given:
        sizes = int(given.get("scenes", _SCENES)), int(given.get("turn", _STEPS))
        _drive_segment(folder, int(given["segment"]), int(given["rounds"]), *sizes)
        return
    write_world_files(folder / "worlds")
    rounds, steps = int(given.get("rounds", 10)), int(given.get("steps", 10_000_000))
    driven, before = _steps(folder), -1
    # A segment without a step would be followed by another one for ever.
    while before < driven < steps:
        segment = 1 + max((int(row["segment"]) for row in _rows(folder)), default=-1)
        words = [sys.executable, __file__, str(folder), f"segment={segment}", f"rounds={rounds}"]
        words += [f"{name}={given[name]}" for name in ("scenes", "turn") if name in given]
        subprocess.run(words, check=True, env={**os.environ, "DUNE_RL_CACHE": str(folder / "cache")})
        before, driven = driven, _steps(folder)


def _rows(folder: Path) -> list[dict[str, str]]:
    return read_csv(folder / "soak.csv")


def _steps(folder: Path) -> int:
    return sum(int(row["steps"]) for row in _rows(folder))


def _drive_segment(folder: Path, segment: int, rounds: int, scenes: int, steps: int) -> None:
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    engine, path = OWN_ENGINES[segment % len(OWN_ENGINES)], folder / "soak.csv"
    for number in range(rounds):
        # Every segment of an engine drives further episodes.
        first = (segment * rounds + number) * 100
        world, robot, actors = _REPEATED
        turns = [(Combination(world, robot, engine, actors), _REPEATED_DRIVER, segment)]
        for place, drawn in enumerate(every_option(segment * rounds + number)):
            chosen = Combination(drawn.world, drawn.robot, engine, drawn.actors)
            turns.append((chosen, _driver_of(chosen, first + place), first + place))
        for chosen, driver, seed in turns:
            turn = Turn(segment, engine, number, chosen.world, chosen.robot, chosen.actors, driver, scenes)
            try:
                try:
                    _drive(turn, chosen, folder, seed, steps)
                except WorldError:
                    turn.world = ROOMY_WORLD
                    _drive(turn, replace(chosen, world=ROOMY_WORLD), folder, seed, steps)
            except DuneError as error:
                turn.fault = f"{type(error).__name__}: {str(error).splitlines()[0]}"
            gc.collect()
            turn.rss_mib = round(memory_mib(), 1)
            return_free_memory()
            turn.held_mib = round(memory_mib(), 1)
            turn.files = len(os.listdir("/proc/self/fd"))
            turn.threads = len(os.listdir("/proc/self/task"))
            turn.processes = len(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())
            turn.commit = short_commit()
            write_csv(path, [*_rows(folder), asdict(turn)])


def _driver_of(chosen: Combination, number: int) -> str:
    if chosen.actors in ("external_walkers", "learning_walkers"):
        return "random"
    drivers = _POLICY_DRIVERS if chosen.robot == _POLICY_ROBOT else _DRIVERS
    return drivers[number // 3 % len(drivers)]


def _drive(turn: Turn, chosen: Combination, folder: Path, seed: int, steps: int) -> None:
    """Drive a turn of so many steps in an environment of its own, and count into `turn`."""
    saved = read_policy_file(_POLICY)[1]["config"] if turn.driver == "policy" else None
    # The settings ask for a policy, which this script makes itself.
    words = [f"world={chosen.world}", *chosen.words(folder / "worlds"), "policy=random"]
    # DART never deletes the meshes of sites (experiments/memory), which would hide any other growth.
    has_new_sites = chosen.has_sites and chosen.engine != "dart"
    words += ["randomisation=everything" if has_new_sites else "randomisation=body"]
    words += [f"task.terminations.time_limit.max_steps={round(_LONGEST * steps)}"]
    start = time.perf_counter()
    conf = compose(EvaluateConf, words, saved=saved)
    env = make_learning_env(conf, turn.scenes, seed)
    try:
        policy = _policy(turn.driver, env, seed)
        observation = env.reset()
        turn.made_s = round(time.perf_counter() - start, 2)
        simulation, start = env.base_env.simulation, time.process_time()
        repeat = simulation.physics.action_repeat
        for _ in range(steps // repeat):
            after = env.step(policy(observation))
            turn.steps += turn.scenes * repeat
            _examine(turn, simulation, after["next"])
            turn.episodes += int(after["next", "done"].sum())
            observation = env.maybe_reset(env.step_mdp(after))
        turn.cpu_s = round(time.process_time() - start, 2)
        turn.open_mib = round(memory_mib(), 1)
    finally:
        env.close()


def _policy(name: str, env: Any, seed: int) -> Callable[[Any], Any]:
    if name == "policy":
        return load_policy(_POLICY, env)[0]
    return RandomByEpisode(env) if name == "random" else built_in_policy(name, env, seed)


def _examine(turn: Turn, simulation: Any, after: Any) -> None:
    """Count what is not finite and what lies below the ground after a step."""
    is_finite = True
    for group in simulation.external:
        part = after[group.name]
        values = [*part["observation"].values(), part["reward"]]
        is_finite &= all(bool(torch.isfinite(value).all()) for value in values if value.is_floating_point())
    for state in simulation.state.groups.values():
        motion = state.motion
        turn.diverged += int(motion.diverged.sum())
        is_finite &= bool(np.isfinite(motion.position_w).all() and np.isfinite(motion.velocity_w).all())
        positions = motion.position_w.reshape(simulation.num_scenes, -1, 3)
        ground = simulation.worlds.height(positions[..., :2])
        turn.fallen += int((positions[..., 2] < ground - _FALLEN_M).sum())
    turn.nan += not is_finite


if __name__ == "__main__":
    main()
