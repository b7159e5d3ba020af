"""Plants the faults of `bugs.toml` in a copy of the checkout, one at a time, and tells which tests find them.

python tests/planted_bugs/run.py [NAME...] [--checkout FOLDER] [--likely] [--out FILE]
"""

import argparse
import csv
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
COLUMNS = ("bug", "file", "breaks", "found", "by", "seconds")
# Enough for the whole suite, and for a few files of it, on a busy machine.
LIMIT_S, LIKELY_LIMIT_S = 3_600.0, 300.0


def copy_of(checkout: Path, folder: Path) -> Path:
    """The checkout's tree in `folder`, with compiled functions and their times, but without its history."""
    ignored = shutil.ignore_patterns(".git", ".venv", "_build", "runs", "outputs", ".pytest_cache")
    return Path(shutil.copytree(checkout, folder / "project", ignore=ignored))


def place_of(bug: dict[str, Any], project: Path) -> Path:
    """The file with the bug's text: the one that is named or, if the text has moved, the only one."""
    named = project / bug["file"]
    files = [named] if named.is_file() else []
    found = [
        file
        for file in files or sorted((project / "dune_rl").rglob("*.py"))
        if bug["text"] in file.read_text()
    ]
    if len(found) != 1 or found[0].read_text().count(bug["text"]) != 1:
        raise SystemExit(f"{bug['file']} does not have the text once: {bug['text']}")
    return found[0]


def first_failure(project: Path, tests: list[str], limit_s: float) -> str:
    """The first of these default tests that fails, or nothing."""
    present = [test for test in tests if (project / test.partition("::")[0]).exists()]
    if not present:
        raise SystemExit(f"the checkout has none of {', '.join(tests)}")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *present]
    environment = {**os.environ, "PYTHONPATH": str(project), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command,
            cwd=project,
            env=environment,
            capture_output=True,
            text=True,
            timeout=limit_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "a test that does not end"
    if done.returncode in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        return ""
    told = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return told[1] if told else done.stdout[-300:] + done.stderr[-300:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="bugs of the list; without any, all")
    parser.add_argument("--checkout", type=Path, default=HERE.parents[1])
    parser.add_argument("--likely", action="store_true", help="run the likely tests only")
    parser.add_argument("--out", type=Path, help="a CSV file, to which a row for each bug is added")
    asked = parser.parse_args()
    bugs = tomllib.loads((HERE / "bugs.toml").read_text())
    if unknown := set(asked.names) - set(bugs):
        parser.error(f"there are no bugs {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory() as folder:
        project = copy_of(asked.checkout, Path(folder))
        for name in asked.names or bugs:
            bug = bugs[name]
            file = place_of(bug, project)
            text, times = file.read_text(), file.stat()
            begin = time.monotonic()
            try:
                file.write_text(text.replace(bug["text"], bug["replacement"]))
                by = first_failure(project, bug["tests"], LIKELY_LIMIT_S)
                if not by and not asked.likely:
                    by = first_failure(project, ["tests"], LIMIT_S)
            finally:
                file.write_text(text)
                # Compiled functions are kept by the times of their files.
                os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
            seconds = f"{time.monotonic() - begin:.0f}"
            print(f"{name}: {f'found by {by}' if by else 'not found'} ({seconds} s)", flush=True)
            if asked.out is not None:
                is_new = not asked.out.exists()
                with asked.out.open("a", newline="") as out:
                    rows = csv.writer(out)
                    if is_new:
                        rows.writerow(COLUMNS)
                    rows.writerow((name, bug["file"], bug["breaks"], "yes" if by else "no", by, seconds))


if __name__ == "__main__":
    main()
