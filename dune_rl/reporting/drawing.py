"""Which figures a report has: what each is drawn from, its title and its caption."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from dune_rl.reporting.comparisons import Comparison
from dune_rl.reporting.figures.distributions import distribution_metrics, draw_distributions
from dune_rl.reporting.figures.results import Results
from dune_rl.reporting.figures.success import draw_success_by
from dune_rl.reporting.figures.training import draw_training_curves
from dune_rl.reporting.layout import Findings, file_stem
from dune_rl.reporting.page.blocks import FigureBlock


@dataclass(frozen=True)
class FigurePlan:
    """A figure to be drawn for a section of the page."""

    section: str
    name: str
    title: str
    caption: str
    sources: Sequence[Path]
    draw: Callable[[], Figure]

    def block(self) -> FigureBlock:
        """The figure, drawn."""
        return FigureBlock(self.name, self.title, self.caption, self.draw(), self.sources)


def plan_figures(findings: Findings) -> list[FigurePlan]:
    """The figures that the inputs allow, in order."""
    return [
        *_training(findings),
        *_distributions(findings),
        *_difficulty(findings),
    ]


def results_of(comparisons: Sequence[Comparison]) -> Results:
    """Rows of episodes by the title of their cases and their method, as figures take them."""
    return {one.cases.title: {method.name: method.rows for method in one.methods} for one in comparisons}


def _training(findings: Findings) -> Iterator[FigurePlan]:
    if not findings.groups:
        return
    groups = {group.name: group.runs for group in findings.groups}
    yield FigurePlan(
        "training",
        "training_curves",
        "Training curves",
        "Success rate and return over frames: on the left in evaluations on unseen episodes, on the right in "
        "training, where actions are noisy. Runs that differ only in their seed are one line.",
        [run.path / "metrics.csv" for group in findings.groups for run in group.runs],
        lambda: draw_training_curves(groups),
    )


def _distributions(findings: Findings) -> Iterator[FigurePlan]:
    results = results_of(findings.comparisons)
    for metric in distribution_metrics(results):
        yield FigurePlan(
            "distributions",
            f"distribution_{file_stem(metric)}",
            f"Distribution of {metric.replace('_', ' ')}",
            "Points are episodes, the shape is their smoothed density, the bar spans the quartiles and the light "
            "mark is the median. On the right: episodes that have a value, of all.",
            _files(findings.comparisons),
            lambda metric=metric: draw_distributions(results, metric),
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
                "Share of successes in each bin with Wilson's 95 % interval; the numbers below are the episodes in "
                "the bin.",
                _files(findings.comparisons),
                lambda column=column: draw_success_by(results, column),
            )


_PROPERTIES = (("goal_distance_m", "the distance to the goal"),)


def _files(comparisons: Sequence[Comparison]) -> list[Path]:
    return list(dict.fromkeys(file for one in comparisons for file in one.files))
