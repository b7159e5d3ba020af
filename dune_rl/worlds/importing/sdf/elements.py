"""Numbers, poses and primitive shapes of SDF files."""

import os
from pathlib import Path
from typing import Literal, get_args
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from numpy.typing import NDArray

from dune_rl.core.errors import WorldError
from dune_rl.core.file_dependencies import mark_incomplete, record_absent
from dune_rl.core.untrusted_files import (
    ImportReport,
    OutsideFolderError,
    WorldFiles,
    printable,
    read_bytes,
    read_xml,
)
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.light import LightConf

Mesh = tuple[Array, NDArray[np.int32]]

_ROUND_SIDES = 24
_LARGEST_M = 1e5
Colour = tuple[float, float, float]
# What a model is to the importer, as an attribute `role` of that namespace: SDF has none for it.
Role = Literal["ground", "deck", "obstacle", "robot"]
ROLES = "urn:dune_rl"
_ROLE = f"{{{ROLES}}}role"


def role_attribute(role: Role | None) -> dict[str, str]:
    """The attribute of a <model> or an <include> that states its role; nothing for None."""
    return {} if role is None else {_ROLE: role}


def parse_role(element: Element) -> Role | None:
    """The role that a <model> or an <include> states; raises `WorldError` for an unknown one."""
    found = element.get(_ROLE)
    for role in get_args(Role):
        if found == role:
            return role
    if found is not None:
        known = ", ".join(get_args(Role))
        raise WorldError(f"the role of a <model> must be one of {known} (got {printable(found, 40)!r}).")
    return None


def parse_numbers(element: Element | None, count: int, default: tuple[float, ...]) -> Array:
    """The `count` finite numbers in an element; `default` without an element or text."""
    text = None if element is None else (element.text or "").strip()
    if not text or element is None:
        return np.array(default, np.float64)
    try:
        found = np.array([float(word) for word in text.split()], np.float64)
    except ValueError:
        found = np.zeros(0)
    if len(found) != count or not np.isfinite(found).all():
        what = "a number" if count == 1 else f"{count} numbers"
        raise WorldError(f"<{element.tag}> must hold {what} (got {printable(text, 60)!r}).")
    return found


def parse_pose(element: Element) -> Array:
    """The transform (4, 4) of an element's <pose>: by default x y z [m] and roll pitch yaw [rad]."""
    pose = element.find("pose")
    if pose is None:
        return np.eye(4)
    matrix = np.eye(4)
    if pose.get("rotation_format") == "quat_xyzw":
        found = parse_numbers(pose, 7, (0, 0, 0, 0, 0, 0, 1))
        x, y, z, w = found[3:] / max(float(np.linalg.norm(found[3:])), 1e-12)
        matrix = trimesh.transformations.quaternion_matrix([w, x, y, z])
    else:
        found = parse_numbers(pose, 6, (0,) * 6)
        angles = np.deg2rad(found[3:]) if pose.get("degrees") in ("true", "1") else found[3:]
        matrix = trimesh.transformations.euler_matrix(angles[0], angles[1], angles[2], "sxyz")
    matrix = np.asarray(matrix, np.float64)
    matrix[:3, 3] = found[:3]
    return matrix


def build_primitive(element: Element) -> Mesh | None:
    """The closed surface of a <box>, <cylinder>, <cone>, <sphere>, <ellipsoid> or <capsule>; else None."""
    kind = element.tag
    if kind == "box":
        solid = trimesh.creation.box(_parse_lengths(element, "size", 3, (1, 1, 1)))
    elif kind in ("cylinder", "cone", "capsule"):
        radius = float(_parse_lengths(element, "radius", 1, (0.5,))[0])
        length = float(_parse_lengths(element, "length", 1, (1,))[0])
        if kind == "cylinder":
            solid = trimesh.creation.cylinder(radius, length, sections=_ROUND_SIDES)
        elif kind == "cone":
            solid = trimesh.creation.cone(radius, length, sections=_ROUND_SIDES)
            solid.vertices[:, 2] -= length / 2
        else:
            solid = trimesh.creation.capsule(length, radius, count=(_ROUND_SIDES, _ROUND_SIDES))
            solid.vertices[:, 2] -= solid.vertices[:, 2].min() + radius + length / 2
    elif kind == "sphere":
        radius = float(_parse_lengths(element, "radius", 1, (1,))[0])
        solid = trimesh.creation.icosphere(2, radius)
    elif kind == "ellipsoid":
        solid = trimesh.creation.icosphere(2, 1.0)
        solid.vertices *= _parse_lengths(element, "radii", 3, (1, 1, 1))
    else:
        return None
    return np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int32)


