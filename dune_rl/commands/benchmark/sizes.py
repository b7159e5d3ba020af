"""Sizes: memory of a process and of a scene, the package as a wheel has it, and the start of each command."""

import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from dune_rl.commands.benchmark.measuring import (
    RandomActions,
    memory_mib,
    observe,
    start_simulation,
    time_in_turns,
)
from dune_rl.commands.pages import PAGES
from dune_rl.config.commands import BenchmarkConf
from dune_rl.core.paths import assets_folder, conf_folder, package_folder

# Control steps after which a process holds what a step needs.
_STEPS = 20


def measure_sizes(conf: BenchmarkConf) -> dict[str, Any]:
    """Memory [MiB], size of a wheel [MiB] and times [s] until each command has begun.

    `process_memory_mib` is that of a process with one scene, and `scene_memory_mib` what each of
    `conf.scenes` adds; both are measured in new processes, after some steps. `startup_s` has the median time
    of each command until it refuses a setting that it does not have: it has loaded what reading them needs.
    """
    one, several = (_memory_of(conf, scenes) for scenes in (1, max(conf.scenes, 2)))
    starts = {name: partial(_start_and_refuse, name) for name in sorted(PAGES)}
    times = time_in_turns(starts, min(conf.rounds, 3))
    return {
        "engine": conf.physics.backend,
        "process_memory_mib": one,
        "scene_memory_mib": (several - one) / (max(conf.scenes, 2) - 1),
        "wheel_mib": _wheel_bytes() / 2**20,
        "startup_s": {name: float(np.median(each)) for name, each in times.items()},
    }


def _memory_of(conf: BenchmarkConf, scenes: int) -> float:
    # A pool of one process, which has nothing of this one.
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(_step_some, (conf, scenes))


def _step_some(conf: BenchmarkConf, scenes: int) -> float:
    simulation = start_simulation(conf, scenes)
    actions = RandomActions(simulation)
    for _ in range(_STEPS):
        simulation.step(actions.draw())
        observe(simulation)
    held = memory_mib()
    simulation.close()
    return held


def _start_and_refuse(name: str) -> None:
    path = os.pathsep.join([str(package_folder().parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    ended = subprocess.run(
        [sys.executable, "-m", f"dune_rl.{name}", "no_such_setting=1"],
        capture_output=True,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    if ended.returncode != 2:
        raise RuntimeError(f"dune_rl.{name} ended with code {ended.returncode}: {ended.stderr.decode()}")


def _wheel_bytes() -> int:
    """Bytes of an archive of all that a wheel has, but for its description."""
    folders: Mapping[str, Any] = {"": package_folder(), "conf": conf_folder(), "assets": assets_folder()}
    with tempfile.TemporaryFile() as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, folder in folders.items():
            for path in sorted(folder.rglob("*")):
                inside = path.relative_to(folder)
                if path.is_file() and "__pycache__" not in inside.parts and "_data" not in inside.parts:
                    archive.write(path, f"{name}/{inside}")
        archive.close()
        return file.seek(0, os.SEEK_END)
