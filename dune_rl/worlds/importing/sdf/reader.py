"""Reading of Gazebo models and worlds (SDF) into parts, planes, height maps, a sun and frictions."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import (
    MAX_FACES,
    Bytes,
    ImportReport,
    WorldFiles,
    first_line,
    printable,
    read_bytes,
    read_image,
)
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_files.files import load_mesh_parts
from dune_rl.rendering.mesh_files.parts import GREY, MeshPart, guess_colour
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.importing.sdf.actors import MOST_ACTORS, parse_actor
from dune_rl.worlds.importing.sdf.elements import (
    Role,
    SdfFileFinder,
    build_primitive,
    parse_colour,
    parse_numbers,
    parse_pose,
    parse_role,
    parse_sun,
)

Colour = tuple[float, float, float]

_DEEPEST, _MOST_INCLUDES, _MOST_ELEMENTS = 16, 2_000, 20_000
# Elements that do not affect the shape of a world.
_IGNORED = {
    *("pose", "name", "static", "uri", "inertial", "gravity", "physics", "scene", "gui", "wind", "audio"),
    *("atmosphere", "magnetic_field", "spherical_coordinates", "state", "self_collide", "enable_wind"),
    *("allow_auto_disable", "kinematic", "velocity_decay", "must_be_base_link", "frame", "author"),
}  # fmt: skip


@dataclass(eq=False)
class SdfHeightMap:
    """A <heightmap>: its file, size (3,) [m], and pose `matrix` (4, 4) of its centre.

    `picture` (rows, columns, 3) is its texture, repeated in tiles of `tile_m`; None without one.
    """

    path: Path
    size: Array
    matrix: Array
    colour: Colour | None
    picture: Bytes | None = None
    tile_m: float = 1.0


@dataclass(eq=False)
class SdfContents:
    """Contents of a file: solid and visible parts, planes with their poses, height maps, sun, frictions, and
    trajectories of actors.
    """

    parts: list[MeshPart] = field(default_factory=list)
    planes: list[tuple[Element, Array, Colour]] = field(default_factory=list)
    height_maps: list[SdfHeightMap] = field(default_factory=list)
    # By the name of a part, or "plane" or "heightmap".
    frictions: dict[str, float] = field(default_factory=dict)
    light: LightConf | None = None
    actors: list[ActorTrajectory] = field(default_factory=list)


class _Place(NamedTuple):
    """Where elements stand: the files that they may refer to, pose (4, 4), name, the including files, and
    the role of the model.
    """

    folder: WorldFiles
    matrix: Array
    name: str = ""
    chain: tuple[Path, ...] = ()
    role: Role | None = None


class SdfReader:
    """Reads a file and everything that it includes; with `actors_only`, nothing but its actors."""

    def __init__(self, finder: SdfFileFinder, report: ImportReport, *, actors_only: bool = False) -> None:
        self._actors_only = actors_only
        self._contents = SdfContents()
        self._finder, self._report = finder, report
        self._elements = self._includes = self._faces = 0
        self._meshes: dict[Path, list[MeshPart]] = {}
        self._pictures: dict[Path, Bytes] = {}

    def read(self, path: Path, folder: WorldFiles) -> SdfContents:
        """The contents of the file at `path`, which may refer to files in `folder`."""
        self._read_file(path, _Place(folder, np.eye(4)))
        return self._contents

    def _read_file(self, path: Path, place: _Place) -> None:
        real, source, chain = path.resolve(), self._report.source, place.chain
        if real in chain:
            loop = " > ".join(p.parent.name + "/" + p.name for p in (*chain[chain.index(real) :], real))
            raise WorldError(f"{source} includes itself ({loop}): take one <include> out.")
        if len(chain) >= _DEEPEST:
            raise WorldError(f"{source} has <include>s more than {_DEEPEST} deep: flatten them.")
        here = place._replace(folder=place.folder.relative_to(path.parent), chain=(*chain, real))
        try:
            self._read_children(self._finder.read_document(path), here)
        except WorldError as error:
            # The message names the innermost file, and only once.
            text = str(error)
            raise WorldError(text if path.name in text or chain else f"{path.name}: {text}") from None

    def _read_children(self, element: Element, place: _Place) -> None:
        for child in element:
            self._elements += 1
            self._limit(self._elements, _MOST_ELEMENTS, "elements")
            if parse_role(child) == "robot":
                continue
            if child.tag in ("world", "model"):
                # In Gazebo, a model without <static> falls and can be pushed.
                if child.tag == "model" and _text(child, "static") not in ("true", "1"):
                    self._report.warn("models that are not <static> do not move here")
                # A world's name is ignored; the name of an <include> replaces the model's own.
                own = "" if child.tag == "world" else child.get("name") or ""
                full = place.name if element.tag == "sdf" and place.name else _path(place.name, own)
                role = parse_role(child) or place.role
                self._read_children(child, self._at(place, child)._replace(name=full, role=role))
            elif child.tag == "actor":
                actor = parse_actor(child, place.matrix, self._report)
                self._contents.actors += [] if actor is None else [actor]
                self._limit(len(self._contents.actors), MOST_ACTORS, "actors")
            elif self._actors_only and child.tag != "include":
                continue
            elif child.tag == "link":
                own = place.name or printable(child.get("name") or "")
                self._read_link(child, self._at(place, child)._replace(name=own))
            elif child.tag == "include":
                self._read_include(child, place)
            else:
                self._read_light_or_warn(child, place)

    def _limit(self, count: int, most: int, what: str) -> None:
        if count > most:
            raise WorldError(f"{self._report.source} has more than {most:,} {what}: reduce it.")

    def _at(self, place: _Place, element: Element) -> _Place:
        """The place moved by the pose of an element."""
        pose = element.find("pose")
        if pose is not None and (pose.get("relative_to") or pose.get("frame")):
            self._report.warn(
                "<pose relative_to> is not supported; such poses are read in their parent's frame"
            )
        return place._replace(matrix=place.matrix @ parse_pose(element))

    def _read_include(self, element: Element, place: _Place) -> None:
        if element.find("placement_frame") is not None:
            self._report.warn("<placement_frame> is not supported and left out")
        found = self._finder.find(_text(element, "uri"), place.folder)
        if found is None:
            return
        path, within = found
        if path.is_dir():
            path = self._finder.find_description(path, within)
        self._includes += 1
        self._limit(self._includes, _MOST_INCLUDES, "<include>s")
        name = _path(place.name, _text(element, "name") or path.parent.name)
        self._read_file(path, self._at(place, element)._replace(folder=within, name=name))

    def _read_link(self, link: Element, place: _Place) -> None:
        for child in link:
            if child.tag not in ("collision", "visual"):
                self._read_light_or_warn(child, place)
        visuals, collisions = link.findall("visual"), link.findall("collision")
        colours = [self._visual_colour(visual, place.folder) for visual in visuals]
        first = next((colour for colour in colours if colour is not None), None)
        for collision in collisions:
            self._read_shape(collision, place, first, visuals, solid=True)
        if not collisions:
            for visual, colour in zip(visuals, colours, strict=True):
                self._read_shape(visual, place, colour, [visual], solid=False)

    def _read_shape(
        self, holder: Element, place: _Place, colour: Colour | None, visuals: list[Element], *, solid: bool
    ) -> None:
        place = self._at(place, holder)
        friction = None
        for way in ("surface/friction/bullet/friction", "surface/friction/ode/mu"):
            if (found := holder.find(way)) is not None:
                friction = float(parse_numbers(found, 1, (1.0,))[0])
        for shape in holder.findall("geometry/*"):
            self._elements += 1
            if shape.tag == "plane":
                if solid:
                    self._contents.planes.append((shape, place.matrix, colour or GREY))
                    self._record_friction("plane", friction)
            elif shape.tag == "heightmap":
                self._read_height_map(shape, place, colour, visuals)
                self._record_friction("heightmap", friction)
            elif shape.tag != "empty":
                parts = [
                    _with_role(part, place.role) for part in self._read_mesh(shape, place, colour, solid)
                ]
                for part in parts:
                    self._faces += len(part.faces)
                    self._record_friction(part.name, friction)
                self._limit(self._faces, MAX_FACES, "triangles")
                self._contents.parts += parts

    def _record_friction(self, name: str, friction: float | None) -> None:
        if friction is not None:
            self._contents.frictions[name] = friction

    def _read_mesh(
        self, shape: Element, place: _Place, colour: Colour | None, solid: bool
    ) -> Iterator[MeshPart]:
        mesh, name = build_primitive(shape), place.name or "thing"
        if mesh is not None:
            part = MeshPart.from_triangles(name, *mesh, colour, shape.tag, solid=solid)
            yield part.transform(place.matrix)
        elif shape.tag == "mesh":
            if shape.find("submesh") is not None:
                self._report.warn("<submesh> is not supported; the whole mesh is used")
            found = self._finder.find(_text(shape, "uri"), place.folder)
            if found is None:
                return
            path, within = found
            real = path.resolve()
            if real not in self._meshes:
                self._meshes[real] = load_mesh_parts(path, within.relative_to(path.parent), self._report)
            scale = np.eye(4)
            scale[range(3), range(3)] = parse_numbers(shape.find("scale"), 3, (1, 1, 1))
            if abs(float(np.linalg.det(scale))) < 1e-12:
                raise WorldError("<scale> of a <mesh> must not be zero.")
            for part in self._meshes[real]:
                about = f"{part.name} {path.stem} {part.about}"
                own = replace(part, name=name, about=about, ground=None, solid=solid)
                if colour is not None:
                    colours = np.broadcast_to(np.array(colour, np.float32), part.colours.shape)
                    own = replace(own, colours=np.ascontiguousarray(colours), texture=None)
                yield own.transform(place.matrix @ scale)
        else:
            self._report.warn(f"<{printable(shape.tag, 40)}> as a shape is not supported and left out")

    def _read_height_map(
        self, shape: Element, place: _Place, colour: Colour | None, visuals: list[Element]
    ) -> None:
        folder = place.folder
        found = self._finder.find(_text(shape, "uri"), folder)
        if found is None:
            return
        picture, tile_m = None, 10.0
        pictures = [shape, *(s for visual in visuals for s in visual.iter("heightmap"))]
        for texture in (t for s in pictures for t in s.findall("texture")):
            diffuse = self._read_picture(_text(texture, "diffuse"), folder)
            if picture is None and diffuse is not None:
                picture, tile_m = diffuse, float(parse_numbers(texture.find("size"), 1, (10.0,))[0])
            # Normal maps are not used, but their absence is reported.
            self._read_picture(_text(texture, "normal"), folder)
        if not 1e-3 <= tile_m <= 1e5:
            self._report.warn(f"<size> of a <texture> is {tile_m:g} m; its mean colour is used")
            colour = colour or (None if picture is None else mean_colour(picture))
            picture = None
        size = parse_numbers(shape.find("size"), 3, (1, 1, 1))
        offset = np.eye(4)
        offset[:3, 3] = parse_numbers(shape.find("pos"), 3, (0, 0, 0))
        if not ((size > 0) & (size < 1e5)).all():
            raise WorldError("<size> of a <heightmap> must be above 0.")
        height_map = SdfHeightMap(found[0], size, place.matrix @ offset, colour, picture, tile_m)
        self._contents.height_maps.append(height_map)

    def _visual_colour(self, visual: Element, folder: WorldFiles) -> Colour | None:
        """The colour of a visual's material; None if it has none, so that a mesh keeps its own."""
        material = visual.find("material")
        if material is None:
            return None
        picture = self._read_picture(_text(material, "pbr/metal/albedo_map"), folder)
        colour = None if picture is None else mean_colour(picture)
        if colour is None and material.find("diffuse") is not None:
            text = " ".join((material.findtext("diffuse") or "").split()[:4])
            colour = parse_colour(text)
            if colour is None:
                self._report.warn(f"<diffuse> {printable(text, 40)!r} is no colour")
        script = material.findtext("script/name")
        if colour is None and script:
            self._report.warn("material scripts are not supported; their colours are guessed by name")
            colour = guess_colour(script)
        return colour

    def _read_picture(self, uri: str, folder: WorldFiles) -> Bytes | None:
        """An image; None, with a warning, if it cannot be read."""
        found = self._finder.find(uri, folder) if uri else None
        if found is None:
            return None
        real = found[0].resolve()
        try:
            if real not in self._pictures:
                self._pictures[real] = self._report.limit_texture(read_image(read_bytes(real)))
            return self._pictures[real]
        except ValueError as error:
            self._report.warn(f"{printable(uri)} is left out: {first_line(error)}")
            return None

    def _read_light_or_warn(self, element: Element, place: _Place) -> None:
        kind = element.get("type") or "none"
        if element.tag != "light":
            if element.tag not in _IGNORED:
                self._report.warn(f"<{printable(element.tag, 40)}> is not supported and left out")
        elif kind != "directional":
            self._report.warn(f"lights of type {printable(kind, 20)!r} are left out; the sun is kept")
        elif self._contents.light is not None:
            self._report.warn("has several directional lights; the first is the sun")
        else:
            turn = self._at(place, element).matrix[:3, :3]
            self._contents.light = parse_sun(element, turn, self._report)


def _with_role(part: MeshPart, role: Role | None) -> MeshPart:
    """The part of a model that states its role, if it states one."""
    return part if role is None else replace(part, ground=role == "ground", drivable=role == "deck")


def mean_colour(picture: Bytes) -> Colour:
    """The mean colour in sRGB of an image (rows, columns, 3) of bytes."""
    red, green, blue = (picture.mean(axis=(0, 1)) / 255.0).tolist()
    return red, green, blue


def _text(element: Element, path: str) -> str:
    return (element.findtext(path) or "").strip()


def _path(name: str, own: str) -> str:
    return printable("/".join(word for word in (name, own) if word))
