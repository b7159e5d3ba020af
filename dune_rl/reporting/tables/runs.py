"""Tables of what was compared, where it comes from, and what training runs and sweeps came to."""

import math
import shlex
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.config.saved import robot_names
from dune_rl.metrics.catalogue import CATALOGUE, NOTHING, format_range, format_value, measure_of
from dune_rl.reporting.comparison import Comparison, files_of
from dune_rl.reporting.inputs import EvaluationRun, Sweep, TrainingGroup, last_evaluation
from dune_rl.reporting.reading import installed_checksum
from dune_rl.reporting.rows import Row, is_number
from dune_rl.reporting.tables.methods import PAPER_MEASURES
from dune_rl.reporting.tables.table import Cell, Table, measure_title, text_table

_SHOWN = 12
_RETURN = "return"


def cases_table(comparisons: Sequence[Comparison]) -> Table:
    """What each set of cases is: episode set and checksum, sites, episodes, engine, thresholds."""
    data: list[Mapping[str, object]] = []
    for one in comparisons:
        rows = [row for method in one.methods for row in method.rows]
        cases = one.cases
        data.append(
            {
                "cases": cases.title,
                "world": cases.world,
                "sites": describe_sites(one, rows),
                "set's checksum": _checksum(one),
                "episodes": format_range([method.episodes for method in one.methods]),
                "seed": NOTHING if cases.seed is None else str(cases.seed),
                "engine": cases.engine or NOTHING,
                "robot": ", ".join(_robots(one)),
                "goals [m]": _distances(rows),
                "VORT above": " or ".join(f"{tilt:g}°" for tilt in one.thresholds) or NOTHING,
                "methods": ", ".join(method.name for method in one.methods),
            }
        )
    return text_table(
        "cases",
        "Cases",
        "Methods on the same cases met the same episodes. VORT above: the tilt from which ground counts as "
        "uneven; the paper states none. Goals: straight distance from start to goal.",
        data,
        files_of(comparisons),
    )


def evaluations_table(evaluations: Sequence[EvaluationRun]) -> Table:
    """Where each evaluation comes from: date, commit, versions, weights, machine, command."""
    data = [_origin(run) for run in evaluations]
    return text_table(
        "evaluations",
        "Evaluations",
        "A study that was published without provenance has dashes. Weights: the beginning of their SHA-256.",
        data,
        [run.path / "provenance.json" for run in evaluations if run.provenance],
    )


def _origin(run: EvaluationRun) -> dict[str, str]:
    told = run.provenance
    git, packages, hardware = (told.get(name, {}) for name in ("git", "packages", "hardware"))
    commit = str(git.get("commit", ""))[:_SHOWN]
    weights = [
        f"{each.get('name')} {each['sha256'][:_SHOWN]}"
        for each in told.get("policies", ())
        if each.get("sha256")
    ]
    return {
        "evaluation": run.name,
        "made": str(told.get("created", NOTHING)),
        "commit": (f"{commit}{' with changes' if git.get('changed') else ''}") or NOTHING,
        "dune_rl": str(packages.get("dune_rl", NOTHING)),
        "weights": ", ".join(weights) or NOTHING,
        "processor": str(hardware.get("processor", NOTHING)),
        "command": shlex.join(told.get("command", ())) or NOTHING,
    }


def training_origin_table(groups: Sequence[TrainingGroup]) -> Table:
    """What each group of training runs was trained on, and for how long."""
    data = []
    for group in groups:
        config = group.runs[0].config
        world, learning = _mapping(config.get("world")), _mapping(config.get("learning"))
        randomisation = _mapping(config.get("randomisation"))
        total = config.get("total_frames")
        data.append(
            {
                "training": group.name,
                "world": str(world.get("name", NOTHING)),
                "site": _trained_sites(world, randomisation),
                "seeds": ", ".join(group.seeds),
                "algorithm": str(learning.get("name", NOTHING)),
                "frames": format_range([round(run.frames) for run in group.runs]),
                "of": f"{total:,}" if isinstance(total, int) else NOTHING,
            }
        )
    return text_table(
        "training_runs",
        "Training runs",
        "Runs that differ only in their seed are together.",
        data,
        [run.path / "config.yaml" for group in groups for run in group.runs if run.config],
    )


def training_table(groups: Sequence[TrainingGroup]) -> Table:
    """What each run came to in its last evaluation, and the mean over the seeds of a group."""
    finals = [
        (group, run, agents, last_evaluation(run.history, agents))
        for group in groups
        for run in group.runs
        for agents in run.agent_groups
    ]
    shown = [name for name in PAPER_MEASURES if any(is_number(row.get(name)) for *_, row in finals)]
    shown.append(_RETURN)
    rows: list[list[Cell]] = []
    data: list[Mapping[str, object]] = []
    for group in groups:
        by_agents: dict[str, list[Row]] = {}
        for _, run, agents, row in (final for final in finals if final[0] is group):
            by_agents.setdefault(agents, []).append(row)
            seed, episodes = run.config.get("seed", NOTHING), row.get("episodes", math.nan)
            told = NOTHING if math.isnan(episodes) else f"{episodes:.0f}"
            words = (_with(run.name, agents), str(seed), f"{run.frames:,.0f}", told)
            rows.append([*map(Cell, words), *(_value(name, row.get(name)) for name in shown)])
            about = {"group": group.name, "run": run.name, "agents": agents}
            about |= {"seed": run.config.get("seed", ""), "frames": row.get("frames", math.nan)}
            values = {name: row.get(name, math.nan) for name in shown}
            data.append({**about, "episodes": episodes, **values})
        if len(group.runs) > 1:
            for agents, found in by_agents.items():
                title = Cell(f"mean of {_with(group.name, agents)}")
                rows.append([title, *[Cell("")] * 3, *(_mean(name, found) for name in shown)])
    titles = [_RETURN if name == _RETURN else measure_title(measure_of(name)) for name in shown]
    return Table(
        "training",
        "The last evaluation of each training run",
        "On unseen episodes, whose number is given. Means over seeds: with the least and the largest.",
        ["run", "seed", "frames", "episodes", *titles],
        rows,
        data,
        [run.path / "metrics.csv" for group in groups for run in group.runs],
    )


