"""Sorts evaluations into comparisons: methods that met the same episodes, whatever folders they are in."""

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

from dune_rl.config.schema import BuiltInPolicy
from dune_rl.episode_sets import read_episode_set
from dune_rl.evaluation.columns import measured_columns
from dune_rl.learning.measures import CASE_COLUMNS, MetricsRow, cluster_rows, estimate_metrics
from dune_rl.learning.paired_comparison import PairedComparison, compare_policies
from dune_rl.learning.statistics import Estimate
from dune_rl.metrics.catalogue import CATALOGUE, Measure, measures_of
from dune_rl.reporting.csv_rows import is_number
from dune_rl.reporting.origins import installed_checksum
from dune_rl.reporting.runs import EvaluationRun, Row

# What decides how an episode runs, apart from the policy: it must be equal for results to pair.
_DECISIVE = ("world", "weather", "agents", "robots", "actors", "randomisation", "protocol", "run_steps")
_DECISIVE_IN_TASK = ("spawn", "terminations")
_BY_NAME = {measure.name: measure for measure in CATALOGUE}


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
    group: str


@dataclass
class Method:
    """A policy on some cases: its episodes, and the evaluations that they come from."""

    name: str
    policy: str
    rows: list[Row]
    runs: list[EvaluationRun] = field(default_factory=list)

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
    """Methods on the same cases, and what a reader must know of them."""

    cases: Cases
    methods: list[Method]
    notes: list[str] = field(default_factory=list)

    def estimates(self) -> dict[str, dict[str, Estimate]]:
        """Each measure with its interval, by method."""
        return {method.name: estimate_rows(method.rows) for method in self.methods}

    def paired(self) -> list[PairedComparison]:
        """All pairs of methods on the episodes that all of them have; empty where there are none."""
        common = self.common_episodes()
        if len(self.methods) < 2 or not common:
            return []
        results = {method.name: _rows_of(method, common) for method in self.methods}
        shared = set.intersection(*(_measured_names(rows) for rows in results.values()))
        kept = {*shared, *CASE_COLUMNS, "episode", "agent"}
        return compare_policies(
            {
                name: [{key: value for key, value in row.items() if key in kept} for row in rows]
                for name, rows in results.items()
            }
        )

    @property
    def sites(self) -> int:
        """Number of sites, if episodes share them, so that intervals are over whole sites; else 0."""
        clusters, kind = cluster_rows(self.methods[0].rows)
        return int(clusters.max()) + 1 if clusters is not None and kind == "sites" else 0

    def common_episodes(self) -> set[tuple[float, str]]:
        """The (episode, agent) that all methods have."""
        return set.intersection(
            *({(row["episode"], row["agent"]) for row in method.rows} for method in self.methods)
        )

    @property
    def files(self) -> list[Path]:
        """The tables that its figures come from."""
        return list(dict.fromkeys(run.path / "episodes.csv" for one in self.methods for run in one.runs))

    @property
    def thresholds(self) -> list[float]:
        """The tilts above which ground counts as uneven for VORT [°]: one, unless the evaluations differ."""
        found = {_uneven_tilt(run.config) for method in self.methods for run in method.runs}
        return sorted(value for value in found if value is not None)


def collect_comparisons(evaluations: Sequence[EvaluationRun]) -> list[Comparison]:
    """The comparisons that evaluations give, by cases; each group of agents has its own.

    A policy of one name in several folders is one method where its rows are the same, and else each
    is called after its folder too.
    """
    comparisons: dict[str, Comparison] = {}
    for run in evaluations:
        for group, rows in _by_group(run.episodes).items():
            cases = cases_of(run, group)
            comparison = comparisons.setdefault(cases.key, Comparison(cases, []))
            for policy in dict.fromkeys(str(row["policy"]) for row in rows):
                mine = [row for row in rows if str(row["policy"]) == policy]
                _add_method(comparison, policy, mine, run)
    for comparison in comparisons.values():
        _name_apart(comparison.methods)
        comparison.notes += _oddities(comparison)
    _tell_apart([one.cases.title for one in comparisons.values()], list(comparisons.values()))
    return list(comparisons.values())


