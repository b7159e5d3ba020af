"""How long a policy takes from a message to its command over DDS, between two processes on this machine.

`python experiments/speed/live_topics.py FOLDER [seconds=60]` runs a scene in real time, drives it from
another process with the published policy of flat ground, and adds a row to `FOLDER/live_topics.csv`.
"""

import os
import re
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from dune_rl.core.files import read_csv, write_csv
from dune_rl.core.machine import short_commit

_POLICY = Path(__file__).parents[1] / "flat" / "seed1" / "policy.pt"
# One that nobody else is likely to use.
_DOMAIN = 137
_SUMMARY = re.compile(r"([\d,]+) decisions in ([\d.]+) s .*command ([\d.]+) ms \(median\), ([\d.]+) ms")


@dataclass
class Row:
    """`decisions` of `seconds`, and times [ms] from the newest message to the command: median and 95 %.

    `load` is the mean number of processes that ran or waited for a core in the last minute.
    """

    decisions: int
    seconds: float
    median_ms: float
    late_ms: float
    cores: int
    load: float
    commit: str


def main(folder: Path, seconds: float) -> None:
    """Drive for some seconds, and add a row."""
    common = [f"checkpoint={_POLICY}", f"domain={_DOMAIN}"]
    scene = subprocess.Popen([sys.executable, "-m", "dune_rl.ros", *common, "actors=none", "on_end=reset"])
    try:
        words = ["-m", "dune_rl.drive", *common, f"duration_s={seconds}", "wait_s=120"]
        driven = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True)
    finally:
        scene.terminate()
        scene.wait()
    found = _SUMMARY.search(driven.stdout + driven.stderr)
    if found is None:
        sys.exit(f"the driver ended without a summary: {driven.stdout}{driven.stderr}")
    decisions, took_s, median_ms, late_ms = (float(each.replace(",", "")) for each in found.groups())
    row = Row(
        int(decisions), took_s, median_ms, late_ms, os.cpu_count() or 0, os.getloadavg()[0], short_commit()
    )
    file = folder / "live_topics.csv"
    write_csv(file, [*read_csv(file), asdict(row)])
    print(row)


if __name__ == "__main__":
    given = dict(word.split("=", 1) for word in sys.argv[2:])
    main(Path(sys.argv[1]), float(given.get("seconds", 60)))
