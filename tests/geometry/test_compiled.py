"""Compiled functions that are kept for later processes."""

import subprocess
import sys
from pathlib import Path

import pytest

HEAD = "from dune_rl.geometry.compiled import compile_function\n"
CALLEE = """LEAST = {least}

@compile_function
def called(value: float) -> float:
    return max(value, LEAST)
"""
CALLER = """from callee import called

@compile_function
def caller(value: float) -> float:
    return called(value) + 1.0

print(caller(0.0), sum(caller.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_kept_code_is_compiled_anew_when_a_constant_of_what_it_calls_has_changed(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(HEAD + CALLER)
    said = []
    for least in (1.0, 1.0, 5.0, 1.0):
        (tmp_path / "callee.py").write_text(HEAD + CALLEE.format(least=least))
        command = [sys.executable, "-B", str(tmp_path / "caller.py")]
        said.append(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert said == [["2.0", "0"], ["2.0", "1"], ["6.0", "0"], ["2.0", "1"]]
