"""Do equal seeds give equal bytes, in every world, with every robot, kind of actors and engine?

`python experiments/reliability/determinism.py FOLDER design=pairs steps=100` drives each combination of a
design and compares digests of all that a scene's agents observe, earn, end with and are measured, and of the
motions and goals of all its bodies, step by step. It adds a row a combination to
`FOLDER/determinism_DESIGN.csv`, and goes on with those that it does not have. Designs are `options` (every
option), `pairs` (every pair of two options) and `all`. What has no room in its world is also driven in the
flat one.

Two scenes drive until the first episodes have so many steps, with actions that depend on (episode, step)
alone. They drive again after a new seeding; another process, with another hash seed, drives the same episodes
in three scenes; and it drives on from a state saved in the middle.
"""

import hashlib
import multiprocessing
import os
import sys
import time
import warnings
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, astuple, dataclass, field, fields, replace
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

# Before NumPy is loaded, which reads them.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))

import numpy as np
from combinations import DESIGNS, ROOMY_WORLD, Combination, write_world_files

from dune_rl.commands.doctor.computed import add_values
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import DuneError, WorldError
from dune_rl.core.files import read_csv, write_csv
from dune_rl.core.machine import short_commit
from dune_rl.env.simulation import SimulationStep, VectorSimulation
from dune_rl.sensors.draws import draw, uniform

_SCENES, _OTHER_SCENES, _SEED = 2, 3, 7
_SPEED_AND_HEADING = 2
# Several episodes, though robots that drive at random seldom end one.
_SHARE_OF_EPISODE = 4

# By (episode, step).
Digests = dict[tuple[int, int], bytes]


@dataclass
class Comparison:
    """A row: how many step digests differ, of how many, and what was driven; `fault` is an error.

    `again` is in the same process, `scenes` in another one with three scenes, and `restored` in another one
    from a state saved in the middle. `digest` is that of all steps, to compare machines.
    """

    world: str
    robot: str
    engine: str
    actors: str
    steps: int = 0
    episodes: int = 0
    again: int = 0
    again_of: int = 0
    scenes: int = 0
    scenes_of: int = 0
    restored: int = 0
    restored_of: int = 0
    first: str = ""
    digest: str = ""
    wall_s: float = 0.0
    fault: str = ""
    commit: str = ""


@dataclass
class Drive:
    """Digests of a drive, the number of its whole episodes, and a state saved half way."""

    digests: Digests = field(default_factory=dict)
    episodes: int = 0
    saved: dict[str, Any] | None = None


def main() -> None:
    """Compare all combinations of a design."""
    folder, given = Path(sys.argv[1]), dict(word.split("=", 1) for word in sys.argv[2:])
    design, steps = given.get("design", "options"), int(given.get("steps", 10_000))
    warnings.simplefilter("ignore")
    write_world_files(folder / "worlds")
    path = folder / f"determinism_{design}.csv"
    rows: list[Mapping[str, object]] = [*read_csv(path)]
    known = {tuple(row[each.name] for each in fields(Combination)): row for row in rows}
    os.environ["PYTHONHASHSEED"] = "77"
    with multiprocessing.get_context("spawn").Pool(1) as other:
        for drawn in DESIGNS[design]():
            for chosen in (drawn, replace(drawn, world=ROOMY_WORLD)):
                if astuple(chosen) not in known:
                    known[astuple(chosen)] = asdict(compare(chosen, steps, folder / "worlds", other))
                    rows.append(known[astuple(chosen)])
                    write_csv(path, rows)
                if not str(known[astuple(chosen)]["fault"]).startswith(WorldError.__name__):
                    break


def compare(chosen: Combination, steps: int, files: Path, other: Pool) -> Comparison:
    """Drive a combination in this process and in `other`."""
    row, start = Comparison(**asdict(chosen), commit=short_commit()), time.perf_counter()
    try:
        with closing(_simulation(chosen, steps, files, _SCENES)) as simulation:
            simulation.reset()
            first = _drive(simulation, steps=steps)
            simulation.reseed(_SEED)
            simulation.reset()
            again = _drive(simulation, episodes=first.episodes)
        arguments = chosen, steps, files, first.episodes
        scenes = other.apply(_drive_elsewhere, (*arguments, _OTHER_SCENES, None))
        restored = other.apply(_drive_elsewhere, (*arguments, _SCENES, first.saved))
    except DuneError as error:
        row.fault = f"{type(error).__name__}: {str(error).splitlines()[0]}"
        return row
    whole = {key: value for key, value in first.digests.items() if key[0] < first.episodes}
    row.steps, row.episodes = sum(step > 0 for _, step in whole), first.episodes
    row.again, row.again_of = _count_others(row, "again", whole, again.digests, whole)
    row.scenes, row.scenes_of = _count_others(row, "scenes", whole, scenes, whole)
    # A restored drive lacks what came before the state was saved.
    row.restored, row.restored_of = _count_others(row, "restored", whole, restored, restored)
    row.digest = hashlib.sha256(b"".join(whole[key] for key in sorted(whole))).hexdigest()[:16]
    row.wall_s = round(time.perf_counter() - start, 1)
    return row


