"""The block `table`: methods and their measures."""

from collections.abc import Mapping, Sequence
from typing import Literal

from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import format_value, measure_of
from dune_rl.reporting.comparison import EvaluatedPolicy, estimate_of, estimate_rows
from dune_rl.reporting.markdown.sources import BlockSources, SourceConf, markdown_table, percent_of
from dune_rl.reporting.rows import read_rows
from dune_rl.reporting.tables.methods import PAPER, PAPER_FIGURES
from dune_rl.reporting.tables.table import estimate_cell
from dune_rl.statistics.intervals import Estimate


class TableConf(Settings):
    """A table of methods and measures.

    `methods` are by their titles; one of several sources has a figure for each, without interval. `labels`
    name measures otherwise. With `paper`, a world's name, the figures of the DUnE paper are beside ours.
    """

    methods: dict[str, str | SourceConf | tuple[str | SourceConf, ...]] = Field(min_length=1)
    measures: tuple[str, ...] = Field(min_length=1)
    rows: Literal["methods", "measures"] = "methods"
    labels: Mapping[str, str] = Field(default_factory=dict)
    decimals: Mapping[str, int] = Field(default_factory=dict)
    intervals: bool = True
    paper: str | None = None


def make_table(conf: TableConf, sources: BlockSources) -> str:
    paper = PAPER_FIGURES.get(conf.paper or "", {})
    if conf.paper and not paper:
        raise ConfigError(f"the paper has no figures of {conf.paper}; it has {', '.join(PAPER_FIGURES)}")
    units = {name: measure_of(name).unit for name in conf.measures}
    labels = {name: f"{name} [{unit}]" if unit not in ("", "%") else name for name, unit in units.items()}
    lines = [["", *(conf.labels.get(name, label) for name, label in labels.items())]]
    for title, source in conf.methods.items():
        chosen = source if isinstance(source, tuple) else (source,)
        methods = [sources.find_method(each) for each in chosen]
        estimates = [estimate_rows(method.rows) for method in methods]
        lines.append([title, *(_table_cell(name, methods, estimates, conf) for name in conf.measures)])
    if conf.paper:
        told = (f"{paper[name]}{percent_of(name)}" if name in paper else "" for name in conf.measures)
        lines.append([PAPER, *told])
    if conf.rows == "measures":
        lines = [list(line) for line in zip(*lines, strict=True)]
    return markdown_table(lines)


def _table_cell(
    name: str, methods: list[EvaluatedPolicy], estimates: Sequence[Mapping[str, Estimate]], conf: TableConf
) -> str:
    if name == "episodes":
        return ", ".join(f"{method.episodes}" for method in methods)
    if name == "frames":
        return ", ".join(_frames(method) for method in methods)
    known = [
        estimate_of(name, str(method.runs[0].path), method.rows, found)
        for method, found in zip(methods, estimates, strict=True)
    ]
    measure, decimals = measure_of(name), conf.decimals.get(name)
    if len(known) == 1 and conf.intervals:
        return estimate_cell(measure, known[0], unit=percent_of(name), decimals=decimals).plain
    return ", ".join(format_value(measure, found.value, decimals) for found in known) + percent_of(name)


def _frames(method: EvaluatedPolicy) -> str:
    file = method.runs[0].path / "metrics.csv"
    if not file.exists():
        raise ConfigError(f"{file.parent} has no metrics.csv, so that its frames are not known")
    rows = read_rows(file, empty=None)
    if not rows or any("frames" not in row for row in rows):
        raise ConfigError(f"{file} lacks the column frames, or has rows without it; its frames are not known")
    frames = max(float(row["frames"]) for row in rows)
    # The collector's last batch goes a little beyond what was asked for.
    return f"{frames:,.0f}" if frames < 1e6 else f"{frames / 1e6:.1f} million"
