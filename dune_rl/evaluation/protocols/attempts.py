"""Attempts at goals as the log of the paper's published code has them, and its best sliding window."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array

REACHED, FAILED, CUT = "reached", "failed", "cut"
_GOAL = "goal_reached"

# Of the published script. How long the windows of the published figures were is not known.
WINDOW_S, WINDOW_STEP_S, WINDOWS = 600.0, 60.0, 1_000
_LEAST_REACHED_S, _LEAST_FAILED_S, _LEAST_LAST_S = 5.0, 25.0, 3.0
# The code's environment logs a collision for every scan with a return nearer than this.
_COLLISION_M = 0.3


@dataclass(frozen=True)
class Attempt:
    """An attempt at a goal: times since the start of the episode [s], and how it ended.

    `late_collision_s` is the time of the first collision that the code logs more than 3 s after the
    beginning, None without one. Attempts that were cut off with a run have neither reached their goal nor
    failed.
    """

    begin_s: float
    end_s: float
    outcome: str
    late_collision_s: float | None = None

    def later(self, offset_s: float) -> "Attempt":
        """The same attempt, with times `offset_s` [s] later."""
        late = None if self.late_collision_s is None else self.late_collision_s + offset_s
        return Attempt(self.begin_s + offset_s, self.end_s + offset_s, self.outcome, late)


class AttemptRecorder:
    """Records the attempts of the one agent of a group in each of M scenes.

    Calls come as those of `EpisodeObserver`; the group's state must have a scanner.
    """

    def __init__(self, simulation: VectorSimulation, group: str) -> None:
        self._simulation, self._group = simulation, group
        scenes = simulation.num_scenes
        self._attempts: list[list[Attempt]] = [[] for _ in range(scenes)]
        self._began_s = np.zeros(scenes)
        self._late_s = np.full(scenes, np.nan)
        self._now_s: Array = np.zeros(scenes)

    def begin(self) -> None:
        """Forget the attempts of scenes that have made no step."""
        fresh = self._simulation.steps == 0
        self._began_s[fresh] = self._now_s[fresh] = 0.0
        self._late_s[fresh] = np.nan
        for scene in np.flatnonzero(fresh).tolist():
            self._attempts[scene] = []

    def step(self) -> None:
        state = self._simulation.state.groups[self._group]
        self._now_s = np.multiply(state.episode.steps, state.episode.step_s, dtype=np.float64)
        reached = state.ended_by(_GOAL)
        collides = (state.nearest_return < _COLLISION_M) & ~reached
        late = collides & (self._now_s - self._began_s > _LEAST_LAST_S) & np.isnan(self._late_s)
        self._late_s[late] = self._now_s[late]
        for scene in np.flatnonzero(reached).tolist():
            self._attempts[scene].append(self._present(scene, REACHED))
        self._began_s = np.where(reached, self._now_s, self._began_s)
        self._late_s[reached] = np.nan

    def finish(self, scene: int) -> list[Attempt]:
        """The attempts of a scene whose episode has ended; the last one failed, unless it has just begun."""
        found = self._attempts[scene]
        if self._now_s[scene] > self._began_s[scene]:
            found = [*found, self._present(scene, FAILED)]
        return found

    def _present(self, scene: int, outcome: str) -> Attempt:
        late = float(self._late_s[scene])
        return Attempt(
            float(self._began_s[scene]), float(self._now_s[scene]), outcome, None if np.isnan(late) else late
        )


def cut_attempts(attempts: Sequence[Attempt], end_s: float) -> list[Attempt]:
    """The attempts of an episode that was cut off at `end_s` [s]; the one under way then is cut."""
    found = [one for one in attempts if one.end_s <= end_s and one.outcome == REACHED]
    for one in attempts[len(found) : len(found) + 1]:
        if one.begin_s < end_s:
            late = one.late_collision_s
            kept = late if late is not None and late <= end_s else None
            found.append(Attempt(one.begin_s, end_s, CUT, kept))
    return found


def join_attempts(episodes: Sequence[tuple[float, Sequence[Attempt]]]) -> list[Attempt]:
    """Attempts of episodes, given with their durations [s], on one clock: one episode after another."""
    found: list[Attempt] = []
    offset_s = 0.0
    for duration_s, attempts in episodes:
        found += [one.later(offset_s) for one in attempts]
        offset_s += duration_s
    return found


def best_window_rate(
    attempts: Sequence[Attempt], window_s: float = WINDOW_S, *, whole: bool = False
) -> float:
    """The largest success rate of up to 1,000 windows of `window_s` [s], begun every 60 s.

    It is NaN without attempts. As the published script has it, windows at the end of the log count as the
    others do, though they have few attempts; with `whole`, only windows that end within the log.
    """
    if not attempts:
        return float("nan")
    begin_s, end_s = (np.array([getattr(one, name) for one in attempts]) for name in ("begin_s", "end_s"))
    late_s = np.array([np.inf if one.late_collision_s is None else one.late_collision_s for one in attempts])
    outcomes, lasted = np.array([one.outcome for one in attempts]), end_s - begin_s
    successes = (outcomes == REACHED) & (lasted > _LEAST_REACHED_S)
    failures = (outcomes == FAILED) & (lasted > _LEAST_FAILED_S)
    # A failure is noticed when the next attempt begins.
    failures[-1] = False

    def success_rate(start_s: float) -> float:
        """The rate of the attempts that begin within a window; 0 where none counts."""
        last_s = start_s + window_s
        inside = (begin_s >= start_s) & (begin_s <= last_s)
        if not inside.any():
            return 0.0
        reached = inside & (end_s <= last_s) & successes
        counted = reached | (inside & (end_s <= last_s) & failures)
        last = np.flatnonzero(inside)[-1]
        counted[last] |= late_s[last] <= last_s
        return float(reached.sum() / counted.sum()) if counted.any() else 0.0

    latest_s = attempts[-1].end_s - (window_s if whole else 0.0)
    begins = [index * WINDOW_STEP_S for index in range(WINDOWS) if index * WINDOW_STEP_S <= latest_s]
    # A log that is shorter than a window is one.
    return max(map(success_rate, begins or [0.0]))
