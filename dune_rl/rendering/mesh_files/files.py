"""Mesh files (.dae, .obj, .stl, .ply, .glb) as named parts in metres, z up."""

import io
import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
from trimesh.resolvers import Resolver

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import (
    MAX_FACES,
    Bytes,
    ImportReport,
    WorldFiles,
    downscale_image,
    first_line,
    open_image,
    printable,
    read_bytes,
    reading,
)
from dune_rl.rendering.mesh_files.collada import load_collada_parts
from dune_rl.rendering.mesh_files.parts import MeshPart, drop_faulty_triangles, frame_hints, mean_face_colours
from dune_rl.rendering.mesh_texture import MeshTexture

UpAxis = Literal["y", "z"]
Pictures = dict[tuple[float, ...], Bytes]

FORMATS = (".dae", ".obj", ".stl", ".ply", ".glb")

# Transform from y up to z up, which keeps x; and from each axis up.
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_X_TO_Y = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
_TO_Z_UP = {"x": Y_UP @ _X_TO_Y, "y": Y_UP, "z": np.eye(4)}
_MOST_NODES = 20_000
# Bytes of a number in a glTF accessor by component type, and numbers of an item by type.
_NUMBER_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_ITEM_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def load_mesh_parts(
    path: Path,
    folder: WorldFiles,
    report: ImportReport,
    *,
    unit_m: float | None = None,
    up: UpAxis | None = None,
) -> list[MeshPart]:
    """The parts of the mesh file at `path`, in metres and z up, without faulty triangles.

    `unit_m` and `up` override the file's own values; .obj, .stl and .ply files have none, and are assumed to
    be in metres and z up. Textures are read from `folder`.
    """
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise WorldError(
            f"{path} has the ending {kind or '(none)'}; meshes are read from {', '.join(FORMATS)}."
        )
    data = read_bytes(path)
    if not data:
        raise WorldError(f"{path} is empty: export it again.")
    if kind == ".dae":
        parts, own_unit, own_up = load_collada_parts(data, path.name, folder, report)
    else:
        _CHECKS[kind](data, path.name)
        parts, own_unit, own_up = _load_parts(data, path.name, kind, folder, report), 1.0, None
    parts = [part for part in parts if len(part.faces)]
    if sum(len(part.faces) for part in parts) > MAX_FACES:
        raise WorldError(f"{path} has more than {MAX_FACES:,} triangles: reduce it, or cut out a piece.")
    turn = up or own_up or ("y" if kind == ".glb" else "z")
    unit = unit_m if unit_m is not None else own_unit
    matrix = _TO_Z_UP[turn].copy()
    matrix[:3] *= unit
    kept = drop_faulty_triangles([part.transform(matrix) for part in parts], report)
    if not kept:
        raise WorldError(f"{path} has no triangles that can be used: export it with its faces.")
    report.hints |= frame_hints(kept, unit, is_y_up=turn == "y")
    return kept


class _FolderResolver(Resolver):
    # Gives trimesh the files that a mesh refers to: material libraries, images, buffers.
    def __init__(self, folder: WorldFiles, report: ImportReport) -> None:
        self._folder, self._report = folder, report

    def get(self, key: str) -> bytes:
        try:
            data = self._folder.read(key)
            if not key.lower().endswith((".mtl", ".bin")):
                open_image(data)
            return data
        except FileNotFoundError:
            self._report.warn(f"{printable(key)} is missing; its faces have a plain colour")
        except WorldError as error:
            self._report.warn(str(error).splitlines()[0])
        except ValueError as error:
            self._report.warn(f"{printable(key)} is left out: {error}")
        raise FileNotFoundError(key)

    def keys(self) -> list[str]:
        return []

    def namespaced(self, namespace: str) -> "_FolderResolver":
        return self

    def write(self, name: str, data: Any) -> None:
        raise PermissionError("nothing is written into a world's folder")


def _load_parts(
    data: bytes, name: str, kind: str, folder: WorldFiles, report: ImportReport
) -> list[MeshPart]:
    options: dict[str, Any] = {"process": False}
    if kind == ".obj":
        options |= {"split_objects": True, "group_material": True}
    with reading(name, f"{kind} mesh"):
        resolver = _FolderResolver(folder, report)
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:], resolver=resolver, **options)
        return list(_parts(scene, kind, report))


def _parts(scene: Any, kind: str, report: ImportReport) -> Iterator[MeshPart]:
    count = 0
    pictures: Pictures = {}
    for node in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        faces = getattr(mesh, "faces", None)
        if faces is None or not len(faces):
            continue
        count += len(faces)
        if count > MAX_FACES:
            raise WorldError(f"it has more than {MAX_FACES:,} triangles: reduce it, or cut out a piece.")
        own_name = str(mesh.metadata.get("name") or geometry)
        name = str(node) if kind == ".glb" else own_name
        colours, material, texture = _colours(mesh, pictures, report)
        shape, about = (mesh.vertices, faces, colours), f"{own_name} {printable(material)}"
        part = MeshPart.from_triangles(printable(name), *shape, about, texture=texture)
        yield part.transform(np.asarray(matrix, np.float64))


