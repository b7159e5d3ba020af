"""Mesh files of a URDF: searched beside it and in packages, and read only within those folders."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from dune_rl.core.errors import DuneWarning, RobotError, WorldError
from dune_rl.core.untrusted_files import ImportReport, WorldFiles, printable
from dune_rl.geometry.arrays import Array, Floats
from dune_rl.rendering.mesh_files.files import FORMATS, load_mesh_parts

PACKAGE_VARIABLE = "ROS_PACKAGE_PATH"
_PACKAGE = "package://"
_PACKAGE_FILE = "package.xml"
# Flatter meshes have no inside [m], so that nothing can collide with them.
_THINNEST_M = 1e-6


class RobotWarning(DuneWarning):
    """A fault of a robot's description that does not keep it from driving."""


class MeshError(RobotError):
    """A mesh that is missing or cannot be read."""


class UrdfMeshes:
    """Mesh files of the URDF file at `urdf`.

    A plain name is relative to the file's folder, within the root of its package (the nearest parent folder
    with a package.xml). `package://NAME/...` is searched in parent folders of the file that are called NAME
    or have a subfolder NAME, and in those of ROS_PACKAGE_PATH. Nothing outside of that folder is read, even
    through links. `report` collects what is worth a warning.
    """

    def __init__(self, urdf: Path) -> None:
        self._urdf = urdf
        self.report = ImportReport(urdf.name)
        self._meshes: dict[str, tuple[Array, NDArray[np.int32], Floats]] = {}
        self._hulls: dict[tuple[str, tuple[float, ...]], Array] = {}
        self._beside = urdf.resolve().parent

    def find(self, name: str) -> Path:
        """Path of the mesh with a name in the URDF; raises `RobotError` if there is none that may be read."""
        if name.startswith(_PACKAGE):
            package, _, rest = name.removeprefix(_PACKAGE).partition("/")
            folders = list(self._packages(package))
            if not folders:
                raise MeshError(
                    f"{printable(name)}: there is no package {printable(package)!r} above "
                    f"{self._urdf.name} nor in {PACKAGE_VARIABLE}; put the folder {printable(package)} "
                    f"beside the file, or set {PACKAGE_VARIABLE}."
                )
            searched = [WorldFiles(folder) for folder in folders]
        else:
            rest = name
            searched = [WorldFiles(self._root(), self._beside)]
        for folder in searched:
            try:
                return folder.find(rest)
            except FileNotFoundError:
                continue
            except WorldError as error:
                raise RobotError(_robot_message(error)) from None
        where = ", ".join(str(folder.base) for folder in searched)
        raise MeshError(f"the mesh {printable(name)} is not in {where}; copy it there, or mend the name.")

    def load(self, name: str) -> tuple[Array, NDArray[np.int32], Floats]:
        """Vertices (V, 3) [m], faces (F, 3) and sRGB colours (F, 3) of a mesh, in the axes of the file.

        Colours include those of textures. Raises `MeshError` if the mesh is missing or cannot be read.
        """
        if name not in self._meshes:
            self._meshes[name] = self._read(name)
        return self._meshes[name]

    def hull_corners(self, name: str, scale: tuple[float, ...]) -> Array:
        """Corners (P, 3) of the hull of a scaled mesh; raises an exception of any kind if it is flat."""
        key = name, scale
        if key not in self._hulls:
            hull = trimesh.Trimesh(self.load(name)[0] * np.array(scale), process=False).convex_hull
            # The library joggles what is flat, and then finds a hull.
            if hull.volume < _THINNEST_M * hull.area:
                raise ValueError("the mesh is flat")
            self._hulls[key] = np.asarray(hull.vertices)
        return self._hulls[key]

    def _read(self, name: str) -> tuple[Array, NDArray[np.int32], Floats]:
        path = self.find(name)
        if path.suffix.lower() not in FORMATS:
            raise MeshError(
                f"the mesh {printable(name)} has the ending {path.suffix or '(none)'}; "
                f"meshes are read from {', '.join(FORMATS)}."
            )
        try:
            # A URDF ignores the up axis that a file declares.
            parts = load_mesh_parts(path, WorldFiles(path.resolve().parent), ImportReport(path.name), up="z")
        except WorldError as error:
            raise MeshError(_robot_message(error)) from None
        starts = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
        return (
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
            np.concatenate([part.colours for part in parts]),
        )

    def _root(self) -> Path:
        for folder in (self._beside, *self._beside.parents):
            if (folder / _PACKAGE_FILE).is_file():
                return folder
        return self._beside

    def _packages(self, name: str) -> Iterator[Path]:
        if not name or name in (".", "..") or Path(name).name != name:
            return
        for folder in (self._beside, *self._beside.parents):
            if folder.name == name:
                yield folder
            if (folder / name).is_dir():
                yield folder / name
        for entry in os.environ.get(PACKAGE_VARIABLE, "").split(os.pathsep):
            if not entry:
                continue
            folder = Path(entry).expanduser()
            if folder.name == name and (folder / _PACKAGE_FILE).is_file():
                yield folder
            if (folder / name).is_dir():
                yield folder / name


def _robot_message(error: WorldError) -> str:
    return str(error).replace("the world needs", "the robot needs").replace("world.path", "robot.path")


def primitive_mesh(kind: str, size: tuple[float, ...], sections: int) -> trimesh.Trimesh:
    """A box, a cylinder with so many sections, or a sphere; for `size` see `Geometry`."""
    if kind == "box":
        return trimesh.creation.box(size)
    if kind == "cylinder":
        radius, length = size
        return trimesh.creation.cylinder(radius, length, sections=sections)
    return trimesh.creation.icosphere(subdivisions=3, radius=size[0])
