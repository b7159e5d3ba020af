"""Methods on the same cases: their episodes, their estimates and how they differ in pairs."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import closest
from dune_rl.evaluation.columns import measured_columns
from dune_rl.metrics.catalogue import Measure, measure_of, measures_of
from dune_rl.reporting.inputs import EvaluationRun
from dune_rl.reporting.rows import Row, is_number
from dune_rl.statistics.intervals import Estimate, as_shares
from dune_rl.statistics.measures import CASE_COLUMNS, cluster_rows, estimate_metrics, mean_of_known
from dune_rl.statistics.paired_comparison import PairedComparison, compare_policies, have_same_cases


@dataclass(frozen=True)
class Cases:
    """The episodes that methods are measured on; `key` is equal where they are the same."""

    key: str
    title: str
    world: str
    set_name: str
    checksum: str
    engine: str
    seed: int | None


@dataclass(eq=False)
class EvaluatedPolicy:
    """A policy on the cases of the title `cases`: its episodes, and the evaluations that they come from.

    `key` is that of the cases.
    """

    name: str
    policy: str
    rows: list[Row]
    runs: list[EvaluationRun] = field(default_factory=list)
    cases: str = ""
    key: str = ""

    @property
    def run(self) -> EvaluationRun:
        """The first evaluation with recorded steps; the first one if none has steps."""
        return next((run for run in self.runs if run.steps), self.runs[0])

    @property
    def episodes(self) -> int:
        """Number of its episodes."""
        return len({row["episode"] for row in self.rows})

    @property
    def agents(self) -> int:
        """Number of its agents in an episode."""
        return len({row["agent"] for row in self.rows})


@dataclass
class Comparison:
    """Methods on the same cases, and what a reader must know of them.

    `numbered`, which is among the notes, says why the title of the cases has a number: others have the same.
    """

    cases: Cases
    methods: list[EvaluatedPolicy]
    notes: list[str] = field(default_factory=list)
    numbered: str = ""

    @cached_property
    def estimates(self) -> dict[str, dict[str, Estimate]]:
        """Each measure with its interval, by method."""
        return {method.name: estimate_rows(method.rows) for method in self.methods}

    @cached_property
    def pairs(self) -> list[PairedComparison]:
        """All pairs of methods on the episodes that all of them have; empty where there are none."""
        return compare_methods({method.name: method for method in self.methods})

    @property
    def sites(self) -> int:
        """Number of sites, if episodes share them, so that intervals are over whole sites; else 0."""
        clusters, kind = cluster_rows(self.methods[0].rows)
        return int(clusters.max()) + 1 if clusters is not None and kind == "sites" else 0

    def common_episodes(self) -> set[tuple[float, str]]:
        """The (episode, agent) that all methods have."""
        return _common_episodes(self.methods)

    @property
    def files(self) -> list[Path]:
        """The tables that its figures come from."""
        return list(dict.fromkeys(run.path / "episodes.csv" for one in self.methods for run in one.runs))

    @property
    def thresholds(self) -> list[float]:
        """The tilts above which ground counts as uneven for VORT [°]: one, unless the evaluations differ."""
        found = {_uneven_tilt(run.config) for method in self.methods for run in method.runs}
        return sorted(value for value in found if value is not None)


def files_of(comparisons: Iterable[Comparison]) -> list[Path]:
    """The tables that the figures of comparisons come from."""
    return list(dict.fromkeys(file for one in comparisons for file in one.files))


def compare_methods(
    methods: Mapping[str, EvaluatedPolicy], only: Measure | None = None
) -> list[PairedComparison]:
    """All pairs of methods, by their names, on the episodes that all of them have; empty without any.

    With `only`, that measure alone is compared. Raises ValueError if their cases differ.
    """
    common = _common_episodes(methods.values())
    if len(methods) < 2 or not common:
        return []
    results = {
        name: [row for row in method.rows if (row["episode"], row["agent"]) in common]
        for name, method in methods.items()
    }
    shared = set.intersection(*(measured_names(rows) for rows in results.values()))
    if only is not None:
        shared &= {only.metric, only.per}
    found = compare_policies({name: select_metrics(rows, shared) for name, rows in results.items()})
    return [pair for pair in found if only is None or pair.measure.name == only.name]


def average_methods(methods: Sequence[EvaluatedPolicy]) -> EvaluatedPolicy:
    """A method each of whose episodes has the mean metrics of several methods, such as seeds of training.

    A metric that some have no value of in an episode is the mean over the others. Raises ValueError if their
    cases differ.
    """
    first, *others = methods
    if any(one.key != first.key or not have_same_cases(first.rows, one.rows) for one in others):
        raise ValueError("they ran different episodes, so that they have no mean")
    names = sorted(set.union(*(measured_names(method.rows) for method in methods)))
    shares = {measure.metric for measure in measures_of(names) if measure.is_share}
    rows = [dict(row) for row in first.rows]
    for name in names:
        values = [[float(row.get(name, math.nan)) for row in method.rows] for method in methods]
        known = as_shares(values) if name in shares else values
        for row, together in zip(rows, zip(*known, strict=True), strict=True):
            row[name] = mean_of_known(together)
    runs = [run for method in methods for run in method.runs]
    return EvaluatedPolicy(first.name, first.policy, rows, runs, first.cases, first.key)


def _common_episodes(methods: Iterable[EvaluatedPolicy]) -> set[tuple[float, str]]:
    return set.intersection(*({(row["episode"], row["agent"]) for row in method.rows} for method in methods))


def _uneven_tilt(config: Mapping[str, Any]) -> float | None:
    metrics = config.get("metrics")
    terms = metrics.get("terms") if isinstance(metrics, dict) else None
    vort = terms.get("vort") if isinstance(terms, dict) else None
    tilt = vort.get("uneven_tilt_deg") if isinstance(vort, dict) else None
    if isinstance(tilt, int | float):
        return float(tilt)
    # Settings of the first studies.
    old = metrics.get("uneven_tilt_rad") if isinstance(metrics, dict) else None
    return round(math.degrees(float(old)), 6) if isinstance(old, int | float) else None


def estimate_rows(rows: Sequence[Row]) -> dict[str, Estimate]:
    """Each measure over the rows of a method with its 95 % interval; those without any value are left out."""
    return estimate_metrics(select_metrics(rows, measured_names(rows)))


def estimate_of(name: str, method: str, rows: Sequence[Row], estimates: Mapping[str, Estimate]) -> Estimate:
    """The estimate of a measure among those of the rows of a `method`; all NaN where no row has a value.

    Raises ConfigError where the rows have no such measure.
    """
    if name in estimates:
        return estimates[name]
    measure = measure_of(name)
    if measure.metric in rows[0] and measure.per in (None, *rows[0]):
        return Estimate(math.nan, math.nan, math.nan, 0)
    near = closest(name, estimates)
    raise ConfigError(f"{method} has no measure {name}" + (f"; did you mean {near}?" if near else ""))


def measured_names(rows: Sequence[Row]) -> set[str]:
    """Metrics that at least one of the rows has a value of."""
    return {name for name in measured_columns([*rows[0]]) if any(is_number(row.get(name)) for row in rows)}


def select_metrics(rows: Sequence[Row], metrics: Collection[str]) -> list[Row]:
    """The rows with these metrics alone, and the columns that tell their cases."""
    kept = {*metrics, *CASE_COLUMNS, "episode", "agent"}
    return [{name: value for name, value in row.items() if name in kept} for row in rows]
