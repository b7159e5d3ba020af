"""A measure over episodes or runs."""

from dataclasses import dataclass
from typing import Literal

PAPER = "Vice & Sukthankar 2025"


@dataclass(frozen=True)
class Measure:
    """A measure over episodes, and how it is made of their metrics.

    `metric` is the metric whose mean over the episodes it is, or the share of them if it `is_share`.
    `per` names another metric where the measure is a ratio of sums; `are_counts` marks numbers of events.
    `formula` is of one episode, `better` the direction in which a policy is better, None where neither is.
    Tables multiply values by `scale`.
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
    scale: float = 1.0
    decimals: int = 2
