"""Minutes of random driving, and what must not happen in them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.engine_comparison.watched import watched_batch
from dune_rl.physics.interface import Engine

Array = NDArray[np.float64]

# A command holds this long.
_HOLD_S = 0.5
# Deeper under the ground than any wheel sinks or ditch is steep.
_FALLEN_M = 0.5
_JUMP = 1.5
_GRAVITY_MPS2 = 9.81


@dataclass(frozen=True)
class Count:
    """Faults in `minutes` of simulated time, over `episodes`.

    `nan` are control steps that end in a state which is not finite, `fallen`
    those with the origin deep under the terrain, `jumps` those that carry the
    robot more than 1.5 times as far as it can go in one, see `PossibleSpeed`,
    and `diverged` the episodes that were given up for one of them. No fault by
    themselves are `fast`, control steps that carry it over the ground more than
    1.5 times as far as the largest speed does that it can be told, and
    `fastest_mps`, the most of any step: what tumbles is fast, and so is what
    its own motors fling, which a flaw of the robot's model may be behind.
    """

    minutes: float
    episodes: int
    nan: int
    fallen: int
    jumps: int
    diverged: int
    fast: int
    fastest_mps: float


class PossibleSpeed:
    """How fast M robots of `mass_kg` can be, by where their energy can have come from.

    Ground that stands still takes energy and gives none. So after a control
    step a robot cannot be faster than its speed before it, what its motors
    have done since and the height that it came down allow:

        v² = v₀² + 2 (W / m + g Δh)

    This holds for wheels and for legs, on level ground, on a slope and in a
    fall. What turning wheels and swinging legs hold of energy beside the body
    is allowed for by the largest speed that it can be told, `top_mps`, which
    it can have at any time, and what tyres do as springs by `v₀` being the
    greater of the speeds at the ends of the last two steps. What a solver
    adds is not carried on from step to step, so that many small gifts come to
    light as a great one does.
    """

    def __init__(self, top_mps: float, mass_kg: float, speed_mps: Array) -> None:
        self._top2, self._mass_kg = top_mps**2, mass_kg
        self._carried2 = np.zeros((2, len(speed_mps)))
        self.restart(np.ones(len(speed_mps), bool), speed_mps)

    def restart(self, mask: NDArray[np.bool_], speed_mps: Array) -> None:
        """Believe the speeds (M,) [m/s] of the robots in `mask` (M,)."""
        self._carried2[:, mask] = speed_mps[mask] ** 2

    def after(self, work_j: Array, drop_m: Array, speed_mps: Array) -> Array:
        """What each can have come to in a step (M,) [m/s], by work [J] and loss of height [m], each (M,).

        `speed_mps` (M,) is the speed that it has now.
        """
        gained2 = 2.0 * (work_j / self._mass_kg + _GRAVITY_MPS2 * drop_m)
        possible2 = np.maximum(np.maximum(self._carried2.max(axis=0), self._top2) + gained2, self._top2)
        self._carried2 = np.stack([self._carried2[1], np.minimum(speed_mps**2, possible2)])
        return np.sqrt(possible2)


def count(place: str, engine: Engine, robot: str, minutes: float, scenes: int, seed: int) -> Count:
    """Drive at random in a place, all scenes together for `minutes` of simulated time."""
    batch, watched = watched_batch(place, engine, robot, scenes, seed, {})
    batch.reset()
    step_s = batch.physics.control_step_s
    low, high = batch.robot.action_bounds()
    draws = np.random.default_rng(seed)
    nan = fallen = jumps = diverged = fast = 0
    fastest = 0.0
    before, speed = batch.motion.position_w.copy(), np.linalg.norm(batch.motion.velocity_w, axis=1)
    possible = PossibleSpeed(batch.robot.max_speed_mps, batch.robot.mass_kg, speed)
    for step in range(round(minutes * 60 / step_s / scenes)):
        if step % round(_HOLD_S / step_s) == 0:
            actions = draws.uniform(low, high, (scenes, len(low))).astype(np.float32)
        outcome = batch.step(actions)
        states = np.array([scene.state for scene in watched])
        sound = np.isfinite(states).all(axis=1)
        nan += int((~sound).sum())
        position = np.where(sound[:, None], states[:, :3], before)
        fallen += int((position[:, 2] < batch.world.terrain.height(position[:, :2]) - _FALLEN_M).sum())
        speed = np.where(sound, np.linalg.norm(states[:, 7:10], axis=1), 0.0)
        work = np.array([scene.work_done_j for scene in watched])
        velocity = (position - before) / step_s
        went = np.linalg.norm(velocity, axis=1)
        fastest = max(fastest, float(went.max()))
        fast += int((np.linalg.norm(velocity[:, :2], axis=1) > _JUMP * batch.robot.max_speed_mps).sum())
        jumps += int((went > _JUMP * possible.after(work, before[:, 2] - position[:, 2], speed)).sum())
        diverged += int(batch.motion.diverged.sum())
        done = outcome.terminated | outcome.truncated
        if done.any():
            batch.reset(done)
            possible.restart(done, np.linalg.norm(batch.motion.velocity_w, axis=1))
        before = batch.motion.position_w.copy()
    episodes = int((batch.episodes // scenes + 1).sum())
    batch.close()
    return Count(minutes, episodes, nan, fallen, jumps, diverged, fast, fastest)