def build_plane(element: Element, least_m: Array) -> Mesh:
    """A <plane> as two triangles of its size, at least `least_m` (2,): Gazebo's planes are infinite."""
    normal = parse_numbers(element.find("normal"), 3, (0, 0, 1))
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        raise WorldError("<normal> of a <plane> must not be zero.")
    half = np.maximum(_parse_lengths(element, "size", 2, (1, 1)), least_m) / 2
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 1.0]
    turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], normal / length)[:3, :3]
    return corners @ np.asarray(turn).T, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def _parse_lengths(element: Element, name: str, count: int, default: tuple[float, ...]) -> Array:
    found = parse_numbers(element.find(name), count, default)
    if not ((found > 0) & (found <= _LARGEST_M)).all():
        raise WorldError(f"<{name}> of a <{element.tag}> must be above 0 and at most {_LARGEST_M:g} m.")
    return found


def parse_sun(element: Element, turn: Array, report: ImportReport) -> LightConf | None:
    """The sun of a <light> with orientation `turn` (3, 3); None, with a warning, if it shines upwards."""
    to_sun = -turn @ parse_numbers(element.find("direction"), 3, (0, 0, -1))
    length = float(np.linalg.norm(to_sun))
    if length < 1e-9 or to_sun[2] / length < 0.02:
        report.warn("its directional light does not come from above and is left out")
        return None
    return LightConf(
        sun_bearing_deg=float(np.rad2deg(np.arctan2(to_sun[1], to_sun[0]))),
        sun_elevation_deg=float(np.clip(np.rad2deg(np.arcsin(to_sun[2] / length)), 1.0, 90.0)),
        shadows=(element.findtext("cast_shadows") or "true").strip() in ("true", "1"),
        sun_colour=_sun_colour(element.findtext("diffuse") or "1 1 1", report),
    )


def _sun_colour(text: str, report: ImportReport) -> Colour:
    colour = parse_colour(text)
    if colour is None or max(colour) <= 0.0:
        report.warn(f"<diffuse> of its sun, {printable(text, 40)!r}, is no colour of a light")
        return 1.0, 1.0, 1.0
    return colour


def parse_colour(text: str) -> Colour | None:
    """The colour (3,) in [0, 1] of a <diffuse>; None if it has none."""
    try:
        red, green, blue = (min(max(float(word), 0.0), 1.0) for word in text.split()[:3])
    except ValueError:
        return None
    return (red, green, blue) if np.isfinite([red, green, blue]).all() else None


RESOURCE_VARIABLE = "GZ_SIM_RESOURCE_PATH"

_MODEL_FILE_BYTES = 32 * 2**20
_NAMES = ("world.sdf", "model.sdf")


