"""Tables in Markdown files that are made from files of results: `python -m dune_rl.report into=README.md`.

A block begins with a comment that says what it is made of, in YAML, and ends with another:

    <!-- report: table
    methods:
      trained: {folder: experiments/inspection, policy: inspection}
    measures: [SR, TR]
    -->
    | method | SR | TR |
    ...
    <!-- end report -->

Folders are relative to the Markdown file. What is between the comments is written anew; the rest stays.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, ValidationError

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import measure_of
from dune_rl.metrics.number_text import format_p, format_value
from dune_rl.reporting import published
from dune_rl.reporting.block_sources import BlockSources, SourceConf
from dune_rl.reporting.comparisons.comparison import EvaluatedPolicy
from dune_rl.reporting.comparisons.estimates import estimate_of, estimate_rows
from dune_rl.reporting.csv_rows import read_rows
from dune_rl.reporting.grid_block import GridConf, make_grid
from dune_rl.reporting.runs import Note
from dune_rl.reporting.tables.table import Cell, Table, escape_markdown, estimate_cell, to_markdown
from dune_rl.statistics.intervals import Estimate
from dune_rl.statistics.measures import CASE_COLUMNS, cluster_rows, compare_success

_BEGIN = re.compile(r"<!-- report: (\w+)\r?\n(.*?)^-->(\r?\n)", flags=re.MULTILINE | re.DOTALL)
_END = "<!-- end report -->"
_CODE = re.compile(r"(^```.*?^```\r?$)", flags=re.MULTILINE | re.DOTALL)


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


class PairConf(Settings):
    """A sentence on which of two methods succeeds more often on the same episodes."""

    first: str | SourceConf
    second: str | SourceConf


@dataclass(frozen=True)
class Rewritten:
    """The text of a file with its blocks written anew, and how many there are.

    `skipped` and `notes` are what is to be known of the folders that they were made from.
    """

    text: str
    blocks: int
    skipped: Sequence[Note]
    notes: Sequence[Note]


def rewrite_file(file: Path) -> Rewritten:
    """Write the blocks of a Markdown file anew, with the line endings that they have.

    Raises ConfigError, and changes nothing, where there is none, or one that cannot be made.
    """
    try:
        text = file.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise ConfigError(f"into={file}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"into={file} cannot be read as text: {error}") from None
    found = rewrite_text(text, file)
    if not found.blocks:
        raise ConfigError(
            f"{file} has no block that begins with <!-- report: table; see docs/how_to/report.md"
        )
    if found.text != text:
        with write_atomically(file) as temporary:
            temporary.write_text(found.text, encoding="utf-8", newline="")
    return found


def rewrite_text(text: str, file: Path) -> Rewritten:
    """The text of `file` with its blocks written anew; code in fences stays."""
    parts = _CODE.split(text)
    sources = BlockSources(file.parent)
    count, done = 0, ""
    for part in parts:
        if part.startswith("```"):
            done += part
            continue
        while found := _BEGIN.search(part):
            end = part.find(_END, found.end())
            following = _BEGIN.search(part, found.end())
            if end < 0 or (following and following.start() < end):
                raise ConfigError(f"{file}: the block '<!-- report: {found[1]}' has no {_END}")
            made = make_block(found[1], found[2], file, sources)
            done += part[: found.end()] + made.replace("\n", found[3]) + _END
            part = part[end + len(_END) :]
            count += 1
        done += part
    return Rewritten(done, count, sources.skipped, sources.notes)


def make_block(kind: str, settings: str, file: Path, sources: BlockSources) -> str:
    """The Markdown of a block of `file` from its settings; raises ConfigError where they are wrong."""
    makers: Mapping[str, tuple[type[Settings], Callable[[Any, BlockSources], str]]] = {
        "table": (TableConf, _make_table),
        "pair": (PairConf, _make_pair),
        "grid": (GridConf, make_grid),
    }
    if kind not in makers:
        raise ConfigError(f"{file}: there is no block {kind!r}; there are {', '.join(makers)}")
    model, make = makers[kind]
    try:
        conf = model.model_validate(yaml.safe_load(settings))
    except yaml.YAMLError as error:
        raise ConfigError(f"{file}: the block of {kind} is not YAML: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{file}: the block of {kind}: {where}: {first['msg']}") from None
    try:
        return make(conf, sources)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from None


def _make_table(conf: TableConf, sources: BlockSources) -> str:
    columns = {
        title: [sources.find_method(each) for each in (source if isinstance(source, tuple) else (source,))]
        for title, source in conf.methods.items()
    }
    estimates = {
        title: [estimate_rows(method.rows) for method in methods] for title, methods in columns.items()
    }
    paper = published.PAPER_FIGURES.get(conf.paper or "", {})
    if conf.paper and not paper:
        raise ConfigError(
            f"the paper has no figures of {conf.paper}; it has {', '.join(published.PAPER_FIGURES)}"
        )
    cells: dict[str, dict[str, str]] = {}
    for name in conf.measures:
        cells[name] = {title: _cell(name, columns[title], estimates[title], conf) for title in columns}
        if conf.paper:
            unit = " %" if measure_of(name).unit == "%" and name in paper else ""
            cells[name][published.NAME] = f"{paper.get(name, '')}{unit}"
    labels = {name: conf.labels.get(name, _label(name)) for name in conf.measures}
    titles = list(next(iter(cells.values())))
    if conf.rows == "measures":
        header = ["", *titles]
        rows = [
            [Cell(labels[name]), *(Cell(cells[name][title]) for title in titles)] for name in conf.measures
        ]
    else:
        header = ["", *labels.values()]
        rows = [[Cell(title), *(Cell(cells[name][title]) for name in conf.measures)] for title in titles]
    # Titles and labels are Markdown of the file's author.
    return to_markdown(Table("", "", "", header, rows, []), escape=False)


def _label(name: str) -> str:
    measure = measure_of(name)
    return f"{name} [{measure.unit}]" if measure.unit not in ("", "%") else name


def _cell(
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
    unit = " %" if measure.unit == "%" else ""
    if len(known) == 1 and conf.intervals:
        return estimate_cell(measure, known[0], unit=unit, decimals=decimals).plain
    values = ", ".join(format_value(measure, found.value, decimals) for found in known)
    return f"{values}{unit}"


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


def _make_pair(conf: PairConf, sources: BlockSources) -> str:
    first, second = (sources.find_method(source) for source in (conf.first, conf.second))
    rows = [
        [
            {"agent": 0.0, **{key: row[key] for key in ("episode", "success", *CASE_COLUMNS) if key in row}}
            for row in method.rows
        ]
        for method in (first, second)
    ]
    try:
        test = compare_success(*rows)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    names = (escape_markdown(f"`{method.policy}`").replace("\\`", "`") for method in (first, second))
    one, other = names
    clusters, units = cluster_rows(rows[0])
    name = "exact McNemar test" if clusters is None else f"sign-flip test of whole {units}"
    known = not math.isnan(test.p_value)
    p_value = f"p = {format_p(test.p_value)}" if known else "p is not defined, as there is nothing to compare"
    return (
        f"Of {first.episodes} episodes, {one} alone succeeds in {test.only_a}, {other} alone in "
        f"{test.only_b}: {name}, {p_value}.\n"
    )
