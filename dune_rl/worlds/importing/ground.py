"""Separation of triangles into ground, as a grid of heights, and everything else."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.mesh_files.parts import MeshPart, join_parts
from dune_rl.worlds.ground_texture import GroundPicture
from dune_rl.worlds.importing.height_grid import (
    Triangles,
    bake_ground_picture,
    cast_down,
    fill_gaps,
    grid_axes,
    grid_spacing,
    ground_extent,
)
from dune_rl.worlds.importing.topology import doubled_areas, label_face_components, open_edges, weld_vertices

# Steeper triangles are no ground: walls, and the sides of objects.
_STEEPEST_RAD = np.deg2rad(62.0)
# A surface is ground if its rim is at most one step, which a wheel can climb, above the ground around it.
_STEP_M = 0.06
_JOINED_SHARE = 0.7
_PASSES = 6
_VAULT_RISE = 0.2
# A surface without ground below it is ground, too, from this share of the largest area on.
_ISLAND_SHARE, _ISLAND_M2 = 0.005, 4.0


class ImportedGround(NamedTuple):
    """The ground of an imported world as a grid.

    `known` (rows, columns) marks heights that were sampled, not filled in; `colours` (rows, columns, 3) are
    sRGB, None if the file has none. `picture` has more detail than these, None without textures.
    """

    terrain: HeightField
    known: Flags
    colours: Floats | None = None
    picture: GroundPicture | None = None


def extract_ground(
    parts: Sequence[MeshPart], spacing_m: float | None, report: ImportReport
) -> tuple[ImportedGround, Flags]:
    """The ground of `parts`, sampled by vertical rays every `spacing_m`; None: chosen for its size.

    Also returns a mask (F,) of the triangles of all parts, in their order, that belong to the ground.
    Connected triangles that face up and are not steep form a surface. The largest one without a surface of
    similar size below it is ground, and so is every other whose rim touches the ground, such as a mound or a
    road, or that has no ground below it. The rest stands on the ground or hangs above it. Parts that declare
    whether they are ground are taken as declared. Holes are filled smoothly, and reported unless an object
    covers them.
    """
    soup = _join_triangles(parts)
    surface = _label_surfaces(soup)
    if surface.max(initial=-1) < 0:
        raise WorldError(
            f"{report.source} has no triangle that faces up, so there is no ground to drive on: "
            "check its up axis (world.up), and that its faces are not inside out."
        )
    is_ground = _find_ground_faces(soup, surface)
    low, high = ground_extent(soup, is_ground)
    step = grid_spacing(low, high, spacing_m)
    x, y, origin = grid_axes(low, high, step)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    heights, face = cast_down(soup, np.flatnonzero(is_ground), points, low, high)
    known = face >= 0
    colours = np.where(known[..., None], soup.colours[face], 0.0).astype(np.float32)
    _warn_of_holes(soup, is_ground, known, points, report)
    terrain = HeightField(fill_gaps(heights, known), step, origin)
    smooth = [fill_gaps(colours[..., channel].astype(np.float64), known) for channel in range(3)]
    colours = np.stack(smooth, axis=-1).astype(np.float32)
    picture = bake_ground_picture(soup, is_ground, terrain, colours)
    return ImportedGround(terrain, known, colours, picture), is_ground


def _join_triangles(parts: Sequence[MeshPart]) -> Triangles:
    whole = join_parts(parts)
    claim = {True: 1, False: -1, None: 0}
    claims = [
        np.full(len(part.faces), claim[part.ground if part.solid else False], np.int8) for part in parts
    ]
    doubled = doubled_areas(whole.vertices[whole.faces])
    length = np.linalg.norm(doubled, axis=1)
    normals = doubled / np.maximum(length, 1e-30)[:, None]
    mesh = whole.vertices, whole.faces, whole.colours
    return Triangles(*mesh, np.concatenate(claims), normals, length / 2, whole.texture)


def _label_surfaces(soup: Triangles) -> NDArray[np.int64]:
    """Number of the connected surface (F,) of each triangle, -1 for none."""
    upward = (soup.normals[:, 2] > np.cos(_STEEPEST_RAD)) & (soup.claim >= 0)
    if (soup.claim > 0).any():
        # If a file declares its ground, nothing else is ground.
        upward = soup.claim > 0
    surface = np.full(len(soup.faces), -1, np.int64)
    chosen = np.flatnonzero(upward)
    if len(chosen):
        surface[chosen] = label_face_components(weld_vertices(soup.vertices, soup.faces)[chosen])
    return surface


def _find_ground_faces(soup: Triangles, surface: NDArray[np.int64]) -> Flags:
    """Mask (F,) of the triangles that are ground, grown from a seed surface."""
    if (soup.claim > 0).any():
        return soup.claim > 0
    count = int(surface.max()) + 1
    chosen = surface >= 0
    flat_area = np.bincount(surface[chosen], (soup.areas * soup.normals[:, 2])[chosen], minlength=count)
    ground = np.zeros(count, bool)
    seed, vault = _choose_seed(soup, surface, np.asarray(flat_area, np.float64))
    ground[seed] = True
    large = ~vault & (flat_area >= max(_ISLAND_M2, _ISLAND_SHARE * float(flat_area[~vault].max(initial=0.0))))
    probes = _rim_probes(soup, surface)
    for _ in range(_PASSES):
        is_ground = ground[surface] & chosen
        joined, over_none = _rims_on_ground(soup, is_ground, probes, count)
        # A roof's rim may be beyond the ground's edge while its inside is above ground.
        others = np.flatnonzero(chosen & ~is_ground)
        centres = soup.vertices[soup.faces[others]].mean(axis=1)
        above = np.zeros(count, bool)
        above[surface[others[np.isfinite(_topmost(soup, is_ground, centres[:, :2]))]]] = True
        islands = large & (over_none > 0.95) & ~above
        more = ~ground & ((joined >= _JOINED_SHARE) | islands)
        if not more.any():
            break
        ground |= more
    return ground[surface] & chosen


def _choose_seed(soup: Triangles, surface: NDArray[np.int64], flat_area: Array) -> tuple[int, Flags]:
    """The lowest surface of at least half the largest area; and a mask (S,) of those that are backdrops."""
    member = np.argsort(surface, kind="stable")[int((surface < 0).sum()) :]
    pieces = np.split(member, np.cumsum(np.bincount(surface[member]))[:-1])
    large = [int(s) for s in np.flatnonzero(flat_area >= min(_ISLAND_M2, float(flat_area.max())))]
    centre = {s: soup.vertices[soup.faces[pieces[s]]].mean(axis=(0, 1)) for s in large}
    vault = np.zeros(len(flat_area), bool)
    # A sky dome is larger than everything below it.
    vault[[s for s in large if _is_vault(soup.vertices[soup.faces[pieces[s]]], centre, s)]] = True
    usable = [s for s in large if not vault[s]] or large
    widest = max(flat_area[usable])
    return min((s for s in usable if flat_area[s] > 0.5 * widest), key=lambda s: float(centre[s][2])), vault


def _is_vault(corners: Array, centre: dict[int, Array], number: int) -> bool:
    """Whether a surface rises like a dome and has another large surface below it."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    if high[2] - low[2] < _VAULT_RISE * (high - low)[:2].max():
        return False
    return any(
        (low[:2] < other[:2]).all() and (other[:2] < high[:2]).all() and other[2] < low[2]
        for key, other in centre.items()
        if key != number
    )


