"""The block `protocols`: evaluations by the protocols of the paper and of its code, beside Table 3."""

import math
from collections.abc import Mapping

import yaml
from pydantic import Field

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import Measure, measure_of
from dune_rl.reporting.markdown.sources import BlockSources, markdown_table
from dune_rl.reporting.rows import read_rows
from dune_rl.reporting.tables.methods import PAPER, TABLE_3
from dune_rl.reporting.tables.table import estimate_cell
from dune_rl.statistics.intervals import Estimate

# What stands before and after the paper's name of a measure in the summary of an evaluation, by its protocol.
_AROUND = {"paper": ("", "/run"), "dune_code": ("code ", "")}


class ProtocolsConf(Settings):
    """Measures of runs, a row for each and a column for each folder, which was made with a `protocol`.

    `columns` are the folders by titles, relative to the Markdown file. `measures` are the paper's names; in a
    folder with `protocol=dune_code` each is what the published code computes. `world` adds a column with what
    the paper's Table 3 says.
    """

    columns: dict[str, str] = Field(min_length=1)
    measures: tuple[str, ...] = Field(min_length=1)
    world: str | None = None
    decimals: Mapping[str, int] = Field(default_factory=dict)


def make_protocols(conf: ProtocolsConf, sources: BlockSources) -> str:
    """The Markdown of the table; a measure that a protocol has not is left empty.

    Raises ConfigError for a folder that was made without a protocol, a measure that no folder has, and a
    world that Table 3 has not.
    """
    if conf.world is not None and conf.world not in TABLE_3:
        raise ConfigError(f"Table 3 of the paper has no {conf.world}; it has {', '.join(TABLE_3)}")
    told = TABLE_3.get(conf.world or "", {})
    columns = {title: _measures_of_runs(sources, folder) for title, folder in conf.columns.items()}
    lines = [["", *columns, *([PAPER] if told else [])]]
    for name in conf.measures:
        known = [found[name][0] for found in columns.values() if name in found]
        if not known:
            raise ConfigError(f"no folder has the measure {name}")
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


def _measures_of_runs(sources: BlockSources, name: str) -> dict[str, tuple[Measure, Estimate]]:
    """The measures of a folder's runs by the names that the paper has for them."""
    folder = sources.beside / name
    try:
        protocol = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))["protocol"]
        before, after = _AROUND[protocol]
    except (OSError, KeyError, TypeError, yaml.YAMLError):
        raise ConfigError(f"{name} is no evaluation with protocol=paper or protocol=dune_code") from None
    found = {}
    for row in read_rows(folder / "summary.csv", empty=math.nan):
        told = str(row["measure"])
        if told.startswith(before) and told.endswith(after):
            estimate = Estimate(row["value"], row["low"], row["high"], int(row["count"]), int(row["units"]))
            measure = measure_of(told.removesuffix("/run"))
            found[told[len(before) : len(told) - len(after)]] = (measure, estimate)
    return found
