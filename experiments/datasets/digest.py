"""Prints a row for a local Minari dataset: its extent, its driver's success, and a digest of its content.

`python experiments/datasets/digest.py NAME ...`; the digest is SHA-256 over the arrays of all episodes in
their order, each by name, type and shape, so that it does not depend on how HDF5 stores them.
"""

import csv
import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import minari
import numpy as np
from minari.storage.datasets_root_dir import get_dataset_path

_PARTS = ("observations", "actions", "rewards", "terminations", "truncations", "infos")


def _arrays(values: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(values, dict):
        for key in sorted(values):
            yield from _arrays(values[key], f"{name}/{key}")
    else:
        yield name, np.ascontiguousarray(values)


def main(names: list[str]) -> None:
    """Write the rows as CSV."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(["dataset", "driver", "episodes", "transitions", "success", "mib", "commit", "sha256"])
    for name in names:
        dataset, digest = minari.load_dataset(name), hashlib.sha256()
        success = 0.0
        for episode in dataset:
            success += float(episode.infos["success"][-1])
            for part in _PARTS:
                for label, array in _arrays(getattr(episode, part), part):
                    digest.update(f"{label} {array.dtype} {array.shape}".encode() + array.tobytes())
        origin = dataset.storage.metadata["dune_rl"]
        file = Path(get_dataset_path(name)) / "data" / "main_data.hdf5"
        row = [name, origin["policy"]["name"], dataset.total_episodes, dataset.total_steps]
        row += [f"{success / dataset.total_episodes:.3f}", f"{file.stat().st_size / 2**20:.0f}"]
        writer.writerow([*row, origin["git"]["commit"][:12], digest.hexdigest()])


if __name__ == "__main__":
    main(sys.argv[1:])
