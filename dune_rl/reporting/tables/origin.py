"""Tables of what was compared: the cases, and where each evaluation and each training run comes from."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dune_rl.config.saved import robot_names
from dune_rl.metrics.number_text import NOTHING, format_range
from dune_rl.reporting.comparisons.comparison import Comparison
from dune_rl.reporting.csv_rows import is_number
from dune_rl.reporting.origins import installed_checksum
from dune_rl.reporting.runs import EvaluationRun, Row
from dune_rl.reporting.tables.table import Cell, Table
from dune_rl.reporting.training_groups import TrainingGroup

_SHOWN = 12


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
    return _text_table(
        "cases",
        "Cases",
        "Methods on the same cases met the same episodes. VORT above: the tilt from which ground counts as "
        "uneven; the paper states none. Goals: straight distance from start to goal.",
        data,
        list(dict.fromkeys(file for one in comparisons for file in one.files)),
    )


def _text_table(
    name: str, title: str, caption: str, data: Sequence[Mapping[str, object]], sources: Sequence[Path]
) -> Table:
    """A table of words; columns in which no row has any are left out."""
    # Long lists have their place in the CSV alone.
    shown = [
        key for key in data[0] if key != "methods" and any(row[key] not in ("", NOTHING) for row in data)
    ]
    rows = [[Cell(str(row[key])) for key in shown] for row in data]
    return Table(name, title, caption, shown, rows, data, sources, heads=len(shown))


def evaluations_table(evaluations: Sequence[EvaluationRun]) -> Table:
    """Where each evaluation comes from: date, commit, versions, weights, machine, command."""
    data = [_origin(run) for run in evaluations]
    return _text_table(
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
        frames = [max(float(row["frames"]) for row in run.history) for run in group.runs]
        data.append(
            {
                "training": group.name,
                "world": str(world.get("name", NOTHING)),
                "site": _trained_sites(world, randomisation),
                "seeds": ", ".join(group.seeds),
                "algorithm": str(learning.get("name", NOTHING)),
                "frames": format_range([round(one) for one in frames]),
                "of": f"{total:,}" if isinstance(total, int) else NOTHING,
            }
        )
    return _text_table(
        "training_runs",
        "Training runs",
        "Runs that differ only in their seed are together.",
        data,
        [run.path / "config.yaml" for group in groups for run in group.runs if run.config],
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
