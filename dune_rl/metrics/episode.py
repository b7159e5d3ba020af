"""Metrics of episodes: the values of metric terms, reduced over the steps of each agent's episode."""

from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.metrics.registry import METRICS, MetricTerms, Reduction
from dune_rl.settings import Settings
from dune_rl.state import Array, Flags, GroupState, State
from dune_rl.terms import bind_terms

BUILT_IN = ("episode", "steps", "return")

PAPER_METRICS: dict[str, Any] = {
    "success": {"reduce": "last", "initial": 0.0},
    "reached": {"term": "ended_by", "termination": "goal_reached", "reduce": "max", "initial": 0.0},
    "goals": {"term": "ended_by", "termination": "goal_reached", "reduce": "sum"},
    "collisions": {"reduce": "sum"},
    "time_to_goal": {"reduce": "first"},
    "clearance": {"reduce": "mean", "initial": 12.0},
    "min_clearance": {"term": "clearance", "reduce": "min", "initial": 12.0},
    "vertical_roughness": {"reduce": "mean", "initial": 0.0},
    "vort": {"reduce": "mean"},
    "smoothness": {"reduce": "mean", "initial": 0.0},
    "diverged": {"term": "ended_by", "termination": "diverged", "reduce": "last", "initial": 0.0},
    "stuck": {"term": "ended_by", "termination": "stuck", "reduce": "last", "initial": 0.0},
    "flipped": {"term": "ended_by", "termination": "flipped", "reduce": "last", "initial": 0.0},
    "out_of_world": {"term": "ended_by", "termination": "out_of_world", "reduce": "last", "initial": 0.0},
    "timeout": {"term": "ended_by", "termination": "time_limit", "reduce": "last", "initial": 0.0},
}
ENERGY_METRICS: dict[str, Any] = {
    "energy_wh": {"reduce": "sum"},
    "battery_share": {"reduce": "last", "initial": 0.0},
    "range_km": {"reduce": "last"},
}


class MetricsConf(Settings):
    """The terms that are measured of each episode, by name; the defaults are the paper's.

    With `energy` the battery's use is measured too: physics has to read the joints' states for it, which
    makes a step some 4 % slower.
    """

    energy: bool = False
    terms: MetricTerms = Field(PAPER_METRICS)

    @model_validator(mode="after")
    def _names_are_free(self) -> Self:
        taken = (*BUILT_IN, *(ENERGY_METRICS if self.energy else ()))
        for name in self.terms:
            if name in taken or name.startswith("reward/"):
                raise ValueError(f"terms.{name}: another metric has this name; choose a different one")
        return self

    @property
    def all_terms(self) -> MetricTerms:
        """The terms with those of the battery's use, where it is measured."""
        if not self.energy:
            return self.terms
        return {**self.terms, **MetricsConf(terms=ENERGY_METRICS).terms}


class MetricSet:
    """Running metrics of N agents; a row is final when its episode is.

    `names` (K) are the columns of `values`: the episode's id, its steps and its return, then the terms.
    """

    def __init__(self, conf: MetricsConf, num_rows: int) -> None:
        confs = conf.all_terms
        self.names = (*BUILT_IN, *confs)
        # In rows by reduction, so that each is one operation; `_order` puts them into the order of names.
        by_reduction = sorted(confs, key=lambda name: _REDUCTIONS.index(confs[name].reduce))
        self._terms, self._stateful = bind_terms(METRICS, [confs[name] for name in by_reduction], num_rows)
        reductions = [confs[name].reduce for name in by_reduction]
        ends = np.cumsum([0, *(reductions.count(reduction) for reduction in _REDUCTIONS)]).tolist()
        self._rows = {
            reduction: slice(ends[index], ends[index + 1])
            for index, reduction in enumerate(_REDUCTIONS)
            if ends[index] < ends[index + 1]
        }
        order = [by_reduction.index(name) + len(BUILT_IN) for name in confs]
        self._order = np.array([*range(len(BUILT_IN)), *order])
        self._initial = np.array([_initial(confs[name].reduce, confs[name].initial) for name in by_reduction])
        self._all = np.zeros((len(self.names), num_rows))
        means = reductions.count("mean")
        self._sums, self._counts = np.zeros((means, num_rows)), np.zeros((means, num_rows))

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Begin the episodes of the agents in `mask` (N,)."""
        self._all[:, mask] = 0.0
        self._all[0, mask] = group.episode.ids[mask]
        self._all[len(BUILT_IN) :, mask] = self._initial[:, None]
        self._sums[:, mask] = 0.0
        self._counts[:, mask] = 0.0
        for term in self._stateful:
            term.reset(mask, group)

    def update(self, state: State, group: GroupState, reward: Array) -> None:
        """Add one control step with its `reward` (N,); agents that are done keep their values."""
        done = group.done if group.done.any() else None
        final = None if done is None else self._all[:, done]
        self._all[1] = group.episode.steps
        self._all[2] += reward
        values = np.empty((len(self._terms), len(reward)))
        for row, term in zip(values, self._terms, strict=True):
            row[:] = term(state, group)
        for reduction, rows in self._rows.items():
            self._reduce(reduction, values[rows], self._all[len(BUILT_IN) :][rows])
        if done is not None:
            self._all[:, done] = final

    def _reduce(self, reduction: Reduction, new: Array, values: Array) -> None:
        if reduction == "last":
            values[:] = new
        elif reduction == "sum":
            values += np.where(np.isnan(new), 0.0, new)
        elif reduction == "mean":
            given = ~np.isnan(new)
            self._sums += np.where(given, new, 0.0)
            self._counts += given
            np.divide(self._sums, self._counts, out=values, where=self._counts > 0.0)
        elif reduction == "min":
            np.fmin(values, new, out=values)
        elif reduction == "max":
            np.fmax(values, new, out=values)
        else:
            np.copyto(values, new, where=np.isnan(values))

    @property
    def values(self) -> Array:
        """Values (N, K) of the present episodes."""
        values: Array = self._all[self._order].T
        return values


_REDUCTIONS: tuple[Reduction, ...] = ("sum", "mean", "min", "max", "last", "first")


def _initial(reduction: Reduction, initial: float | None) -> float:
    if initial is not None:
        return initial
    return 0.0 if reduction == "sum" else np.nan
