"""The robots' meshes: that they are ours, and where the figures come from."""

from collections.abc import Callable
from runpy import run_path

import numpy as np
import pytest
import trimesh

from dune_rl.core.paths import assets_folder

ROBOTS = run_path(str(assets_folder() / "robots" / "draw_meshes.py"))["ROBOTS"]


@pytest.mark.parametrize(("robot", "shapes"), ROBOTS.items(), ids=ROBOTS)
def test_its_meshes_are_those_that_its_script_draws(robot: str, shapes: Callable[[], dict]):
    folder = assets_folder() / "robots" / robot / "meshes"
    drawn = shapes()
    assert {path.name for path in folder.iterdir()} == {f"{name}.stl" for name in drawn}
    for name, mesh in drawn.items():
        stored = trimesh.load(folder / f"{name}.stl", process=False)
        np.testing.assert_allclose(stored.triangles, mesh.triangles, atol=1e-6)


@pytest.mark.parametrize("robot", ROBOTS)
def test_where_it_comes_from_and_its_licence_are_told(robot: str):
    folder = assets_folder() / "robots" / robot
    assert "our own" in (folder / "PROVENANCE.md").read_text()
    assert "MIT" in (folder / "LICENSE").read_text()
