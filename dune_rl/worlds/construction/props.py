"""Props of building sites, each fitted to the terrain below it."""

import numpy as np
from numpy.typing import ArrayLike

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.props import Mesh, axes_of, beam, merge_meshes, tube, unit_vector, upright_box
from dune_rl.worlds.world import Colour, Prop

WALL_HEIGHT_M = 2.5
WALL_THICKNESS_M = 0.09
SCAFFOLD_M = (4.7, 4.3)

PLASTER: Colour = (0.80, 0.78, 0.73)
TIMBER: Colour = (0.76, 0.60, 0.38)
_BRICK: Colour = (0.62, 0.31, 0.22)
_PLANK: Colour = (0.68, 0.52, 0.32)
_CRATE: Colour = (0.58, 0.45, 0.28)
_STEEL: Colour = (0.62, 0.64, 0.67)
_BOXES: tuple[Colour, ...] = ((0.20, 0.36, 0.55), (0.75, 0.42, 0.12), (0.30, 0.45, 0.34))

_STUD_M = 0.045
_STUD_SPACING_M = 0.6
_LINTEL_FROM_M = 2.1
_SUNK_M = 0.15
_BRICK_M, _LAYER_M = 0.8, 0.14


def plastered_wall(terrain: HeightField, start: ArrayLike, end: ArrayLike) -> Mesh:
    """A finished wall from `start` to `end` (2,), 2.5 m high and 9 cm thick."""
    middle, yaw, length = span(start, end)
    low, _ = _ground_range(terrain, middle, yaw, length, WALL_THICKNESS_M)
    return upright_box(middle, yaw, low - _SUNK_M, low + WALL_HEIGHT_M, length, WALL_THICKNESS_M)


def stud_wall(terrain: HeightField, start: ArrayLike, end: ArrayLike) -> list[Mesh]:
    """The frame of a wall: studs about 0.6 m apart between two plates."""
    middle, yaw, length = span(start, end)
    low, high = _ground_range(terrain, middle, yaw, length, WALL_THICKNESS_M)
    top = low + WALL_HEIGHT_M
    parts = [
        upright_box(middle, yaw, low - _SUNK_M, high + _STUD_M, length, WALL_THICKNESS_M),
        upright_box(middle, yaw, top - _STUD_M, top, length, WALL_THICKNESS_M),
    ]
    edge = (length - _STUD_M) / 2
    for s in np.linspace(-edge, edge, 1 + max(1, round(length / _STUD_SPACING_M))):
        at = middle + s * unit_vector(yaw)
        parts.append(upright_box(at, yaw, low, top - _STUD_M / 2, _STUD_M, WALL_THICKNESS_M - 0.004))
    return parts


def lintel(terrain: HeightField, start: ArrayLike, end: ArrayLike) -> Mesh:
    """The wall above a door from `start` to `end` (2,)."""
    middle, yaw, length = span(start, end)
    low, _ = _ground_range(terrain, middle, yaw, length, WALL_THICKNESS_M)
    return upright_box(middle, yaw, low + _LINTEL_FROM_M, low + WALL_HEIGHT_M, length, WALL_THICKNESS_M)


def bricks(
    terrain: HeightField, name: str, xy: ArrayLike, yaw: float, layers: int, rng: np.random.Generator
) -> Prop:
    """A slightly skewed stack of `layers` packs of bricks, each 0.8 m square and 0.14 m high."""
    low, high = _ground_range(terrain, xy, yaw, _BRICK_M, _BRICK_M)
    parts: list[Mesh] = []
    for layer in range(layers):
        bottom = low - _SUNK_M if layer == 0 else high + layer * _LAYER_M + 0.006
        turn = yaw + float(rng.uniform(-0.09, 0.09))
        at = np.asarray(xy) + rng.uniform(-0.03, 0.03, 2)
        parts.append(upright_box(at, turn, bottom, high + (layer + 1) * _LAYER_M, _BRICK_M, _BRICK_M))
    return Prop(name, "bricks", *merge_meshes(parts), colour=_BRICK)


def beams(terrain: HeightField, name: str, xy: ArrayLike, yaw: float, length: float) -> Prop:
    """A stack of nine beams, in rows of four, three and two."""
    low, high = _ground_range(terrain, xy, yaw, length, 0.7)
    across = unit_vector(yaw + np.pi / 2)
    parts = []
    for row, count in enumerate((4, 3, 2)):
        for place in np.arange(count) - (count - 1) / 2:
            bottom = low - _SUNK_M if row == 0 else high + 0.13 * row
            at = np.asarray(xy) + 0.17 * place * across + 0.04 * (row - 1) * unit_vector(yaw) * np.sign(place)
            parts.append(upright_box(at, yaw, bottom, high + 0.13 * row + 0.125, length, 0.14))
    return Prop(name, "beams", *merge_meshes(parts), colour=_PLANK)


def trestle(terrain: HeightField, name: str, xy: ArrayLike, yaw: float) -> Prop:
    """Two sawhorses 0.95 m high under a board of 1.5 by 1.3 m."""
    low, high = _ground_range(terrain, xy, yaw, 1.5, 1.3)
    along, across = axes_of(yaw)
    top = high + 0.95
    parts = [upright_box(xy, yaw, top - 0.04, top, 1.5, 1.3)]
    for u in (-0.5, 0.5):
        ridge = np.asarray(xy) + u * along
        ends = [[*(ridge + v * across), top - 0.08] for v in (-0.6, 0.6)]
        parts.append(beam(ends[0], ends[1], 0.07, 0.1))
        for v in (-0.5, 0.5):
            for lean in (-0.22, 0.22):
                foot = [*(ridge + v * across + lean * along), low - _SUNK_M]
                parts.append(beam(foot, [*(ridge + v * across), top - 0.08], 0.06, 0.06))
        for lean in (-0.16, 0.16):
            bar = [[*(ridge + v * across + lean * along), high + 0.22] for v in (-0.5, 0.5)]
            parts.append(beam(bar[0], bar[1], 0.03, 0.08))
    return Prop(name, "sawhorse", *merge_meshes(parts), colour=TIMBER)


