"""Props of industrial sites, each fitted to the terrain below it."""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.props import Mesh, axes_of, beam, merge_meshes, slab, tube, unit_vector, upright_box
from dune_rl.worlds.world import Colour, Prop

_STEEL: Colour = (0.55, 0.57, 0.60)
_PANEL: Colour = (0.10, 0.16, 0.38)
_WOOD: Colour = (0.50, 0.34, 0.19)
_PIPE: Colour = (0.80, 0.66, 0.20)
_CONCRETE: Colour = (0.66, 0.65, 0.62)
_PLASTER: Colour = (0.72, 0.60, 0.50)
_SIGNAL: Colour = (0.80, 0.25, 0.15)
_WATER: Colour = (0.20, 0.42, 0.55)

# Depth of feet below the ground, so that no gap shows on a slope.
_SUNK_M = 0.4

ARRAY_LENGTH_M = 6.2
ARRAY_DEPTH_M = 2.6
_ARRAY_TILT = np.deg2rad(42.0)
_ARRAY_LOW_EDGE_M = 0.18
_ARRAY_THICKNESS_M = 0.08


def solar_array(terrain: HeightField, name: str, xy: ArrayLike, yaw: float) -> tuple[Prop, Prop]:
    """A tilted panel, 6.2 m long (along `yaw`) and 2.6 m deep, on six posts: panel, and frame.

    Its low edge, to the right of `yaw`, clears the highest ground below it by 0.18 m.
    """
    along, across = axes_of(yaw)
    low_edge = np.asarray(xy) - ARRAY_DEPTH_M / 2 * across
    s, t, ground = _ground_below_array(terrain, xy, yaw)
    pitch, level = np.polyfit(s, ground[:, 0], 1)
    rise = np.tan(_ARRAY_TILT)
    level += (ground - (level + pitch * s[:, None] + rise * t)).max() + _ARRAY_LOW_EDGE_M

    def underside(s_m: float, t_m: float) -> Array:
        return np.array([*(low_edge + s_m * along + t_m * across), level + pitch * s_m + rise * t_m])

    ahead = np.array([*along, pitch])
    ahead /= np.linalg.norm(ahead)
    up_panel = np.array([*across, rise])
    out = np.cross(ahead, up_panel)
    out /= np.linalg.norm(out)
    axes = np.stack([ahead, np.cross(out, ahead), out])
    centre = underside(0.0, ARRAY_DEPTH_M / 2) + out * _ARRAY_THICKNESS_M / 2
    length, depth = float(np.hypot(1.0, pitch)), float(np.linalg.norm(up_panel))
    panel = slab(centre, axes, [ARRAY_LENGTH_M * length, ARRAY_DEPTH_M * depth, _ARRAY_THICKNESS_M])
    frame: list[Mesh] = []
    for t_m in (0.3, ARRAY_DEPTH_M - 0.45):
        for s_m in (-2.6, 0.0, 2.6):
            top = underside(s_m, t_m)
            foot = float(terrain.height(top[:2])) - _SUNK_M
            frame.append(upright_box(top[:2], yaw, foot, top[2] + 0.04, 0.12, 0.12))
        frame.append(beam(underside(-3.0, t_m), underside(3.0, t_m), 0.08, 0.08))
    # Kick boards close the gap below the low edge, which robots would hit above their LiDAR's plane.
    for s_m in (np.arange(6) - 2.5) * ARRAY_LENGTH_M / 6:
        top = underside(float(s_m), 0.05)
        bottom = float(terrain.height(top[:2])) + 0.1
        frame.append(upright_box(top[:2], yaw, bottom, max(top[2], bottom + 0.1), ARRAY_LENGTH_M / 6, 0.1))
    return (
        Prop(f"{name} panel", "solar array", *panel, colour=_PANEL),
        Prop(f"{name} frame", "solar array", *merge_meshes(frame), colour=_STEEL),
    )


def array_unevenness(terrain: HeightField, xy: ArrayLike, yaw: float) -> float:
    """Range [m] of the gap between a solar array's straight low edge and the ground below it."""
    s, _, ground = _ground_below_array(terrain, xy, yaw)
    return float(np.ptp(ground[:, 0] - np.polyval(np.polyfit(s, ground[:, 0], 1), s)))


