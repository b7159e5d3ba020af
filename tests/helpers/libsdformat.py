"""Gazebo's own checker of SDF and URDF files, where it is installed."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest


def assert_valid(path: Path, resources: Path) -> None:
    """Fail with the checker's words for a file that it does not take; skip without it.

    Models that the file includes are in the folder `resources`.
    """
    if shutil.which("ign") is None:
        pytest.skip("needs ign sdf (ignition-tools, libsdformat-dev)")
    # A URDF is checked by its conversion to SDF.
    flag = "-p" if path.suffix == ".urdf" else "-k"
    ran = subprocess.run(
        ["ign", "sdf", flag, str(path)],
        capture_output=True,
        text=True,
        env={**os.environ, "SDF_PATH": str(resources)},
        timeout=120,
    )
    # A library for traces of crashes is missing in some distributions.
    told = [line for line in (ran.stdout + ran.stderr).splitlines() if "backtrace" not in line]
    faults = [line for line in told if "Error" in line or "Warning" in line]
    assert ran.returncode == 0 and not faults, "\n".join(faults or told)
    assert flag == "-p" or "Valid." in told
