"""Textures of mesh files: shown on ground and things, and warned of where they cannot be."""

import re
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image
from world_files import (
    dae_text,
    obj_text,
    yard,
)

from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh


def picture(folder, name="paint.png") -> None:
    # Left half red, right half blue.
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:, :4], pixels[:, 4:] = (200, 20, 20), (20, 20, 200)
    Image.fromarray(pixels).save(folder / name)


def test_textures_colour_ground_and_things(tmp_path):
    picture(tmp_path)
    path = tmp_path / "yard.dae"
    path.write_text(dae_text(yard(), unit='<unit meter="1"/>', axis="Z_UP", picture="paint.png"))
    world = build_mesh(MeshConf(path=str(path)))
    # The texture is laid over x from -10 to 10.
    crate = next(prop for prop in world.props if prop.kind == "crate")
    bench = next(prop for prop in world.props if prop.kind == "bench")
    assert crate.colour == pytest.approx((20 / 255, 20 / 255, 200 / 255), abs=0.01)
    assert bench.colour == pytest.approx((200 / 255, 20 / 255, 20 / 255), abs=0.01)
    assert crate.face_colours.shape == (len(crate.faces), 3)
    colours = world.picture.colours
    columns = colours.shape[1]
    assert colours[:, : int(0.45 * columns), 0].min() > 0.7
    assert colours[:, int(0.55 * columns) :, 2].min() > 0.7
    # The ground's one look is the mean of both.
    assert world.ground.low[0] == pytest.approx(world.ground.low[2], abs=0.02)


def test_textures_of_obj_and_glb_and_colours_of_vertices(tmp_path):
    picture(tmp_path)
    (tmp_path / "paint.mtl").write_text("newmtl paint\nKd 1 1 1\nmap_Kd paint.png\n")
    quad = "v -5 -5 0\nv 5 -5 0\nv 5 5 0\nv -5 5 0\nvt 0.6 0\nvt 1 0\nvt 1 1\nvt 0.6 1\n"
    (tmp_path / "q.obj").write_text(
        f"mtllib paint.mtl\no q\n{quad}usemtl paint\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    blue = build_mesh(MeshConf(path=str(tmp_path / "q.obj"))).picture.colours
    np.testing.assert_allclose(blue.reshape(-1, 3).mean(axis=0), [20 / 255, 20 / 255, 200 / 255], atol=0.01)
    trimesh.load_scene(tmp_path / "q.obj", process=False).export(tmp_path / "q.glb")
    up = build_mesh(MeshConf(path=str(tmp_path / "q.glb"), up="z")).picture.colours
    np.testing.assert_allclose(up.reshape(-1, 3).mean(axis=0), [20 / 255, 20 / 255, 200 / 255], atol=0.01)
    sheet = trimesh.Trimesh([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]], [[0, 1, 2], [0, 2, 3]])
    sheet.visual.vertex_colors = [51, 102, 153, 255]
    sheet.export(tmp_path / "c.ply")
    own = build_mesh(MeshConf(path=str(tmp_path / "c.ply"))).ground
    np.testing.assert_allclose(np.mean([own.low, own.high], axis=0), [0.2, 0.4, 0.6], atol=0.01)


@pytest.mark.slow(all_but=["obj-*"])
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing.png", "missing.png is missing"),
        ("../secret.png", "'../secret.png' leads out of the folder|../secret.png leads out of the folder"),
        ("/etc/hostname", "/etc/hostname leads out of the folder"),
        ("file:///etc/hostname", "leads out of the folder"),
        ("link.png", "link.png leads out of the folder"),
        ("bomb.png", "bomb.png is left out: it is no picture"),
        ("text.png", "text.png is left out: it is no picture"),
        (".", "is missing"),
    ],
)
@pytest.mark.parametrize("kind", ["dae", "obj"])
def test_textures_that_cannot_be_had_are_warnings(tmp_path, kind, name, said):
    folder = tmp_path / "world"
    folder.mkdir()
    picture(tmp_path, "secret.png")
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    (folder / "text.png").write_text("no picture")
    (folder / "bomb.png").write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"\0\0\0\rIHDR"
        + struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
        + b"\0" * 40
    )
    path = folder / f"q.{kind}"
    if kind == "dae":
        path.write_text(dae_text(yard(), unit='<unit meter="1"/>', axis="Z_UP", picture=name))
    else:
        (folder / "q.mtl").write_text(f"newmtl paint\nmap_Kd {name}\n")
        path.write_text(obj_text(yard(), "mtllib q.mtl", "paint"))
    with pytest.warns(WorldWarning, match=said) as caught:
        world = build_mesh(MeshConf(path=str(path)))
    assert len([w for w in caught if re.search(said, str(w.message))]) == 1
    assert len(world.props) == 2
