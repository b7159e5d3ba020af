"""Which figures a report has: what each is drawn from, its title and its caption."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from dune_rl.core.paths import file_stem
from dune_rl.reporting.comparisons.comparison import Comparison, EvaluatedPolicy
from dune_rl.reporting.figures.aggregates import (
    collect_scores,
    draw_aggregates,
    draw_improvements,
    draw_profiles,
)
from dune_rl.reporting.figures.distributions import distribution_metrics, draw_distributions
from dune_rl.reporting.figures.failures import (
    MOST_FAILURES,
    choose_failures,
    collect_failures,
    draw_failures,
)
from dune_rl.reporting.figures.results import Results, axis_label, failures_of
from dune_rl.reporting.figures.success import draw_success_by
from dune_rl.reporting.figures.track_data import collect_tracks
from dune_rl.reporting.figures.tracks import draw_tracks
from dune_rl.reporting.figures.training import by_world, draw_training_curves
from dune_rl.reporting.layout import Findings
from dune_rl.reporting.origins import policy_origins
from dune_rl.reporting.page.render import FigureBlock, shown_path
from dune_rl.reporting.progress import ReportProgress

_PROPERTIES = (
    ("goal_distance_m", "the distance to the goal"),
    ("slope_deg", "the steepest ground on the way to the goal"),
)
# Amounts of progress: of a figure, and of an episode that is run again.
DRAWN, _REPLAYED = 1.0, 8.0


@dataclass(frozen=True)
class FigurePlan:
    """A figure to be drawn for a section of the page; `amount` is what of the report's progress it makes."""

    section: str
    name: str
    title: str
    caption: str
    sources: Sequence[Path]
    draw: Callable[[], Figure]
    amount: float = DRAWN

    def block(self) -> FigureBlock:
        """The figure, drawn."""
        return FigureBlock(self.name, self.title, self.caption, self.draw(), self.sources)


def plan_figures(findings: Findings, failures: int, progress: ReportProgress) -> list[FigurePlan]:
    """The figures that the inputs allow, in order; at most so many `failures` are run again for pictures.

    `progress` shows these one by one.
    """
    return [
        *_training(findings),
        *_distributions(findings),
        *_difficulty(findings),
        *_tracks(findings),
        *_failures(findings, failures, progress),
        *_aggregates(findings),
    ]


def results_of(comparisons: Sequence[Comparison]) -> Results:
    """Rows of episodes by the title of their cases and their method, as figures take them."""
    return {one.cases.title: {method.name: method.rows for method in one.methods} for one in comparisons}


def _training(findings: Findings) -> Iterator[FigurePlan]:
    # Runs on other worlds have other lengths and returns.
    for world, groups in by_world({group.name: group.runs for group in findings.groups}).items():
        yield FigurePlan(
            "training",
            f"training_{file_stem(world)}",
            f"Training on {world}",
            "Success rate and return over frames: on the left in evaluations on unseen episodes, on the "
            "right in training, where actions are noisy. Runs that differ only in their seed are one line.",
            [run.path / "metrics.csv" for runs in groups.values() for run in runs],
            partial(draw_training_curves, groups),
        )


def _distributions(findings: Findings) -> Iterator[FigurePlan]:
    results = results_of(findings.comparisons)
    for metric in distribution_metrics(results):
        yield FigurePlan(
            "distributions",
            f"distribution_{file_stem(metric)}",
            f"Distribution of {axis_label(metric)}",
            "Points are episodes, the shape is their smoothed density, the bar spans the quartiles and the "
            "light mark is the median. On the right: episodes that have a value, of all.",
            _files(findings.comparisons),
            partial(draw_distributions, results, metric),
        )


def _difficulty(findings: Findings) -> Iterator[FigurePlan]:
    results = results_of(findings.comparisons)
    rows = [row for methods in results.values() for rows in methods.values() for row in rows]
    for column, words in _PROPERTIES:
        if any(column in row for row in rows):
            yield FigurePlan(
                "difficulty",
                f"success_by_{column}",
                f"Success against {words}",
                "Share of successes in each bin with its 95 % interval; the numbers below are "
                "the episodes in the bin.",
                _files(findings.comparisons),
                partial(draw_success_by, results, column),
            )


