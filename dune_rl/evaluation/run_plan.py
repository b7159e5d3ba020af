"""Runs an evaluation into its folder, and shows its tables."""

from collections.abc import Mapping, Sequence

from rich.console import Console

from dune_rl.evaluation.blocks import missing_blocks
from dune_rl.evaluation.folder import COMPARISON, SUMMARY, ResultsFolder, rows_of_group
from dune_rl.evaluation.processes import run_in_processes
from dune_rl.evaluation.recorder import START_COLUMNS
from dune_rl.evaluation.running import BlockRunner, EvaluationPlan, FinishedEpisode
from dune_rl.learning.measures import cluster_rows, estimate_metrics, write_csv
from dune_rl.learning.paired_comparison import PairedComparison, compare_policies
from dune_rl.learning.run.progress import show_episodes
from dune_rl.learning.table import comparison_table, paired_line, results_table

_TWO = 2


def prepare_run(plan: EvaluationPlan) -> BlockRunner:
    """The environment and policies of a plan; raises DuneError where they do not fit."""
    runner = BlockRunner(plan)
    runner.try_policies()
    return runner


def run_plan(
    plan: EvaluationPlan, folder: ResultsFolder, runner: BlockRunner, console: Console, processes: int
) -> None:
    """Run the episodes that `folder` lacks, write its tables and show them.

    When it is interrupted, the rows of the finished episodes are written, and it says how to go on.
    """
    agents = runner.agents
    blocks = missing_blocks(len(plan.sources), plan.episodes, folder.finished.keys(), plan.scenes, processes)
    name = plan.sources[0].name if len(plan.sources) == 1 else f"{len(plan.sources)} policies"
    total = len(plan.sources) * plan.episodes
    try:
        with show_episodes(console, name, total) as show:

            def keep(episode: FinishedEpisode) -> None:
                if (episode.policy, episode.episode) not in folder.finished:
                    folder.add(episode)
                show(len(folder.finished))

            if processes == 1 or len(blocks) <= 1:
                for block in blocks:
                    runner.run(block, keep)
            else:
                # Its memory is for the others.
                runner.close()
                run_in_processes(plan, blocks, processes, keep)
    except BaseException:
        done = len(folder.finished)
        if not done and folder.is_new:
            folder.discard()
            raise
        folder.write(complete=False)
        console.print(
            f"Cut off after {done} of {total} episodes; go on with python -m dune_rl.evaluate "
            f"resume={folder.path}",
            highlight=False,
            soft_wrap=True,
        )
        raise
    if not runner.env.is_closed:
        runner.close()
    folder.write(complete=True)
    _report(plan, folder, agents, console)


def _report(
    plan: EvaluationPlan, folder: ResultsFolder, agents: Mapping[str, Sequence[str]], console: Console
) -> None:
    rows = folder.rows()
    summary: list[dict[str, object]] = []
    comparisons: list[dict[str, object]] = []
    for group, names in agents.items():
        of_group = rows_of_group(rows, names)
        if not of_group:
            # Groups without metrics have no rows.
            continue
        numbers = {name: float(index) for index, name in enumerate(names)}
        results = {
            source.name: [
                {**row, "agent": numbers[row["agent"]]} for row in of_group if row["policy"] == source.name
            ]
            for source in plan.sources
        }
        estimates = {name: estimate_metrics(_numeric(found)) for name, found in results.items()}
        title = f"{_title(plan)}, {group}" if len(agents) > 1 else _title(plan)
        count = "1 episode" if plan.episodes == 1 else f"{plan.episodes} episodes"
        title += f": {count} of seed {plan.conf.seed}"
        clusters, kind = cluster_rows(of_group[: len(next(iter(results.values())))])
        sites = int(clusters.max()) + 1 if clusters is not None and kind == "sites" else 0
        console.print(results_table(estimates, title, num_agents=len(names), sites=sites))
        compared = compare_policies({name: _numeric(found) for name, found in results.items()})
        if len(results) == _TWO and all("success" in found[0] for found in results.values()):
            console.print(paired_line(*results.items()))
        if len(results) > _TWO:
            console.print(comparison_table(compared, "SR"))
        summary += [
            {"policy": name, "group": group, "measure": measure, **vars(estimate)}
            for name, measures in estimates.items()
            for measure, estimate in measures.items()
        ]
        comparisons += [{"group": group, **_comparison_row(one)} for one in compared]
    write_csv(folder.path / f"{SUMMARY}.csv", summary)
    if comparisons:
        write_csv(folder.path / f"{COMPARISON}.csv", comparisons)
    console.print(f"Results: {folder.path}", highlight=False, soft_wrap=True)


def _title(plan: EvaluationPlan) -> str:
    return plan.conf.world.name if plan.episode_set is None else plan.episode_set.name


def _numeric(rows: Sequence[Mapping[str, object]]) -> list[dict[str, float]]:
    """The metrics of rows and the seeds of their worlds, without names, the episodes' seed and places."""
    left_out = ("seed", *START_COLUMNS)
    return [
        {key: value for key, value in row.items() if isinstance(value, int | float) and key not in left_out}
        for row in rows
    ]


def _comparison_row(one: PairedComparison) -> dict[str, object]:
    return {
        "measure": one.measure.name,
        "metric": one.measure.metric,
        "first": one.first,
        "second": one.second,
        "difference": one.difference.value,
        "low": one.difference.low,
        "high": one.difference.high,
        "episodes": one.difference.count,
        "p": one.p_value,
        "p_holm": one.adjusted_p,
        "effect": one.effect,
    }
