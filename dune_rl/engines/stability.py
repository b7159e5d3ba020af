"""Minutes of random driving, and what must not happen in them."""

from dataclasses import dataclass

import numpy as np

from dune_rl.engines.watched import watched_batch
from dune_rl.physics.interface import Engine

# A command holds this long.
_HOLD_S = 0.5
# Deeper under the ground than any wheel sinks or ditch is steep.
_FALLEN_M = 0.5
_JUMP = 1.5


@dataclass(frozen=True)
class Count:
    """Faults in `minutes` of simulated time, over `episodes`.

    `nan` are control steps that end in a state which is not finite, `fallen`
    those with the origin deep under the terrain, `jumps` those that carry the
    robot more than 1.5 times as far over the ground as it can go in one, and
    `diverged` the episodes that were given up for one of them.
    """

    minutes: float
    episodes: int
    nan: int
    fallen: int
    jumps: int
    diverged: int


def count(place: str, engine: Engine, robot: str, minutes: float, scenes: int, seed: int) -> Count:
    """Drive at random in a place, all scenes together for `minutes` of simulated time."""
    batch, watched = watched_batch(place, engine, robot, scenes, seed, {})
    batch.reset()
    step_s = batch.physics.control_step_s
    low, high = batch.robot.action_bounds()
    draws = np.random.default_rng(seed)
    reach = _JUMP * batch.robot.max_speed_mps * step_s
    nan = fallen = jumps = diverged = 0
    before = batch.motion.position_w.copy()
    for step in range(round(minutes * 60 / step_s / scenes)):
        if step % round(_HOLD_S / step_s) == 0:
            actions = draws.uniform(low, high, (scenes, len(low))).astype(np.float32)
        outcome = batch.step(actions)
        states = np.array([scene.state for scene in watched])
        sound = np.isfinite(states).all(axis=1)
        nan += int((~sound).sum())
        position = np.where(sound[:, None], states[:, :3], before)
        fallen += int((position[:, 2] < batch.world.terrain.height(position[:, :2]) - _FALLEN_M).sum())
        jumps += int((np.linalg.norm(position[:, :2] - before[:, :2], axis=1) > reach).sum())
        diverged += int(batch.motion.diverged.sum())
        done = outcome.terminated | outcome.truncated
        if done.any():
            batch.reset(done)
        before = batch.motion.position_w.copy()
    episodes = int((batch.episodes // scenes + 1).sum())
    batch.close()
    return Count(minutes, episodes, nan, fallen, jumps, diverged)