class _Probes(NamedTuple):
    """Points on the rims of surfaces: positions, surfaces, lengths of rim [m], and outward directions."""

    at: Array
    surface: NDArray[np.int64]
    weight: Array
    outward: Array


def _rim_probes(soup: Triangles, surface: NDArray[np.int64]) -> _Probes:
    chosen = np.flatnonzero(surface >= 0)
    ids = weld_vertices(soup.vertices, soup.faces)[chosen]
    edge_face, edge_side = open_edges(ids)
    face = chosen[edge_face]
    start = soup.vertices[soup.faces[face, edge_side]]
    end = soup.vertices[soup.faces[face, (edge_side + 1) % 3]]
    opposite = soup.vertices[soup.faces[face, (edge_side + 2) % 3]]
    along = (end - start)[:, :2]
    length = np.linalg.norm(along, axis=1)
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    inward = ((opposite - start)[:, :2] * outward).sum(axis=1) > 0
    outward[inward] *= -1
    at = start[:, None] + np.array([[0.15], [0.5], [0.85]]) * (end - start)[:, None]
    values = (np.repeat(each, 3, axis=0) for each in (surface[face], length, outward))
    return _Probes(at.reshape(-1, 3), *values)


def _rims_on_ground(soup: Triangles, ground: Flags, probes: _Probes, count: int) -> tuple[Array, Array]:
    """Shares (count,) of each surface's rim that touch the ground, and that have no ground above or below."""
    if not len(probes.at):
        return np.zeros(count), np.zeros(count)
    beside_m = 0.05
    below = _topmost(soup, ground, probes.at[:, :2] + beside_m * probes.outward)
    has_ground = np.isfinite(below)
    touches = probes.at[:, 2] - below < _STEP_M + beside_m * np.tan(_STEEPEST_RAD) / 2
    total = np.maximum(np.bincount(probes.surface, probes.weight, minlength=count), 1e-12)
    joined = np.bincount(probes.surface, probes.weight * touches, minlength=count) / total
    return joined, np.bincount(probes.surface, probes.weight * ~has_ground, minlength=count) / total


def _topmost(soup: Triangles, faces: Flags, xy: Array) -> Array:
    """Height [m], (N,), of the topmost of the triangles in `faces` (F,) at points (N, 2); -inf for none."""
    return RayScene(soup.vertices, soup.faces[faces]).topmost(xy)


def _warn_of_holes(soup: Triangles, ground: Flags, known: Flags, points: Array, report: ImportReport) -> None:
    holes = points[~known]
    if len(holes) and not ground.all():
        holes = holes[~np.isfinite(_topmost(soup, ~ground, holes))]
    share = len(holes) / known.size
    if share > 0.001:
        width, depth = points[-1, -1] - points[0, 0]
        report.warn(
            f"{share:.1%} of its rectangle of {width:.0f} by {depth:.0f} m has no ground; "
            "the holes are filled smoothly"
        )
