"""Props of imported worlds: triangles that are not ground, grouped and closed."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dune_rl.core.untrusted_files import ImportReport
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.mesh_files.parts import MeshPart, join_parts
from dune_rl.worlds.importing.topology import (
    close_surface,
    doubled_areas,
    label_face_components,
    weld_vertices,
)
from dune_rl.worlds.world import Prop

MAX_PROPS = 400
# Bullet takes no mesh with more than 131,072 vertices or 524,288 indices.
_MOST_FACES = 40_000
# Pieces with vertices in the same cell of this size form one prop.
_CELL_M = 0.5
# Up to this number, pieces with overlapping bounding boxes form one prop, too.
_MOST_COMPARED = 2_000
# Faces this close to the ground, or below it, belong to the ground: skirts, steep faces, decals.
_FLUSH_M = 0.02
_LONGEST_STEEP_M = 1.5
_BACKDROP_M = 50.0


# A part, and pieces of it that form one prop.
_Group = tuple[MeshPart, list[MeshPart]]


def extract_props(
    parts: Sequence[MeshPart], is_ground: Flags, terrain: HeightField, report: ImportReport
) -> list[Prop]:
    """Props of the triangles that are not ground; `is_ground` (F,) covers all parts in their order.

    Pieces of a part that are near each other form one prop. Triangles below the ground or flush with it are
    left out.
    """
    starts = np.cumsum([0, *(len(part.faces) for part in parts)])
    groups: list[_Group] = []
    for part, start in zip(parts, starts[:-1], strict=True):
        rest = np.flatnonzero(~is_ground[start : start + len(part.faces)])
        far = _is_backdrop(part, rest, terrain)
        if far.any():
            report.warn(f"{part.name!r} reaches far beyond the ground; its triangles there are left out")
        pieces = list(_split_pieces(part, rest[~far], terrain))
        groups += [(part, group) for group in _group_near_pieces(pieces)]
    if len(groups) > MAX_PROPS:
        report.warn(f"{len(groups)} separate objects are merged into one per part of the file")
        groups = _merge_by_part(groups)
    return _build_props(groups)


def _is_backdrop(part: MeshPart, faces: NDArray[np.intp], terrain: HeightField) -> Flags:
    """Mask of triangles far beyond the ground, such as those of a sky dome."""
    xmin, xmax, ymin, ymax = terrain.extent
    reach = max(_BACKDROP_M, 0.5 * max(xmax - xmin, ymax - ymin))
    bottom, top = terrain.heights.min() - reach, terrain.heights.max() + reach
    corners = part.vertices[part.faces[faces]]
    beyond = (corners < [xmin - reach, ymin - reach, bottom]) | (corners > [xmax + reach, ymax + reach, top])
    return np.asarray(beyond.any(axis=(1, 2)))


def _split_pieces(part: MeshPart, rest: NDArray[np.intp], terrain: HeightField) -> Iterator[MeshPart]:
    """The connected components of some faces of a part, each closed."""
    if not len(rest):
        return
    height = terrain.height(part.vertices[:, :2])
    over = part.vertices[:, 2] - height
    if part.solid:
        rest = rest[~_is_terrain_face(part, rest, over, terrain)]
        if not len(rest):
            return
    number = label_face_components(weld_vertices(part.vertices, part.faces[rest]))
    order = np.argsort(number, kind="stable")
    for piece in np.split(rest[order], np.flatnonzero(np.diff(number[order])) + 1):
        faces = part.faces[piece]
        if part.solid and not part.drivable and (over[faces] < _FLUSH_M).all():
            continue
        vertices, corners, source = close_surface(part.vertices, faces, height)
        texture = None if part.texture is None else part.texture.select_faces(piece[source])
        colours = part.colours[piece][source]
        yield replace(part, vertices=vertices, faces=corners, colours=colours, texture=texture)


def _is_terrain_face(part: MeshPart, faces: NDArray[np.intp], over: Array, terrain: HeightField) -> Flags:
    """Mask of steep faces that belong to the terrain: they lie on it, to the accuracy of its grid."""
    reach = max(_FLUSH_M, 0.5 * terrain.spacing_m)
    near = (np.abs(over[part.faces[faces]]) < reach).all(axis=1)
    near &= np.ptp(part.vertices[part.faces[faces], 2], axis=1) < _LONGEST_STEEP_M
    # Thin plates and low kerbs are near the ground, too: only single sheets belong to it.
    corners = part.vertices[part.faces[faces]]
    centre = corners.mean(axis=1)
    near &= np.abs(centre[:, 2] - terrain.height(centre[:, :2])) < reach / 2
    return near & (part.ground is not False) & is_single_sheet(part)


def is_single_sheet(part: MeshPart) -> bool:
    # Hardly any face of a terrain faces down; of a closed surface, as much area faces down as up.
    upward = doubled_areas(part.vertices[part.faces])[:, 2]
    return bool(upward[upward > 0].sum() > 5 * -upward[upward < 0].sum())


def _group_near_pieces(pieces: list[MeshPart]) -> list[list[MeshPart]]:
    """Groups of pieces with overlapping bounding boxes, or with vertices in the same cells."""
    if len(pieces) <= 1:
        return [pieces] if pieces else []
    owner = np.repeat(np.arange(len(pieces)), [len(piece.vertices) for piece in pieces])
    cells = np.floor(np.concatenate([piece.vertices for piece in pieces]) / _CELL_M).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    nodes = len(pieces) + int(cell.max()) + 1
    pairs = np.stack([owner, len(pieces) + cell.reshape(-1)])
    if len(pieces) <= _MOST_COMPARED:
        low = np.array([piece.vertices.min(axis=0) for piece in pieces])
        high = np.array([piece.vertices.max(axis=0) for piece in pieces])
        below = np.ones((len(pieces), len(pieces)), bool)
        for axis in range(3):
            below &= low[:, None, axis] <= high[None, :, axis]
        pairs = np.concatenate([pairs, np.stack(np.nonzero(below & below.T))], axis=1)
    graph = coo_array((np.ones(pairs.shape[1], np.int8), tuple(pairs)), shape=(nodes, nodes))
    count, label = connected_components(graph, directed=False)
    groups: list[list[MeshPart]] = [[] for _ in range(count)]
    for piece, number in zip(pieces, label[: len(pieces)], strict=True):
        groups[number].append(piece)
    return [group for group in groups if group]


def _merge_by_part(groups: list[_Group]) -> list[_Group]:
    # By kind if the file has too many parts.
    merged: dict[object, _Group] = {}
    for key in (lambda part: id(part), lambda part: (part.kind, part.solid, part.drivable)):
        merged = {}
        for part, pieces in groups:
            merged.setdefault(key(part), (part, []))[1].extend(pieces)
        if len(merged) <= MAX_PROPS:
            break
    return list(merged.values())


def _build_props(groups: list[_Group]) -> list[Prop]:
    props: list[Prop] = []
    counts: dict[str, int] = {}
    for whole, pieces in groups:
        for part in _split_within_limits(join_parts(pieces)):
            number = counts[part.name] = counts.get(part.name, 0) + 1
            area = np.linalg.norm(doubled_areas(part.vertices[part.faces]), axis=1)
            red, green, blue = np.average(part.colours, axis=0, weights=area + 1e-12).tolist()
            name = part.name if number == 1 else f"{part.name} #{number}"
            is_solid = part.solid and not part.is_named_water
            mesh, colours = (part.vertices, part.faces), part.colours.astype(np.float32)
            is_drivable = is_solid and whole.drivable
            look: Any = {"colour": (red, green, blue), "face_colours": colours, "texture": part.texture}
            props.append(Prop(name, whole.kind, *mesh, is_solid, is_drivable, **look))
    return props


def _split_within_limits(part: MeshPart) -> Iterator[MeshPart]:
    """The part, or several if an engine's limits require it; together these are closed."""
    if len(part.faces) <= _MOST_FACES:
        yield part
        return
    along = int(np.ptp(part.vertices[:, :2], axis=0).argmax())
    order = np.argsort(part.vertices[part.faces, along].mean(axis=1), kind="stable")
    for chosen in np.array_split(order, int(np.ceil(len(order) / _MOST_FACES))):
        yield part.select_faces(chosen)
