"""What importers advise: a unit or an up axis to try, and the reasons why a world has no ground."""

import warnings

import numpy as np
import pytest
import trimesh
from gazebo import include, model, sdf
from world_files import joined, yard

import dune_rl
from dune_rl.core.errors import WorldError
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf

ON_ITS_SIDE = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]


def advice(folder, scale: float = 1.0, turn: bool = False, kind: str = "stl", **settings) -> str:
    """The warnings and the error of the yard, scaled and turned."""
    mesh = joined(yard())
    if turn:
        mesh.apply_transform(ON_ITS_SIDE)
    mesh.apply_scale(scale)
    path = folder / f"yard.{kind}"
    (trimesh.Scene(mesh) if kind == "glb" else mesh).export(path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            build_mesh(MeshConf(path=str(path), **settings))
        except WorldError as error:
            return "\n".join([*(str(each.message) for each in caught), str(error)])
    return "\n".join(str(each.message) for each in caught)


@pytest.mark.slow
def test_a_mesh_in_millimetres_is_told_its_unit(tmp_path):
    text = advice(tmp_path, 1000.0)
    assert (
        "it is 20,000 by 16,000 by 1,8" in text and "world.unit_m=0.001 if the file's unit is a milli" in text
    )
    assert advice(tmp_path, 1000.0, unit_m=0.001) == ""


def test_a_mesh_that_is_too_small_is_told_a_larger_unit(tmp_path):
    text = advice(tmp_path, 0.001)
    assert "too little to drive on" in text and "if that is too small, try world.unit_m=1000" in text


@pytest.mark.slow
def test_a_mesh_on_its_side_is_told_the_axis(tmp_path):
    assert "as if it were on its side: try world.up=y" in advice(tmp_path, turn=True)
    assert advice(tmp_path, turn=True, up="y") == ""
    # A .glb is y up, unless told otherwise.
    assert "try world.up=z" in advice(tmp_path, kind="glb")
    assert advice(tmp_path, kind="glb", up="z") == ""
    text = advice(tmp_path, 1000.0, turn=True)
    assert "try world.up=y" in text and "world.unit_m=0.001" in text


def test_a_world_without_ground_says_what_was_left_out(tmp_path):
    path = tmp_path / "w.sdf"
    mesh = model("hall", "<mesh><uri>model://hall/hall.dae</uri></mesh>")
    path.write_text(sdf(include("https://fuel.gazebosim.org/1.0/o/models/Cave"), mesh))
    with pytest.raises(WorldError) as caught:
        build_sdf(SdfConf(path=str(path)))
    text = str(caught.value)
    assert "has nothing that a robot could stand on, since all of it was left out:" in text
    assert "models/Cave is left out; download its folder beside the file, and write model://FOLDER" in text
    assert "model://hall/hall.dae is missing" in text
    path.write_text(sdf())
    with pytest.raises(WorldError, match=r"stand on: it needs a plane, mesh or height map\.$"):
        build_sdf(SdfConf(path=str(path)))


def test_many_reasons_are_cut_short(tmp_path):
    path = tmp_path / "w.sdf"
    path.write_text(sdf(*(include(f"model://absent_{number}") for number in range(9))))
    with pytest.raises(WorldError, match="and 5 more such reports") as caught:
        build_sdf(SdfConf(path=str(path)))
    assert len(str(caught.value).splitlines()) == 6


def test_a_world_too_small_for_walkers_names_the_way_without(tmp_path):
    np.save(tmp_path / "m.npy", np.zeros((21, 21)))
    world = {"name": "heightmap", "path": str(tmp_path / "m.npy"), "size_m": [5.0, 5.0]}
    with pytest.raises(WorldError, match="take actors=none"):
        dune_rl.parallel_env(world=world)
    env = dune_rl.parallel_env(world=world, actors="none")
    env.reset(seed=0)
    env.close()
