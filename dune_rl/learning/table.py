"""Tables of results, for the command lines to print."""

import math
from collections.abc import Mapping

from rich.table import Table

from dune_rl.learning.evaluation import MEASURES
from dune_rl.learning.statistics import Estimate


def results_table(results: Mapping[str, Mapping[str, Estimate]], title: str) -> Table:
    """One row for each policy of `results` (by name), one column for each measure with its 95 % interval."""
    table = Table(title=title, caption="brackets: 95 % intervals", caption_justify="left")
    table.add_column("policy", no_wrap=True)
    for name, (_, unit) in MEASURES.items():
        table.add_column(f"{name} [{unit}]" if unit else name, justify="right")
    for policy, estimates in results.items():
        table.add_row(policy, *(_cell(name, estimates[name]) for name in MEASURES))
    return table


def _cell(name: str, estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "–"
    scale, form = (100, "{:.0f}") if name in ("SR", "TR") else (1, "{:.2f}")
    value = form.format(estimate.value * scale) + (" %" if scale == 100 else "")
    if math.isnan(estimate.low):
        return value
    return f"{value}\n({form.format(estimate.low * scale)}–{form.format(estimate.high * scale)})"
