"""The block `table`: methods and their measures."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import measure_of
from dune_rl.reporting.comparison import EvaluatedPolicy
from dune_rl.reporting.markdown.seeds import SeedCells, mean_of_seeds
from dune_rl.reporting.markdown.sources import BlockSources, SourceConf, markdown_table, percent_of
from dune_rl.reporting.rows import read_rows
from dune_rl.reporting.tables.methods import PAPER, PAPER_FIGURES


class TableConf(Settings):
    """A table of methods and measures.

    `methods` are by their titles; one of several sources, such as seeds of training, has their mean, and each
    figure behind it. Without `intervals` it has the figures alone. `labels` name measures otherwise. With
    `paper`, a world's name, the figures of the DUnE paper are beside ours.
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
        lines.append([title, *_cells(title, methods, conf)])
    if conf.paper:
        told = (f"{paper[name]}{percent_of(name)}" if name in paper else "" for name in conf.measures)
        lines.append([PAPER, *told])
    if conf.rows == "measures":
        lines = [list(line) for line in zip(*lines, strict=True)]
    return markdown_table(lines)


def _cells(title: str, methods: Sequence[EvaluatedPolicy], conf: TableConf) -> Iterator[str]:
    has_means = conf.intervals and not {"episodes", "frames"}.issuperset(conf.measures)
    cells = SeedCells(methods, mean_of_seeds(methods, title) if has_means else None)
    for name in conf.measures:
        if name == "episodes":
            yield ", ".join(f"{method.episodes}" for method in methods)
        elif name == "frames":
            yield ", ".join(_frames(method) for method in methods)
        else:
            yield cells.cell(name, conf.decimals.get(name))


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
