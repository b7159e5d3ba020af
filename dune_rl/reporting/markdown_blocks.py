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
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, ValidationError

from dune_rl.errors import ConfigError
from dune_rl.files import write_atomically
from dune_rl.learning.measures import CASE_COLUMNS, cluster_rows, compare_success
from dune_rl.learning.statistics import Estimate
from dune_rl.metrics.catalogue import Measure
from dune_rl.reporting import published
from dune_rl.reporting.block_sources import SourceConf, find_method
from dune_rl.reporting.comparisons import Method, estimate_rows, measure_of
from dune_rl.reporting.csv_rows import read_rows
from dune_rl.reporting.grid_block import GridConf, make_grid
from dune_rl.reporting.tables.methods import format_p
from dune_rl.reporting.tables.table import Cell, Table, escape_markdown, to_markdown
from dune_rl.settings import Settings

_BEGIN = re.compile(r"<!-- report: (\w+)\n(.*?)^-->\n", flags=re.MULTILINE | re.DOTALL)
_END = "<!-- end report -->"
_CODE = re.compile(r"(^```.*?^```$)", flags=re.MULTILINE | re.DOTALL)


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


def rewrite_file(file: Path) -> int:
    """Write the blocks of a Markdown file anew; returns how many there are.

    Raises ConfigError, and changes nothing, where there is none, or one that cannot be made.
    """
    try:
        text = file.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise ConfigError(f"into={file}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"into={file} cannot be read as text: {error}") from None
    rewritten, count = rewrite_text(text, file)
    if not count:
        raise ConfigError(
            f"{file} has no block that begins with <!-- report: table; see docs/how_to/report.md"
        )
    if rewritten != text:
        with write_atomically(file) as temporary:
            temporary.write_text(rewritten, encoding="utf-8", newline="")
    return count


def rewrite_text(text: str, file: Path) -> tuple[str, int]:
    """The text of `file` with its blocks written anew, and how many there are; code in fences stays."""
    parts = _CODE.split(text)
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
            done += part[: found.end()] + make_block(found[1], found[2], file) + _END
            part = part[end + len(_END) :]
            count += 1
        done += part
    return done, count


def make_block(kind: str, settings: str, file: Path) -> str:
    """The Markdown of a block of `file` from its settings; raises ConfigError where they are wrong."""
    makers: Mapping[str, tuple[type[Settings], Callable[[Any, Path], str]]] = {
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
        return make(conf, file.parent)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from None


def _make_table(conf: TableConf, folder: Path) -> str:
    columns = {
        title: [find_method(each, folder) for each in (source if isinstance(source, tuple) else (source,))]
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
        measure = _with_decimals(measure_of(name), conf)
        cells[name] = {
            title: _cell(name, measure, columns[title], estimates[title], conf, folder) for title in columns
        }
        if conf.paper:
            unit = " %" if measure.unit == "%" and name in paper else ""
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


def _with_decimals(measure: Measure, conf: TableConf) -> Measure:
    if measure.name not in conf.decimals:
        return measure
    return Measure(**{**vars(measure), "decimals": conf.decimals[measure.name]})


def _cell(
    name: str,
    measure: Measure,
    methods: list[Method],
    estimates: Sequence[Mapping[str, Estimate]],
    conf: TableConf,
    folder: Path,
) -> str:
    if name == "episodes":
        return ", ".join(f"{method.episodes}" for method in methods)
    if name == "frames":
        return ", ".join(_frames(method) for method in methods)
    if any(name not in found for found in estimates):
        raise ConfigError(f"{methods[0].runs[0].path} has no measure {name}")
    found = [estimate[name] for estimate in estimates]
    unit = " %" if measure.unit == "%" else ""
    values = ", ".join(_number(measure, one.value) for one in found)
    if len(found) > 1 or not conf.intervals or math.isnan(found[0].low):
        # One episode, for example, has no interval.
        return f"{values}{unit}"
    return f"{values}{unit} ({_number(measure, found[0].low)} to {_number(measure, found[0].high)})"


def _number(measure: Measure, value: float) -> str:
    return f"{value * measure.scale:.{measure.decimals}f}"


def _frames(method: Method) -> str:
    file = method.runs[0].path / "metrics.csv"
    if not file.exists():
        raise ConfigError(f"{file.parent} has no metrics.csv, so that its frames are not known")
    frames = max(float(row["frames"]) for row in read_rows(file, empty=None))
    # The collector's last batch goes a little beyond what was asked for.
    return f"{frames:,.0f}" if frames < 1e6 else f"{frames / 1e6:.1f} million"


def _make_pair(conf: PairConf, folder: Path) -> str:
    first, second = (find_method(source, folder) for source in (conf.first, conf.second))
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
    return (
        f"Of {first.episodes} episodes, {one} alone succeeds in {test.only_a}, {other} alone in "
        f"{test.only_b}: {name}, p = {format_p(test.p_value)}.\n"
    )