def _with(name: str, agents: str) -> str:
    return f"{name}, {agents}" if agents else name


def _mean(name: str, rows: Sequence[Row]) -> Cell:
    values = [float(row[name]) for row in rows if is_number(row.get(name))]
    cell = _value(name, statistics.fmean(values) if values else None)
    if len(values) < 2:
        return cell
    return Cell(cell.text, f"{_value(name, min(values)).text} to {_value(name, max(values)).text}")


def _value(name: str, value: object) -> Cell:
    if not isinstance(value, int | float) or math.isnan(value):
        return Cell(NOTHING)
    return Cell(f"{value:.1f}" if name == _RETURN else format_value(measure_of(name), float(value)))


def sweep_table(name: str, sweep: Sweep) -> Table:
    """The parameters of each job and what it came to; the best job is marked."""
    parameters = list(dict.fromkeys(each for job in sweep.jobs for each in job.parameters))
    measure = next((one for one in CATALOGUE if sweep.metric in (one.metric, one.name)), None)
    known = [job.objective for job in sweep.jobs if not math.isnan(job.objective)]
    best_value = next((job.objective for job in sweep.jobs if job.name == sweep.best), math.nan)
    rows, data = [], []
    for job in sweep.jobs:
        if math.isnan(job.objective):
            text, best = NOTHING, not known and job.name == sweep.best
        else:
            text = f"{job.objective:.3g}" if measure is None else format_value(measure, job.objective)
            # Where all jobs are equal, none is the best.
            best = len(set(known)) > 1 and job.objective == best_value
        words = (job.name, *(job.parameters.get(each, "") for each in parameters))
        # Not by its colour alone.
        rows.append([*map(Cell, words), Cell(f"{text} (best)" if best else text, best=best)])
        result = {"objective": job.objective, "best": int(job.name == sweep.best)}
        data.append({"sweep": sweep.name, "job": job.name, **job.parameters, **result})
    title = sweep.metric if measure is None else measure_title(measure)
    caption = (
        f"Objective: {title} in the last evaluation of each job; "
        f"{'more' if sweep.maximise else 'less'} is better. The best of many jobs looks better than it is: "
        "evaluate it on episodes that it was not chosen by."
    )
    if len(known) < len(sweep.jobs):
        caption += f" {len(sweep.jobs) - len(known)} of {len(sweep.jobs)} jobs have no figure."
    return Table(
        name,
        f"{sweep.name}: {len(sweep.jobs)} jobs",
        caption,
        ["job", *parameters, title],
        rows,
        data,
        [job.path / file for job in sweep.jobs for file in (".hydra/overrides.yaml", "metrics.csv")],
        heads=1 + len(parameters),
    )


def describe_sites(comparison: Comparison, rows: Sequence[Row]) -> str:
    """How many sites the episodes are on, and of which seeds."""
    seeds = sorted({int(row["world_seed"]) for row in rows if is_number(row.get("world_seed"))})
    if not seeds:
        found = {
            _mapping(run.config.get("world")).get("seed")
            for method in comparison.methods
            for run in method.runs
        }
        seeds = sorted(seed for seed in found if isinstance(seed, int))
    if not seeds:
        return "one"
    if len(seeds) == 1:
        return f"one (seed {seeds[0]})"
    return f"{len(seeds)} (seeds {seeds[0]} to {seeds[-1]})"


def _trained_sites(world: Mapping[str, Any], randomisation: Mapping[str, Any]) -> str:
    drawn = _mapping(randomisation.get("world_seed"))
    if drawn:
        return f"drawn, world seeds {drawn.get('low', '?')} to {drawn.get('high', '?')}"
    return f"world seed {world['seed']}" if "seed" in world else "one"


def _checksum(comparison: Comparison) -> str:
    cases = comparison.cases
    if not cases.checksum:
        return NOTHING
    installed = installed_checksum(cases.set_name)
    state = (
        "not installed" if installed is None else "as installed" if installed == cases.checksum else "ANOTHER"
    )
    return f"{cases.checksum[:_SHOWN]} ({state})"


def _robots(comparison: Comparison) -> list[str]:
    runs = [run for method in comparison.methods for run in method.runs]
    return sorted({", ".join(robot_names(run.config)) or NOTHING for run in runs})


def _distances(rows: Sequence[Row]) -> str:
    names = ("start_x_m", "start_y_m", "goal_x_m", "goal_y_m")
    distances = [
        ((row["goal_x_m"] - row["start_x_m"]) ** 2 + (row["goal_y_m"] - row["start_y_m"]) ** 2) ** 0.5
        for row in rows
        if all(is_number(row.get(name)) for name in names)
    ]
    return f"{min(distances):.1f} to {max(distances):.1f}" if distances else NOTHING


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