def _aggregates(findings: Findings) -> Iterator[FigurePlan]:
    # Of sampled episodes each would be a unit of its own, with a score of 0 or 1.
    results = shared_results([one for one in findings.comparisons if one.cases.set_name])
    methods = list(dict.fromkeys(name for each in results.values() for name in each))
    rows = [row for each in results.values() for found in each.values() for row in found]
    # Of a single set the main table says as much.
    if len(results) < 2 or not any("success" in row for row in rows):
        return
    scores = collect_scores(results, "success", trained_groups(findings))
    sources = _files([one for one in findings.comparisons if one.cases.title in results])
    units = f"Units: {scores.units}; 95 % intervals of a stratified bootstrap."
    yield FigurePlan(
        "aggregates",
        "aggregates",
        "Success over all sets",
        "Interquartile mean, median, mean and optimality gap of the success rate (Agarwal et al. 2021). "
        + units,
        sources,
        partial(draw_aggregates, scores),
    )
    yield FigurePlan(
        "aggregates",
        "profiles",
        "Performance profiles",
        f"Share of units with a success rate above each threshold. {units}",
        sources,
        partial(draw_profiles, scores),
    )
    if len(methods) > 1:
        yield FigurePlan(
            "aggregates",
            "improvements",
            "Probability of improvement",
            f"How probably a unit of one method has a higher success rate than one of another. {units}",
            sources,
            partial(draw_improvements, scores),
        )


def _tracks(findings: Findings) -> Iterator[FigurePlan]:
    for one in findings.comparisons:
        if not any(run.steps for method in one.methods for run in method.runs):
            continue
        yield FigurePlan(
            "tracks",
            f"tracks_{findings.name(one)}",
            f"Tracks on {one.cases.title}",
            "Of the first sites the first episodes, coloured by forward speed, on the shaded ground.",
            [file.with_name("steps.csv") for file in one.files],
            partial(_draw_tracks, one.methods),
        )


def _draw_tracks(methods: Sequence[EvaluatedPolicy]) -> Figure:
    return draw_tracks(collect_tracks(methods))


def _failures(findings: Findings, most: int, progress: ReportProgress) -> Iterator[FigurePlan]:
    everything = [each for one in findings.comparisons for each in one.methods]
    # Nothing tells how the others were run.
    methods = [each for each in everything if each.run.provenance or each.run.steps]
    failed = [each for each in everything if each not in methods and any(map(failures_of, each.rows))]
    findings.failures_left_out = [
        f"those of {path}, whose evaluation has no provenance and no steps"
        for path in dict.fromkeys(shown_path(each.run.path) for each in failed)
    ]
    if not choose_failures(methods, most=max(most, 1)):
        return
    replays = len(choose_failures(methods, most=most)) if most else 0

    def begin(done: int) -> None:
        if done < replays:
            progress.begin(f"running failure {done + 1} of {replays} again")

    def advance(done: int, total: int) -> None:
        if most:
            progress.finish(_REPLAYED)
            begin(done)

    def draw() -> Figure:
        begin(0)
        gallery = collect_failures(methods, most=most or MOST_FAILURES, progress=advance, simulate=most > 0)
        findings.failures_left_out += gallery.left_out
        return draw_failures(gallery)

    yield FigurePlan(
        "failures",
        "failures",
        "How episodes failed",
        "The last seconds before a failure of each kind and method, from left to right; where an episode "
        "could not be run again, its recorded track.",
        _files(findings.comparisons),
        draw,
        DRAWN + _REPLAYED * replays,
    )


def shared_results(comparisons: Sequence[Comparison]) -> Results:
    """The largest block of results without gaps: of methods that all have the same sets of cases."""
    cases_by_method: dict[str, list[str]] = {}
    for one in comparisons:
        for method in one.methods:
            cases_by_method.setdefault(method.name, []).append(one.cases.title)
    candidates = [set(cases) for cases in cases_by_method.values()]

    def methods_on(cases: set[str]) -> list[str]:
        return [name for name, found in cases_by_method.items() if cases <= set(found)]

    if not candidates:
        return {}
    most = max(candidates, key=lambda cases: len(cases) * len(methods_on(cases)))
    names = methods_on(most)
    return {
        title: {name: found[name] for name in names}
        for title, found in results_of(comparisons).items()
        if title in most
    }


def trained_groups(findings: Findings) -> dict[str, str]:
    """The group of training runs that made the policy of each method, where there are several such runs."""
    found = {}
    for method in (method for one in findings.comparisons for method in one.methods):
        for group in findings.groups:
            folders = [run.path.resolve() for run in group.runs]
            if len(folders) > 1 and any(
                place.is_relative_to(folder) for place in _places(method) for folder in folders
            ):
                found[method.name] = group.name
    return found


def _places(method: EvaluatedPolicy) -> Iterator[Path]:
    """Where the weights of a method may lie: beside its episodes, or where its provenance says."""
    for run in method.runs:
        yield run.path.resolve()
        for each in policy_origins(run.provenance, method.policy):
            yield Path(str(each.get("location", ""))).resolve()


def _files(comparisons: Sequence[Comparison]) -> list[Path]:
    return list(dict.fromkeys(file for one in comparisons for file in one.files))
