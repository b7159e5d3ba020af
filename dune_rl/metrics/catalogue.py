"""The measures that evaluations report (`measures.csv`), and their numbers as tables write them."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from dune_rl.metrics.episode import BUILT_IN

NOTHING, MINUS = "\N{EN DASH}", "\N{MINUS SIGN}"


@dataclass(frozen=True)
class Measure:
    """A measure over episodes, and how it is made of their metrics.

    `metric` is the metric whose mean over the episodes it is, or the share of them if it `is_share`.
    `per` names another metric where the measure is a ratio of sums; `are_counts` marks numbers of events.
    `formula` is of one episode, `better` the direction in which a policy is better, None where neither is.
    """

    name: str
    metric: str
    meaning: str = ""
    unit: str = ""
    better: Literal["higher", "lower"] | None = None
    formula: str = ""
    source: str = ""
    per: str | None = None
    is_share: bool = False
    are_counts: bool = False
    decimals: int = 2

    @property
    def scale(self) -> float:
        """The factor of values in tables: shares are stored as 0 to 1."""
        return 100.0 if self.unit == "%" else 1.0


def _read_catalogue() -> tuple[Measure, ...]:
    with Path(__file__).with_name("measures.csv").open(newline="", encoding="utf-8") as file:
        return tuple(
            Measure(
                row["name"], row["metric"], row["meaning"], row["unit"],
                cast(Literal["higher", "lower"] | None, row["better"] or None),
                row["formula"], row["source"], row["per"] or None,
                row["kind"] == "share", row["kind"] == "count", int(row["decimals"]),
            )
            for row in csv.DictReader(file)
        )  # fmt: skip


CATALOGUE = _read_catalogue()
_BY_NAME = {measure.name: measure for measure in CATALOGUE}


def measure_of(name: str) -> Measure:
    """The measure of a name; users' own have none but the name."""
    return _BY_NAME.get(name, Measure(name, name))


# Metrics of which no measure is made: ids, and details that the CSV has.
_DETAILS = {
    *("agent", *BUILT_IN, "set", "world", "world_file", "seed", "world_seed", "goals", "min_clearance"),
    *("diverged", "stuck", "flipped", "out_of_world", "timeout"),
    # Those of the published code are sums, which only mean something when they are divided.
    *("dune_code_attempts", "dune_code_clearance_rows", "dune_code_rough_rows", "dune_code_rows"),
}


def measures_of(metrics: Sequence[str]) -> list[Measure]:
    """The measures that metrics of these names give: those of the catalogue, then users' own by their names.

    Names with a slash (reward terms and what was drawn at random) give none.
    """
    known = [one for one in CATALOGUE if one.metric in metrics and (one.per is None or one.per in metrics)]
    taken = {measure.metric for measure in CATALOGUE} | _DETAILS
    return [*known, *(Measure(name, name) for name in metrics if name not in taken and "/" not in name)]


def format_value(measure: Measure, value: float, decimals: int | None = None) -> str:
    """A value of a measure with its scale and decimals; of those of users' own, three digits count.

    A value that is not known is a dash.
    """
    if math.isnan(value):
        return NOTHING
    scaled = value * measure.scale
    if decimals is not None or measure.source or measure.meaning:
        text = f"{scaled:.{measure.decimals if decimals is None else decimals}f}"
    else:
        text = f"{scaled:.3g}" if abs(scaled) < 1e4 else f"{scaled:.4g}"
    # No minus before a zero that rounding made.
    return text.removeprefix("-") if _is_zero(text) else text


def format_difference(measure: Measure, value: float, decimals: int | None = None) -> str:
    """A difference of a measure, with its sign; a dash where it is not known."""
    if math.isnan(value):
        return NOTHING
    text = format_value(measure, abs(value), decimals)
    return text if _is_zero(text) else f"{MINUS if value < 0 else '+'}{text}"


def _is_zero(text: str) -> bool:
    return not any(digit in text for digit in "123456789")


def format_p(value: float, *, is_bound: bool = False) -> str:
    """A p-value with two digits, "≤" before it where it is a bound; a dash where it is not defined."""
    if math.isnan(value):
        return NOTHING
    return f"{'≤ ' if is_bound else ''}{value:.2g}"


def equation_of_p(value: float, *, is_bound: bool = False) -> str:
    """The same as "p = 0.02" or "p ≤ 0.0001"."""
    return f"p {'≤' if is_bound else '='} {format_p(value)}"


def format_range(numbers: Sequence[int]) -> str:
    """The least and the largest of whole numbers, as "1,200" or "5 to 10"; "no" without any."""
    if not numbers:
        return "no"
    least, largest = min(numbers), max(numbers)
    return f"{least:,}" if least == largest else f"{least:,} to {largest:,}"
