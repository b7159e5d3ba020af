"""Numbers as reports write them: values of measures, p-values, counts and ranges of counts."""

import math
from collections.abc import Sequence

from dune_rl.metrics.measure import Measure

NOTHING, MINUS = "\N{EN DASH}", "\N{MINUS SIGN}"


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
    return text.removeprefix("-") if not any(digit in text for digit in "123456789") else text


def format_difference(measure: Measure, value: float, decimals: int | None = None) -> str:
    """A difference of a measure, with its sign; a dash where it is not known."""
    if math.isnan(value):
        return NOTHING
    text = format_value(measure, abs(value), decimals)
    zero = not any(digit in text for digit in "123456789")
    return text if zero else f"{MINUS if value < 0 else '+'}{text}"


def format_effect(value: float) -> str:
    """An effect size with two decimals; a dash where it is not defined."""
    return NOTHING if math.isnan(value) else f"{value:.2f}".replace("-", MINUS)


def format_p(value: float) -> str:
    """A p-value with two digits; a dash where it is not defined."""
    return NOTHING if math.isnan(value) else f"{value:.2g}"


def format_range(numbers: Sequence[int]) -> str:
    """The least and the largest of whole numbers, as "1,200" or "5 to 10"; "no" without any."""
    if not numbers:
        return "no"
    least, largest = min(numbers), max(numbers)
    return f"{least:,}" if least == largest else f"{least:,} to {largest:,}"