class SdfFileFinder:
    """Finds files by their URIs in the world's folder, and in the folders of GZ_SIM_RESOURCE_PATH.

    `model://NAME/...` may be in the world's own folder if that is named NAME, in the folder NAME or
    models/NAME in it, or in the folder NAME of a resource folder. Links that lead out of these are refused.
    """

    def __init__(self, folder: Path, report: ImportReport) -> None:
        self.folder = WorldFiles(folder)
        self._report = report
        self._resources = [
            Path(p).expanduser() for p in os.environ.get(RESOURCE_VARIABLE, "").split(":") if p
        ]
        self._xml: dict[Path, Element] = {}

    def find(self, uri: str, beside: WorldFiles) -> tuple[Path, WorldFiles] | None:
        """A file or folder, and the files that it may refer to; None, with a warning, if it is missing.

        Raises `OutsideFolderError` if the URI leads out of the permitted folders.
        """
        scheme, separator, rest = uri.strip().partition("://")
        if separator and scheme in ("model", "package"):
            found = self._find_model(rest)
        elif separator and scheme != "file":
            self._report.warn(
                f"{scheme}:// addresses are not supported: {printable(uri)} is left out; download its folder "
                "beside the file, and write model://FOLDER"
            )
            return None
        else:
            found = _find_inside(beside, rest if separator else uri.strip())
        if found is None:
            self._report.warn(
                f"{printable(uri)} is missing and left out; "
                f"put its folder beside the file, or into {RESOURCE_VARIABLE}"
            )
        return found

    def _find_model(self, rest: str) -> tuple[Path, WorldFiles] | None:
        name, _, inner = rest.replace("\\", "/").partition("/")
        if name in ("", ".", "..") or "\0" in rest:
            raise OutsideFolderError(f"model://{printable(rest)} names no model: use model://NAME/FILE.")
        top = self.folder.root
        own = [*([top] if top.name == name else []), top / name, top / "models" / name]
        for root in (*own, *(resource / name for resource in self._resources)):
            if not root.is_dir():
                record_absent(root)
                continue
            # A resource folder may itself be a link: the user put it there.
            if root in own and not root.resolve().is_relative_to(top):
                raise OutsideFolderError(f"{root} is a link that leads out of {top}: it is not read.")
            if found := _find_inside(WorldFiles(root), inner):
                return found
        return None

    def read_document(self, path: Path) -> Element:
        """The root element of an SDF file; each file is read once."""
        real = path.resolve()
        if real not in self._xml:
            root = read_xml(read_bytes(path, _MODEL_FILE_BYTES), path.name)
            if root.tag != "sdf":
                raise WorldError(
                    f"{path} is no SDF file: its root is <{printable(root.tag, 40)}>, not <sdf>."
                )
            self._xml[real] = root
        return self._xml[real]

    def find_description(self, folder: Path, within: WorldFiles) -> Path:
        """The SDF file of a model's or world's folder: the newest in model.config, or one of usual name."""
        names: list[str] = []
        config = folder / "model.config"
        if not config.is_file():
            record_absent(config)
        else:
            within.relative_to(folder).find("model.config")
            root = read_xml(read_bytes(config, _MODEL_FILE_BYTES), config.name)
            listed = [(_version(element), (element.text or "").strip()) for element in root.iter("sdf")]
            names = [name for _, name in sorted(listed, key=lambda item: item[0], reverse=True) if name]
        for name in (*names, *_NAMES):
            try:
                return within.relative_to(folder).find(name)
            except FileNotFoundError:
                continue
        mark_incomplete()
        found = sorted(p for ending in ("*.sdf", "*.world") for p in folder.glob(ending))
        if len(found) == 1:
            return within.relative_to(folder).find(found[0].name)
        listing = ", ".join(p.name for p in found[:8]) or "none"
        raise WorldError(
            f"{folder} has no model.sdf or world.sdf (of .sdf and .world: {listing}): name the file."
        )


def _find_inside(folder: WorldFiles, inner: str) -> tuple[Path, WorldFiles] | None:
    """A file or folder inside `folder`, or `folder` itself, with its files; None if it is missing."""
    try:
        path = folder.locate(inner)
    except FileNotFoundError:
        return None
    return path, WorldFiles(path.resolve()) if path.is_dir() else folder


def _version(element: Element) -> tuple[int, ...]:
    words = (element.get("version") or "0").split(".")
    return tuple(int(word) if word.isdigit() else 0 for word in words[:3])
