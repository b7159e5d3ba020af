"""Minutes of random driving, and the faults of physics in them."""

from dataclasses import dataclass

import numpy as np

from dune_rl.commands.engines.recording import RecordedSimulation
from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.physics.interface import Engine

# Duration of each random command.
_HOLD_S = 0.5
# Deeper below the terrain than sinkage or a steep ditch can account for.
_FALLEN_M = 0.5
_JUMP = 1.5


@dataclass(frozen=True)
class FaultCounts:
    """Faults in `minutes` of simulated time, over `episodes`.

    `nan` counts control steps whose final state is not finite, `fallen` those with the origin far below the
    terrain, `jumps` those that move the robot more than 1.5 times as far as its energy allows (see
    `SpeedLimit`), and `diverged` the episodes that were given up for one of these. `fast` counts control
    steps that move it horizontally more than 1.5 times as far as its largest commanded speed, and
    `fastest_mps` is the largest speed of any step. These two are no faults by themselves: a robot that
    tumbles is fast, and so is one that its own motors throw, which may be due to its model.
    """

    minutes: float
    episodes: int
    nan: int
    fallen: int
    jumps: int
    diverged: int
    fast: int
    fastest_mps: float


class SpeedLimit:
    """Largest possible speeds of M robots of `mass_kg`, by conservation of energy.

    Ground at rest takes energy and gives none. After a control step a robot therefore cannot be faster than
    its speed before the step, the work of its motors and the loss of height allow:

        v² = v₀² + 2 (W / m + g Δh)

    This holds for wheels and legs, on level ground, on a slope and in a fall. The kinetic energy of wheels
    and legs relative to the body is allowed for by `top_mps`, the largest speed that can be commanded, which
    a robot may always have; that of compressed tyres by taking for v₀ the larger of the speeds at the ends of
    the last two steps. Energy that a solver adds is not carried over to the next step, so that many small
    errors are found as one large error is.
    """

    def __init__(self, top_mps: float, mass_kg: float, speed_mps: Array) -> None:
        self._top2, self._mass_kg = top_mps**2, mass_kg
        self._carried2 = np.zeros((2, len(speed_mps)))
        self.restart(np.ones(len(speed_mps), bool), speed_mps)

    def restart(self, mask: Flags, speed_mps: Array) -> None:
        """Accept the speeds (M,) [m/s] of the robots in `mask` (M,) as they are."""
        self._carried2[:, mask] = speed_mps[mask] ** 2

    def update(self, work_j: Array, drop_m: Array, speed_mps: Array) -> Array:
        """Largest possible speeds (M,) [m/s] after a step with work [J] and loss of height [m], each (M,).

        `speed_mps` (M,) are the actual speeds after the step.
        """
        gained2 = 2.0 * (work_j / self._mass_kg + GRAVITY_MPS2 * drop_m)
        possible2 = np.maximum(np.maximum(self._carried2.max(axis=0), self._top2) + gained2, self._top2)
        self._carried2 = np.stack([self._carried2[1], np.minimum(speed_mps**2, possible2)])
        return np.sqrt(possible2)


def count_faults(
    world: str, engine: Engine, robot: str, minutes: float, scenes: int, seed: int
) -> FaultCounts:
    """Drive at random in a world, all scenes together for `minutes` of simulated time."""
    recorded = RecordedSimulation(world, engine, robot, scenes, seed)
    simulation = recorded.simulation
    simulation.reset()
    step_s, described = recorded.step_s, recorded.robot.description
    top_mps, low, high = described.max_speed_mps, described.actions.low, described.actions.high
    draws = np.random.default_rng(seed)
    nan = fallen = jumps = diverged = fast = 0
    fastest = 0.0
    before, speed = recorded.motion.position_w.copy(), np.linalg.norm(recorded.motion.velocity_w, axis=1)
    limit = SpeedLimit(top_mps, described.mass_kg, speed)
    for step in range(round(minutes * 60 / step_s / scenes)):
        if step % round(_HOLD_S / step_s) == 0:
            actions = draws.uniform(low, high, (scenes, len(low))).astype(np.float32)
        done = recorded.step(actions).done
        states = np.array([scene.state for scene in recorded.scenes])
        finite = np.isfinite(states).all(axis=1)
        nan += int((~finite).sum())
        position = np.where(finite[:, None], states[:, :3], before)
        ground = recorded.world.terrain.height(position[:, :2])
        fallen += int((position[:, 2] < ground - _FALLEN_M).sum())
        speed = np.where(finite, np.linalg.norm(states[:, 7:10], axis=1), 0.0)
        work = np.array([scene.work_done_j for scene in recorded.scenes])
        velocity = (position - before) / step_s
        moved = np.linalg.norm(velocity, axis=1)
        fastest = max(fastest, float(moved.max()))
        fast += int((np.linalg.norm(velocity[:, :2], axis=1) > _JUMP * top_mps).sum())
        jumps += int((moved > _JUMP * limit.update(work, before[:, 2] - position[:, 2], speed)).sum())
        diverged += int(recorded.motion.diverged.sum())
        if done.any():
            simulation.reset(done)
            limit.restart(done, np.linalg.norm(recorded.motion.velocity_w, axis=1))
        before = recorded.motion.position_w.copy()
    episodes = int((simulation.episodes // scenes + 1).sum())
    simulation.close()
    return FaultCounts(minutes, episodes, nan, fallen, jumps, diverged, fast, fastest)