def container(terrain: HeightField, name: str, xy: ArrayLike, yaw: float, rng: np.random.Generator) -> Prop:
    """A ribbed container, 1.2 by 1 m and 2.4 m high."""
    low, high = _ground_range(terrain, xy, yaw, 1.2, 1.0)
    parts = [upright_box(xy, yaw, low - _SUNK_M, high + 2.4, 1.14, 0.94)]
    for u in np.linspace(-0.54, 0.54, 5):
        at = np.asarray(xy) + u * unit_vector(yaw)
        parts.append(upright_box(at, yaw, low - _SUNK_M, high + 2.36, 0.08, 1.0))
    for bottom, top in ((0.0, 0.12), (2.28, 2.42)):
        parts.append(upright_box(xy, yaw, high + bottom, high + top, 1.2, 1.0))
    return Prop(name, "container", *merge_meshes(parts), colour=_BOXES[int(rng.integers(len(_BOXES)))])


def crate(terrain: HeightField, name: str, xy: ArrayLike, yaw: float) -> Prop:
    """A wooden crate 2.3 by 1.6 m and 1.15 m high, with battens."""
    low, high = _ground_range(terrain, xy, yaw, 2.3, 1.6)
    along, across = axes_of(yaw)
    parts = [upright_box(xy, yaw, low - _SUNK_M, high + 1.12, 2.24, 1.54)]
    for u in (-1.1, 0.0, 1.1):
        for v in (-0.76, 0.76):
            at = np.asarray(xy) + u * along + v * across
            parts.append(upright_box(at, yaw, low - _SUNK_M, high + 1.15, 0.1, 0.08))
    for v in (-0.76, 0.76):
        for bottom in (0.0, 1.05):
            at = np.asarray(xy) + v * across
            parts.append(upright_box(at, yaw, high + bottom, high + bottom + 0.1, 2.3, 0.07))
    return Prop(name, "crate", *merge_meshes(parts), colour=_CRATE)


def scaffold(terrain: HeightField, name: str, xy: ArrayLike, yaw: float) -> tuple[Prop, Prop]:
    """A scaffold, 4.7 by 4.3 m, with room for robots below its boards at 2 m: tubes, and boards."""
    length, width = SCAFFOLD_M
    low, high = _ground_range(terrain, xy, yaw, length, width)
    along, across = axes_of(yaw)
    half_u, half_v = length / 2 - 0.1, width / 2 - 0.1

    def at(u: float, v: float, above: float) -> list[float]:
        return [*(np.asarray(xy) + u * along + v * across), high + above]

    tubes: list[Mesh] = []
    for u in (-half_u, 0.0, half_u):
        for v in (-half_v, half_v):
            foot = [*at(u, v, 0.0)[:2], low - _SUNK_M]
            tubes.append(tube(foot, at(u, v, 2.4 if u else 2.0), 0.035, sides=8))
            tubes.append(upright_box(foot[:2], yaw, low - _SUNK_M, high + 0.05, 0.22, 0.22))
        tubes.append(tube(at(u, -half_v - 0.1, 1.92), at(u, half_v + 0.1, 1.92), 0.03, sides=6))
    for v in (-half_v, half_v):
        for above in (1.86, 2.38):
            tubes.append(tube(at(-half_u - 0.1, v, above), at(half_u + 0.1, v, above), 0.03, sides=6))
        # Only the ends have braces; the long sides stay open for robots.
    for u in (-half_u, half_u):
        tubes.append(tube(at(u, -half_v, 0.15), at(u, half_v, 1.8), 0.025, sides=6))
    boards = []
    count = 10
    for number in range(count):
        v = (number - (count - 1) / 2) * (width - 0.3) / count
        boards.append(upright_box(at(0.0, v, 0.0)[:2], yaw, high + 1.96, high + 2.01, length - 0.1, 0.36))
    return (
        Prop(f"{name} tubes", "scaffold", *merge_meshes(tubes), colour=_STEEL),
        Prop(f"{name} boards", "scaffold", *merge_meshes(boards), colour=_PLANK),
    )


def span(start: ArrayLike, end: ArrayLike) -> tuple[Array, float, float]:
    """Middle (2,), yaw [rad] and length [m] of the way from `start` to `end` (2,)."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    ahead = last - first
    return (first + last) / 2, float(np.arctan2(ahead[1], ahead[0])), float(np.hypot(*ahead))


def _ground_range(
    terrain: HeightField, xy: ArrayLike, yaw: float, length: float, width: float
) -> tuple[float, float]:
    # Lowest and highest ground below a rectangle.
    u = np.linspace(-length / 2, length / 2, 2 + int(length / 0.4))
    v = np.linspace(-width / 2, width / 2, 2 + int(width / 0.4))
    axes = axes_of(yaw)
    local = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    height = terrain.height(np.asarray(xy) + local @ axes)
    return float(height.min()), float(height.max())
