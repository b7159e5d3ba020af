"""Tables of training runs and of sweeps."""

import math
import statistics
from collections.abc import Mapping, Sequence

from dune_rl.metrics.catalogue import CATALOGUE, measure_of
from dune_rl.metrics.number_text import NOTHING, format_value
from dune_rl.reporting.csv_rows import is_number
from dune_rl.reporting.runs import Row, Sweep, TrainingRun, last_evaluation
from dune_rl.reporting.tables.methods import PAPER_MEASURES
from dune_rl.reporting.tables.table import Cell, Table, measure_title
from dune_rl.reporting.training_groups import TrainingGroup, agent_groups

_RETURN = "return"


def training_table(groups: Sequence[TrainingGroup]) -> Table:
    """What each run came to in its last evaluation, and the mean over the seeds of a group."""
    finals = [
        (group, run, agents, last_evaluation(run.history, agents))
        for group in groups
        for run in group.runs
        for agents in agent_groups(run)
    ]
    shown = [name for name in PAPER_MEASURES if any(is_number(row.get(name)) for *_, row in finals)]
    rows: list[list[Cell]] = []
    for group in groups:
        mine = [(run, agents, row) for each, run, agents, row in finals if each is group]
        rows += [_run_row(run, agents, row, shown) for run, agents, row in mine]
        if len(group.runs) > 1:
            rows += [
                _mean_row(group, agents, [row for _, each, row in mine if each == agents], shown)
                for agents in dict.fromkeys(agents for _, agents, _ in mine)
            ]
    data: list[Mapping[str, object]] = [
        {
            "group": group.name,
            "run": run.name,
            "agents": agents,
            "seed": run.config.get("seed", ""),
            "frames": row.get("frames", math.nan),
            "episodes": row.get("episodes", math.nan),
            **{name: row.get(name, math.nan) for name in (*shown, _RETURN)},
        }
        for group, run, agents, row in finals
    ]
    return Table(
        "training",
        "The last evaluation of each training run",
        "On unseen episodes, whose number is given. Means over seeds: with the least and the largest.",
        ["run", "seed", "frames", "episodes", *(measure_title(measure_of(name)) for name in shown), _RETURN],
        rows,
        data,
        [run.path / "metrics.csv" for group in groups for run in group.runs],
    )


def _run_row(run: TrainingRun, agents: str, row: Row, shown: Sequence[str]) -> list[Cell]:
    name = f"{run.name}, {agents}" if agents else run.name
    frames = max(float(each["frames"]) for each in run.history)
    return [
        Cell(name),
        Cell(str(run.config.get("seed", NOTHING))),
        Cell(f"{frames:,.0f}"),
        Cell(f"{row['episodes']:.0f}" if is_number(row.get("episodes")) else NOTHING),
        *(_value(name, row.get(name)) for name in (*shown, _RETURN)),
    ]


def _mean_row(group: TrainingGroup, agents: str, rows: Sequence[Row], shown: Sequence[str]) -> list[Cell]:
    cells = [Cell(f"mean of {group.name}{f', {agents}' if agents else ''}"), Cell(""), Cell(""), Cell("")]
    for name in (*shown, _RETURN):
        values = [float(row[name]) for row in rows if is_number(row.get(name))]
        mean = _value(name, statistics.fmean(values) if values else None)
        if len(values) > 1:
            least, largest = (_value(name, end).text for end in (min(values), max(values)))
            mean = Cell(mean.text, f"{least} to {largest}")
        cells.append(mean)
    return cells


def _value(name: str, value: object) -> Cell:
    if not is_number(value):
        return Cell(NOTHING)
    assert isinstance(value, float | int)
    return Cell(f"{value:.1f}" if name == _RETURN else format_value(measure_of(name), float(value)))


def sweep_table(name: str, sweep: Sweep) -> Table:
    """The parameters of each job and what it came to; the best job is marked."""
    parameters = list(dict.fromkeys(each for job in sweep.jobs for each in job.parameters))
    measure = next((one for one in CATALOGUE if sweep.metric in (one.metric, one.name)), None)
    best_value = next((job.objective for job in sweep.jobs if job.name == sweep.best), math.nan)
    # Where all jobs are equal, none is the best.
    differ = len({job.objective for job in sweep.jobs if not math.isnan(job.objective)}) > 1
    rows = []
    for job in sweep.jobs:
        known = not math.isnan(job.objective)
        value = f"{job.objective:.3g}" if measure is None else format_value(measure, job.objective)
        best = job.objective == best_value if differ else job.name == sweep.best and not known
        # Not by its colour alone.
        text = value if known else NOTHING
        rows.append(
            [
                Cell(job.name),
                *(Cell(job.parameters.get(each, "")) for each in parameters),
                Cell(f"{text} (best)" if best else text, best=best),
            ]
        )
    data = [
        {
            "sweep": sweep.name,
            "job": job.name,
            **job.parameters,
            "objective": job.objective,
            "best": int(job.name == sweep.best),
        }
        for job in sweep.jobs
    ]
    title = sweep.metric if measure is None else measure_title(measure)
    failed = sum(math.isnan(job.objective) for job in sweep.jobs)
    caption = (
        f"Objective: {title} in the last evaluation of each job; "
        f"{'more' if sweep.maximise else 'less'} is better. The best of many jobs looks better than it is: "
        "evaluate it on episodes that it was not chosen by."
    )
    if failed:
        caption += f" {failed} of {len(sweep.jobs)} jobs have no figure."
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