def _ground_below_array(terrain: HeightField, xy: ArrayLike, yaw: float) -> tuple[Array, Array, Array]:
    # Coordinates along (S,) and across (T,) the panel from the middle of its low edge; ground heights (S, T).
    along, across = axes_of(yaw)
    s = np.linspace(-ARRAY_LENGTH_M / 2, ARRAY_LENGTH_M / 2, 25)
    t = np.linspace(0.0, ARRAY_DEPTH_M, 9)
    low_edge = np.asarray(xy) - ARRAY_DEPTH_M / 2 * across
    return s, t, terrain.height(low_edge + s[:, None, None] * along + t[:, None] * across)


def bridge(
    terrain: HeightField, name: str, xy: ArrayLike, yaw: float, length: float, width: float
) -> tuple[Prop, Prop]:
    """A wooden bridge along `yaw`, its ends flush with the ground: drivable deck, and piers and rails."""
    centre, (along, across) = np.asarray(xy), axes_of(yaw)
    ends_xy = np.array([centre - length / 2 * along, centre + length / 2 * along])
    ends = np.column_stack([ends_xy, terrain.height(ends_xy) + 0.03])
    thickness = 0.16

    def on_deck(u: float, v: float, above: float) -> Array:
        middle = ends[0] + (u / length + 0.5) * (ends[1] - ends[0])
        return middle + np.array([*(v * across), above])

    start, end = (on_deck(u, 0, -thickness / 2) for u in (-length / 2, length / 2))
    deck = beam(start, end, width, thickness)
    frame: list[Mesh] = []
    edge = width / 2 - 0.08
    for v in (-edge, edge):
        for u in np.linspace(-length / 2 + 0.1, length / 2 - 0.1, 8):
            foot = on_deck(u, v, 0.0)
            frame.append(upright_box(foot[:2], yaw, foot[2] - thickness, foot[2] + 1.0, 0.1, 0.1))
        for above in (0.35, 0.95):
            frame.append(beam(on_deck(-length / 2, v, above), on_deck(length / 2, v, above), 0.08, 0.14))
        for u in (-3.6, 0.0, 3.6):
            top = on_deck(u, v * 0.9, -thickness)
            bottom = float(terrain.height(top[:2])) - _SUNK_M
            frame.append(upright_box(top[:2], yaw, bottom, top[2] + 0.04, 0.24, 0.24))
    for u in (-3.6, 0.0, 3.6):
        frame.append(beam(on_deck(u, -edge, -0.24), on_deck(u, edge, -0.24), 0.18, 0.2))
    return (
        Prop(f"{name} deck", "bridge", *deck, drivable=True, colour=_WOOD, surface="wood"),
        Prop(f"{name} frame", "bridge", *merge_meshes(frame), colour=(0.38, 0.25, 0.14)),
    )


