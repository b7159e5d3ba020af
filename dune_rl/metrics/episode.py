"""Metrics of episodes: the values of metric terms, reduced over the steps of each agent's episode."""

from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.metrics.registry import METRICS, MetricTermConf, MetricTerms, Reduction
from dune_rl.state.state import GroupState, State
from dune_rl.state.terms import bind_terms, name_term

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


def metric_names(conf: MetricsConf) -> tuple[str, ...]:
    """Names of the metrics of episodes, without those of reward terms."""
    return (*BUILT_IN, *conf.all_terms)


class MetricSet:
    """Running metrics of N agents; a row is final when its episode is.

    `names` (K) are the columns of `values`: the episode's id, its steps and its return, then the terms.
    `needs_joints` tells whether a term reads the joints' state, `needs_scan` whether one reads
    `GroupState.nearest_return`.
    """

    def __init__(self, conf: MetricsConf, num_rows: int) -> None:
        confs = conf.all_terms
        self.names = metric_names(conf)
        reductions: list[Reduction] = ["last", "last", "sum", *(term.reduce for term in confs.values())]
        self._reductions = np.array([_REDUCTIONS.index(reduction) for reduction in reductions])
        self._initial = np.array([[0.0]] * len(BUILT_IN) + [[_initial(term)] for term in confs.values()])
        # What a step gives and what it is reduced into, a row for each name; of means also sums and counts.
        self._new, self._values, self._sums, self._counts = np.zeros((4, len(self.names), num_rows))
        self._ids, self._steps, self._returns = self._new[: len(BUILT_IN)]
        shared = _names_by_term(confs)
        terms, self._stateful = bind_terms(METRICS, [confs[names[0]] for names in shared], num_rows)
        rows = [[self._new[self.names.index(name)] for name in names] for names in shared]
        self._terms = list(zip(terms, rows, strict=True))
        self.needs_joints = any(METRICS.needs_joints(confs[names[0]]) for names in shared)
        self.needs_scan = any(METRICS.needs_scan(confs[names[0]]) for names in shared)
        self._first_names = [names[0] for names in shared]

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Begin the episodes of the agents in `mask` (N,)."""
        self._values[:, mask] = self._initial
        self._values[0, mask] = group.episode.ids[mask]
        self._sums[:, mask] = 0.0
        self._counts[:, mask] = 0.0
        for term in self._stateful:
            term.reset(mask, group)

    def clear(self, mask: Flags) -> None:
        """Leave the agents in `mask` (N,) without values until their next `reset`."""
        self._values[:, mask] = np.nan

    def update(self, state: State, group: GroupState, reward: Array) -> None:
        """Add one control step with its `reward` (N,); agents that are done keep their values."""
        self._ids[:] = group.episode.ids
        self._steps[:] = group.episode.steps
        self._returns[:] = reward
        try:
            for term, rows in self._terms:
                values = term(state, group)
                for row in rows:
                    row[:] = values
        except Exception as error:
            named = zip(self._first_names, self._terms, strict=True)
            name_term(error, "metric", next(name for name, (each, _) in named if each is term))
            raise
        _reduce(self._reductions, self._new, group.done, self._values, self._sums, self._counts)

    @property
    def values(self) -> Array:
        """Values (N, K) of the present episodes."""
        return self._values.T.copy()

    @property
    def term_values(self) -> Array:
        """Values (K, N) of the terms alone, a row for each, without those that every set has."""
        return self._values[len(BUILT_IN) :].copy()


_REDUCTIONS: tuple[Reduction, ...] = ("mean", "sum", "min", "max", "last", "first")
_MEAN, _SUM, _MIN, _MAX, _LAST, _FIRST = range(len(_REDUCTIONS))


@compile_function
def _reduce(reductions: Counts, new: Array, done: Flags, values: Array, sums: Array, counts: Array) -> None:
    """Reduce the values of a step, `new` (K, N), into those of the episodes, `values` (K, N).

    `reductions` (K,) are the indices in `_REDUCTIONS`. NaN is no value; agents that are `done` (N,) get none.
    `sums` and `counts` (K, N) are those of the values so far.
    """
    rows, agents = new.shape
    for row in range(rows):
        how = reductions[row]
        for agent in range(agents):
            value, before = new[row, agent], values[row, agent]
            if done[agent] or np.isnan(value):
                continue
            counts[row, agent] += 1.0
            if how == _MEAN:
                sums[row, agent] += value
                values[row, agent] = sums[row, agent] / counts[row, agent]
            elif how == _SUM:
                values[row, agent] = before + value
            elif (
                how == _LAST
                or counts[row, agent] == 1.0
                or (how == _MIN and value < before)
                or (how == _MAX and value > before)
            ):
                values[row, agent] = value


def _initial(conf: MetricTermConf) -> float:
    if conf.initial is not None:
        return conf.initial
    return 0.0 if conf.reduce == "sum" else np.nan


def _names_by_term(confs: MetricTerms) -> list[list[str]]:
    """The metrics by term: those that differ in their reduction alone share one."""
    shared: dict[str, list[str]] = {}
    for name, conf in confs.items():
        shared.setdefault(conf.model_dump_json(exclude={"reduce", "initial"}), []).append(name)
    return list(shared.values())
