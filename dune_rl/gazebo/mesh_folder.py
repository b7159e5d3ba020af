"""A folder of mesh files (OBJ, with materials and pictures), no two of one name."""

import io
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from dune_rl.gazebo.elements import UniqueNames, words
from dune_rl.gazebo.painted_mesh import PaintedMesh, PaintedPart, face_normals
from dune_rl.geometry.arrays import Array, Bytes

FOLDER = "meshes"


class MeshFolder:
    """Writes meshes into the folder `meshes` of `parent`; equal pictures share a file.

    Names of files are given relative to `parent`.
    """

    def __init__(self, parent: Path) -> None:
        self._folder = parent / FOLDER
        self._folder.mkdir()
        self._names = UniqueNames()
        self._pictures: dict[int, tuple[Bytes, str]] = {}

    def write_obj(self, name: str, mesh: PaintedMesh) -> str:
        """Write an OBJ file called `name`, or nearly so, with its materials; returns its path."""
        stem = self._names.make(name, ".obj")
        names = [f"{stem}_{number}" for number in range(len(mesh.parts))]
        materials = "\n".join(
            self._material(own, stem, part) for own, part in zip(names, mesh.parts, strict=True)
        )
        (self._folder / f"{stem}.mtl").write_text(materials, encoding="utf-8")
        (self._folder / f"{stem}.obj").write_text(_obj_text(mesh, f"{stem}.mtl", names), encoding="utf-8")
        return f"{FOLDER}/{stem}.obj"

    def write_file(self, name: str, suffix: str, content: bytes) -> str:
        """Write a file called `name`, or nearly so, with an ending; returns its path."""
        file = f"{self._names.make(name, suffix)}{suffix}"
        (self._folder / file).write_bytes(content)
        return f"{FOLDER}/{file}"

    def write_hull(self, name: str, points: Array) -> str:
        """Write the convex hull of points (P, 3) as an STL file; returns its path."""
        hull = trimesh.Trimesh(points, process=False).convex_hull
        return self.write_file(name, ".stl", hull.export(file_type="stl"))

    def write_picture(self, name: str, picture: Bytes) -> str:
        """Write a PNG of bytes (rows, columns, 3), unless it is there already; returns its name."""
        if id(picture) not in self._pictures:
            data = io.BytesIO()
            Image.fromarray(picture).save(data, "png")
            path = self.write_file(name, ".png", data.getvalue())
            self._pictures[id(picture)] = picture, path.removeprefix(f"{FOLDER}/")
        return self._pictures[id(picture)][1]

    def _material(self, name: str, stem: str, part: PaintedPart) -> str:
        colour = words(part.colour)
        # Without the roughness of the PBR extension, Gazebo takes 0: a mirror.
        lines = [f"newmtl {name}", f"Ka {colour}", f"Kd {colour}", "Ks 0 0 0", "Pr 1", "Pm 0"]
        if part.picture is not None:
            lines.append(f"map_Kd {self.write_picture(stem, part.picture)}")
        return "\n".join([*lines, ""])


def _obj_text(mesh: PaintedMesh, library: str, materials: list[str]) -> str:
    lines = [f"mtllib {library}", *_rows("v", mesh.vertices)]
    if mesh.normals is not None:
        lines += _rows("vn", mesh.normals)
    normals = textures = 1
    for material, part in zip(materials, mesh.parts, strict=True):
        faces = part.faces.astype(np.int64) + 1
        corners = np.empty((len(faces), 3, 3), np.int64)
        corners[..., 0] = corners[..., 2] = faces
        if mesh.normals is None:
            own, index = np.unique(face_normals(mesh, part).round(6) + 0.0, axis=0, return_inverse=True)
            lines += _rows("vn", own)
            corners[..., 2] = (normals + index.reshape(-1))[:, None]
            normals += len(own)
        pattern = "f {}//{} {}//{} {}//{}"
        if part.uv is not None:
            own, index = np.unique(part.uv.reshape(-1, 2), axis=0, return_inverse=True)
            lines += _rows("vt", own)
            corners[..., 1] = (textures + index).reshape(-1, 3)
            textures += len(own)
            pattern = "f {}/{}/{} {}/{}/{} {}/{}/{}"
        columns = corners if part.uv is not None else corners[..., [0, 2]]
        lines.append(f"usemtl {material}")
        lines += [pattern.format(*row) for row in columns.reshape(len(faces), -1).tolist()]
    return "\n".join([*lines, ""])


def _rows(tag: str, values: Array) -> list[str]:
    return [f"{tag} {words(row)}" for row in values.tolist()]
