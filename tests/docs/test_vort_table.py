"""The table of VORT at several thresholds is that of the study's file."""

import csv
import re
from pathlib import Path

import generated_pages
from vort_table import SUMMARY, vort_table

README = SUMMARY.parent / "README.md"


def test_the_study_shows_the_table_of_its_file() -> None:
    table = vort_table()
    assert table in README.read_text(encoding="utf-8")
    assert generated_pages.generated_part("vort", 2) == table
    rows = list(csv.DictReader(SUMMARY.read_text(encoding="utf-8").splitlines()))
    counts = {int(row["count"]) for row in rows if row["measure"] == "SR"}
    assert counts == {100}
    for row in rows:
        if row["measure"] in ("VORT", "vort_2", "vort_10", "vort_15"):
            assert f"{float(row['value']):.2f} (" in table


def test_the_table_is_of_the_file(tmp_path: Path) -> None:
    lines = ["policy,measure,value,low,high,count"]
    for number, threshold in enumerate((2, 5, 10, 15)):
        speed, time = ("VORT", "uneven") if threshold == 5 else (f"vort_{threshold}", f"uneven_{threshold}")
        lines += [f"p,{speed},0.{number}1,0.1,0.9,{90 - number}", f"p,{time},{number}.04,0,9,100"]
    summary = tmp_path / "summary.csv"
    summary.write_text("\n".join(lines))
    rows = vort_table(summary).splitlines()
    assert rows[2] == "| 2° | 0.01 (0.10 to 0.90) | 90, 0.0 s |"
    assert rows[5] == "| 15° | 0.31 (0.10 to 0.90) | 87, 3.0 s |"
    assert re.fullmatch(r"\|(---\|){3}", rows[1])
