"""Binary glTF 2.0 (GLB): coloured meshes, nodes, and animations of nodes.

The format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dune_rl.geometry.arrays import Array, Bytes, Floats
from dune_rl.geometry.frames import quaternions

_MAGIC, _VERSION, _JSON, _BINARY = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_FLOAT, _USHORT = 5126, 5123
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_UNLIT = "KHR_materials_unlit"
_REPEAT, _CLAMP = 10497, 33071
_JPEG_QUALITY = 92


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with one material: `corners` (F, 3, 3) [m] and `colours` in linear RGB, in [0, 1], of faces
    (F, 3) or of their corners (F, 3, 3).

    A `picture` (rows, columns, 3) of sRGB bytes is multiplied by the colours; `uv` (F, 3, 2) are its
    coordinates at the corners, from 0 at its upper left to 1. It repeats beyond, unless it is `clamped`.
    Surfaces that are not `lit` are shown as they are; all colours are multiplied by `gain`.
    """

    corners: Array
    colours: Floats
    picture: Bytes | None = None
    uv: Floats | None = None
    clamped: bool = False
    lit: bool = True
    opacity: float = 1.0
    gain: float = 1.0
    two_sided: bool = False


class GltfFile:
    """A scene whose z axis points up, written as GLB; with `y_up` it is turned to glTF's axes.

    Equal pictures and meshes that are added once are stored once. Nodes are named and posed in the world.
    """

    def __init__(self, *, y_up: bool = True) -> None:
        self._chunks: list[bytes] = []
        self._size = 0
        self._tree: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "dune_rl"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": "world", "children": []}],
        }
        if y_up:
            self._tree["nodes"][0]["rotation"] = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
        self._textures: dict[tuple[bytes, bool], int] = {}
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []

    def add_mesh(self, surfaces: Sequence[Surface]) -> int:
        """The number of a mesh of these surfaces, of which at least one has faces."""
        primitives = [self._primitive(each) for each in surfaces if len(each.corners)]
        return self._append("meshes", {"primitives": primitives})

    def add_node(
        self,
        name: str,
        mesh: int | None = None,
        position: Array | None = None,
        rotation: Array | None = None,
        parent: int = 0,
    ) -> int:
        """The number of a node at `position` (3,) [m] with `rotation` (3, 3), in its parent's frame."""
        node: dict[str, Any] = {"name": name}
        if mesh is not None:
            node["mesh"] = mesh
        if position is not None:
            node["translation"] = np.asarray(position, float).tolist()
        if rotation is not None:
            node["rotation"] = quaternions(rotation).tolist()
        number = self._append("nodes", node)
        self._tree["nodes"][parent].setdefault("children", []).append(number)
        return number

    def animate(
        self,
        node: int,
        path: Literal["translation", "rotation", "scale"],
        times_s: Array,
        values: Array,
        *,
        steps: bool = False,
    ) -> None:
        """Set a node's translation (T, 3), rotation (T, 4: xyzw) or scale (T, 3) at `times_s` (T,).

        Values between are interpolated or, with `steps`, stay as they were.
        """
        sampler = {
            "input": self._accessor(np.asarray(times_s, np.float32)[:, None], bounds=True),
            "output": self._accessor(np.asarray(values, np.float32)),
            "interpolation": "STEP" if steps else "LINEAR",
        }
        self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
        self._samplers.append(sampler)

    def to_bytes(self) -> bytes:
        """The file's content."""
        tree = dict(self._tree)
        if self._channels:
            tree["animations"] = [{"name": "episode", "samplers": self._samplers, "channels": self._channels}]
        tree["buffers"] = [{"byteLength": self._size}]
        text = json.dumps(tree, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._chunks)
        head = struct.pack("<III", _MAGIC, _VERSION, 28 + len(text) + len(binary))
        return b"".join(
            [
                head,
                struct.pack("<II", len(text), _JSON),
                text,
                struct.pack("<II", len(binary), _BINARY),
                binary,
            ]
        )

    def _append(self, kind: str, entry: dict[str, Any]) -> int:
        entries: list[dict[str, Any]] = self._tree.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def _view(self, data: bytes) -> int:
        entry = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        padded = data + b"\0" * (-len(data) % 4)
        self._chunks.append(padded)
        self._size += len(padded)
        return self._append("bufferViews", entry)

    def _accessor(self, values: NDArray[Any], *, bounds: bool = False) -> int:
        """The number of an accessor of `values` (n, k): 32-bit floats, or normalised 16-bit numbers."""
        is_float = values.dtype == np.float32
        entry: dict[str, Any] = {
            "bufferView": self._view(np.ascontiguousarray(values).tobytes()),
            "componentType": _FLOAT if is_float else _USHORT,
            "count": len(values),
            "type": _TYPES[values.shape[1]],
        }
        if not is_float:
            entry["normalized"] = True
        if bounds:
            entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self._append("accessors", entry)

    def _primitive(self, surface: Surface) -> dict[str, Any]:
        corners = surface.corners.reshape(-1, 3).astype(np.float32)
        colours = np.ones((len(surface.corners), 3, 4))
        colours[..., :3] = surface.colours.reshape(len(surface.corners), -1, 3)
        words = (np.clip(colours, 0.0, 1.0) * 65535.0 + 0.5).astype(np.uint16)
        attributes = {
            "POSITION": self._accessor(corners, bounds=True),
            "COLOR_0": self._accessor(words.reshape(-1, 4)),
        }
        if surface.uv is not None:
            attributes["TEXCOORD_0"] = self._accessor(surface.uv.reshape(-1, 2).astype(np.float32))
        return {"attributes": attributes, "material": self._material(surface)}

    def _material(self, surface: Surface) -> int:
        look: dict[str, Any] = {
            "baseColorFactor": [surface.gain, surface.gain, surface.gain, surface.opacity],
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
        }
        if surface.picture is not None:
            look["baseColorTexture"] = {"index": self._texture(surface.picture, surface.clamped)}
        material: dict[str, Any] = {"pbrMetallicRoughness": look}
        if surface.opacity < 1.0:
            material["alphaMode"] = "BLEND"
        if surface.two_sided:
            material["doubleSided"] = True
        if not surface.lit:
            material["extensions"] = {_UNLIT: {}}
            self._tree["extensionsUsed"] = [_UNLIT]
        known = self._tree.setdefault("materials", [])
        return known.index(material) if material in known else self._append("materials", material)

    def _texture(self, picture: Bytes, clamped: bool) -> int:
        file = BytesIO()
        Image.fromarray(picture).save(file, format="jpeg", quality=_JPEG_QUALITY)
        key = file.getvalue(), clamped
        if key not in self._textures:
            wrap = _CLAMP if clamped else _REPEAT
            sampler = self._append("samplers", {"wrapS": wrap, "wrapT": wrap})
            image = self._append("images", {"bufferView": self._view(key[0]), "mimeType": "image/jpeg"})
            self._textures[key] = self._append("textures", {"sampler": sampler, "source": image})
        return self._textures[key]