def _colours(mesh: Any, pictures: Pictures, report: ImportReport) -> tuple[Any, str, MeshTexture | None]:
    """Colours, None to guess them; the material's name; and the texture."""
    visual = mesh.visual
    if visual.kind in ("vertex", "face"):
        return np.asarray(visual.face_colors, np.float32)[:, :3] / 255.0, "", None
    if visual.kind != "texture":
        return None, "", None
    material = visual.material
    name = str(getattr(material, "name", None) or "")
    factor = getattr(material, "baseColorFactor", None)
    is_tinted = factor is not None
    if factor is None and getattr(material, "_data", None) is None and "diffuse" in vars(material):
        factor = material.diffuse
    tint = None if factor is None else np.asarray(factor, np.float32)[:3] / 255.0
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is not None and visual.uv is not None and len(visual.uv) == len(mesh.vertices):
        shades = np.clip(tint, 0.0, 1.0) if is_tinted and tint is not None else np.ones(3, np.float32)
        # Equal pictures are shared.
        key = (id(image), *shades.tolist())
        try:
            if key not in pictures:
                pictures[key] = report.limit_texture((downscale_image(image) * shades + 0.5).astype(np.uint8))
        except ValueError as error:
            report.warn(f"the texture of {printable(name)!r} is left out: {error}")
        else:
            uv = np.asarray(visual.uv, np.float64)[mesh.faces]
            corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
            return mean_face_colours(pictures[key], uv), name, MeshTexture.from_uv(pictures[key], corners, uv)
    has_default = tint is None or np.allclose(tint, 0.4, atol=0.01) or np.allclose(tint, 1.0)
    return (None if has_default else tint), name, None


def _check_stl(data: bytes, name: str) -> None:
    if len(data) >= 84:
        (count,) = struct.unpack_from("<I", data, 80)
        if len(data) == 84 + 50 * count:
            return
        if not data.lstrip()[:5].lower() == b"solid" or b"facet" not in data[:4096].lower():
            raise WorldError(
                f"{name} claims {count:,} triangles and has room for {max(0, (len(data) - 84) // 50):,}: "
                "it is damaged or no STL; export it again."
            )
    elif b"facet" not in data.lower():
        raise WorldError(f"{name} is no STL mesh: export it again.")


def _check_ply(data: bytes, name: str) -> None:
    end = data.find(b"end_header", 0, 65_536)
    if not data.startswith(b"ply") or end < 0:
        raise WorldError(f"{name} is no PLY mesh: export it again.")
    for line in data[:end].splitlines():
        words = line.split()
        if len(words) != 3 or words[0] != b"element":
            continue
        # Every item takes at least a byte.
        if not words[2].isdigit() or len(words[2]) > 12 or int(words[2]) > len(data):
            kind, count = (printable(word.decode("latin-1"), 20) for word in words[1:])
            raise WorldError(
                f"{name} claims {count} items of {kind!r} in {len(data):,} bytes: "
                "it is damaged; export it again."
            )


def _check_obj(data: bytes, name: str) -> None:
    if b"\0" in data[:65_536]:
        raise WorldError(f"{name} is no OBJ mesh, which is a text: export it again.")


def _check_glb(data: bytes, name: str) -> None:
    """Refuse counts that exceed the file's size, and nodes that do not form a tree."""
    try:
        magic, _, _, length, chunk = struct.unpack_from("<IIIII", data)
        if magic != 0x46546C67 or chunk != 0x4E4F534A:
            raise ValueError("it does not begin as a GLB")
        header = json.loads(data[20 : 20 + length])
        if header.get("extensionsRequired"):
            names = ", ".join(map(str, header["extensionsRequired"]))
            raise ValueError(f"it needs {printable(names)}, which is not supported; export it without")
        views = header.get("bufferViews", [])
        for accessor in header.get("accessors", []):
            numbers = int(accessor["count"]) * _ITEM_NUMBERS[accessor["type"]]
            room = len(data) if "bufferView" not in accessor else views[accessor["bufferView"]]["byteLength"]
            if numbers < 0 or numbers * _NUMBER_BYTES[accessor["componentType"]] > min(room, 2**31):
                raise ValueError(f"an accessor claims {accessor['count']} items, more than there are bytes")
        nodes = header.get("nodes", [])
        children = [int(child) for node in nodes for child in node.get("children", [])]
        if len(nodes) > _MOST_NODES or len(set(children)) != len(children):
            raise ValueError(f"its nodes are no tree, or more than {_MOST_NODES:,}")
        _refuse_loops([node.get("children", []) for node in nodes])
        keys = ("matrix", "translation", "rotation", "scale")
        if not all(math.isfinite(x) for node in nodes for key in keys for x in node.get(key, ())):
            raise ValueError("a node's pose is not finite")
        _refuse_many_instances(header)
    except (
        *(LookupError, TypeError, ValueError, AttributeError, ArithmeticError),
        *(struct.error, RecursionError),
    ) as error:
        fault = f"is no GLB mesh that can be read ({first_line(error)}): export it again."
        raise WorldError(f"{name} {fault}") from None


def _refuse_loops(children: list[list[int]]) -> None:
    parent = {child: index for index, found in enumerate(children) for child in found}
    for start in range(len(children)):
        node, steps = start, 0
        while node in parent:
            node, steps = parent[node], steps + 1
            if steps > 200:
                raise ValueError("its nodes run in a loop or more than 200 deep")


def _refuse_many_instances(header: dict[str, Any]) -> None:
    # A small mesh that many nodes refer to has many triangles.
    accessors, sizes = header.get("accessors", []), []
    for mesh in header.get("meshes", []):
        counted = [each.get("indices", each["attributes"].get("POSITION", 0)) for each in mesh["primitives"]]
        sizes.append(sum(int(accessors[index]["count"]) // 3 for index in counted if accessors))
    total = sum(sizes[node["mesh"]] for node in header.get("nodes", []) if "mesh" in node)
    if total > MAX_FACES:
        raise ValueError(f"it has more than {MAX_FACES:,} triangles")


_CHECKS = {".stl": _check_stl, ".ply": _check_ply, ".obj": _check_obj, ".glb": _check_glb}
