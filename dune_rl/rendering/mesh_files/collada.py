"""COLLADA (.dae) files as named parts, with their unit and up axis."""

import io
from collections.abc import Iterator
from typing import Any

import collada
import numpy as np
from collada.polygons import Polygons
from collada.polylist import Polylist
from collada.scene import GeometryNode
from collada.triangleset import TriangleSet
from numpy.typing import NDArray

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import (
    MAX_FACES,
    ImportReport,
    WorldFiles,
    first_line,
    printable,
    read_image,
    read_xml,
    reading,
)
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.mesh_files.parts import MeshPart, mean_face_colours
from dune_rl.rendering.mesh_texture import MeshTexture

_MOST_NODES = 20_000
_DEEPEST = 100


def load_collada_parts(
    data: bytes, name: str, folder: WorldFiles, report: ImportReport
) -> tuple[list[MeshPart], float, str | None]:
    """Parts in the file's own unit and axes; that unit [m]; and the up axis: "x", "y" or "z".

    Each node's geometry gives one part per material. Textures are read from `folder`.
    """
    # The library would expand entities and unpack archives; this check refuses both.
    read_xml(data, name)
    with reading(name, ".dae mesh"):
        document = collada.Collada(
            io.BytesIO(data), ignore=[collada.common.DaeError], aux_file_loader=_load_nothing
        )
        unit = document.assetInfo.unitmeter
        axis = str(document.assetInfo.upaxis)[:1].lower()
        if document.scene is None:
            raise WorldError(f"{name} has no scene, so its meshes have no positions.")
        reader = _Reader(name, folder, report)
        parts = [part for node in document.scene.nodes for part in reader.parts(node, np.eye(4), "", 0)]
    if document.errors:
        first = first_line(document.errors[0])
        report.warn(f"{len(document.errors)} elements in it are not supported, such as: {first}")
    unit = 1.0 if unit is None else float(unit)
    if not 1e-6 <= unit <= 1e6:
        raise WorldError(f"{name} states a unit of {unit} m: set world.unit_m to the length of its unit.")
    return parts, unit, axis if axis in ("x", "y", "z") else "y"


def _load_nothing(name: str) -> bytes:
    raise FileNotFoundError(name)


class _Reader:
    def __init__(self, name: str, folder: WorldFiles, report: ImportReport) -> None:
        self._name, self._folder, self._report = name, folder, report
        self._diffuse: dict[str, Any] = {}
        self._pictures: dict[str, NDArray[np.uint8]] = {}
        self._nodes = self._faces = 0

    def parts(self, node: Any, matrix: Array, name: str, depth: int) -> Iterator[MeshPart]:
        """Parts of a node and its descendants; nodes are counted, since nested instances can be very many."""
        self._nodes += 1
        if depth > _DEEPEST or self._nodes > _MOST_NODES:
            raise WorldError(
                f"{self._name} has nodes that contain themselves, are nested more than {_DEEPEST} deep, "
                f"or are more than {_MOST_NODES:,}: export it again, without instances."
            )
        if isinstance(node, GeometryNode):
            yield from self._geometry(node, matrix, name)
        elif hasattr(node, "children"):
            own = getattr(node, "xmlnode", None)
            name = (own.get("name") if own is not None else None) or getattr(node, "id", None) or name
            for child in node.children:
                yield from self.parts(child, matrix @ np.asarray(node.matrix, np.float64), name, depth + 1)
        else:
            self._report.warn(f"{type(node).__name__.removesuffix('Node').lower()}s in it are left out")

    def _geometry(self, node: Any, matrix: Array, name: str) -> Iterator[MeshPart]:
        materials = {bound.symbol: bound.target for bound in node.materials}
        for primitive in node.geometry.primitives:
            if isinstance(primitive, Polygons | Polylist):
                self._count(int(np.maximum(np.asarray(primitive.vcounts, np.int64) - 2, 0).sum()))
                primitive = primitive.triangleset()
            elif isinstance(primitive, TriangleSet):
                self._count(len(primitive))
            else:
                self._report.warn(f"{type(primitive).__name__} in it is not supported and left out")
                continue
            if primitive.vertex is None or primitive.vertex_index is None or not len(primitive.vertex_index):
                continue
            material = materials.get(primitive.material)
            about = printable(str(getattr(material, "name", None) or primitive.material or ""))
            colours, texture = self._colours(primitive, material)
            mesh = primitive.vertex, primitive.vertex_index, colours
            own = printable(name or str(node.geometry.name))
            yield MeshPart.from_triangles(own, *mesh, about, texture=texture).transform(matrix)

    def _count(self, faces: int) -> None:
        self._faces += faces
        if self._faces > MAX_FACES:
            raise WorldError(
                f"{self._name} has more than {MAX_FACES:,} triangles: reduce it, or cut out a piece."
            )

    def _colours(self, primitive: Any, material: Any) -> tuple[Any, MeshTexture | None]:
        if material is None:
            return None, None
        if material.id not in self._diffuse:
            self._diffuse[material.id] = self._read_diffuse(material)
        diffuse = self._diffuse[material.id]
        if diffuse is None or diffuse.ndim == 1:
            return diffuse, None
        if not len(primitive.texcoordset):
            return diffuse.mean(axis=(0, 1)) / 255.0, None
        uv = np.asarray(primitive.texcoordset[0], np.float64)[primitive.texcoord_indexset[0]][..., :2]
        corners = np.asarray(primitive.vertex, np.float64)[primitive.vertex_index]
        return mean_face_colours(diffuse, uv), MeshTexture.from_uv(diffuse, corners, uv)

    def _read_diffuse(self, material: Any) -> NDArray[Any] | None:
        """An image of bytes (rows, columns, 3), a colour (3,) in [0, 1], or None if there is neither."""
        diffuse = getattr(material.effect, "diffuse", None)
        if isinstance(diffuse, collada.material.Map):
            picture = diffuse.sampler.surface.image.path or ""
            if picture in self._pictures:
                return self._pictures[picture]
            try:
                image = read_image(self._folder.read(picture))
                self._pictures[picture] = self._report.limit_texture(image)
                return self._pictures[picture]
            except FileNotFoundError:
                self._report.warn(f"{printable(picture)} is missing; its faces have a plain colour")
            except WorldError as error:
                self._report.warn(str(error).splitlines()[0])
            except ValueError as error:
                self._report.warn(f"{printable(picture)} is left out: {error}")
            return None
        if diffuse is None:
            return None
        colour = np.asarray(diffuse, np.float32)[:3]
        return colour if colour.shape == (3,) and np.isfinite(colour).all() else None
