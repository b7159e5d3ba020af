"""Metric terms as the paper's published code computes them, where it differs from the paper's definitions.

Its metrics node keeps the last 100 readings of each sensor and writes a row of their means once a second;
figures are means over rows. Readings come once a control step (20 Hz), the IMU's with gravity, and scans are
those of `GroupState.nearest_return`. An attempt lasts from a goal to the next: the first begins with the
episode. Sums over rows, steps and attempts are reduced here; `dune_rl.metrics.catalogue` divides them.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.metrics.terms.paper import vector_norms
from dune_rl.state.state import GroupState, State

Seconds = Annotated[float, Field(ge=0.0)]
Readings = Annotated[int, Field(ge=1)]


def dune_code_collisions(
    state: State, group: GroupState, *, distance_m: Annotated[float, Field(gt=0.0)] = 0.2
) -> Flags:
    """1 if the scan of this step has a return nearer than `distance_m`; its sum is the code's TC."""
    # Comparisons with NaN, where nothing returns, are False.
    near: Flags = group.nearest_return < distance_m
    return near


dune_code_collisions.needs_scan = True  # type: ignore[attr-defined]


def dune_code_vertical(state: State, group: GroupState) -> Array:
    """Size of the IMU's vertical acceleration with gravity, along the body's z axis [m/s²]."""
    return np.abs(_specific_force(group)[:, 2])


def _writes_row(group: GroupState, every_s: float) -> Flags:
    """Whether a row is written (N,): in each step that completes another `every_s` [s]."""
    due: Flags = group.episode.steps % max(round(every_s / group.episode.step_s), 1) == 0
    return due


class _RowMean:
    """In a step with a row the mean of the last `readings` values of `_measure`, else NaN.

    Readings of NaN are left out.
    """

    def __init__(
        self, num_rows: int, *, readings: Readings = 100, every_s: Annotated[float, Field(gt=0.0)] = 1.0
    ) -> None:
        self._every_s = every_s
        self._kept = np.full((num_rows, readings), np.nan)
        self._count = np.zeros(num_rows, np.int64)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """There are no readings in the episodes of the agents in `mask` (N,)."""
        self._kept[mask] = np.nan
        self._count[mask] = 0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Means (N,); to be called once a control step."""
        values, window = self._measure(group), self._kept.shape[1]
        rows = np.flatnonzero(~np.isnan(values))
        self._kept[rows, self._count[rows] % window] = values[rows]
        self._count[rows] += 1
        number = np.minimum(self._count, window)
        means = np.full(len(number), np.nan)
        written = _writes_row(group, self._every_s)
        np.divide(np.nansum(self._kept, axis=1), number, out=means, where=written & (number > 0))
        return means

    def _measure(self, group: GroupState) -> Array:
        raise NotImplementedError


class DuneCodeClearance(_RowMean):
    """Mean of the last 100 smallest ranges [m] once a second; NaN before anything has returned."""

    needs_scan = True

    def _measure(self, group: GroupState) -> Array:
        return group.nearest_return


class DuneCodeSmoothness(_RowMean):
    """Mean of the last 100 sums |acceleration| + |angular velocity| once a second, with gravity."""

    def _measure(self, group: GroupState) -> Array:
        return vector_norms(_specific_force(group)) + vector_norms(group.motion.angular_b)


class DuneCodeSpeed(_RowMean):
    """Mean of the last 100 speeds [m/s] once a second, wherever the agent is.

    With `rough_mps2`, only in rows at whose moment |acceleration| with gravity is above this [m/s²].
    """

    def __init__(
        self,
        num_rows: int,
        *,
        readings: Readings = 100,
        every_s: Annotated[float, Field(gt=0.0)] = 1.0,
        rough_mps2: Annotated[float, Field(gt=0.0)] | None = None,
    ) -> None:
        super().__init__(num_rows, readings=readings, every_s=every_s)
        self._rough_mps2 = rough_mps2

    def __call__(self, state: State, group: GroupState) -> Array:
        """Means (N,); to be called once a control step."""
        means = super().__call__(state, group)
        if self._rough_mps2 is None:
            return means
        return np.where(vector_norms(_specific_force(group)) > self._rough_mps2, means, np.nan)

    def _measure(self, group: GroupState) -> Array:
        return vector_norms(group.motion.velocity_w)


class DuneCodeRows:
    """1 in a step with a row, else 0.

    `of` "clearance" counts those that have one: rows since a beam has returned. With `rough_mps2`, only rows
    count at whose moment |acceleration| with gravity is above this [m/s²].
    """

    needs_scan = True

    def __init__(
        self,
        num_rows: int,
        *,
        of: Literal["all", "clearance"] = "all",
        every_s: Annotated[float, Field(gt=0.0)] = 1.0,
        rough_mps2: Annotated[float, Field(gt=0.0)] | None = None,
    ) -> None:
        self._every_s, self._of, self._rough_mps2 = every_s, of, rough_mps2
        self._returned = np.zeros(num_rows, bool)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing has returned in the episodes of the agents in `mask` (N,)."""
        self._returned[mask] = False

    def __call__(self, state: State, group: GroupState) -> Flags:
        """Flags (N,); to be called once a control step."""
        counts = _writes_row(group, self._every_s)
        if self._of == "clearance":
            self._returned |= ~np.isnan(group.nearest_return)
            counts = counts & self._returned
        if self._rough_mps2 is not None:
            counts = counts & (vector_norms(_specific_force(group)) > self._rough_mps2)
        return counts


