"""Damaged files: the importers give a world or a `WorldError`, never another error, a crash or a hang.

Each case runs in a process of its own, with little memory and time, which a crash would end.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from world_files import SHARED_WORLDS

KINDS = ("obj", "stl", "ply", "glb", "dae", "sdf", "tif", "png", "npy")

# Runs in the other process: arguments are a folder, kinds, and the seeds from and to.
RUNNER = """
import resource, signal, sys, warnings
from pathlib import Path
import numpy as np
from fuzzing import mutated, seed_file
from dune_rl.core.errors import WorldError
folder, kinds, first, last = sys.argv[1], sys.argv[2].split(","), int(sys.argv[3]), int(sys.argv[4])
warnings.simplefilter("ignore")
for kind in kinds:
    (Path(folder) / kind).mkdir()
    build, path, data = seed_file(f"{folder}/{kind}", kind)
    build()
    # Address space, as memory itself cannot be limited.
    resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))
    worlds = errors = 0
    for seed in range(first, last):
        print(kind, "seed", seed, flush=True)
        path.write_bytes(mutated(data, np.random.default_rng([seed, len(kind)]), kind))
        signal.alarm(60)
        try:
            build()
            worlds += 1
        except WorldError as error:
            assert len(str(error).splitlines()) <= 2 and len(str(error)) < 900, str(error)
            errors += 1
        signal.alarm(0)
    print("done", kind, worlds, errors)
"""


def fuzz(folder: Path, kinds: str, first: int, last: int) -> dict[str, tuple[int, int]]:
    """How many of the seeds gave a world, and how many an error, for each kind."""
    done = subprocess.run(
        [sys.executable, "-c", RUNNER, str(folder), kinds, str(first), str(last)],
        capture_output=True,
        text=True,
        timeout=1800,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    lines = done.stdout.splitlines()
    assert done.returncode == 0, f"{lines[-1:]}: {done.returncode}\n{done.stderr[-3000:]}"
    counts = [line.split()[1:] for line in lines if line.startswith("done")]
    return {kind: (int(worlds), int(errors)) for kind, worlds, errors in counts}


@pytest.mark.slow
@pytest.mark.parametrize("kinds", ["obj,stl,ply", "glb,dae,sdf", "tif,png,npy"])
def test_damaged_files_are_refused_or_read(tmp_path, kinds):
    found = fuzz(tmp_path, kinds, 0, 20)
    assert list(found) == kinds.split(",")
    for worlds, errors in found.values():
        assert worlds + errors == 20
        # Both happen, or the damage is too little or too much to try anything.
        assert worlds > 0
        assert errors > 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_files_are_refused_or_read(tmp_path, kind):
    assert sum(fuzz(tmp_path, kind, 1000, 1400)[kind]) == 400


@pytest.mark.slow
@pytest.mark.skipif(not SHARED_WORLDS.is_dir(), reason="the worlds of others are not here")
@pytest.mark.parametrize("kind", ["agriculture", "marsyard"])
def test_damaged_real_worlds_are_refused_or_read(tmp_path, kind):
    assert sum(fuzz(tmp_path, kind, 0, 40)[kind]) == 40
