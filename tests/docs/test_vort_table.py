"""The table of VORT at several thresholds is that of the study's episodes."""

import csv
from pathlib import Path

import generated_pages
import pytest
from vort_table import EPISODES, vort_table

from dune_rl.core.files import write_csv

README = EPISODES.parent / "README.md"
TIMES = {"uneven_2": 4.0, "uneven_time": 3.0, "uneven_10": 2.0, "uneven_15": 1.0}
NAN = float("nan")


def test_the_study_shows_the_table_of_its_episodes() -> None:
    table = vort_table()
    assert table in README.read_text(encoding="utf-8")
    assert generated_pages.generated_part("vort", 2) == table
    rows = list(csv.DictReader(EPISODES.read_text(encoding="utf-8").splitlines()))
    for policy in ("inspection", "go_to_goal"):
        mine = [float(row["vort"]) for row in rows if row["policy"] == policy]
        seen = [value for value in mine if value == value]
        assert len(mine) == 100
        (line,) = (line for line in table.splitlines() if line.startswith("| 5° |"))
        assert f" {sum(seen) / len(seen):.2f} (" in line and f" {len(seen)}, " in line


def test_the_table_is_of_the_file(folder: Path) -> None:
    speeds = [
        {"vort_2": 0.5, "vort": 0.5},
        {"vort_2": 0.7, "vort": 0.9},
        {"vort_2": 0.3, "vort": NAN},
        {"vort_2": 0.5, "vort": NAN},
    ]
    rows = [
        {"policy": "p", "set": "s", "world": "w", "world_seed": 1, "episode": number}
        | {**speed, "vort_10": 0.25, "vort_15": NAN, **TIMES}
        for number, speed in enumerate(speeds)
    ]
    write_csv(folder / "episodes.csv", rows)
    lines = vort_table(folder / "episodes.csv").splitlines()
    assert lines[0] == "| threshold | p: VORT [m/s] | p: episodes, mean time |"
    assert lines[2].startswith("| 2° | 0.50 (") and lines[2].endswith("| 4, 4.0 s |")
    assert lines[3].startswith("| 5° | 0.70 |"), "two episodes have no interval"
    assert lines[3].endswith("| 2, 3.0 s |")
    assert lines[4] == "| 10° | 0.25 (0.25 to 0.25) | 4, 2.0 s |"
    assert lines[5] == "| 15° | - | 0, 1.0 s |"


def test_a_study_without_the_metrics_is_an_error(folder: Path) -> None:
    write_csv(
        folder / "episodes.csv", [{"policy": "p", "set": "s", "world": "w", "world_seed": 1, "episode": 0}]
    )
    with pytest.raises(KeyError):
        vort_table(folder / "episodes.csv")