def _count_others(
    row: Comparison, name: str, ours: Digests, theirs: Digests, keys: Mapping[tuple[int, int], bytes]
) -> tuple[int, int]:
    """How many of the steps in `keys` differ, and of how many; notes the first one that does."""
    compared = sorted({*keys} & {*ours})
    different = [key for key in compared if ours[key] != theirs.get(key)]
    if different and not row.first:
        row.first = "{}: episode {}, step {}".format(name, *different[0])
    return len(different), len(compared)


def _drive_elsewhere(
    chosen: Combination,
    steps: int,
    files: Path,
    episodes: int,
    scenes: int,
    saved: dict[str, Any] | None,
) -> Digests:
    warnings.simplefilter("ignore")
    with closing(_simulation(chosen, steps, files, scenes)) as simulation:
        if saved is None:
            simulation.reset()
        else:
            simulation.restore(saved)
        return _drive(simulation, episodes=episodes).digests


def _simulation(chosen: Combination, steps: int, files: Path, scenes: int) -> VectorSimulation:
    limit = f"task.terminations.time_limit.max_steps={max(1, steps // _SHARE_OF_EPISODE)}"
    words = [*chosen.words(files), "randomisation=body", limit]
    return make_simulation(compose_environment(chosen.world, words), scenes, _SEED)


def _drive(simulation: VectorSimulation, *, steps: int = 0, episodes: int = 0) -> Drive:
    """Drive on until the first `episodes` have ended or, without a number of them, have `steps` in all."""
    found, ended, lengths = Drive(), set[int](), dict[int, int]()
    # After a restored state, the steps that scenes are in were taken before.
    _record(simulation, found.digests, None, np.flatnonzero(simulation.steps == 0).tolist())
    while True:
        actions = {group.name: _draw_actions(simulation, group) for group in simulation.external}
        result = simulation.step(actions)
        _record(simulation, found.digests, result, range(simulation.num_scenes))
        for scene in np.flatnonzero(result.done).tolist():
            ended.add(int(simulation.episodes[scene]))
            lengths[int(simulation.episodes[scene])] = int(simulation.steps[scene])
        if result.done.any():
            simulation.reset(result.done)
            _record(simulation, found.digests, None, np.flatnonzero(result.done).tolist())
        while found.episodes in ended or (episodes and found.episodes < simulation.episodes.min()):
            found.episodes += 1
        driven = sum(length for episode, length in lengths.items() if episode < found.episodes)
        if (
            found.saved is None
            and steps
            and int(simulation.steps.sum()) + sum(lengths.values()) >= steps // 2
        ):
            found.saved = simulation.save_state()
        if (found.episodes >= episodes) if episodes else (driven >= steps):
            return found


def _draw_actions(simulation: VectorSimulation, group: Any) -> np.ndarray:
    """Random actions by (episode, step); mostly ahead where they are a speed and a heading."""
    episode = simulation.state.groups[group.name].episode
    low, high = group.action_bounds
    if group.action_size == _SPEED_AND_HEADING:
        low, high = np.array([0.2 * high[0], -1.0]), np.array([high[0], 1.0])
    shares = draw(uniform, episode, f"determinism {group.name}", group.action_size)
    actions = (low + shares * (high - low)).astype(np.float32)
    return actions.reshape(simulation.num_scenes, group.count, -1)


def _record(
    simulation: VectorSimulation, digests: Digests, result: SimulationStep | None, scenes: Any
) -> None:
    """Add the digest of the present step of each of the `scenes`."""
    values: dict[str, Any] = {}
    for group in simulation.external:
        for name, reading in simulation.observe(group.name).items():
            values[f"{group.name} {name}"] = reading
        values[f"{group.name} metrics"] = simulation.metrics(group.name)
        if result is not None:
            step = result.groups[group.name]
            ends = step.reward, step.terminated, step.truncated
            values[f"{group.name} ends"] = np.stack([each.astype(np.float32) for each in ends], -1)
    for name, state in simulation.state.groups.items():
        motion = state.motion
        for key in ("position_w", "roll_pitch_yaw", "velocity_w", "angular_w"):
            values[f"{name} {key}"] = getattr(motion, key)
        values[f"{name} goal"] = state.goal.position_w
    rows = {name: value.reshape(simulation.num_scenes, -1) for name, value in values.items()}
    for scene in scenes:
        digest = hashlib.sha256()
        add_values(digest, {name: value[scene] for name, value in rows.items()})
        digests[int(simulation.episodes[scene]), int(simulation.steps[scene])] = digest.digest()[:8]


if __name__ == "__main__":
    main()
