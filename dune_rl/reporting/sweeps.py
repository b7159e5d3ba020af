"""Reads sweeps of `dune_rl.train -m`: the parameters of each job, and its objective."""

import math
from pathlib import Path
from typing import Any

import yaml

from dune_rl.core.errors import ConfigError
from dune_rl.metrics.catalogue import CATALOGUE
from dune_rl.reporting.csv_rows import is_number, read_rows
from dune_rl.reporting.runs import Note, Sweep, SweepJob, last_evaluation

MULTIRUN, OPTUNA = "multirun.yaml", "optimization_results.yaml"
_OVERRIDES, _HYDRA = ".hydra/overrides.yaml", ".hydra/hydra.yaml"
_HISTORY, _CONFIG = "metrics.csv", "config.yaml"


def is_sweep(path: Path) -> bool:
    """Whether `path` is the folder of a sweep: Hydra's or Optuna's file is there, or a job says so."""
    if (path / MULTIRUN).exists() or (path / OPTUNA).exists():
        return True
    return any(_is_job(job) for job in _job_folders(path))


def read_sweep(path: Path) -> tuple[Sweep, list[Note]]:
    """The sweep in `path`, and what is odd about it."""
    notes: list[Note] = []
    folders = _job_folders(path)
    found = _read_yaml(path / OPTUNA) or {}
    metric, maximise = _goal(folders, path)
    jobs = [
        SweepJob(job, job.name, _parameters(job, notes), _objective(job, metric, notes)) for job in folders
    ]
    # A parameter that no job changes tells nothing.
    names = dict.fromkeys(name for job in jobs for name in job.parameters)
    varied = [name for name in names if len({job.parameters.get(name) for job in jobs}) > 1]
    jobs = [
        SweepJob(
            job.path,
            job.name,
            {name: job.parameters[name] for name in varied if name in job.parameters} or job.parameters,
            job.objective,
        )
        for job in jobs
    ]
    return Sweep(path, "", metric, maximise, jobs, _best(jobs, found, maximise)), notes


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


def _is_job(job: Path) -> bool:
    content = _read_yaml(job / _HYDRA)
    hydra = content.get("hydra") if isinstance(content, dict) else None
    return isinstance(hydra, dict) and str(hydra.get("mode", "")).upper().endswith("MULTIRUN")


def _goal(folders: list[Path], path: Path) -> tuple[str, bool]:
    """The metric that the sweep optimises, and whether more of it is better."""
    metric = "success"
    if folders and isinstance(config := _read_yaml(folders[0] / _CONFIG), dict):
        metric = str(config.get("objective", metric))
    files = [job / _HYDRA for job in folders[:1]] + [path / MULTIRUN]
    direction = next(filter(None, map(_direction, files)), None)
    if direction is not None:
        return metric, not direction.lower().endswith("minimize")
    better = next((one.better for one in CATALOGUE if one.metric == metric), None)
    return metric, better != "lower"


def _direction(file: Path) -> str | None:
    content = _read_yaml(file)
    hydra = content.get("hydra") if isinstance(content, dict) else None
    sweeper = hydra.get("sweeper") if isinstance(hydra, dict) else None
    direction = sweeper.get("direction") if isinstance(sweeper, dict) else None
    return direction if isinstance(direction, str) else None


def _parameters(job: Path, notes: list[Note]) -> dict[str, str]:
    words = _read_yaml(job / _OVERRIDES)
    if not isinstance(words, list):
        notes.append(Note(job, f"{_OVERRIDES} is damaged; its parameters are not in the report"))
        return {}
    pairs = [str(word).partition("=") for word in words]
    return {name.lstrip("+~"): value for name, _, value in pairs}


def _objective(job: Path, metric: str, notes: list[Note]) -> float:
    """The mean of the metric in the job's last evaluation; NaN where there is none."""
    try:
        rows = read_rows(job / _HISTORY, empty=None) if (job / _HISTORY).exists() else []
    except ConfigError as error:
        notes.append(Note(job, str(error)))
        return math.nan
    last = last_evaluation(rows)
    names = [metric, *(one.name for one in CATALOGUE if one.metric == metric)]
    for name in names:
        if is_number(last.get(name)):
            return float(last[name])
    return math.nan


def _best(jobs: list[SweepJob], found: Any, maximise: bool) -> str | None:
    measured = [job for job in jobs if not math.isnan(job.objective)]
    if measured:
        return (max if maximise else min)(measured, key=lambda job: job.objective).name
    # Metrics that are no measures are in no history; Optuna has noted the best parameters.
    best = found.get("best_params") if isinstance(found, dict) else None
    if isinstance(best, dict):
        wanted = {str(name): str(value) for name, value in best.items()}
        for job in jobs:
            if all(job.parameters.get(name) == value for name, value in wanted.items()):
                return job.name
    return None


def _read_yaml(file: Path) -> Any:
    if not file.is_file():
        return None
    try:
        return yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError):
        return None
