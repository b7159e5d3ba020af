"""Metrics of episodes: the values of metric terms, reduced over the steps of each agent's episode."""

from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.metrics.registry import METRICS, MetricTermConf, MetricTerms, Reduction
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
        reductions = {"return": "sum", "steps": "last", **{name: term.reduce for name, term in confs.items()}}
        # A row for each metric, by reduction, so that each reduction is one operation.
        rows = sorted(reductions, key=lambda name: _REDUCTIONS.index(reductions[name]))
        kinds = [reductions[name] for name in rows]
        ends = np.cumsum([kinds.count(kind) for kind in _REDUCTIONS]).tolist()
        self._rows = dict(zip(_REDUCTIONS, map(slice, [0, *ends], ends), strict=False))
        self._added = slice(0, ends[1])
        # What a step gives, and what is kept of an episode: of a mean the sum, and beside it the count.
        self._new = np.zeros((len(rows), num_rows))
        self._kept = np.zeros((len(rows), num_rows))
        self._counts = np.zeros((kinds.count("mean"), num_rows))
        self._ids = np.zeros(num_rows)
        self._initial = np.array([[_initial(confs.get(name))] for name in rows])
        self._order = np.array([rows.index(name) for name in self.names[1:]])
        self._steps, self._returns = self._new[rows.index("steps")], self._new[rows.index("return")]
        shared = _names_by_term(confs)
        terms, self._stateful = bind_terms(METRICS, [confs[names[0]] for names in shared], num_rows)
        places = [[self._new[rows.index(name)] for name in names] for names in shared]
        self._terms = list(zip(terms, places, strict=True))

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Begin the episodes of the agents in `mask` (N,)."""
        self._ids[mask] = group.episode.ids[mask]
        self._kept[:, mask] = self._initial
        self._kept[self._rows["mean"], mask] = 0.0
        self._counts[:, mask] = 0.0
        for term in self._stateful:
            term.reset(mask, group)

    def update(self, state: State, group: GroupState, reward: Array) -> None:
        """Add one control step with its `reward` (N,); agents that are done keep their values."""
        self._steps[:] = group.episode.steps
        self._returns[:] = reward
        for term, rows in self._terms:
            values = term(state, group)
            for row in rows:
                row[:] = values
        if np.count_nonzero(group.done):
            self._new[:, group.done] = np.nan
        self._reduce()

    def _reduce(self) -> None:
        new, kept, rows = self._new, self._kept, self._rows
        given = ~np.isnan(new)
        if np.count_nonzero(given) == given.size:
            kept[self._added] += new[self._added]
            kept[rows["last"]] = new[rows["last"]]
        else:
            kept[self._added] += np.where(given[self._added], new[self._added], 0.0)
            np.copyto(kept[rows["last"]], new[rows["last"]], where=given[rows["last"]])
        self._counts += given[rows["mean"]]
        kept[rows["min"]] = np.fmin(kept[rows["min"]], new[rows["min"]])
        kept[rows["max"]] = np.fmax(kept[rows["max"]], new[rows["max"]])
        first = kept[rows["first"]]
        np.copyto(first, new[rows["first"]], where=np.isnan(first))

    @property
    def values(self) -> Array:
        """Values (N, K) of the present episodes."""
        values, means = self._kept.copy(), self._rows["mean"]
        values[means] = self._initial[means]
        np.divide(self._kept[means], self._counts, out=values[means], where=self._counts > 0.0)
        return np.concatenate([self._ids[None], values.take(self._order, axis=0)]).T


# Sums and means come first: both are added up.
_REDUCTIONS: tuple[Reduction, ...] = ("sum", "mean", "min", "max", "first", "last")


def _initial(conf: MetricTermConf | None) -> float:
    """The value before the first one; without settings, that of the built-in columns."""
    if conf is None:
        return 0.0
    if conf.initial is not None:
        return conf.initial
    return 0.0 if conf.reduce == "sum" else np.nan


def _names_by_term(confs: MetricTerms) -> list[list[str]]:
    """The metrics by term: those that differ in their reduction alone share one."""
    shared: dict[str, list[str]] = {}
    for name, conf in confs.items():
        shared.setdefault(conf.model_dump_json(exclude={"reduce", "initial"}), []).append(name)
    return list(shared.values())
