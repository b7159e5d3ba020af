"""Reads sweeps of `dune_rl.train -m`: the parameters of each job, and its objective."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.untrusted_files import parse_yaml
from dune_rl.metrics.catalogue import CATALOGUE
from dune_rl.reporting.inputs import Note, Sweep, SweepJob, last_evaluation
from dune_rl.reporting.rows import is_number, read_rows

HISTORY = "metrics.csv"
_MULTIRUN, _OPTUNA = "multirun.yaml", "optimization_results.yaml"
_OVERRIDES, _HYDRA, _CONFIG = ".hydra/overrides.yaml", ".hydra/hydra.yaml", "config.yaml"


def is_sweep(path: Path) -> bool:
    """Whether `path` is the folder of a sweep: Hydra's or Optuna's file is there, or a job says so."""
    if (path / _MULTIRUN).exists() or (path / _OPTUNA).exists():
        return True
    modes = (_entry(job / _HYDRA, "hydra", "mode") for job in _job_folders(path))
    return any(str(mode).upper().endswith("MULTIRUN") for mode in modes)


def read_sweep(path: Path) -> tuple[Sweep, list[Note]]:
    """The sweep in `path`, and what is odd about it."""
    notes: list[Note] = []
    folders = _job_folders(path)
    metric, maximise = _goal(folders, path)
    jobs = [
        SweepJob(job, job.name, _parameters(job, notes), _objective(job, metric, notes)) for job in folders
    ]
    # A parameter that no job changes tells nothing.
    names = dict.fromkeys(name for job in jobs for name in job.parameters)
    varied = [name for name in names if len({job.parameters.get(name) for job in jobs}) > 1]
    for number, job in enumerate(jobs):
        own = {name: job.parameters[name] for name in varied if name in job.parameters}
        jobs[number] = replace(job, parameters=own or job.parameters)
    best = _best(jobs, _entry(path / _OPTUNA, "best_params"), maximise)
    return Sweep(path, "", metric, maximise, jobs, best), notes


def _job_folders(path: Path) -> list[Path]:
    try:
        folders = [each for each in path.iterdir() if (each / _OVERRIDES).is_file()]
    except OSError:
        return []
    # Jobs are numbered, and 10 comes after 9.
    return sorted(folders, key=lambda job: (_number(job.name), job.name))


def _number(name: str) -> int:
    digits = name.partition("_")[0]
    return int(digits) if digits.isascii() and digits.isdigit() else -1


def _goal(folders: list[Path], path: Path) -> tuple[str, bool]:
    """The metric that the sweep optimises, and whether more of it is better."""
    metric = str((_entry(folders[0] / _CONFIG, "objective") if folders else None) or "success")
    for file in (*(job / _HYDRA for job in folders[:1]), path / _MULTIRUN):
        direction = _entry(file, "hydra", "sweeper", "direction")
        if isinstance(direction, str):
            return metric, not direction.lower().endswith("minimize")
    return metric, next((one.better for one in CATALOGUE if one.metric == metric), None) != "lower"


def _parameters(job: Path, notes: list[Note]) -> dict[str, str]:
    words = read_yaml(job / _OVERRIDES)
    if not isinstance(words, list):
        notes.append(Note(job, f"{_OVERRIDES} is damaged; its parameters are not in the report"))
        return {}
    pairs = [str(word).partition("=") for word in words]
    return {name.lstrip("+~"): value for name, _, value in pairs}


def _objective(job: Path, metric: str, notes: list[Note]) -> float:
    """The mean of the metric in the job's last evaluation; NaN where there is none."""
    try:
        rows = read_rows(job / HISTORY, empty=None) if (job / HISTORY).exists() else []
    except ConfigError as error:
        notes.append(Note(job, str(error)))
        return math.nan
    last = last_evaluation(rows)
    names = [metric, *(one.name for one in CATALOGUE if one.metric == metric)]
    return next((float(last[name]) for name in names if is_number(last.get(name))), math.nan)


def _best(jobs: list[SweepJob], optuna: Any, maximise: bool) -> str | None:
    measured = [job for job in jobs if not math.isnan(job.objective)]
    if measured:
        return (max if maximise else min)(measured, key=lambda job: job.objective).name
    # Metrics that are no measures are in no history; Optuna has noted the best parameters.
    wanted = {str(name): str(value) for name, value in optuna.items()} if isinstance(optuna, dict) else {}
    found = (job.name for job in jobs if wanted and wanted.items() <= job.parameters.items())
    return next(found, None)


def _entry(file: Path, *keys: str) -> Any:
    """What a YAML file has below `keys`; None where it has nothing."""
    content = read_yaml(file)
    for key in keys:
        content = content.get(key) if isinstance(content, Mapping) else None
    return content


def read_yaml(file: Path) -> Any:
    """The content of a YAML file; None where it is missing or damaged."""
    if not file.is_file():
        return None
    try:
        return parse_yaml(file.read_bytes())
    except (OSError, ValueError):
        return None
