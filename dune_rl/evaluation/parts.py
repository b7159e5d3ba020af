"""Evaluations in parts, as of a Slurm array: which episodes a part has, and how parts become one."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from rich.console import Console

from dune_rl.config.commands import EvaluateConf
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import typed_word
from dune_rl.evaluation.blocks import FinishedEpisode, missing_blocks
from dune_rl.evaluation.folder import (
    PROVENANCE,
    ResultsFolder,
    check_free_for_results,
    read_provenance,
    read_settings,
)
from dune_rl.evaluation.protocols.report import finished_runs
from dune_rl.evaluation.provenance import check_same_sources, describe_provenance
from dune_rl.evaluation.run_plan import prepare_run, run_plan
from dune_rl.evaluation.running import EvaluationPlan

# What may differ between parts.
_OWN: dict[str, Any] = {"part": None, "out": None, "bag": None, "processes": 1, "overwrite": False}
# What the provenance of the whole has of each part's.
_KEPT = ("created", "command", "git", "packages", "python", "platform", "hardware")


def join_parts(path: Path, out: Path, console: Console, trusted: Collection[str] = ()) -> None:
    """Write to `out` the results of the whole of which the folders in `path` are the parts, and show them.

    Of users' functions only the `trusted` ones are run.
    Raises ConfigError where a part is missing or not complete, or is of another evaluation.
    """
    folders = (
        sorted(each for each in path.iterdir() if (each / PROVENANCE).is_file()) if path.is_dir() else []
    )
    if not folders:
        raise ConfigError(f"join={path} holds no parts; give the folder in which each part has its own")
    check_free_for_results(out, overwrite=False)
    settings = [read_settings(folder) for folder in folders]
    whole = settings[0].model_copy(update=_OWN)
    plan = EvaluationPlan.of_settings(whole)
    finished: dict[tuple[int, int], FinishedEpisode] = {}
    kept = {}
    for folder, conf in zip(folders, settings, strict=True):
        if conf.part is None or conf.model_copy(update=_OWN) != whole:
            raise ConfigError(f"{folder} is no part of the evaluation of {folders[0]}; take it out of {path}")
        provenance = read_provenance(folder)
        check_same_sources(plan, provenance, folder, trusted)
        kept[conf.part] = {key: provenance.get(key) for key in _KEPT}
        with ResultsFolder.reopen(folder) as part:
            finished |= part.finished
    _check_complete(plan, settings, folders, finished)
    prepared = prepare_run(plan)
    provenance = {**describe_provenance(plan), "parts": kept}
    with ResultsFolder.create(out, whole, provenance, overwrite=False) as results:
        for key in sorted(finished):
            results.add(finished[key])
        run_plan(plan, results, prepared, console, 1)


def _check_complete(
    plan: EvaluationPlan,
    settings: list[EvaluateConf],
    folders: list[Path],
    finished: dict[tuple[int, int], FinishedEpisode],
) -> None:
    done = finished.keys() if plan.conf.protocol is None else finished_runs(plan, finished.values())
    for conf, folder in zip(settings, folders, strict=True):
        of_part = plan.part_of(conf)
        if any((policy, number) not in done for policy in range(len(plan.sources)) for number in of_part):
            raise ConfigError(f"{folder} is not complete; go on with {typed_word('resume', folder)}")
    if missing := missing_blocks(len(plan.sources), plan.episodes, done, 1, 1):
        there = ", ".join(str(conf.part) for conf in settings)
        raise ConfigError(
            f"episode {missing[0].first} is in none of the parts {there}; evaluate the others too"
        )