def pipe_run(
    terrain: HeightField,
    name: str,
    start: ArrayLike,
    end: ArrayLike,
    *,
    radius: float,
    lift: float,
    spacing: float = 2.2,
    valve: bool = False,
) -> Prop:
    """A pipe on stands about `spacing` [m] apart, its underside `lift` [m] above the ground at the stands.

    It comes out of the ground at `start` and goes back into it at `end` (2,).
    """
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    spans = max(1, round(float(np.linalg.norm(last - first)) / spacing))
    nodes_xy = first + np.linspace(0.0, 1.0, spans + 1)[:, None] * (last - first)
    z = terrain.height(nodes_xy) + lift + radius
    z = _raise_over_bumps(terrain, nodes_xy, z, radius + min(lift, 0.12))
    nodes = np.column_stack([nodes_xy, z])
    ahead = (last - first) / np.linalg.norm(last - first)
    yaw = float(np.arctan2(ahead[1], ahead[0]))
    parts = [tube(a, b, radius) for a, b in pairwise(nodes)]
    flange = 0.09 * np.array([*ahead, 0.0])
    feet = terrain.height(nodes_xy)
    for node, foot in zip(nodes[1:-1], feet[1:-1], strict=True):
        parts.append(tube(node - flange, node + flange, radius * 1.3))
        parts.append(upright_box(node[:2], yaw, foot - _SUNK_M, node[2] - 0.6 * radius, 0.22, 2.2 * radius))
    for node, foot in zip(nodes[[0, -1]], feet[[0, -1]], strict=True):
        x, y, z_m = node
        buried = [x, y, foot - _SUNK_M]
        parts.append(tube(buried, [x, y, z_m + radius], radius * 1.05))
        parts.append(tube(buried, [x, y, foot + 0.1], radius * 1.35))
    if valve:
        middle = (nodes[spans // 2] + nodes[spans // 2 + 1 if spans > 1 else -1]) / 2
        body, up = 0.22 * np.array([*ahead, 0.0]), np.array([0.0, 0.0, 1.0])
        stem = middle + (radius + 0.35) * up
        parts += [
            tube(middle - body, middle + body, radius * 1.45),
            tube(middle, stem, 0.05, sides=8),
            tube(stem, stem + 0.05 * up, 0.24, bore=0.19),
            slab(stem + 0.025 * up, np.eye(3), [0.4, 0.04, 0.03]),
        ]
    return Prop(name, "pipeline", *merge_meshes(parts), colour=_PIPE)


def _raise_over_bumps(terrain: HeightField, nodes: Array, z: Array, room: float) -> Array:
    # Where a straight pipe would pass through a bump between two stands, both stands are raised.
    z, t = z.copy(), np.linspace(0.0, 1.0, 13)[:, None]
    for i in range(len(nodes) - 1):
        ground = terrain.height(nodes[i] + t * (nodes[i + 1] - nodes[i]))
        missing = (ground + room - (z[i] + t[:, 0] * (z[i + 1] - z[i]))).max()
        z[i : i + 2] += max(missing, 0.0)
    return z


def culvert(terrain: HeightField, name: str, xy: ArrayLike, yaw: float) -> Prop:
    """A concrete ring of 2.8 m diameter and 0.8 m length, its axis along `yaw`, its bottom in the ground."""
    radius, half = 1.4, 0.4
    axis = unit_vector(yaw)
    along = np.asarray(xy) + np.linspace(-half, half, 5)[:, None] * axis
    centre = np.array([*np.asarray(xy), terrain.height(along).min() - 0.3 + radius])
    step = half * np.array([*axis, 0.0])
    mesh = tube(centre - step, centre + step, radius, bore=radius - 0.13, sides=24)
    return Prop(name, "culvert", *mesh, colour=_CONCRETE)


def wall(terrain: HeightField, name: str, xy: ArrayLike, yaw: float, length: float, height: float) -> Prop:
    """A wall 0.3 m thick along `yaw`, in blocks of about a metre that follow the ground."""
    count = max(1, round(length))
    step, along = length / count, unit_vector(yaw)
    blocks = []
    for i in range(count):
        middle = np.asarray(xy) + ((i + 0.5) * step - length / 2) * along
        ground = float(terrain.height(middle))
        blocks.append(upright_box(middle, yaw, ground - 2 * _SUNK_M, ground + height, step, 0.3))
    return Prop(name, "wall", *merge_meshes(blocks), colour=_PLASTER)


def post(terrain: HeightField, name: str, xy: ArrayLike, radius: float, height: float) -> Prop:
    """A thin round post."""
    foot = np.array([*np.asarray(xy), float(terrain.height(xy)) - _SUNK_M])
    mesh = tube(foot, foot + np.array([0.0, 0.0, _SUNK_M + height]), radius, sides=8)
    return Prop(name, "post", *mesh, colour=_SIGNAL)


def water_table(terrain: HeightField, name: str, xy: ArrayLike, level: float, reach: float) -> Prop:
    """Water at height `level` [m] round `xy`, out to the shore or `reach` [m]; not solid."""
    centre = np.asarray(xy)
    angles = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
    distances = np.arange(0.0, reach, 0.25)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    dry = terrain.height(centre + distances[:, None, None] * directions) > level + 0.05
    shore = np.where(dry.any(axis=0), distances[dry.argmax(axis=0)], reach)
    rim = np.column_stack([centre + shore[:, None] * directions, np.full(64, level)])
    here = np.arange(64)
    faces = np.stack([np.full(64, 64), here, np.roll(here, -1)], axis=-1).astype(np.int32)
    return Prop(name, "water", np.vstack([rim, [*centre, level]]), faces, solid=False, colour=_WATER)


def stand(terrain: HeightField, name: str, xy: ArrayLike, yaw: float) -> Prop:
    """A control box 0.5 m wide on a plinth."""
    ground = float(terrain.height(xy))
    plinth = upright_box(xy, yaw, ground - _SUNK_M, ground + 0.15, 0.6, 0.6)
    box = upright_box(xy, yaw, ground + 0.1, ground + 1.3, 0.5, 0.35)
    return Prop(name, "stand", *merge_meshes([plinth, box]), colour=(0.35, 0.50, 0.38))
