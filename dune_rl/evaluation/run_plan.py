"""Runs an evaluation into its folder, and shows its tables."""

import shlex
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from rich.console import Console

from dune_rl.config.commands import Processes
from dune_rl.core.errors import TrainingError
from dune_rl.core.files import write_csv
from dune_rl.core.suggestions import text_word
from dune_rl.evaluation.blocks import EpisodeBlock, FinishedEpisode, missing_blocks
from dune_rl.evaluation.datasets.writing import dataset_spaces, write_dataset
from dune_rl.evaluation.folder import ATTEMPTS, COMPARISON, RUNS, SUMMARY, ResultsFolder
from dune_rl.evaluation.processes import run_in_processes
from dune_rl.evaluation.protocols.report import attempt_rows, estimate_runs, finished_runs, show_runs
from dune_rl.evaluation.ray_tasks import run_on_ray
from dune_rl.evaluation.recorder import START_COLUMNS
from dune_rl.evaluation.running import BlockRunner, EvaluationPlan
from dune_rl.evaluation.tables import (
    comparison_table,
    metric_notes,
    notes_by_measure,
    paired_line,
    results_table,
)
from dune_rl.learning.run.progress import show_episodes
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import MetricsRow, cluster_rows, estimate_metrics
from dune_rl.statistics.paired_comparison import PairedComparison, compare_policies

_TWO = 2


def prepare_run(plan: EvaluationPlan) -> BlockRunner:
    """The environment and policies of a plan; raises DuneError where they do not fit."""
    runner = BlockRunner(plan)
    runner.try_policies()
    return runner


def run_plan(
    plan: EvaluationPlan,
    folder: ResultsFolder,
    runner: BlockRunner,
    console: Console,
    processes: Processes,
    resume: Path | None = None,
) -> None:
    """Run the episodes that `folder` lacks, write its tables and show them.

    When it is interrupted, the rows of the finished episodes are written, and it says how to go on: by
    `resume`, or else by the folder.
    """
    agents = runner.agents
    spaces = None if plan.transitions is None else dataset_spaces(runner.env)
    has_runs = plan.conf.protocol is not None
    unit = "runs" if has_runs else "episodes"

    def done() -> Collection[tuple[int, int]]:
        return finished_runs(plan, folder.finished.values()) if has_runs else folder.finished.keys()

    scenes = 1 if has_runs else plan.scenes

    part = plan.part_of(plan.conf)
    others = {
        (policy, number)
        for policy in range(len(plan.sources))
        for number in range(plan.episodes)
        if number not in part
    }

    def find_blocks(processes: int) -> list[EpisodeBlock]:
        return missing_blocks(len(plan.sources), plan.episodes, {*done(), *others}, scenes, processes)

    name = plan.sources[0].name if len(plan.sources) == 1 else f"{len(plan.sources)} policies"
    total = len(plan.sources) * len(part)
    try:
        with show_episodes(console, name, total, counted=unit) as show:

            def keep(episode: FinishedEpisode) -> None:
                if (episode.policy, episode.episode) not in folder.finished:
                    folder.add(episode)
                show(len(done()))

            # Where others run the blocks, its memory is for them.
            if processes == "ray":
                runner.close()
                run_on_ray(plan, find_blocks, keep)
            elif processes == 1 or len(blocks := find_blocks(processes)) <= 1:
                for block in find_blocks(1):
                    runner.run(block, keep)
            else:
                runner.close()
                run_in_processes(plan, blocks, processes, keep)
            if find_blocks(1):
                # As where a cluster's processors differ, and a lost block was repeated in another order.
                missing = total - len(done())
                raise TrainingError(f"{missing} {unit} did not come back from the processes that ran them")
    except BaseException:
        if not folder.finished and folder.is_new:
            folder.discard()
            raise
        folder.write()
        words = ["python", "-m", "dune_rl.evaluate", text_word("resume", str(resume or folder.path))]
        go_on = f"go on with {shlex.join(words)}"
        cut_off = f"Cut off after {len(done())} of {total} {unit}; {go_on}"
        console.print(cut_off, highlight=False, markup=False, soft_wrap=True)
        raise
    if not runner.env.is_closed:
        runner.close()
    folder.write()
    if plan.conf.bag is not None:
        console.print(f"Bags: {plan.conf.bag}", highlight=False, markup=False, soft_wrap=True)
    if plan.conf.part is not None:
        text = f"Part {plan.conf.part}: {folder.path}; join=FOLDER joins all parts in it"
        console.print(text, highlight=False, soft_wrap=True)
        return
    _report(plan, folder, agents, console)
    if spaces is not None:
        written = write_dataset(plan, folder, spaces)
        console.print(f"Dataset: {written}", highlight=False, markup=False, soft_wrap=True)
    folder.complete()
    console.print(f"Results: {folder.path}", highlight=False, soft_wrap=True)


Compared = list[tuple[str, PairedComparison]]
SummaryRows = list[dict[str, object]]


def _report(
    plan: EvaluationPlan, folder: ResultsFolder, agents: Mapping[str, Sequence[str]], console: Console
) -> None:
    """Show the tables, and write them as CSV."""
    report = _report_episodes if plan.conf.protocol is None else _report_runs
    summary, compared = report(plan, folder, agents, console)
    write_csv(folder.path / f"{SUMMARY}.csv", summary)
    if compared:
        rows = [{"group": group, **_comparison_row(one)} for group, one in compared]
        write_csv(folder.path / f"{COMPARISON}.csv", rows)


