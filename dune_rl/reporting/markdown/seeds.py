"""A cell of a Markdown table for one method, or for several seeds of training of one."""

from collections.abc import Mapping, Sequence

from dune_rl.core.errors import ConfigError
from dune_rl.metrics.catalogue import format_value, measure_of
from dune_rl.reporting.comparison import EvaluatedPolicy, average_methods, estimate_of, estimate_rows
from dune_rl.reporting.markdown.sources import percent_of
from dune_rl.reporting.tables.table import estimate_cell
from dune_rl.statistics.intervals import Estimate


def mean_of_seeds(seeds: Sequence[EvaluatedPolicy], where: str) -> EvaluatedPolicy:
    """The method that has the means of the `seeds` in each episode; raises ConfigError if episodes differ."""
    if len(seeds) == 1:
        return seeds[0]
    try:
        return average_methods(seeds)
    except ValueError as error:
        raise ConfigError(f"the seeds of {where}: {error}; intervals: false leaves their mean out") from None


class SeedCells:
    """Cells of measures: the figure of each of `seeds`, behind that of their `mean` if there is one."""

    def __init__(self, seeds: Sequence[EvaluatedPolicy], mean: EvaluatedPolicy | None) -> None:
        self._seeds = [(one, estimate_rows(one.rows)) for one in seeds]
        self._mean = None if mean is None else (mean, estimate_rows(mean.rows))

    def cell(self, name: str, decimals: int | None) -> str:
        """The measure `name`: the mean has its 95 % interval."""
        measure, unit = measure_of(name), percent_of(name)
        each = [_estimate(name, *found).value for found in self._seeds]
        figures = ", ".join(format_value(measure, value, decimals) for value in each)
        if self._mean is None:
            return f"{figures}{unit}"
        mean = estimate_cell(measure, _estimate(name, *self._mean), unit=unit, decimals=decimals).plain
        return f"{mean}; {figures}" if len(each) > 1 else mean


def _estimate(name: str, method: EvaluatedPolicy, found: Mapping[str, Estimate]) -> Estimate:
    return estimate_of(name, str(method.runs[0].path), method.rows, found)
