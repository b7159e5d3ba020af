"""The block `protocols`: evaluations by the protocols of the paper and of its code, beside Table 3."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import typed_word
from dune_rl.core.untrusted_files import parse_yaml
from dune_rl.metrics.catalogue import Measure, measure_of
from dune_rl.reporting.markdown.sources import BlockSources, SourceConf, markdown_table
from dune_rl.reporting.rows import Row, is_number, read_rows
from dune_rl.reporting.tables.methods import PAPER, TABLE_3
from dune_rl.reporting.tables.table import estimate_cell
from dune_rl.statistics.intervals import Estimate

# What stands before and after the paper's name of a measure in the summary of an evaluation, by its protocol.
_AROUND = {"paper": ("", "/run"), "dune_code": ("code ", "")}


# Columns of a summary that are read.
_COLUMNS = ("policy", "group", "measure", "value", "low", "high", "count", "units")


class ProtocolsConf(Settings):
    """Measures of runs, a row for each and a column for each source, which was made with a `protocol`.

    `columns` are the sources by titles. `measures` are the paper's names; in a folder with
    `protocol=dune_code` each is what the published code computes. `world` adds a column with what the paper's
    Table 3 says, whose VORT and TSR are those of the code.
    """

    columns: dict[str, str | SourceConf] = Field(min_length=1)
    measures: tuple[str, ...] = Field(min_length=1)
    world: str | None = None
    decimals: Mapping[str, Annotated[int, Field(ge=0, le=6)]] = Field(default_factory=dict)


def make_protocols(conf: ProtocolsConf, sources: BlockSources) -> str:
    """The Markdown of the table; a measure that a protocol has not is left empty.

    Raises ConfigError for a folder that was made without a protocol, or is damaged, a measure that no folder
    has, and a world that Table 3 has not.
    """
    if unused := [name for name in conf.decimals if name not in conf.measures]:
        raise ConfigError(f"decimals: {unused[0]} is none of the measures")
    if conf.world is not None and conf.world not in TABLE_3:
        raise ConfigError(f"Table 3 of the paper has no {conf.world}; it has {', '.join(TABLE_3)}")
    told = TABLE_3.get(conf.world or "", {})
    columns = {title: _measures_of_runs(sources, source) for title, source in conf.columns.items()}
    lines = [["", *columns, *([PAPER] if told else [])]]
    for name in conf.measures:
        known = [found[name][0] for found in columns.values() if name in found]
        if not known:
            there = ", ".join(dict.fromkeys(each for found in columns.values() for each in found))
            raise ConfigError(f"no folder has the measure {name}; they have {there}")
        unit = known[0].unit
        cells = (_cell(found.get(name), conf.decimals.get(name)) for found in columns.values())
        title = f"{name} [{unit}]" if unit not in ("", "%") else name
        lines.append([title, *cells, *([told.get(name, "")] if told else [])])
    return markdown_table(lines)


def _cell(found: tuple[Measure, Estimate] | None, decimals: int | None) -> str:
    if found is None:
        return ""
    measure, estimate = found
    unit = " %" if measure.unit == "%" else ""
    return estimate_cell(measure, estimate, unit=unit, decimals=decimals).plain


def _measures_of_runs(sources: BlockSources, source: str | SourceConf) -> dict[str, tuple[Measure, Estimate]]:
    """The measures of a source's runs by the names that the paper has for them."""
    told = SourceConf(folder=source) if isinstance(source, str) else source
    before, after = _AROUND[_protocol_of(sources.beside / told.folder, told.folder)]
    found = {}
    for row in _summary_of(sources.beside / told.folder, told):
        name = str(row["measure"])
        if name.startswith(before) and name.endswith(after):
            estimate = Estimate(row["value"], row["low"], row["high"], int(row["count"]), int(row["units"]))
            measure = measure_of(name.removesuffix("/run"))
            found[name[len(before) : len(name) - len(after)]] = (measure, estimate)
    return found


def _protocol_of(folder: Path, name: str) -> str:
    """The protocol that the evaluation in a `folder` was made with."""
    if not folder.is_dir():
        raise ConfigError(f"there is no folder {name}")
    try:
        config = parse_yaml((folder / "config.yaml").read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{name}: config.yaml cannot be read ({error})") from None
    protocol = config.get("protocol") if isinstance(config, dict) else None
    if protocol not in _AROUND:
        raise ConfigError(f"{name} was made with protocol={protocol}, not with {' or '.join(_AROUND)}")
    return str(protocol)


def _summary_of(folder: Path, told: SourceConf) -> list[Row]:
    """The rows of a folder's summary that are of one policy, and of one group of agents."""
    file = folder / "summary.csv"
    if not file.is_file():
        raise ConfigError(
            f"{told.folder} has no summary.csv; evaluate again, or go on with "
            f"{typed_word('resume', told.folder)}"
        )
    rows = [row for row in read_rows(file, empty=math.nan) if told.policy in (None, row.get("policy"))]
    if not rows:
        raise ConfigError(f"{told.folder}/summary.csv has no rows of {told.policy or 'a policy'}")
    if missing := [column for column in _COLUMNS if column not in rows[0]]:
        raise ConfigError(f"{told.folder}/summary.csv lacks the column {missing[0]}")
    for what, kind in (("policies", "policy"), ("groups of agents", "group")):
        if len(several := dict.fromkeys(str(row[kind]) for row in rows)) > 1:
            raise ConfigError(f"{told.folder} has several {what} ({', '.join(several)}); name one")
    if any(not is_number(row[column]) for row in rows for column in ("count", "units")):
        raise ConfigError(f"{told.folder}/summary.csv has rows without a count")
    return rows
