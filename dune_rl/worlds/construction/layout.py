"""Placement of props in the rooms of the construction world."""

from dataclasses import dataclass
from itertools import cycle, islice

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.construction import props as prop_shapes
from dune_rl.worlds.construction.walls import Storey
from dune_rl.worlds.occupancy import OccupiedRectangles
from dune_rl.worlds.world import Prop, Rectangle

_TRIES = 600
# Wide enough for a robot of up to 0.45 m radius.
_GAP_M = 1.0
_FLUSH_M = 0.08
_FLUSH_SHARE = 0.55
_DOORWAY_M = 2.2

# Kinds of every eleven props, in the order of their placement.
_KINDS = (
    "bricks", "sawhorse", "bricks", "container", "bricks", "beams",
    "bricks", "sawhorse", "crate", "bricks", "bricks",
)  # fmt: skip
_SIZES = {"bricks": (0.9, 0.9), "sawhorse": (1.5, 1.3), "container": (1.2, 1.0), "crate": (2.3, 1.6)}


@dataclass(frozen=True)
class _Placement:
    xy: Array
    yaw: float


def place_props(terrain: HeightField, storey: Storey, seed: int, per_100m2: float) -> list[Prop]:
    """A scaffold, and `per_100m2` other props per 100 m² of floor; `WorldError` if they do not fit."""
    walls, doors, occupied = OccupiedRectangles(), OccupiedRectangles(), OccupiedRectangles()
    for start, end in storey.stretches:
        ahead = end - start
        yaw = float(np.arctan2(ahead[1], ahead[0]))
        walls.add((start + end) / 2, yaw, float(np.hypot(*ahead)), prop_shapes.WALL_THICKNESS_M)
    for door in storey.doors:
        doors.add(door.middle, door.yaw, door.width_m, _DOORWAY_M)
    rng = stream(seed, "construction things")
    props = _scaffold(terrain, storey, occupied, rng)
    xmin, xmax, ymin, ymax = terrain.extent
    count = round(per_100m2 * (xmax - xmin) * (ymax - ymin) / 100.0)
    for number, kind in enumerate(islice(cycle(_KINDS), count), start=1):
        length, width = _SIZES.get(kind, (float(rng.uniform(2.2, 3.4)), 0.75))
        place = _find_placement(storey.rooms, walls, doors, occupied, rng, length, width)
        if place is None:
            raise WorldError(
                f"The construction site has no room for world.props_per_100m2={per_100m2:g}: "
                f"prop {number} of {count} fits nowhere. Lower it, or raise world.room_size_m."
            )
        occupied.add(place.xy, place.yaw, length, width)
        props.append(_build(terrain, rng, kind, f"{kind} {number}", place, length))
    return props


def _scaffold(
    terrain: HeightField, storey: Storey, occupied: OccupiedRectangles, rng: np.random.Generator
) -> list[Prop]:
    # In the largest room, along its longer side; none if it does not fit there.
    length, width = prop_shapes.SCAFFOLD_M
    room = max(storey.rooms, key=_least_side)
    sides = np.array([room[1] - room[0], room[3] - room[2]])
    if sides.min() < width + 0.4:
        return []
    yaw = 0.0 if sides[0] >= sides[1] else np.pi / 2
    size = np.array([length, width] if yaw == 0.0 else [width, length])
    spare = np.maximum(sides - size - 0.4, 0.0) / 2
    xy = np.array([room[0] + room[1], room[2] + room[3]]) / 2 + rng.uniform(-spare, spare)
    occupied.add(xy, yaw, length, width)
    return list(prop_shapes.scaffold(terrain, "scaffold", xy, yaw))


def _least_side(room: Rectangle) -> float:
    return min(room[1] - room[0], room[3] - room[2])


def _find_placement(
    rooms: tuple[Rectangle, ...],
    walls: OccupiedRectangles,
    doors: OccupiedRectangles,
    occupied: OccupiedRectangles,
    rng: np.random.Generator,
    length: float,
    width: float,
) -> _Placement | None:
    areas = np.array([(room[1] - room[0]) * (room[3] - room[2]) for room in rooms])
    for _ in range(_TRIES):
        room = rooms[int(rng.choice(len(rooms), p=areas / areas.sum()))]
        flush = rng.uniform() < _FLUSH_SHARE
        place = _draw_at_wall(room, rng, length, width) if flush else _draw_in_room(room, rng)
        clear = walls.gap(place.xy, place.yaw, length, width)
        if clear < (0.02 if flush else _GAP_M) or doors.gap(place.xy, place.yaw, length, width) < 0.05:
            continue
        if occupied.gap(place.xy, place.yaw, length, width) >= _GAP_M:
            return place
    return None


def _draw_in_room(room: Rectangle, rng: np.random.Generator) -> _Placement:
    xy = rng.uniform([room[0], room[2]], [room[1], room[3]])
    return _Placement(xy, float(rng.uniform(-np.pi, np.pi)))


def _draw_at_wall(room: Rectangle, rng: np.random.Generator, length: float, width: float) -> _Placement:
    # Long side along one of the room's four walls.
    side = int(rng.integers(4))
    axis, far = side // 2, side % 2
    off = prop_shapes.WALL_THICKNESS_M / 2 + _FLUSH_M + width / 2
    xy = rng.uniform([room[0], room[2]], [room[1], room[3]])
    xy[1 - axis] = room[2 * (1 - axis) + far] + (off if far == 0 else -off)
    return _Placement(xy, axis * np.pi / 2)


def _build(
    terrain: HeightField, rng: np.random.Generator, kind: str, name: str, place: _Placement, length: float
) -> Prop:
    xy, yaw = place.xy, place.yaw
    if kind == "bricks":
        return prop_shapes.bricks(terrain, name, xy, yaw, int(rng.choice([2, 2, 3])), rng)
    if kind == "beams":
        return prop_shapes.beams(terrain, name, xy, yaw, length)
    if kind == "sawhorse":
        return prop_shapes.trestle(terrain, name, xy, yaw)
    if kind == "container":
        return prop_shapes.container(terrain, name, xy, yaw, rng)
    return prop_shapes.crate(terrain, name, xy, yaw)
