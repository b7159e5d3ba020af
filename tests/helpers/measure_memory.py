"""Measures the memory of a process with 16 scenes, part by part, and the time that making them takes.

`python tests/helpers/measure_memory.py OUT.csv [WORD ...]` writes how many MiB become resident with each part
of a process with inspection scenes; words such as `physics=dart` or `world=mesh world.path=FILE` change them.
It runs on older code too (with `PYTHONPATH` on that checkout).
"""

import csv
import importlib
import os
import sys
import time
import warnings
from pathlib import Path


def resident_mib() -> float:
    """Resident memory of this process [MiB]; Linux only."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    """Write the CSV file named on the command line."""
    rows, before = [], resident_mib()

    def note(part: str) -> None:
        nonlocal before
        now = resident_mib()
        rows.append((part, round(now - before)))
        before = now

    rows.append(("Python", round(before)))
    for part, modules in (
        ("import torch", ["torch"]),
        ("import torchrl", ["torchrl", "torchrl.envs"]),
        ("import scipy, numba", ["scipy.ndimage", "scipy.spatial.transform", "numba"]),
        ("import trimesh", ["trimesh"]),
        ("import dune_rl", ["dune_rl", "dune_rl.config.build", "dune_rl.env.torchrl"]),
    ):
        for module in modules:
            importlib.import_module(module)
        note(part)
    import torch

    import dune_rl

    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    words = sys.argv[2:]
    if any(word.startswith("world.path=") for word in words):
        # Once, so that what follows is the cost of the scenes.
        dune_rl.make("inspection", 1, overrides=words).close()
        note("importing a world")
    start = time.perf_counter()
    env = dune_rl.make("inspection", 16, seed=0, overrides=words)
    seconds = time.perf_counter() - start
    note("16 scenes")
    now = env.reset()
    for _ in range(200):
        _, now = env.step_and_maybe_reset(env.rand_action(now))
    note("reset and 200 steps")
    rows.append(("together", round(resident_mib())))
    rows.append(("seconds to make 16 scenes", round(seconds, 1)))
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("part", "resident_mib"), *rows])


if __name__ == "__main__":
    main()
