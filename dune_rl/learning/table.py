"""Tables of results, for the command lines to print."""

import math
from collections.abc import Mapping, Sequence

from rich.table import Table
from rich.text import Text

from dune_rl.learning.measures import MEASURES, MetricsRow, compare_success
from dune_rl.learning.statistics import Estimate

# Scale, form and unit of what is not printed as a plain number.
_FORMS = {"SR": (100, "{:.0f}", " %"), "TR": (100, "{:.0f}", " %"), "battery": (100, "{:.2f}", " %")}


def results_table(results: Mapping[str, Mapping[str, Estimate]], title: str, *, num_agents: int = 1) -> Table:
    """One column for each policy of `results` (by name), one row for each measure with its 95 % interval.

    Measures that not all policies have are left out. The intervals take the
    `num_agents` agents of an episode for independent, and the caption says so.
    """
    caption = "brackets: 95 % intervals"
    if num_agents > 1:
        title += f", {num_agents} agents each"
        caption += ", as if the agents of an episode were independent"
    table = Table(title=title, caption=caption, caption_justify="left", title_justify="left")
    table.add_column("measure", no_wrap=True)
    for policy in results:
        table.add_column(Text(policy), justify="right")
    for name in dict.fromkeys(name for estimates in results.values() for name in estimates):
        if not all(name in estimates for estimates in results.values()):
            continue
        meaning, unit = MEASURES.get(name, ("", ""))
        # As Text: in a string, rich takes brackets for markup.
        label = Text("  ".join(filter(None, (name, meaning))) + (f" [{unit}]" if unit else ""))
        table.add_row(label, *(_cell(name, estimates[name]) for estimates in results.values()))
    return table


def paired_line(first: tuple[str, Sequence[MetricsRow]], second: tuple[str, Sequence[MetricsRow]]) -> str:
    """One line on which of two policies, (name, episodes) each, succeeds more often on the same episodes."""
    test = compare_success(first[1], second[1])
    return (
        f"Paired: {first[0]} alone succeeds in {test.only_a} episodes, {second[0]} alone in {test.only_b}; "
        f"exact McNemar test p = {test.p_value:.2g}"
    )


def _cell(name: str, estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    scale, form, unit = _FORMS.get(name, (1, "{:.2f}", ""))
    value = form.format(estimate.value * scale) + unit
    if math.isnan(estimate.low):
        return value
    return f"{value} ({form.format(estimate.low * scale)} to {form.format(estimate.high * scale)})"