def cases_of(run: EvaluationRun, group: str) -> Cases:
    """The cases of a group of agents in an evaluation whose episodes are all of one set, world and seed."""
    first = run.episodes[0]
    groups = len(_by_group(run.episodes))
    name, world, engine = (str(first.get(key, "")) for key in ("set", "world", "engine"))
    seed = int(first["seed"]) if is_number(first.get("seed")) else None
    used = run.provenance.get("set")
    checksum = str(used.get("sha256", "")) if isinstance(used, dict) else ""
    if name:
        decisive: Any = [name, checksum]
        title = name
    else:
        decisive = [world, seed, _decisive_settings(run.config)]
        title = world if seed is None else f"{world}, seed {seed}"
    text = json.dumps([decisive, engine, group], sort_keys=True, default=str)
    key = hashlib.sha256(text.encode()).hexdigest()
    protocol = run.config.get("protocol")
    title += "" if protocol is None else f", protocol={protocol}"
    title += f" ({engine})" if engine not in ("", "bullet") else ""
    title += f", {group}" if groups > 1 else ""
    return Cases(key, title, world, name, checksum, engine, seed, group)


def _decisive_settings(config: Mapping[str, Any]) -> dict[str, Any]:
    task = config.get("task")
    parts = {name: config.get(name) for name in _DECISIVE}
    if isinstance(task, dict):
        parts |= {f"task.{name}": task.get(name) for name in _DECISIVE_IN_TASK}
    return parts


