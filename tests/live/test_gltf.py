"""Binary glTF: trimesh reads back what is written, and animations are where the specification has them."""

import json
import struct
from io import BytesIO
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dune_rl.geometry.frames import quaternions
from dune_rl.rendering.web.gltf import GltfFile, Surface

CORNERS = np.array([[[0, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 0, 3], [2, 0, 3], [0, 1, 3]]], float)
COLOURS = np.array([[1.0, 0.5, 0.0], [0.0, 0.25, 1.0]], np.float32)


def tree_of(file: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk of a GLB."""
    magic, version, size = struct.unpack_from("<III", file)
    assert (magic, version, size) == (0x46546C67, 2, len(file))
    length, kind = struct.unpack_from("<II", file, 12)
    assert kind == 0x4E4F534A and length % 4 == 0
    binary_length, binary_kind = struct.unpack_from("<II", file, 20 + length)
    assert binary_kind == 0x004E4942 and 28 + length + binary_length == len(file)
    return json.loads(file[20 : 20 + length]), file[28 + length :]


def values_of(file: bytes, accessor: int) -> NDArray[np.float32]:
    """The numbers of an accessor of floats."""
    tree, binary = tree_of(file)
    entry = tree["accessors"][accessor]
    view = tree["bufferViews"][entry["bufferView"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[entry["type"]]
    assert entry["componentType"] == 5126 and view["byteLength"] == 4 * width * entry["count"]
    values = np.frombuffer(binary, np.float32, width * entry["count"], view["byteOffset"])
    return values.reshape(-1, width)


def colours_of(file: bytes) -> NDArray[np.float64]:
    """RGBA (F, 3, 4) of the corners of the first mesh's faces."""
    tree, binary = tree_of(file)
    colours = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    assert (colours["componentType"], colours["type"], colours["normalized"]) == (5123, "VEC4", True)
    start = tree["bufferViews"][colours["bufferView"]]["byteOffset"]
    return np.frombuffer(binary, np.uint16, 4 * colours["count"], start).reshape(-1, 3, 4) / 65535.0


def test_a_mesh_is_read_back_where_its_nodes_are() -> None:
    file = GltfFile(y_up=False)
    mesh = file.add_mesh([Surface(CORNERS, COLOURS)])
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    outer = file.add_node("outer", position=np.array([0.0, 0.0, 5.0]))
    file.add_node("inner", mesh, np.array([1.0, 0.0, 0.0]), turn, parent=outer)
    scene = trimesh.load(BytesIO(file.to_bytes()), file_type="glb", process=False)
    expected = CORNERS.reshape(-1, 3) @ turn.T + [1.0, 0.0, 5.0]
    np.testing.assert_allclose(scene.to_geometry().triangles.reshape(-1, 3), expected, atol=1e-6)


def test_each_face_has_its_colour() -> None:
    file = GltfFile()
    file.add_node("mesh", file.add_mesh([Surface(CORNERS, COLOURS)]))
    values = colours_of(file.to_bytes())
    np.testing.assert_allclose(values[..., :3], np.repeat(COLOURS[:, None], 3, axis=1), atol=1e-4)
    assert (values[..., 3] == 1.0).all()


def test_corners_of_a_face_may_have_colours_of_their_own() -> None:
    shades = np.linspace(0.0, 1.0, 18, dtype=np.float32).reshape(2, 3, 3)
    file = GltfFile()
    file.add_node("mesh", file.add_mesh([Surface(CORNERS, shades)]))
    np.testing.assert_allclose(colours_of(file.to_bytes())[..., :3], shades, atol=1e-4)


def test_files_have_the_y_axis_of_gltf_upwards() -> None:
    file = GltfFile()
    file.add_node("mesh", file.add_mesh([Surface(CORNERS, COLOURS)]))
    found = trimesh.load(BytesIO(file.to_bytes()), file_type="glb", process=False).to_geometry()
    x, y, z = CORNERS.reshape(-1, 3).T
    np.testing.assert_allclose(found.triangles.reshape(-1, 3), np.stack([x, z, -y], axis=1), atol=1e-6)


def test_pictures_are_stored_once_and_mapped_from_their_upper_left() -> None:
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:4] = [200, 30, 30]
    uv = np.array([[[0, 0], [1, 0], [0, 0.25]]] * 2, np.float32)
    surface = Surface(CORNERS, np.ones((2, 3), np.float32), picture, uv, lit=False)
    file = GltfFile(y_up=False)
    file.add_node("first", file.add_mesh([surface]))
    file.add_node("second", file.add_mesh([surface]))
    content = file.to_bytes()
    tree, _ = tree_of(content)
    assert len(tree["images"]) == len(tree["textures"]) == len(tree["materials"]) == 1
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    colours = trimesh.load(BytesIO(content), file_type="glb").to_geometry().visual.to_color().vertex_colors
    assert np.abs(colours[:, :3].astype(int) - [200, 30, 30]).max() < 12


def test_animations_have_their_times_and_values() -> None:
    file = GltfFile()
    node = file.add_node("body", file.add_mesh([Surface(CORNERS, COLOURS)]))
    times = np.array([0.0, 0.5, 1.0])
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0]], float)
    turns = quaternions(Rotation.from_euler("z", [[0], [45], [90]], degrees=True).as_matrix())
    file.animate(node, "translation", times, positions)
    file.animate(node, "rotation", times, turns)
    file.animate(node, "scale", times[:2], np.array([[1, 1, 1], [0, 0, 0]]), steps=True)
    content = file.to_bytes()
    (animation,) = tree_of(content)[0]["animations"]
    found = {each["target"]["path"]: animation["samplers"][each["sampler"]] for each in animation["channels"]}
    assert {each["target"]["node"] for each in animation["channels"]} == {node}
    assert [found[path]["interpolation"] for path in found] == ["LINEAR", "LINEAR", "STEP"]
    np.testing.assert_array_equal(values_of(content, found["translation"]["input"])[:, 0], times)
    np.testing.assert_array_equal(values_of(content, found["translation"]["output"]), positions)
    np.testing.assert_allclose(
        values_of(content, found["rotation"]["output"])[2], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-6
    )
    bounds = tree_of(content)[0]["accessors"][found["scale"]["input"]]
    assert (bounds["min"], bounds["max"]) == ([0.0], [0.5])
