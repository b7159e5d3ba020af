"""Reads very many damaged files of every format, and writes what each of them did.

`python experiments/reliability/strangers.py FOLDER [mutants=10000] [first=0] [minutes=60] [kinds=obj,stl]`
reads the formats in turns of 500 files, until each has so many or the time is over, and goes on with what
`FOLDER/strangers.csv` has. A row is a format; the numbers and faults of its defects are in
`FOLDER/strangers_defects.csv`. Number N of a format is the same file at every call.
"""

import csv
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

# The samples and the watch are those of the tests.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "helpers"))

from strangers.samples import SAMPLES
from strangers.watch import ACCEPTED, DEFECT, REFUSED, Outcome, count_attacks, run_damaged

from dune_rl.core.files import read_csv, write_csv
from dune_rl.core.machine import short_commit

_TURN = 500
COLUMNS = ("format", "attacks", "mutants", ACCEPTED, REFUSED, "defects", "most_s", "most_mib", "commit")


def read_rows(file: Path) -> dict[str, dict[str, str]]:
    """The rows of `strangers.csv` by format; none without the file."""
    return {row["format"]: row for row in read_csv(file)}


def _read_turn(kind: str, numbers: Sequence[int]) -> list[Outcome]:
    with tempfile.TemporaryDirectory() as folder:
        return list(run_damaged(SAMPLES[kind], numbers, Path(folder)))


def _add(before: Mapping[str, str], kind: str, attacks: int, found: Sequence[Outcome]) -> dict[str, str]:
    counts = Counter(one.result for one in found)
    names = {
        "mutants": len(found),
        ACCEPTED: counts[ACCEPTED],
        REFUSED: counts[REFUSED],
        "defects": counts[DEFECT],
    }
    sums = {name: str(int(before.get(name, 0)) + number) for name, number in names.items()}
    most_s = max(float(before.get("most_s", 0)), *(one.seconds for one in found))
    most_mib = max(float(before.get("most_mib", 0)), *(one.grown_mb for one in found))
    row = {
        "format": kind,
        "attacks": str(attacks),
        **sums,
        "most_s": f"{most_s:.1f}",
        "most_mib": f"{most_mib:.0f}",
        "commit": short_commit(),
    }
    return {name: row[name] for name in COLUMNS}


def main(folder: Path, mutants: int, first: int, minutes: float, kinds: Sequence[str]) -> None:
    """Read damaged files in turns, and write the tables after each turn."""
    folder.mkdir(parents=True, exist_ok=True)
    file, faults = folder / "strangers.csv", folder / "strangers_defects.csv"
    rows, end = read_rows(file), time.monotonic() + 60.0 * minutes
    attacks: dict[str, int] = {}
    while time.monotonic() < end:
        left = [kind for kind in kinds if int(rows.get(kind, {}).get("mutants", 0)) < mutants]
        if not left:
            return
        for kind in left:
            done = int(rows.get(kind, {}).get("mutants", 0))
            if kind not in attacks:
                with tempfile.TemporaryDirectory() as place:
                    attacks[kind] = count_attacks(SAMPLES[kind], Path(place))
            found = _read_turn(kind, range(first + done, first + min(mutants, done + _TURN)))
            rows[kind] = _add(rows.get(kind, {}), kind, attacks[kind], found)
            write_csv(file, [rows[each] for each in SAMPLES if each in rows])
            with faults.open("a", newline="", encoding="utf-8") as opened:
                writer = csv.writer(opened)
                writer.writerows([kind, one.number, one.detail] for one in found if one.result == DEFECT)
            if time.monotonic() > end:
                break


if __name__ == "__main__":
    place, *words = sys.argv[1:]
    given = dict(word.split("=", 1) for word in words)
    main(
        Path(place),
        int(given.get("mutants", 10_000)),
        int(given.get("first", 0)),
        float(given.get("minutes", 60)),
        given["kinds"].split(",") if "kinds" in given else list(SAMPLES),
    )