def _by_group(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by the group of their agents, which are called GROUP_NUMBER."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(re.sub(r"_\d+$", "", str(row["agent"])), []).append(row)
    return found


def _add_method(comparison: Comparison, policy: str, rows: list[Row], run: EvaluationRun) -> None:
    for known in comparison.methods:
        if known.policy == policy and _same_rows(known.rows, rows):
            known.runs.append(run)
            return
    ordered = sorted(rows, key=lambda row: (row["episode"], str(row["agent"])))
    comparison.methods.append(Method(policy, policy, ordered, [run]))


def _same_rows(first: Sequence[Row], second: Sequence[Row]) -> bool:
    ids = ("episode", "agent")
    a, b = ({tuple(row[key] for key in ids): row for row in rows} for rows in (first, second))
    return a.keys() == b.keys() and all(_same_row(row, b[key]) for key, row in a.items())


def _same_row(first: Row, second: Row) -> bool:
    return all(
        first[name] == second[name] or (first[name] != first[name] and second[name] != second[name])
        for name in first.keys() & second.keys()
    )


def _name_apart(methods: list[Method]) -> None:
    for policy in {method.policy for method in methods}:
        same = [method for method in methods if method.policy == policy]
        if len(same) > 1:
            for method in same:
                folder = method.runs[0].name
                method.name = folder if policy in ("trained", Path(folder).name) else f"{policy} ({folder})"


def _tell_apart(titles: Sequence[str], comparisons: Sequence[Comparison]) -> None:
    """Number the comparisons of equal titles, and say that they differ."""
    for title in {title for title in titles if titles.count(title) > 1}:
        same = [one for one in comparisons if one.cases.title == title]
        for number, one in enumerate(same, 1):
            one.cases = replace(one.cases, title=f"{title} (cases {number})")
            what = "checksums of the set" if one.cases.set_name else "settings of the episodes"
            one.notes.append(f"There are {len(same)} kinds of cases called {title}: their {what} differ.")


def _oddities(comparison: Comparison) -> list[str]:
    notes = []
    if len(comparison.thresholds) > 1:
        values = ", ".join(f"{value:g}°" for value in comparison.thresholds)
        notes.append(f"VORT was measured with different thresholds ({values}) and does not compare.")
    counts = {method.name: len(method.rows) for method in comparison.methods}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        notes.append(
            f"The methods have different numbers of episodes ({told}); pairs are compared on the "
            f"{len(comparison.common_episodes())} that all have."
        )
    elif len(comparison.methods) > 1 and len(comparison.common_episodes()) < max(counts.values()):
        notes.append("The methods have different episodes; pairs are compared on those that all have.")
    for method in comparison.methods:
        if method.episodes == 1:
            notes.append(f"{method.name} has one episode, which has no interval.")
    total = _episodes_of_set(comparison.cases)
    short = {f"{method.name} {method.episodes}" for method in comparison.methods if method.episodes < total}
    if short:
        notes.append(f"The set has {total} episodes, of which there are: {', '.join(sorted(short))}.")
    for method in comparison.methods:
        if sites := _sites_of_training(method):
            notes.append(f"{method.name} was trained on {sites} of these sites: these are not unseen ones.")
    trained = [method.name for method in comparison.methods if _is_at_home(comparison.cases, method)]
    if trained:
        notes.append(
            f"{', '.join(trained)}: measured on the site that it was trained on; on others it may do worse."
        )
    robots = {
        str((run.config.get("robot") or {}).get("name")) for one in comparison.methods for run in one.runs
    }
    if len(robots) > 1:
        notes.append(f"The robots differ: {', '.join(sorted(robots))}.")
    return notes


def _episodes_of_set(cases: Cases) -> int:
    """How many episodes the set has; 0 where it is not installed, or has changed."""
    if not cases.set_name or installed_checksum(cases.set_name) != cases.checksum:
        return 0
    return read_episode_set(cases.set_name).header.episodes


def _sites_of_training(method: Method) -> int:
    """On how many of the set's sites the policy was trained, as its evaluation notes."""
    for run in method.runs:
        policies = run.provenance.get("policies")
        for each in policies if isinstance(policies, list) else []:
            if isinstance(each, dict) and each.get("name") == method.policy:
                return len(each.get("sites_of_training") or ())
    return 0


def _is_at_home(cases: Cases, method: Method) -> bool:
    """Whether a policy was measured on the one site of its training, as far as its folder tells."""
    if cases.set_name or method.policy in get_args(BuiltInPolicy):
        return False
    for run in method.runs:
        world, drawn = run.config.get("world"), run.config.get("randomisation")
        # Beside a training, the settings are those of the training.
        has_site = isinstance(world, dict) and world.get("seed") is not None and "total_frames" in run.config
        if has_site and not (isinstance(drawn, dict) and drawn.get("world_seed")):
            return True
    return False


def estimate_rows(rows: Sequence[Row]) -> dict[str, Estimate]:
    """Each measure over the rows of a method with its 95 % interval; those without any value are left out."""
    names = _measured_names(rows)
    found: dict[str, Estimate] = {}
    for measure in measures_of([name for name in _columns(rows) if name in names]):
        used = [measure.metric, *([measure.per] if measure.per else [])]
        numeric = _numeric(rows, used)
        if measure.is_share:
            numeric = [row for row in numeric if not math.isnan(row[measure.metric])]
        found |= {
            name: estimate for name, estimate in estimate_metrics(numeric).items() if name == measure.name
        }
    return found


def measure_of(name: str) -> Measure:
    """The measure of a name; users' own have none but the name."""
    return _BY_NAME.get(name, Measure(name, name))


def _columns(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _measured_names(rows: Sequence[Row]) -> set[str]:
    """Metrics that at least one of the rows has a value of."""
    return {
        name for name in measured_columns(_columns(rows)) if any(is_number(row.get(name)) for row in rows)
    }


def _numeric(rows: Sequence[Row], names: Sequence[str]) -> list[MetricsRow]:
    """The metrics `names` of rows, their ids as numbers and their sites; NaN where a row has no value."""
    agents = {agent: float(number) for number, agent in enumerate(sorted({row["agent"] for row in rows}))}
    return [
        {
            "episode": row["episode"],
            "agent": agents[row["agent"]],
            **{name: row[name] for name in CASE_COLUMNS if name in row},
            **{name: row[name] if is_number(row.get(name)) else math.nan for name in names},
        }
        for row in rows
    ]


def _rows_of(method: Method, ids: set[tuple[float, str]]) -> list[MetricsRow]:
    rows = [row for row in method.rows if (row["episode"], row["agent"]) in ids]
    return _numeric(rows, sorted(_measured_names(rows), key=_columns(rows).index))


def _uneven_tilt(config: Mapping[str, Any]) -> float | None:
    metrics = config.get("metrics")
    if not isinstance(metrics, dict):
        return None
    terms = metrics.get("terms")
    vort = terms.get("vort") if isinstance(terms, dict) else None
    if isinstance(vort, dict) and is_number(vort.get("uneven_tilt_deg")):
        return float(vort["uneven_tilt_deg"])
    # Settings of earlier versions.
    old = metrics.get("uneven_tilt_rad")
    return round(math.degrees(float(old)), 6) if isinstance(old, int | float) else None
