"""The sites of the sets are, on this machine, those on which the studies were made."""

import csv
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import yaml

from dune_rl.evaluation.recorder import steepest_slope_deg
from dune_rl.worlds.registry import WORLDS

REFERENCES = Path(__file__).parents[2] / "experiments" / "sets" / "references"
SITES = 8


@pytest.mark.slow(all_but=["island", "inspection"])
@pytest.mark.parametrize("family", ["inspection", "construction", "rubicon", "island"])
def test_sites_are_those_of_the_studies(family: str) -> None:
    # Sites with far goals may be larger than those of the family's other sets.
    rows: dict[tuple[str, str], list[dict[str, str]]] = defaultdict(list)
    for folder in sorted(REFERENCES.glob(f"{family}*")):
        settings = yaml.safe_load((folder / "config.yaml").read_text())["world"] | {"seed": None}
        table = list(csv.DictReader((folder / "episodes.csv").read_text().splitlines()))
        for row in table:
            if row["policy"] == table[0]["policy"]:
                rows[row["world_seed"], json.dumps(settings)].append(row)
        assert len({row["world_seed"] for row in table}) == 50
    differences = []
    first = set(sorted({seed for seed, _ in rows})[:SITES])
    for (seed, settings), episodes in rows.items():
        if seed not in first:
            continue
        terrain = WORLDS.build(WORLDS.parse_settings(json.loads(settings) | {"seed": int(seed)})).terrain
        start, goal = (
            np.array([[float(row[f"{end}_x_m"]), float(row[f"{end}_y_m"])] for row in episodes])
            for end in ("start", "goal")
        )
        then = np.array([float(row["slope_deg"]) for row in episodes])
        differences += (steepest_slope_deg(terrain, start, goal) - then).tolist()
    # A point on the edge between two triangles of the ground may count to either of them.
    same = np.abs(differences) < 1e-6
    assert len(same) >= 4 * 2 * SITES
    assert same.mean() > 0.95
