"""The construction world: rooms of plastered and stud walls with building materials in them."""

from itertools import cycle, islice
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.construction import props as prop_shapes
from dune_rl.worlds.construction.walls import Storey, build_storey
from dune_rl.worlds.ground_texture import GroundColours
from dune_rl.worlds.props import OccupiedRectangles, Placement
from dune_rl.worlds.settings import SeededConf, SurfacedConf
from dune_rl.worlds.surfaces import SurfaceShare, surface_map
from dune_rl.worlds.world import Prop, Rectangle, World

LENGTH_M, WIDTH_M = 44.0, 25.0
SPACING_M = 0.5
# Distance from the floor's edge to the building.
_MARGIN_M = 2.0
_MOUND_RADII_M = (2.0, 2.85)

# The floor is level, so only the mounds' slopes show bare earth.
_CONCRETE = GroundColours(
    low=(0.52, 0.51, 0.49), high=(0.60, 0.59, 0.56), bare=(0.47, 0.40, 0.32), bare_from_rad=0.16, contrast=0.5
)

_SURFACES = (
    SurfaceShare("concrete", 0.7),
    SurfaceShare("sand", 0.15, high=1.0),
    SurfaceShare("gravel", 0.15),
)


class ConstructionConf(SurfacedConf, SeededConf):
    """Settings of `build_construction`."""

    name: Literal["construction"] = "construction"
    room_size_m: float = Field(
        default=6.0, ge=4.0, le=20.0, description="rooms longer than 1.6 times this are divided"
    )
    door_width_m: float = Field(default=1.3, ge=1.0, le=2.0)
    stud_share: float = Field(default=0.35, ge=0.0, le=1.0, description="share of walls that are bare frames")
    props_per_100m2: float = Field(
        default=2.8, ge=0.0, le=8.0, description="bricks, beams, sawhorses, crates and containers"
    )
    mounds_per_100m2: float = Field(default=1.0, ge=0.0, le=4.0)
    mound_height_m: float = Field(default=0.15, ge=0.0, le=0.6)
    region_size_m: float = Field(default=8.0, ge=3.0, le=20.0, description="side of the spawn region")

    @model_validator(mode="after")
    def _doors_fit(self) -> Self:
        if self.room_size_m < 3.4 * self.door_width_m:
            raise ValueError(
                f"room_size_m must be at least 3.4 times door_width_m={self.door_width_m:g} "
                f"(got {self.room_size_m:g})"
            )
        return self


def build_construction(conf: ConstructionConf) -> World:
    """The site of `conf.seed`: a floor of 44 by 25 m round the origin, most of it divided into rooms.

    Raises `WorldError` if the props do not fit.
    """
    terrain = build_floor(conf.seed, conf.mounds_per_100m2, conf.mound_height_m)
    half_x, half_y = LENGTH_M / 2 - _MARGIN_M, WIDTH_M / 2 - _MARGIN_M
    plan = (-half_x, half_x, -half_y, half_y)
    storey = build_storey(terrain, plan, conf.layout, conf.room_size_m, conf.door_width_m, conf.stud_share)
    props = place_props(terrain, storey, conf.layout, conf.props_per_100m2)
    reach = conf.region_size_m / 2
    return World(
        "construction",
        terrain,
        [*storey.props, *props],
        region=(-reach, reach, -reach, reach),
        friction=conf.friction,
        ground=_CONCRETE,
        texture_seed=conf.seed,
        surfaces=surface_map(conf.surfaces, terrain, conf.seed, _SURFACES, sinkage=conf.sinkage),
    )


def build_floor(seed: int, mounds_per_100m2: float, mound_height_m: float) -> HeightField:
    """A level floor at z = 0 with round mounds 4 to 5.7 m wide, spread out over it."""
    rng = stream(seed, "construction mounds")
    x = np.arange(-LENGTH_M / 2, LENGTH_M / 2 + SPACING_M / 2, SPACING_M)
    y = np.arange(-WIDTH_M / 2, WIDTH_M / 2 + SPACING_M / 2, SPACING_M)
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    z = np.zeros(xy.shape[:2])
    count = round(mounds_per_100m2 * LENGTH_M * WIDTH_M / 100.0)
    half = np.array([LENGTH_M / 2, WIDTH_M / 2]) - _MOUND_RADII_M[1]
    centres = _spread_points(rng, half, count)
    radii = rng.uniform(*_MOUND_RADII_M, count)
    for centre, radius in zip(centres, radii, strict=True):
        away = np.minimum(np.hypot(*np.moveaxis(xy - centre, -1, 0)) / radius, 1.0)
        z = np.maximum(z, mound_height_m * (1.0 + np.cos(np.pi * away)) / 2)
    # Rounded to 1 mm, so that machines whose arithmetic differs in the last bits make the same terrain.
    return HeightField(np.round(z, 3), SPACING_M, (x[0], y[0]))


