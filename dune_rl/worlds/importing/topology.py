"""Connectivity of triangle meshes, and closing of open surfaces."""

import numpy as np
import scipy
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array

Faces = NDArray[np.int32]
Ids = NDArray[np.int64]

_WELD_M = 1e-4
_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
SHELL_M = 0.02


def weld_vertices(vertices: Array, faces: Faces) -> Ids:
    """Faces (F, 3) with welded vertex ids: vertices within about 0.1 mm get the same id."""
    cells = np.round(vertices / _WELD_M).astype(np.int64).view(np.uint64)
    # A hash of each cell; among a million cells, the probability of a collision is 1 in 10 million.
    key = cells[:, 0] * _MIX[0]
    for axis in (1, 2):
        key = (key ^ (key >> np.uint64(29))) * _MIX[axis] + cells[:, axis] * _MIX[axis - 1]
    _, place = np.unique(key, return_inverse=True)
    return np.asarray(place, np.int64).reshape(-1)[faces]


def renumber_welded(vertices: Array, faces: Faces) -> tuple[Ids, NDArray[np.int32]]:
    """Faces (F, 3) of welded vertices, numbered from 0, and the index in `vertices` of each of these."""
    _, index, ids = np.unique(weld_vertices(vertices, faces), return_index=True, return_inverse=True)
    return ids.reshape(-1, 3), faces.reshape(-1)[index]


def doubled_areas(corners: Array) -> Array:
    """Normals (F, 3) of triangles (F, 3, 3), as long as twice their areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def label_face_components(ids: Ids) -> Ids:
    """Number of the connected component (F,) of each face (F, 3): faces that share an edge are connected."""
    count = len(ids)
    _, _, keys, edge, _ = _edges(ids)
    face = np.tile(np.arange(count), 3)
    # A bipartite graph of faces and edges.
    nodes = count + len(keys)
    graph = scipy.sparse.coo_array((np.ones(len(face), np.int8), (face, count + edge)), shape=(nodes, nodes))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.unique(label[:count], return_inverse=True)[1].reshape(-1).astype(np.int64)


def open_edges(ids: Ids) -> tuple[Ids, Ids]:
    """Face indices and sides (N,) of the edges that belong to only one of the faces (F, 3)."""
    _, _, _, edge, uses = _edges(ids)
    single = np.flatnonzero(uses[edge] == 1)
    return single % len(ids), single // len(ids)


def _edges(ids: Ids) -> tuple[Ids, Ids, Ids, Ids, Ids]:
    """Start and end (3F,) of all sides, sides 0 of all faces first; keys (E,) of the edges; the edge of each
    side (3F,); and the number of sides of each edge (E,).
    """
    start, end = ids.T.reshape(-1), np.roll(ids, -1, axis=1).T.reshape(-1)
    key = np.minimum(start, end) * (int(ids.max(initial=0)) + 1) + np.maximum(start, end)
    keys, edge, uses = np.unique(key, return_inverse=True, return_counts=True)
    return start, end, keys, edge.reshape(-1), uses


def boundary_edges(ids: Ids) -> tuple[Ids, Ids]:
    """Start and end ids (N,) of the directed edges without an opposite edge; they may repeat."""
    start, end, keys, edge, _ = _edges(ids)
    net = np.bincount(edge, np.where(start < end, 1, -1), minlength=len(keys)).astype(int)
    least, most = np.divmod(keys, int(ids.max(initial=0)) + 1)
    net[least == most] = 0
    times = np.abs(net)
    first, second = np.where(net > 0, least, most), np.where(net > 0, most, least)
    return np.repeat(first, times), np.repeat(second, times)


def close_surface(
    vertices: Array, faces: Faces, ground_height: Array
) -> tuple[Array, Faces, NDArray[np.intp]]:
    """The mesh as a closed surface facing outward, and the source face (F,) of each of its faces.

    A mesh that is open only at or below the ground (`ground_height` (V,) [m] below its vertices) is capped
    there. Any other open mesh is treated as a sheet and gets a back side at a distance of `SHELL_M`.
    """
    ids, origin = renumber_welded(vertices, faces)
    points, ground = vertices[origin], ground_height[origin]
    start, end = boundary_edges(ids)
    rim = np.concatenate([start, end])
    if not (points[rim, 2] <= ground[rim] + 0.03).all():
        return _thicken(points, ids, start, end)
    if len(rim):
        apex = points[rim].mean(axis=0)
        apex[2] = min(float(points[rim, 2].min()), float(ground[rim].min())) - 0.1
        caps = np.stack([end, start, np.full(len(start), len(points))], axis=1)
        ids, points = np.concatenate([ids, caps]), np.concatenate([points, apex[None]])
    if signed_volumes(points, ids).sum() < 0:
        ids = ids[:, ::-1]
    source = np.concatenate([np.arange(len(faces)), np.zeros(len(start), np.intp)])
    return points, ids.astype(np.int32), source


def _thicken(points: Array, ids: Ids, start: Ids, end: Ids) -> tuple[Array, Faces, NDArray[np.intp]]:
    normals = np.zeros_like(points)
    np.add.at(normals, ids.reshape(-1), np.repeat(doubled_areas(points[ids]), 3, axis=0))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # Where sheets touch back to back, normals cancel; any direction will do.
    normals = np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    count = len(points)
    both = np.concatenate([points + normals * SHELL_M / 2, points - normals * SHELL_M / 2])
    sides = np.concatenate(
        [np.stack([end, start, start + count], axis=1), np.stack([end, start + count, end + count], axis=1)]
    )
    faces = np.concatenate([ids, ids[:, ::-1] + count, sides]).astype(np.int32)
    source = np.arange(len(ids))
    return both, faces, np.concatenate([source, source, np.zeros(len(sides), np.intp)])


def signed_volumes(points: Array, ids: Ids) -> Array:
    """Six times the signed volumes (F,) between the faces (F, 3) and the centroid of `points` (V, 3)."""
    # About the centroid, where rounding errors are smallest.
    a, b, c = np.moveaxis(points[ids] - points.mean(axis=0), 1, 0)
    return np.einsum("ij,ij->i", a, np.cross(b, c))
