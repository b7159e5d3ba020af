"""The sites of the sets are, on this machine, those on which the studies were made."""

import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from dune_rl.evaluation.recorder import steepest_slope_deg
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.world import World

REFERENCES = Path(__file__).parents[2] / "experiments" / "sets" / "references"
SITES = 8


def build(name: str, seed: str) -> World:
    settings = WORLDS.settings_class(name)
    assert settings is not None
    return WORLDS.build(settings(seed=int(float(seed))))


@pytest.mark.parametrize("family", ["inspection", "construction", "rubicon", "island"])
def test_sites_are_those_of_the_studies(family: str) -> None:
    rows: dict[str, list[dict[str, str]]] = defaultdict(list)
    for folder in sorted(REFERENCES.glob(f"{family}*")):
        table = list(csv.DictReader((folder / "episodes.csv").read_text().splitlines()))
        for row in table:
            if row["policy"] == table[0]["policy"]:
                rows[row["world_seed"]].append(row)
    assert len(rows) == 50
    differences = []
    for seed in sorted(rows)[:SITES]:
        terrain = build(family, seed).terrain
        start, goal = (
            np.array([[float(row[f"{end}_x_m"]), float(row[f"{end}_y_m"])] for row in rows[seed]])
            for end in ("start", "goal")
        )
        then = np.array([float(row["slope_deg"]) for row in rows[seed]])
        differences += (steepest_slope_deg(terrain, start, goal) - then).tolist()
    # A point on the edge between two triangles of the ground may count to either of them.
    same = np.abs(differences) < 1e-6
    assert len(same) >= 4 * 2 * SITES
    assert same.mean() > 0.95
