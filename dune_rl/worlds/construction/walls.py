"""The rooms of the construction world, and the walls and doors between them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.seeding import stream
from dune_rl.worlds.construction.objects import (
    PLASTER,
    TIMBER,
    WALL_THICKNESS_M,
    lintel,
    plastered_wall,
    stud_wall,
)
from dune_rl.worlds.props import Mesh, merge_meshes
from dune_rl.worlds.world import Prop, Rectangle

Array = NDArray[np.float64]

# From a door to the next wall that meets this one.
_BESIDE_DOOR_M = 0.3
_DOOR_EVERY_M = 7.0
_OUTER_DOOR_SHARE = 1.8


@dataclass(frozen=True, eq=False)
class Door:
    """A gap `width_m` wide in the wall round `middle` (2,), which runs along `yaw`."""

    middle: Array
    yaw: float
    width_m: float


@dataclass(frozen=True, eq=False)
class _Wall:
    # From `start` along an axis (0 is x, 1 is y) for `length`; `outer` ones bound the building.
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
    """Rooms as rectangles (xmin, xmax, ymin, ymax) between the middles of walls; doors; walls as props.

    `stretches` are the ends (2,) of what stands of them between doors.

    Of each wall the finished parts are one prop and the frames another: engines take time for each body.
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
    """Rooms that divide `plan`, all joined by doors, a share `stud_share` of the walls' parts but frames."""
    rng = stream(seed, "construction rooms")
    rooms, walls = _divide(plan, room_size_m, rng)
    doors: list[Door] = []
    props: list[Prop] = []
    stretches: list[tuple[Array, Array]] = []
    half = WALL_THICKNESS_M / 2
    for number, wall in enumerate(walls, start=1):
        width = door_width_m * (_OUTER_DOOR_SHARE if wall.outer else 1.0)
        met = sorted(_junctions(wall, walls))
        gaps = _door_places(wall, met, width, rng)
        doors += [Door(wall.at(s), wall.axis * np.pi / 2, width) for s in gaps]
        # Walls end at the face of the one they meet, and outer ones along x go round the corners.
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
                # A board for each stretch between walls, so that light can differ from board to board.
                ends = [s + side * half for s in met for side in (-1, 1) if first < s + side * half < last]
                boards = pairwise(sorted({first, *ends, last}))
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
    corner, across = np.array([xmin, ymin]), np.array([xmax, ymax])
    walls = [
        _Wall(corner, 0, xmax - xmin, True),
        _Wall(corner, 1, ymax - ymin, True),
        _Wall(np.array([xmin, ymax]), 0, xmax - xmin, True),
        _Wall(np.array([across[0], ymin]), 1, ymax - ymin, True),
    ]
    rooms: list[Rectangle] = []
    waiting = [plan]
    while waiting:
        room = waiting.pop()
        sides = room[1] - room[0], room[3] - room[2]
        axis = int(sides[1] > sides[0])
        if sides[axis] < 1.6 * room_size_m:
            rooms.append(room)
            continue
        cut = room[2 * axis] + sides[axis] * float(rng.uniform(0.38, 0.62))
        start = np.array([room[0], room[2]])
        start[axis] = cut
        walls.append(_Wall(start, 1 - axis, sides[1 - axis], False))
        first, second = list(room), list(room)
        first[2 * axis + 1] = second[2 * axis] = cut
        waiting += [_rectangle(second), _rectangle(first)]
    return rooms, walls


def _rectangle(values: list[float]) -> Rectangle:
    xmin, xmax, ymin, ymax = values
    return xmin, xmax, ymin, ymax


def _junctions(wall: _Wall, walls: list[_Wall]) -> list[float]:
    # Where other walls end on this one, measured along it.
    found = {0.0, wall.length}
    for other in walls:
        if other.axis != wall.axis:
            for end in (other.start, other.end):
                s = float(end[wall.axis] - wall.start[wall.axis])
                if abs(end[1 - wall.axis] - wall.start[1 - wall.axis]) < 1e-9 and 0.0 < s < wall.length:
                    found.add(s)
    return list(found)


def _door_places(wall: _Wall, met: list[float], width: float, rng: np.random.Generator) -> list[float]:
    # One door for every seven metres, in the longest stretches between junctions.
    room = width / 2 + _BESIDE_DOOR_M + WALL_THICKNESS_M
    stretches = sorted(pairwise(met), key=lambda ends: ends[0] - ends[1])
    places = []
    for first, last in stretches[: max(1, round(wall.length / _DOOR_EVERY_M))]:
        if last - first > 2 * room:
            places.append(float(rng.uniform(first + room, last - room)))
    return sorted(places)
