"""Cross-play: every robot's policy among every population of actors, in one folder.

Each population has a results folder of its own in it, as of any evaluation, so that an
interrupted cross-play can be resumed, and all robots have the same episodes among all populations.
"""

import csv
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from dune_rl.config.checks import validate
from dune_rl.config.commands import EvaluateConf, Processes
from dune_rl.config.shorthands import replace_actors
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.core.files import sha256_of, write_atomically, write_csv
from dune_rl.evaluation.actor_populations import CHECKPOINT, ActorPopulation
from dune_rl.evaluation.cross_play_figure import cells_of, describe_cell, draw_matrices, row_title
from dune_rl.evaluation.folder import (
    SUMMARY,
    ResultsFolder,
    check_free_for_results,
    read_provenance,
    read_settings,
)
from dune_rl.evaluation.provenance import check_same_sources, describe_provenance
from dune_rl.evaluation.run_plan import prepare_run, run_plan
from dune_rl.evaluation.running import EvaluationPlan

RECORD, MATRIX, PICTURE = "cross_play.json", "cross_play.csv", "cross_play.png"
MEASURES = ("SR", "TC", "OC")
_ESTIMATE = ("measure", "value", "low", "high", "count", "units")


def settings_among(conf: EvaluateConf, population: ActorPopulation, out: Path) -> EvaluateConf:
    """The settings of the evaluation of the robots of `conf` among `population`, with results in `out`.

    The population takes the place of all actors; raises ConfigError where it has a group of the robots' name.
    """
    data = {**conf.model_dump(mode="json"), "cross_play": False, "populations": [], "out": str(out)}
    taken = sorted((conf.agents.keys() - conf.actors.keys()) & population.groups.keys())
    if taken:
        raise ConfigError(
            f"populations: {population.location} has a group {taken[0]}, as the robots are called: give "
            "the robots' group in agents another name"
        )
    data["agents"] = replace_actors(data["agents"], population.groups)
    return validate(EvaluateConf, data)


def begin_cross_play(
    conf: EvaluateConf, populations: Sequence[ActorPopulation], out: Path, *, overwrite: bool
) -> None:
    """Make the folders of a cross-play and of its populations, with nothing evaluated yet.

    Raises ConfigError, and makes nothing, if the robots cannot be tested among one of them.
    """
    settings = [settings_among(conf, one, out / one.name) for one in populations]
    plans = [EvaluationPlan.of_settings(each) for each in settings]
    if out.is_dir():
        names = {RECORD, MATRIX, PICTURE, *(one.name for one in populations)}
        others = sorted(each.name for each in out.iterdir() if each.name not in names)
        if others:
            what = "a cross-play among others" if (out / RECORD).exists() else "other files"
            raise ConfigError(f"out={out} holds {what} ({others[0]}); remove it, or choose another folder")
    for one in populations:
        check_free_for_results(out / one.name, overwrite=overwrite)
    faults = []
    for one, plan in zip(populations, plans, strict=True):
        try:
            prepare_run(plan).close()
        except DuneError as error:
            faults.append(f"populations: {one.location}: {error}")
    if faults:
        raise ConfigError("\n".join(faults))
    for one, plan in zip(populations, plans, strict=True):
        provenance = {**describe_provenance(plan), "population": one.plain()}
        with ResultsFolder.create(out / one.name, plan.conf, provenance, overwrite=overwrite):
            pass
    for old in (MATRIX, PICTURE):
        (out / old).unlink(missing_ok=True)
    record = {
        "populations": [one.plain() for one in populations],
        "robots": [source.plain() for source in plans[0].sources],
    }
    with write_atomically(out / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def run_cross_play(
    out: Path, console: Console, processes: Processes | None = None, trusted: Collection[str] = ()
) -> None:
    """Run what the cross-play in `out` lacks, write its matrix as CSV and picture, and show it.

    Of users' functions only the `trusted` ones are run.
    """
    populations = _read_record(out)["populations"]
    for one in populations:
        path = out / one["name"]
        provenance = read_provenance(path)
        if provenance.get("complete"):
            continue
        if one["kind"] == CHECKPOINT and sha256_of(Path(one["weights"])) != one["sha256"]:
            raise ConfigError(
                f"{one['weights']} has other weights than when the cross-play began; run it again"
            )
        plan = EvaluationPlan.of_settings(read_settings(path))
        check_same_sources(plan, provenance, path, trusted)
        console.print(f"Among {one['name']}", highlight=False, markup=False)
        prepared = prepare_run(plan)
        with ResultsFolder.reopen(path) as folder:
            run_plan(plan, folder, prepared, console, processes or plan.conf.processes, resume=out)
    rows = []
    for one in populations:
        with (out / one["name"] / f"{SUMMARY}.csv").open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                if row["measure"] in MEASURES:
                    names = {"robot": row["policy"], "group": row["group"], "population": one["name"]}
                    rows.append(names | {key: row[key] for key in _ESTIMATE})
    write_csv(out / MATRIX, rows)
    if rows:
        draw_matrices(rows, MEASURES, out / PICTURE)
    _show(rows, console)
    console.print(f"Results: {out}", highlight=False, soft_wrap=True)


def is_cross_play(path: Path) -> bool:
    """Whether a folder holds a cross-play."""
    return (path / RECORD).is_file()


def _read_record(path: Path) -> dict[str, Any]:
    try:
        content = json.loads((path / RECORD).read_text(encoding="utf-8"))
        names = [one["name"] for one in content["populations"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise ConfigError(f"{path / RECORD} is missing or damaged; run the cross-play again") from None
    if any(Path(name).name != name or name == ".." for name in names):
        raise ConfigError(f"{path / RECORD} names a folder outside of {path}; run the cross-play again")
    found: dict[str, Any] = content
    return found


def _show(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    populations = list(dict.fromkeys(row["population"] for row in rows))
    for measure in MEASURES:
        cells = cells_of(rows, measure)
        table = Table("robot", title=f"{measure} of robots among populations of actors", title_justify="left")
        for name in populations:
            table.add_column(name, justify="right")
        robots = list(dict.fromkeys((key[0], key[1]) for key in cells))
        for robot in robots:
            found = [cells.get((*robot, name)) for name in populations]
            texts = ["" if one is None else describe_cell(one) for one in found]
            table.add_row(row_title(*robot, robots), *texts)
        if cells:
            console.print(table)
