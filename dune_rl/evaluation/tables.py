"""Tables of results: on the console, and in CSV and Parquet with the same rows, columns and order."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from dune_rl.core.files import write_atomically, write_csv
from dune_rl.evaluation.columns import describe_columns
from dune_rl.metrics.catalogue import (
    MINUS,
    Measure,
    equation_of_p,
    format_difference,
    format_p,
    format_value,
    measure_of,
    measures_of,
)
from dune_rl.metrics.episode import MetricsConf
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import MetricsRow, cluster_rows
from dune_rl.statistics.paired_comparison import PairedComparison, compare_success

Row = Mapping[str, Any]

# With more policies, meanings are left out and intervals have lines of their own, for 80 columns.
_WIDE_COLUMNS = 2
_OF_RUNS = "/run"


def notes_by_measure(conf: MetricsConf) -> dict[str, str]:
    """What must be known beside a measure, by its name: the threshold of VORT."""
    thresholds = {name: getattr(term, "uneven_tilt_deg", None) for name, term in conf.terms.items()}
    return {
        measure.name: f"tilt above {thresholds[measure.metric]:g}°"
        for measure in measures_of(list(thresholds))
        if thresholds.get(measure.metric) is not None
    }


def metric_notes(conf: MetricsConf, shown: Iterable[str]) -> tuple[str, ...]:
    """The same of the measures that a table has `shown`, as lines below it."""
    names = {name.removesuffix(_OF_RUNS) for name in shown}
    return tuple(f"{name}: {note}" for name, note in notes_by_measure(conf).items() if name in names)


def results_table(
    results: Mapping[str, Mapping[str, Estimate]],
    title: str,
    *,
    num_agents: int = 1,
    sites: int = 0,
    notes: Sequence[str] = (),
) -> Table:
    """One column for each policy of `results` (by name), one row for each measure with its 95 % interval.

    Measures that not all policies have are left out. Where episodes have `num_agents`, the title says so, and
    where several share each of `sites` the caption does. `notes` are lines below the table.
    """
    caption = "brackets: 95 % intervals"
    if num_agents > 1:
        title += f", {num_agents} agents each"
    if sites:
        caption += f", over {sites} whole sites"
    elif num_agents > 1:
        caption += ", over whole episodes"
    caption = "\n".join([caption, *notes])
    table = Table(title=title, caption=caption, caption_justify="left", title_justify="left")
    many = len(results) > _WIDE_COLUMNS
    # On a narrow terminal, meanings are folded before numbers are.
    table.add_column("measure", no_wrap=many)
    for policy in results:
        table.add_column(Text(policy, overflow="fold"), justify="right", overflow="fold")
    for name in dict.fromkeys(name for estimates in results.values() for name in estimates):
        if not all(name in estimates for estimates in results.values()):
            continue
        measure = measure_of(name)
        unit = f" [{measure.unit}]" if measure.unit not in ("", "%") else ""
        # As Text: in a string, rich takes brackets for markup.
        label = Text("  ".join(filter(None, (name, "" if many else measure.meaning))) + unit)
        cells = (describe_estimate(measure, estimates[name]) for estimates in results.values())
        table.add_row(label, *(cell.replace(" (", "\n(") if many else cell for cell in cells))
    return table


def paired_line(first: tuple[str, Sequence[MetricsRow]], second: tuple[str, Sequence[MetricsRow]]) -> str:
    """One line on which of two policies, (name, episodes) each, succeeds more often on the same episodes."""
    test = compare_success(first[1], second[1])
    clusters, units = cluster_rows(first[1])
    name = "exact McNemar test" if clusters is None else f"sign-flip test of whole {units}"
    return (
        f"Paired: {first[0]} alone succeeds in {test.only_a} episodes, {second[0]} alone in {test.only_b}; "
        f"{name}, {equation_of_p(test.p_value, is_bound=test.p_is_bound)}"
    )


def comparison_table(comparisons: Sequence[PairedComparison], measure: str) -> Table:
    """One row for each pair of policies: by how much a measure differs, and how surely.

    The last column is `PairedComparison.effect`.
    """
    chosen = [one for one in comparisons if one.measure.name == measure]
    caption = "brackets: 95 % intervals; p by Holm's method over all pairs"
    if any(math.isnan(one.adjusted_p) for one in chosen):
        unit = "run" if measure.endswith(_OF_RUNS) else "episode"
        caption += f"\n-: not defined, as no {unit} has a value of both"
    table = Table(title=f"{measure}, in pairs", caption=caption, caption_justify="left", title_justify="left")
    table.add_column("first - second")
    for name in ("difference", "p", "effect"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in chosen:
        unit = " %" if one.measure.unit == "%" else ""
        ends = (one.difference.value, one.difference.low, one.difference.high)
        value, low, high = (format_difference(one.measure, end).replace(MINUS, "-") for end in ends)
        interval = "" if math.isnan(one.difference.low) else f" ({low} to {high})"
        table.add_row(
            Text(f"{one.first} - {one.second}"),
            "-" if math.isnan(one.difference.value) else f"{value}{unit}{interval}",
            "-" if math.isnan(one.adjusted_p) else format_p(one.adjusted_p, is_bound=one.p_is_bound),
            "-" if math.isnan(one.effect) else f"{one.effect:.2f}",
        )
    return table


def describe_estimate(measure: Measure, estimate: Estimate, separator: str = " ") -> str:
    """Value and interval, shares in per cent; a dash where nothing was measured."""
    if math.isnan(estimate.value):
        return "-"
    value = format_value(measure, estimate.value) + (" %" if measure.unit == "%" else "")
    if math.isnan(estimate.low):
        return value
    low, high = (format_value(measure, end) for end in (estimate.low, estimate.high))
    return f"{value}{separator}({low} to {high})"


def write_tables(stem: Path, rows: Sequence[Row], metadata: Mapping[str, str]) -> None:
    """Write STEM.csv and STEM.parquet; units and `metadata` are in the schema of the latter.

    Columns are those of all rows; a row without one has no value there.
    """
    import pyarrow
    import pyarrow.parquet

    names = list(dict.fromkeys(name for row in rows for name in row))
    full = [dict.fromkeys(names) | dict(row) for row in rows]
    write_csv(stem.with_suffix(".csv"), full)
    fields, columns = [], []
    for description in describe_columns(names):
        name = description["column"]
        values = [row[name] for row in full]
        kind = _arrow_type(values, pyarrow)
        columns.append(pyarrow.array(values, kind))
        metadata = {key: description[key] for key in ("unit", "meaning") if description[key]}
        fields.append(pyarrow.field(name, kind, metadata=metadata))
    schema = pyarrow.schema(fields, metadata=dict(metadata))
    with write_atomically(stem.with_suffix(".parquet")) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns, schema=schema), temporary)


def _arrow_type(values: Sequence[Any], pyarrow: Any) -> Any:
    present = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in present):
        return pyarrow.string()
    return pyarrow.int64() if present and all(isinstance(one, int) for one in present) else pyarrow.float64()


def plain_number(value: float) -> int | float:
    """An int where the value is whole, as it reads better."""
    return int(value) if math.isfinite(value) and float(value).is_integer() else value
