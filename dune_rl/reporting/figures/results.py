"""What figures of methods are made of: the rows of episodes by cases and method."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.metrics.catalogue import CATALOGUE, Measure
from dune_rl.reporting.runs import EvaluationRun, Row

# Rows of episodes by the title of the cases (a set, or a world and a seed), and in that by method.
Results = Mapping[str, Mapping[str, Sequence[Row]]]
_MEASURES = {measure.metric: measure for measure in CATALOGUE}


@dataclass(frozen=True)
class MethodRun:
    """A method on some cases: the names of both, and its policy, its evaluation and its rows of episodes."""

    cases: str
    name: str
    policy: str
    run: EvaluationRun
    rows: Sequence[Row]


def collect_methods(evaluations: Sequence[EvaluationRun]) -> list[MethodRun]:
    """The methods of evaluations: policies are called after their folder too where a name has other rows."""
    found: dict[tuple[str, str], MethodRun] = {}
    for run in evaluations:
        by_policy: dict[str, list[Row]] = {}
        for row in run.episodes:
            by_policy.setdefault(str(row["policy"]), []).append(row)
        for policy, rows in by_policy.items():
            cases = cases_title(rows[0])
            known = found.get((cases, policy))
            name = policy if known is None or known.rows == rows else f"{policy} ({run.name})"
            found[cases, name] = MethodRun(cases, name, policy, run, rows)
    return list(found.values())


def collect_results(evaluations: Sequence[EvaluationRun]) -> dict[str, dict[str, Sequence[Row]]]:
    """The rows by cases and method, as `collect_methods` calls them."""
    found: dict[str, dict[str, Sequence[Row]]] = {}
    for one in collect_methods(evaluations):
        found.setdefault(one.cases, {})[one.name] = one.rows
    return found


def cases_title(row: Row) -> str:
    """The cases of a row: its set, or its world and seed."""
    if row.get("set"):
        return str(row["set"])
    seed = row.get("seed", math.nan)
    world = str(row.get("world", "unknown world"))
    return f"{world}, seed {seed:.0f}" if isinstance(seed, int | float) and math.isfinite(seed) else world


def method_names(results: Results) -> list[str]:
    """All methods, in the order in which they appear."""
    return list(dict.fromkeys(name for methods in results.values() for name in methods))


def column(rows: Sequence[Row], name: str) -> NDArray[np.float64]:
    """The values of a column, NaN where a row has none."""
    return np.array([_number(row.get(name)) for row in rows], float)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def measure_of(metric: str) -> Measure:
    """The measure of a metric; one of its own name for users' metrics."""
    return _MEASURES.get(metric) or Measure(metric, metric)


def axis_label(metric: str) -> str:
    """What a metric is, with its unit; shares are of 1, not in per cent."""
    measure = measure_of(metric)
    # Of an episode, not of their mean.
    text = (measure.meaning or measure.name.replace("_", " ")).removeprefix("mean ")
    unit = "" if measure.unit == "%" else measure.unit
    return f"{text} [{unit}]" if unit else text


def count_text(results: Results) -> str:
    """How many episodes each method has on each cases, and on how many sites, in words."""
    episodes = sorted({_episodes(rows) for methods in results.values() for rows in methods.values()})
    sites = sorted({_sites(rows) for methods in results.values() for rows in methods.values()})
    text = f"{_range(episodes)} episode" + ("" if episodes == [1] else "s")
    return text if sites in ([], [0]) else f"{text} on {_range(sites)} site" + ("" if sites == [1] else "s")


def _episodes(rows: Sequence[Row]) -> int:
    return len({row.get("episode") for row in rows})


def _sites(rows: Sequence[Row]) -> int:
    seeds = column(rows, "world_seed")
    return len(np.unique(seeds[~np.isnan(seeds)])) or 1


def _range(numbers: Sequence[int]) -> str:
    if not numbers:
        return "no"
    return f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
