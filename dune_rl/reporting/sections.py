"""What a report shows: the tables and figures of each section, their titles and captions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from dune_rl.core.paths import file_stem
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.comparison import Comparison, EvaluatedPolicy, files_of
from dune_rl.reporting.figures import aggregates
from dune_rl.reporting.figures.distributions import distribution_metrics, draw_distributions
from dune_rl.reporting.figures.failures import MOST_FAILURES, choose_failures, draw_failures, show_failures
from dune_rl.reporting.figures.results import Results, all_rows, axis_label, failures_of
from dune_rl.reporting.figures.success import PROPERTIES, draw_success_by
from dune_rl.reporting.figures.track_data import collect_tracks
from dune_rl.reporting.figures.tracks import draw_tracks
from dune_rl.reporting.figures.training import by_world, draw_training_curves
from dune_rl.reporting.inputs import Note, ReportInputs, TrainingGroup, group_runs
from dune_rl.reporting.output import ReportProgress
from dune_rl.reporting.page import (
    Block,
    FigureBlock,
    Section,
    TableBlock,
    TextBlock,
    figures_of,
    shown_path,
    tables_of,
)
from dune_rl.reporting.reading import policy_origins
from dune_rl.reporting.tables import methods as method_tables
from dune_rl.reporting.tables import runs as run_tables
from dune_rl.reporting.tables.methods import PAPER_MEASURES

# The progress of an episode that is run again.
_REPLAYED = 8.0


@dataclass
class Findings:
    """What the inputs give: comparisons of methods on the same cases, and groups of training runs."""

    inputs: ReportInputs
    comparisons: list[Comparison]
    groups: list[TrainingGroup]

    def name(self, comparison: Comparison) -> str:
        """The stem of the files of a comparison."""
        number = self.comparisons.index(comparison) + 1
        return f"{number:02d}_{file_stem(comparison.cases.title)}"


def collect_findings(inputs: ReportInputs) -> Findings:
    """The comparisons and groups of the inputs."""
    return Findings(inputs, collect_comparisons(inputs.evaluations), group_runs(inputs.training))


def lay_out(findings: Findings, failures: int, progress: ReportProgress) -> list[Section]:
    """The sections of the page, whose figures are not drawn yet.

    At most so many `failures` are run again for pictures, and `progress` shows these one by one.
    """
    sections = [
        Section("compared", "What was compared", list(_compared(findings))),
        Section("results", "Main comparison", list(_results(findings))),
        Section("pairs", "Methods in pairs", list(_pairs(findings))),
        Section("measures", "All measures", list(_measures(findings))),
        Section("training", "Training", list(_training(findings))),
        Section("distributions", "Distributions", list(_distributions(findings.comparisons))),
        Section("difficulty", "Success against distance and slope", list(_difficulty(findings.comparisons))),
        Section("tracks", "Tracks", list(_tracks(findings))),
        Section("failures", "Failures", list(_failures(findings.comparisons, failures, progress))),
        Section("aggregates", "Aggregates over sets", list(_aggregates(findings))),
        Section("sweeps", "Sweeps", list(_sweeps(findings))),
    ]
    return [*sections, Section("files", "Files", list(_files(sections)))]


def describe_note(note: Note) -> str:
    """A note with the folder that it is about."""
    return f"{shown_path(note.path)}: {note.text}"


def _compared(findings: Findings) -> Iterator[Block]:
    inputs = findings.inputs
    for text, notes in (("Left out:", inputs.skipped), ("To be known:", inputs.notes)):
        if notes:
            yield TextBlock(text, [describe_note(note) for note in notes], warning=True)
    if findings.comparisons:
        yield TableBlock(run_tables.cases_table(findings.comparisons))
    if inputs.evaluations:
        yield TableBlock(run_tables.evaluations_table(inputs.evaluations), folded=True)
    if findings.groups:
        yield TableBlock(run_tables.training_origin_table(findings.groups))


def _results(findings: Findings) -> Iterator[Block]:
    if len(findings.comparisons) > 1:
        for measure in ("SR", "TR"):
            if any(measure in found for each in findings.comparisons for found in each.estimates.values()):
                yield TableBlock(method_tables.overview_table(findings.comparisons, measure))
    for comparison in findings.comparisons:
        yield TableBlock(method_tables.main_table(findings.name(comparison), comparison))
        if comparison.notes:
            yield TextBlock("", comparison.notes, warning=True)


def _pairs(findings: Findings) -> Iterator[Block]:
    for comparison in findings.comparisons:
        name = findings.name(comparison)
        # Many pairs would push all else away.
        folded = len(findings.comparisons) > 1 or len(comparison.methods) > 2
        for further, stem in ((False, name), (True, f"{name}_further")):
            pairs = [one for one in comparison.pairs if (one.measure.name not in PAPER_MEASURES) == further]
            if pairs:
                table = method_tables.paired_table(stem, comparison, pairs, further=further)
                yield TableBlock(table, folded=folded or further)


def _measures(findings: Findings) -> Iterator[Block]:
    for comparison in findings.comparisons:
        table = method_tables.all_measures_table(findings.name(comparison), comparison)
        yield TableBlock(table, folded=len(findings.comparisons) > 1)


def _training(findings: Findings) -> Iterator[Block]:
    if findings.groups:
        yield TableBlock(run_tables.training_table(findings.groups))
    # Runs on other worlds have other lengths and returns.
    for world, groups in by_world({group.name: group.runs for group in findings.groups}).items():
        yield FigureBlock(
            f"training_{file_stem(world)}",
            f"Training on {world}",
            "Success rate and return over frames: on the left in evaluations on unseen episodes, on the "
            "right in training, where actions are noisy. Runs that differ only in their seed are one line.",
            partial(draw_training_curves, groups),
            [run.path / "metrics.csv" for runs in groups.values() for run in runs],
        )


def results_of(comparisons: Sequence[Comparison]) -> Results:
    """Rows of episodes by the title of their cases and their method, as figures take them."""
    return {one.cases.title: {method.name: method.rows for method in one.methods} for one in comparisons}


def _distributions(comparisons: Sequence[Comparison]) -> Iterator[Block]:
    results = results_of(comparisons)
    for metric in distribution_metrics(results):
        yield FigureBlock(
            f"distribution_{file_stem(metric)}",
            f"Distribution of {axis_label(metric)}",
            "Points are episodes, the shape is their smoothed density, the bar spans the quartiles and the "
            "light mark is the median. On the right: episodes that have a value, of all.",
            partial(draw_distributions, results, metric),
            files_of(comparisons),
        )


def _difficulty(comparisons: Sequence[Comparison]) -> Iterator[Block]:
    rows = [row for one in comparisons for method in one.methods for row in method.rows]
    for column, (words, _) in PROPERTIES.items():
        if any(column in row for row in rows):
            yield FigureBlock(
                f"success_by_{column}",
                f"Success against {words}",
                "Share of successes in each bin with its 95 % interval; the numbers below are "
                "the episodes in the bin.",
                partial(draw_success_by, results_of(comparisons), column),
                files_of(comparisons),
            )


def _tracks(findings: Findings) -> Iterator[Block]:
    for one in findings.comparisons:
        if any(run.steps for method in one.methods for run in method.runs):
            yield FigureBlock(
                f"tracks_{findings.name(one)}",
                f"Tracks on {one.cases.title}",
                "Of the first sites the first episodes, coloured by forward speed, on the shaded ground.",
                partial(_draw_tracks, one.methods),
                [file.with_name("steps.csv") for file in one.files],
            )


def _draw_tracks(methods: Sequence[EvaluatedPolicy]) -> Figure:
    return draw_tracks(collect_tracks(methods))


def _failures(comparisons: Sequence[Comparison], most: int, progress: ReportProgress) -> Iterator[Block]:
    if not comparisons:
        return
    yield TableBlock(method_tables.endings_table(comparisons))
    numbered = list(filter(None, dict.fromkeys(one.numbered for one in comparisons)))
    # Pictures have the numbers beside them, far from the main comparison.
    yield TextBlock("", numbered, warning=True)
    everything = [each for one in comparisons for each in one.methods]
    # Nothing tells how the others were run.
    methods = [each for each in everything if each.run.provenance or each.run.steps]
    failed = [each for each in everything if each not in methods and any(map(failures_of, each.rows))]
    left_out = [
        f"those of {path}, whose evaluation has no provenance and no steps"
        for path in dict.fromkeys(shown_path(each.run.path) for each in failed)
    ]
    chosen = choose_failures(methods, most=most or MOST_FAILURES)
    replays = len(chosen) if most else 0

    def advance(done: int) -> None:
        if done:
            progress.finish(_REPLAYED)
        progress.begin(f"running failure {min(done + 1, replays)} of {replays} again")

    def draw() -> Figure:
        shown = show_failures(chosen, advance if replays else None)
        left_out.extend(one.reason for one in shown if not one.is_shown)
        return draw_failures(shown)

    if chosen:
        yield FigureBlock(
            "failures",
            "How episodes failed",
            "The last seconds before a failure of each kind and method, from left to right; where an episode "
            "could not be run again, its recorded track.",
            draw,
            files_of(comparisons),
            _REPLAYED * replays,
        )
    # Complete when the figure is drawn.
    yield TextBlock("Not shown:", left_out)


def _aggregates(findings: Findings) -> Iterator[Block]:
    # Of sampled episodes each would be a unit of its own, with a score of 0 or 1.
    results = shared_results([one for one in findings.comparisons if one.cases.set_name])
    # Of a single set the main table says as much.
    if len(results) < 2 or not any("success" in row for row in all_rows(results)):
        return
    scores = aggregates.collect_scores(results, trained_groups(findings))
    sources = files_of(one for one in findings.comparisons if one.cases.title in results)
    units = f"Units: {scores.units}; 95 % intervals of a stratified bootstrap."
    yield FigureBlock(
        "aggregates",
        "Success over all sets",
        "Interquartile mean, median, mean and optimality gap of the success rate (Agarwal et al. 2021). "
        + units,
        partial(aggregates.draw_aggregates, scores),
        sources,
    )
    yield FigureBlock(
        "profiles",
        "Performance profiles",
        f"Share of units with a success rate above each threshold. {units}",
        partial(aggregates.draw_profiles, scores),
        sources,
    )
    if len({name for each in results.values() for name in each}) > 1:
        yield FigureBlock(
            "improvements",
            "Probability of improvement",
            f"How probably a unit of one method has a higher success rate than one of another. {units}",
            partial(aggregates.draw_improvements, scores),
            sources,
        )


def shared_results(comparisons: Sequence[Comparison]) -> Results:
    """The largest block of results without gaps: of methods that all have the same sets of cases."""
    cases_by_method: dict[str, set[str]] = {}
    for one in comparisons:
        for method in one.methods:
            cases_by_method.setdefault(method.name, set()).add(one.cases.title)

    def methods_on(cases: set[str]) -> list[str]:
        return [name for name, found in cases_by_method.items() if cases <= found]

    most = max(
        cases_by_method.values(), key=lambda cases: len(cases) * len(methods_on(cases)), default=set[str]()
    )
    return {
        title: {name: found[name] for name in methods_on(most)}
        for title, found in results_of(comparisons).items()
        if title in most
    }


def trained_groups(findings: Findings) -> dict[str, str]:
    """The group of training runs that made the policy of each method, where there are several such runs."""
    found = {}
    for method in (method for one in findings.comparisons for method in one.methods):
        for group in findings.groups:
            folders = [run.path.resolve() for run in group.runs]
            places = [place for place in _places(method) if any(map(place.is_relative_to, folders))]
            if len(folders) > 1 and places:
                found[method.name] = group.name
    return found


def _places(method: EvaluatedPolicy) -> Iterator[Path]:
    """Where the weights of a method may lie: beside its episodes, or where its provenance says."""
    for run in method.runs:
        yield run.path.resolve()
        for each in policy_origins(run.provenance, method.policy):
            yield Path(str(each.get("location", ""))).resolve()


def _sweeps(findings: Findings) -> Iterator[Block]:
    for number, sweep in enumerate(findings.inputs.sweeps, 1):
        yield TableBlock(run_tables.sweep_table(f"sweep_{number:02d}", sweep))


def _files(sections: Sequence[Section]) -> Iterator[Block]:
    tables, figures = tables_of(sections), figures_of(sections)
    if tables:
        yield TextBlock(
            "Each in tables/ as .tex (booktabs), .md and .csv; the last has all digits.",
            [f"{table.name}: {table.title}" for table in tables],
            heading="Tables",
        )
    if figures:
        names = [f"{figure.name}: {figure.title}" for figure in figures]
        yield TextBlock("Each in figures/ as .png and .pdf.", names, heading="Figures")
