"""Repeats a sample of an evaluation's episodes and compares their rows with the stored rows."""

import csv
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from dune_rl.core.errors import ConfigError
from dune_rl.core.seeding import stream
from dune_rl.core.suggestions import typed_word
from dune_rl.evaluation.blocks import EpisodeBlock, FinishedEpisode
from dune_rl.evaluation.folder import EPISODES, changed_files, read_provenance
from dune_rl.evaluation.running import BlockRunner, EvaluationPlan
from dune_rl.learning.run.progress import show_episodes

_SHOWN = 3


class RowDifference(NamedTuple):
    """A cell of a repeated episode that differs from what was stored."""

    policy: str
    episode: int
    agent: str
    column: str
    stored: str
    repeated: str


def sample_blocks(
    plan: EvaluationPlan, sample: int, sizes: Mapping[tuple[str, int], int] | None = None
) -> list[EpisodeBlock]:
    """Blocks of about `sample` episodes over all policies, the same for the same plan.

    They are whole batches of scenes, so that each episode is repeated in the row that it had. Of a protocol
    they are whole runs, with `sizes`: the episodes of each, by policy and run.
    """
    scenes = plan.scenes if sizes is None else 1
    blocks = [
        EpisodeBlock(policy, first, min(scenes, plan.episodes - first))
        for policy in range(len(plan.sources))
        for first in range(0, plan.episodes, scenes)
    ]
    found: list[EpisodeBlock] = []
    count = 0
    for index in stream(plan.conf.seed, "verify", len(blocks)).permutation(len(blocks)).tolist():
        if count >= sample:
            break
        block = blocks[index]
        found.append(block)
        key = plan.sources[block.policy].name, block.first
        count += block.count if sizes is None else sizes.get(key, 0)
    return sorted(found, key=lambda block: (block.policy, block.first))


def verify_folder(path: Path, plan: EvaluationPlan, sample: int, console: Console) -> None:
    """Repeat about `sample` episodes of the results in `path`.

    Raises ConfigError if a row differs or is missing, or if a file was changed after the evaluation.
    """
    provenance = read_provenance(path)
    complete, changed = bool(provenance.get("complete")), changed_files(path, provenance)
    stored = _read_rows(path, complete)
    runner = BlockRunner(plan)
    repeated: list[Mapping[str, Any]] = []
    differences: list[RowDifference] = []
    missing = 0
    if plan.conf.protocol is None:
        blocks = sample_blocks(plan, sample)
        total = sum(block.count for block in blocks)
    else:
        sizes = Counter((row["policy"], int(row["run"])) for row in stored.values())
        blocks = sample_blocks(plan, sample, sizes)
        total = sum(sizes[plan.sources[block.policy].name, block.first] for block in blocks)
    with show_episodes(console, "verifying", total) as show:
        count = 0

        def compare(episode: FinishedEpisode) -> None:
            nonlocal count, missing
            count += 1
            for row in (row for rows in episode.rows.values() for row in rows):
                key = (row["policy"], str(row["episode"]), row["agent"])
                if key not in stored:
                    missing += 1
                    continue
                repeated.append(row)
                for column, value in row.items():
                    before, now = str(stored[key].get(column)), "" if value is None else str(value)
                    if before != now:
                        where = row["policy"], row["episode"], row["agent"], column
                        differences.append(RowDifference(*where, before, now))
            show(count)

        for block in blocks:
            runner.run(block, compare)
    runner.close()
    if not repeated and not complete:
        raise ConfigError(
            f"{path} has none of the sampled episodes; go on with {typed_word('resume', path)} first"
        )
    edited = []
    if missing and complete:
        edited += [f"{missing} of {missing + len(repeated)} sampled rows are missing in {EPISODES}.csv."]
    if changed:
        edited += [f"{' and '.join(changed)} changed since the evaluation wrote them."]
    if missing and not complete:
        console.print(f"{missing} sampled rows are not in the files yet.", highlight=False)
    if differences:
        raise ConfigError("\n".join([_describe(path, differences, len(repeated)), *edited]))
    if edited:
        raise ConfigError(
            f"{path}: {' '.join(edited)}\n{len(repeated)} rows were repeated and came out the same; others "
            "may not be those of the evaluation. Evaluate again."
        )
    console.print(
        f"{len(repeated)} of {len(stored)} rows were repeated and came out the same.", highlight=False
    )


def _read_rows(path: Path, complete: bool) -> dict[tuple[str, str, str], dict[str, str]]:
    file = path / f"{EPISODES}.csv"
    if not file.exists() and not complete:
        raise ConfigError(f"{path} has no tables yet; go on with {typed_word('resume', path)} first")
    try:
        with file.open(newline="", encoding="utf-8") as opened:
            rows = list(csv.DictReader(opened))
        return {(row["policy"], row["episode"], row["agent"]): row for row in rows}
    except (OSError, KeyError, csv.Error, UnicodeDecodeError):
        raise ConfigError(f"{file} is missing or has no rows of episodes; evaluate again") from None


def _describe(path: Path, differences: Sequence[RowDifference], rows: int) -> str:
    wrong = {(one.policy, one.episode, one.agent) for one in differences}
    lines = [f"{path}: {len(wrong)} of {rows} repeated rows differ. The largest differences:"]
    for one in sorted(differences, key=difference_size, reverse=True)[:_SHOWN]:
        where = f"{one.policy}, episode {one.episode}, {one.column}"
        lines.append(f"  {where}: {one.stored} stored, {one.repeated} repeated")
    lines.append("Compare the versions and the hardware in provenance.json with those here.")
    return "\n".join(lines)


def difference_size(one: RowDifference) -> float:
    """How much a cell differs, relative to it; text counts as all of it."""
    try:
        stored, repeated = float(one.stored), float(one.repeated)
    except ValueError:
        return math.inf
    if math.isnan(stored) or math.isnan(repeated):
        return math.inf
    scale = max(abs(stored), abs(repeated))
    return abs(stored - repeated) / scale if scale else 0.0