def _report_episodes(
    plan: EvaluationPlan, folder: ResultsFolder, agents: Mapping[str, Sequence[str]], console: Console
) -> tuple[SummaryRows, Compared]:
    rows = folder.rows()
    summary: SummaryRows = []
    comparisons: Compared = []
    case = plan.conf.world.name if plan.episode_set is None else plan.episode_set.name
    count = "1 episode" if plan.episodes == 1 else f"{plan.episodes} episodes"
    for group, names in agents.items():
        numbers = {name: float(index) for index, name in enumerate(names)}
        results: dict[str, list[MetricsRow]] = {}
        # Groups without metrics have no rows; among the actors of some policy nobody may have come.
        for source in plan.sources:
            own = [row for row in rows if row["policy"] == source.name and row["agent"] in numbers]
            if own:
                results[source.name] = [{**row, "agent": numbers[row["agent"]]} for row in own]
        if not results:
            continue
        estimates = {name: estimate_metrics(_numeric(found)) for name, found in results.items()}
        title = f"{case}, {group}" if len(agents) > 1 else case
        title += f": {count} of seed {plan.conf.seed}"
        clusters, kind = cluster_rows(next(iter(results.values())))
        sites = int(clusters.max()) + 1 if clusters is not None and kind == "sites" else 0
        notes = (
            *_note_on_sites(plan, rows),
            *metric_notes(plan.conf.metrics, next(iter(estimates.values()))),
        )
        console.print(results_table(estimates, title, num_agents=len(names), sites=sites, notes=notes))
        paired = rows_in_common(results)
        compared = compare_policies({name: _numeric(found) for name, found in paired.items()})
        if compared and all("success" in found[0] for found in paired.values()):
            if len(paired) == _TWO:
                console.print(paired_line(*paired.items()))
            else:
                console.print(comparison_table(compared, "SR"))
        summary += _summary_rows(plan, group, estimates)
        comparisons += [(group, one) for one in compared]
    return summary, comparisons


def _note_on_sites(plan: EvaluationPlan, rows: Sequence[Mapping[str, object]]) -> tuple[str, ...]:
    """A line where all episodes are on one of a set's sites, of which several episodes in a row are."""
    all_sites = 1 if plan.episode_set is None else plan.episode_set.header.sites
    if all_sites == 1 or len({row["world_seed"] for row in rows}) > 1:
        return ()
    return (f"all on one of the set's {all_sites} sites: nothing is said of others",)


def rows_in_common(results: Mapping[str, Sequence[MetricsRow]]) -> dict[str, list[MetricsRow]]:
    """The rows, by policy, of the episodes and agents that all policies have: agents come and go."""
    keys = [{(row["episode"], row["agent"]) for row in rows} for rows in results.values()]
    common = set.intersection(*keys)
    chosen = {
        name: [row for row in rows if (row["episode"], row["agent"]) in common]
        for name, rows in results.items()
    }
    return chosen if common else {}


def _report_runs(
    plan: EvaluationPlan, folder: ResultsFolder, agents: Mapping[str, Sequence[str]], console: Console
) -> tuple[SummaryRows, Compared]:
    (group,) = agents
    finished = list(folder.finished.values())
    estimates, runs, described = estimate_runs(plan, finished, group)
    compared = show_runs(plan, estimates, runs, console)
    summary = _summary_rows(plan, group, estimates)
    if plan.conf.protocol == "paper":
        rows = [row for row in folder.rows() if row["finished"]]
        by_episode = {
            source.name: estimate_metrics(_numeric([row for row in rows if row["policy"] == source.name]))
            for source in plan.sources
        }
        summary += _summary_rows(plan, group, by_episode)
    write_csv(folder.path / f"{RUNS}.csv", described)
    attempts = attempt_rows(plan, finished, group)
    if attempts:
        write_csv(folder.path / f"{ATTEMPTS}.csv", attempts)
    return summary, [(group, one) for one in compared]


def _summary_rows(
    plan: EvaluationPlan, group: str, estimates: Mapping[str, Mapping[str, Estimate]]
) -> list[dict[str, object]]:
    notes = notes_by_measure(plan.conf.metrics)
    return [
        {
            "policy": name,
            "group": group,
            "measure": measure,
            **vars(estimate),
            "note": notes.get(measure.removesuffix("/run"), ""),
        }
        for name, measures in estimates.items()
        for measure, estimate in measures.items()
    ]


def _numeric(rows: Sequence[Mapping[str, object]]) -> list[dict[str, float]]:
    """The metrics of rows and the seeds of their worlds, without names, the episodes' seed and places."""
    left_out = ("seed", "run", "finished", *START_COLUMNS)
    return [
        {key: value for key, value in row.items() if isinstance(value, int | float) and key not in left_out}
        for row in rows
    ]


def _comparison_row(one: PairedComparison) -> dict[str, object]:
    measure, difference = one.measure, one.difference
    return {
        **{"measure": measure.name, "metric": measure.metric, "first": one.first, "second": one.second},
        **{"difference": difference.value, "low": difference.low, "high": difference.high},
        **{"episodes": difference.count, "p": one.p_value, "p_holm": one.adjusted_p, "effect": one.effect},
    }
