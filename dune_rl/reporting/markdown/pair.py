"""The block `pair`: which of two methods succeeds alone, in how many episodes."""

import math

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.metrics.catalogue import equation_of_p
from dune_rl.reporting.comparison import select_metrics
from dune_rl.reporting.markdown.sources import BlockSources, SourceConf
from dune_rl.reporting.tables.table import escape_markdown
from dune_rl.statistics.measures import cluster_rows
from dune_rl.statistics.paired_comparison import compare_success


class PairConf(Settings):
    """A sentence on which of two methods succeeds more often on the same episodes."""

    first: str | SourceConf
    second: str | SourceConf


def make_pair(conf: PairConf, sources: BlockSources) -> str:
    first, second = (sources.find_method(source) for source in (conf.first, conf.second))
    rows = [
        [{**row, "agent": 0.0} for row in select_metrics(method.rows, ["success"])]
        for method in (first, second)
    ]
    try:
        test = compare_success(*rows)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    one, other = (escape_markdown(f"`{method.policy}`").replace("\\`", "`") for method in (first, second))
    clusters, units = cluster_rows(rows[0])
    name = "exact McNemar test" if clusters is None else f"sign-flip test of whole {units}"
    p_value = equation_of_p(test.p_value, is_bound=test.p_is_bound)
    if math.isnan(test.p_value):
        p_value = "p is not defined, as there is nothing to compare"
    return (
        f"Of {first.episodes} episodes, {one} alone succeeds in {test.only_a}, {other} alone in "
        f"{test.only_b}: {name}, {p_value}.\n"
    )
