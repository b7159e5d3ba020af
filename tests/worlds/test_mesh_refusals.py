"""Mesh files that are damaged or hostile: refused in words, or mended with a warning."""

import json
import math
import os
import struct

import numpy as np
import pytest
import trimesh
from mesh_worlds import FORMATS
from world_files import (
    box,
    dae_text,
    joined,
    write_yard,
    yard,
)

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import MAX_FILE_BYTES, WorldWarning
from dune_rl.worlds.importing.mesh_world import MeshConf, build_mesh


def refused(path, match: str, **settings) -> None:
    with pytest.raises(WorldError, match=match) as caught:
        build_mesh(MeshConf(path=str(path), **settings))
    assert len(str(caught.value).splitlines()) <= 2


def test_what_is_no_mesh_is_refused_in_words(tmp_path):
    def file(name: str, data: bytes):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    refused(tmp_path / "none.stl", "there is no file")
    refused(tmp_path, "ending|no plain file")
    refused(
        file("world.txt", b"hello"), r"has the ending .txt; meshes are read from .dae, .obj, .stl, .ply, .glb"
    )
    refused(file("empty.obj", b""), "is empty")
    for kind in FORMATS:
        refused(file(f"noise.{kind}", np.random.default_rng(1).bytes(5000)), "export it again")
        refused(file(f"text.{kind}", b"this is no mesh at all\n" * 9), "export|no triangles")
    refused(file("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "no triangles|that can be read")
    refused(
        file("wall.obj", b"v 0 0 0\nv 9 0 0\nv 9 0 3\nv 0 0 3\nf 1 2 3\nf 1 3 4\n"),
        "no triangle that faces up",
    )
    refused(file("tiny.obj", b"v 0 0 0\nv .1 0 0\nv .1 .1 0\nf 1 2 3\n"), "too little to drive on")
    refused(
        file("nan.obj", b"v 0 0 nan\nv 9 0 nan\nv 9 9 nan\nf 1 2 3\n"),
        "no triangles that can be used|that can be read",
    )
    refused(file("out.obj", b"v 0 0 0\nv 9 0 0\nv 9 9 0\nf 1 2 77\n"), "no triangles|that can be read")


def test_triangles_with_nan_are_left_out_with_a_warning(tmp_path):
    mesh = joined(yard())
    vertices = mesh.vertices.copy()
    vertices[100] = np.nan
    (tmp_path / "nan.stl").write_bytes(
        trimesh.Trimesh(vertices, mesh.faces, process=False).export(file_type="stl")
    )
    with pytest.warns(WorldWarning, match=r"nan.stl: has vertices that are NaN or infinite"):
        world = build_mesh(MeshConf(path=str(tmp_path / "nan.stl")))
    assert np.isfinite(world.terrain.heights).all()


def test_counts_that_a_file_does_not_hold_are_refused(tmp_path):
    stl = tmp_path / "claim.stl"
    stl.write_bytes(b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 500)
    refused(stl, "claims 4,000,000,000 triangles and has room for 10")
    ply = tmp_path / "claim.ply"
    for form in (b"ascii", b"binary_little_endian"):
        ply.write_bytes(
            b"ply\nformat " + form + b" 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
            b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            + b"\0"
            * 99
        )
        refused(ply, "claims 4000000000 items of 'vertex'")


@pytest.mark.parametrize(
    ("count", "message"),
    [(4_000_000_000, "an accessor claims 4000000000 items"), (math.inf, "cannot convert float infinity")],
)
def test_counts_that_a_glb_does_not_hold_are_refused(tmp_path, count, message):
    header = json.dumps(
        {
            "asset": {"version": "2.0"},
            "accessors": [{"componentType": 5126, "count": count, "type": "VEC3"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
    ).encode()
    header += b" " * (-len(header) % 4)
    glb = tmp_path / "claim.glb"
    glb.write_bytes(struct.pack("<IIIII", 0x46546C67, 2, 20 + len(header), len(header), 0x4E4F534A) + header)
    refused(glb, message)


def glb_with_nodes(path, nodes) -> None:
    # A real one, with its nodes exchanged.
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    header = json.loads(data[20 : 20 + length])
    header["nodes"] = nodes(header["nodes"])
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    path.write_bytes(
        struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest
    )


def test_nodes_that_contain_themselves_or_multiply_are_refused(tmp_path):
    path = write_yard(tmp_path, "glb")
    glb_with_nodes(path, lambda nodes: [{"children": [1]}, {"children": [0], "mesh": 0}, *nodes[2:]])
    refused(path, "loop")
    path = write_yard(tmp_path, "glb")
    glb_with_nodes(path, lambda nodes: [*nodes, *({"mesh": 0} for _ in range(3000))])
    refused(path, "more than 4,000,000 triangles")
    # A COLLADA whose nodes are instances of nodes, tenfold on each of nine levels.
    levels = "".join(
        f'<node id="n{k}">' + f'<instance_node url="#n{k - 1}"/>' * 10 + "</node>" for k in range(1, 10)
    )
    ends = '<node id="n0"><instance_geometry url="#Crate_01-mesh"/></node>'
    (tmp_path / "many.dae").write_text(dae_text(yard(), scene=f"{ends}{levels}"))
    refused(tmp_path / "many.dae", "nodes that contain themselves|more than 20,000|more than 4,000,000")


ENTITIES = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    "before",
    [
        ENTITIES,
        '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE x [<!ENTITY % a SYSTEM "http://127.0.0.1:9/x.dtd"> %a;]>',
    ],
)
def test_xml_entities_are_refused(tmp_path, before):
    path = tmp_path / "bomb.dae"
    path.write_text(
        dae_text({"a": box(0, 0, 0, (5, 5, 1))}, before=before).replace(
            "paint", "&b;" if before is ENTITIES else "&a;"
        )
    )
    refused(path, "declares XML entities or refers to external ones")


def test_deep_xml_and_archives_are_refused(tmp_path):
    (tmp_path / "deep.dae").write_bytes(b"<a>" * 200_000 + b"</a>" * 200_000)
    refused(tmp_path / "deep.dae", "nested more than 128 deep")
    (tmp_path / "zip.dae").write_bytes(b"PK\x03\x04" + b"\0" * 100)
    refused(tmp_path / "zip.dae", "no valid XML")


def test_files_that_are_too_large_or_no_files_are_not_read(tmp_path):
    large = tmp_path / "large.stl"
    with large.open("wb") as file:
        file.truncate(5 * 2**30)
    refused(large, f"has 5,120 MiB, and at most {MAX_FILE_BYTES // 2**20} are read")
    os.mkfifo(tmp_path / "pipe.obj")
    refused(tmp_path / "pipe.obj", "no plain file")