def _spread_points(rng: np.random.Generator, half: Array, count: int) -> Array:
    # Best-candidate sampling: of 12 random points, the one farthest from those before it.
    centres = np.empty((0, 2))
    for _ in range(count):
        draws = rng.uniform(-half, half, (12, 2))
        if len(centres):
            nearest = np.linalg.norm(draws[:, None] - centres, axis=-1).min(axis=1)
            draws = draws[[nearest.argmax()]]
        centres = np.concatenate([centres, draws[:1]])
    return centres


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


def place_props(terrain: HeightField, storey: Storey, seed: int, per_100m2: float) -> list[Prop]:
    """A scaffold, and `per_100m2` other props per 100 m² of floor; `WorldError` if they do not fit."""
    walls, doors, occupied = OccupiedRectangles(), OccupiedRectangles(), OccupiedRectangles()
    for start, end in storey.stretches:
        walls.add(*prop_shapes.span(start, end), prop_shapes.WALL_THICKNESS_M)
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
        occupied.add(*place, length, width)
        props.append(_build(terrain, rng, kind, f"{kind} {number}", place, length))
    return props


def _scaffold(
    terrain: HeightField, storey: Storey, occupied: OccupiedRectangles, rng: np.random.Generator
) -> list[Prop]:
    # In the largest room, along its longer side; none if it does not fit there.
    length, width = prop_shapes.SCAFFOLD_M
    room = max(storey.rooms, key=lambda room: min(room[1] - room[0], room[3] - room[2]))
    sides = np.array([room[1] - room[0], room[3] - room[2]])
    if sides.min() < width + 0.4:
        return []
    yaw = 0.0 if sides[0] >= sides[1] else np.pi / 2
    size = np.array([length, width] if yaw == 0.0 else [width, length])
    spare = np.maximum(sides - size - 0.4, 0.0) / 2
    xy = np.array([room[0] + room[1], room[2] + room[3]]) / 2 + rng.uniform(-spare, spare)
    occupied.add(xy, yaw, length, width)
    return list(prop_shapes.scaffold(terrain, "scaffold", xy, yaw))


def _find_placement(
    rooms: tuple[Rectangle, ...],
    walls: OccupiedRectangles,
    doors: OccupiedRectangles,
    occupied: OccupiedRectangles,
    rng: np.random.Generator,
    length: float,
    width: float,
) -> Placement | None:
    areas = np.array([(room[1] - room[0]) * (room[3] - room[2]) for room in rooms])
    for _ in range(_TRIES):
        room = rooms[int(rng.choice(len(rooms), p=areas / areas.sum()))]
        flush = rng.uniform() < _FLUSH_SHARE
        place = _draw_at_wall(room, rng, length, width) if flush else _draw_in_room(room, rng)
        if (
            walls.gap(*place, length, width) >= (0.02 if flush else _GAP_M)
            and doors.gap(*place, length, width) >= 0.05
            and occupied.gap(*place, length, width) >= _GAP_M
        ):
            return place
    return None


def _draw_in_room(room: Rectangle, rng: np.random.Generator) -> Placement:
    xy = rng.uniform([room[0], room[2]], [room[1], room[3]])
    return Placement(xy, float(rng.uniform(-np.pi, np.pi)))


def _draw_at_wall(room: Rectangle, rng: np.random.Generator, length: float, width: float) -> Placement:
    # Long side along one of the room's four walls.
    side = int(rng.integers(4))
    axis, far = side // 2, side % 2
    off = prop_shapes.WALL_THICKNESS_M / 2 + _FLUSH_M + width / 2
    xy = rng.uniform([room[0], room[2]], [room[1], room[3]])
    xy[1 - axis] = room[2 * (1 - axis) + far] + (off if far == 0 else -off)
    return Placement(xy, axis * np.pi / 2)


def _build(
    terrain: HeightField, rng: np.random.Generator, kind: str, name: str, place: Placement, length: float
) -> Prop:
    match kind:
        case "bricks":
            return prop_shapes.bricks(terrain, name, *place, int(rng.choice([2, 2, 3])), rng)
        case "beams":
            return prop_shapes.beams(terrain, name, *place, length)
        case "sawhorse":
            return prop_shapes.trestle(terrain, name, *place)
        case "container":
            return prop_shapes.container(terrain, name, *place, rng)
    return prop_shapes.crate(terrain, name, *place)
