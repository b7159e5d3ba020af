"""Rooms of the construction world, with the walls and doors between them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.construction.props import (
    PLASTER,
    TIMBER,
    WALL_THICKNESS_M,
    lintel,
    plastered_wall,
    stud_wall,
)
from dune_rl.worlds.props import Mesh, merge_meshes
from dune_rl.worlds.world import Prop, Rectangle

# Smallest distance between a door and a junction with another wall.
_BESIDE_DOOR_M = 0.3
_DOOR_EVERY_M = 7.0
_OUTER_DOOR_SHARE = 1.8


@dataclass(frozen=True, eq=False)
class Door:
    """A gap of `width_m` centred at `middle` (2,) in a wall along `yaw` [rad]."""

    middle: Array
    yaw: float
    width_m: float


@dataclass(frozen=True, eq=False)
class _Wall:
    # From `start` (2,) along an axis (0: x, 1: y) for `length`; `outer` walls bound the building.
    start: Array
    axis: int
    length: float
    outer: bool

    @property
    def end(self) -> Array:
        return self.at(self.length)

    def at(self, s: float) -> Array:
        return self.start + s * np.eye(2)[self.axis]


@dataclass(frozen=True)
class Storey:
    """Rooms as rectangles (xmin, xmax, ymin, ymax) between the walls' centre lines; doors; walls as props.

    `stretches` are the end points (2,) of the pieces of wall between doors. Each wall has one prop of its
    plastered pieces and one of its frames, since engines spend time on every body.
    """

    rooms: tuple[Rectangle, ...]
    doors: tuple[Door, ...]
    props: tuple[Prop, ...]
    stretches: tuple[tuple[Array, Array], ...]


def build_storey(
    terrain: HeightField,
    plan: Rectangle,
    seed: int,
    room_size_m: float,
    door_width_m: float,
    stud_share: float,
) -> Storey:
    """Rooms that divide `plan`, all connected by doors; a share `stud_share` of wall pieces are frames."""
    rng = stream(seed, "construction rooms")
    rooms, walls = _divide(plan, room_size_m, rng)
    doors: list[Door] = []
    props: list[Prop] = []
    stretches: list[tuple[Array, Array]] = []
    half = WALL_THICKNESS_M / 2
    for number, wall in enumerate(walls, start=1):
        width = door_width_m * (_OUTER_DOOR_SHARE if wall.outer else 1.0)
        junctions = sorted(_junctions(wall, walls))
        gaps = _place_doors(wall, junctions, width, rng)
        doors += [Door(wall.at(s), wall.axis * np.pi / 2, width) for s in gaps]
        # A wall ends at the face of the wall it joins; outer walls along x include the corners.
        inset = -half if wall.outer and wall.axis == 0 else half
        edges = [inset, *(s + side * width / 2 for s in gaps for side in (-1, 1)), wall.length - inset]
        finished: list[Mesh] = []
        frame: list[Mesh] = []
        for part, (first, last) in enumerate(pairwise(edges)):
            if part % 2:
                frame += [] if wall.outer else [lintel(terrain, wall.at(first), wall.at(last))]
                continue
            stretches.append((wall.at(first), wall.at(last)))
            if rng.uniform() < stud_share:
                frame += stud_wall(terrain, wall.at(first), wall.at(last))
            else:
                # One board per piece between junctions, so that each board can be lit differently.
                ends = {s + side * half for s in junctions for side in (-1, 1)}
                boards = pairwise(sorted({first, *(s for s in ends if first < s < last), last}))
                finished += [plastered_wall(terrain, wall.at(u), wall.at(v)) for u, v in boards]
        if finished:
            props.append(Prop(f"wall {number} plaster", "wall", *merge_meshes(finished), colour=PLASTER))
        if frame:
            props.append(Prop(f"wall {number} frame", "wall", *merge_meshes(frame), colour=TIMBER))
    return Storey(tuple(rooms), tuple(doors), tuple(props), tuple(stretches))


def _divide(
    plan: Rectangle, room_size_m: float, rng: np.random.Generator
) -> tuple[list[Rectangle], list[_Wall]]:
    xmin, xmax, ymin, ymax = plan
    corners = ((xmin, ymin), 0), ((xmin, ymin), 1), ((xmin, ymax), 0), ((xmax, ymin), 1)
    sides = xmax - xmin, ymax - ymin
    walls = [_Wall(np.array(corner), axis, sides[axis], True) for corner, axis in corners]
    rooms: list[Rectangle] = []
    undivided = [plan]
    while undivided:
        room = undivided.pop()
        sides = room[1] - room[0], room[3] - room[2]
        axis = int(sides[1] > sides[0])
        if sides[axis] < 1.6 * room_size_m:
            rooms.append(room)
            continue
        cut = room[2 * axis] + sides[axis] * float(rng.uniform(0.38, 0.62))
        start = np.array([room[0], room[2]])
        start[axis] = cut
        walls.append(_Wall(start, 1 - axis, sides[1 - axis], False))
        xmin, xmax, ymin, ymax = room
        if axis == 0:
            undivided += [(cut, xmax, ymin, ymax), (xmin, cut, ymin, ymax)]
        else:
            undivided += [(xmin, xmax, cut, ymax), (xmin, xmax, ymin, cut)]
    return rooms, walls


def _junctions(wall: _Wall, walls: list[_Wall]) -> list[float]:
    # Positions along the wall where other walls end on it.
    positions = {0.0, wall.length}
    for other in walls:
        if other.axis != wall.axis:
            for end in (other.start, other.end):
                s = float(end[wall.axis] - wall.start[wall.axis])
                if abs(end[1 - wall.axis] - wall.start[1 - wall.axis]) < 1e-9 and 0.0 < s < wall.length:
                    positions.add(s)
    return list(positions)


def _place_doors(wall: _Wall, junctions: list[float], width: float, rng: np.random.Generator) -> list[float]:
    # One door per seven metres of wall, in the longest pieces between junctions.
    room = width / 2 + _BESIDE_DOOR_M + WALL_THICKNESS_M
    stretches = sorted(pairwise(junctions), key=lambda ends: ends[0] - ends[1])
    places = []
    for first, last in stretches[: max(1, round(wall.length / _DOOR_EVERY_M))]:
        if last - first > 2 * room:
            places.append(float(rng.uniform(first + room, last - room)))
    return sorted(places)