class DuneCodeGoalTime:
    """Time since the attempt began [s] in a step that reaches its goal, else 0."""

    def __init__(self, num_rows: int, *, termination: str = "goal_reached") -> None:
        self._termination = termination
        self._began = np.zeros(num_rows, np.int64)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """The first attempts of the agents in `mask` (N,) begin."""
        self._began[mask] = 0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Times (N,); to be called once a control step."""
        return np.where(group.ended_by(self._termination), self._lasted(group), 0.0)

    def _lasted(self, group: GroupState) -> Array:
        """For how long the attempts (N,) have lasted [s]; the next ones begin where a goal is reached."""
        lasted: Array = np.multiply(group.episode.steps - self._began, group.episode.step_s, dtype=np.float64)
        self._began = np.where(group.ended_by(self._termination), group.episode.steps, self._began)
        return lasted


class DuneCodeAttempts(DuneCodeGoalTime):
    """1 in a step that ends an attempt which the code counts, else 0.

    An attempt ends by the termination `termination`, which reaches the goal, or by any other. It counts if it
    lasted more than `reached_s` or `failed_s` [s]. `outcome` chooses attempts that reached the goal, or all.
    """

    def __init__(
        self,
        num_rows: int,
        *,
        termination: str = "goal_reached",
        outcome: Literal["reached", "all"] = "all",
        reached_s: Seconds = 5.0,
        failed_s: Seconds = 25.0,
    ) -> None:
        super().__init__(num_rows, termination=termination)
        self._all, self._reached_s, self._failed_s = outcome == "all", reached_s, failed_s

    def __call__(self, state: State, group: GroupState) -> Flags:  # type: ignore[override]
        """Flags (N,); to be called once a control step."""
        reached, lasted = group.ended_by(self._termination), self._lasted(group)
        counts: Flags = reached & (lasted > self._reached_s)
        if self._all:
            others = [ended for name, ended in group.endings.items() if name != self._termination]
            failed = np.any([np.zeros_like(reached), *others], axis=0)
            counts = counts | (failed & ~reached & (lasted > self._failed_s))
        return counts


def _specific_force(group: GroupState) -> Array:
    """What an accelerometer feels [m/s²], body frame (N, 3): (0, 0, +9.81) at rest on level ground."""
    return group.motion.acceleration_b + GRAVITY_MPS2 * group.motion.rotation[:, 2]
