"""An industrial site on hills: solar arrays, a pipeline, a bridge over a gully, culverts, walls and posts."""

from collections.abc import Callable
from itertools import cycle, islice
from typing import Literal

import numpy as np
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.grass import grow_grass
from dune_rl.worlds.inspection import props as site_props
from dune_rl.worlds.inspection.terrain import (
    BRIDGE_LENGTH_M,
    BRIDGE_WIDTH_M,
    HALF_MAIN_M,
    YARD_CENTRE,
    YARD_HALF_M,
    Gully,
    build_terrain,
)
from dune_rl.worlds.props import OccupiedRectangles, Placement, unit_vector
from dune_rl.worlds.settings import GrassyConf, SeededConf
from dune_rl.worlds.surfaces import SurfaceShare, surface_map
from dune_rl.worlds.world import Prop, World

_SURFACES = (
    SurfaceShare("grass", 0.6),
    SurfaceShare("gravel", 0.25, steep=0.5),
    SurfaceShare("mud", 0.15, steep=-0.5, high=-1.0),
)


class InspectionConf(GrassyConf, SeededConf):
    """Settings of `build_inspection`.

    Every `seed` gives a different site with the same distribution of slopes,
    the same relief and a similar share of occupied ground.
    """

    name: Literal["inspection"] = "inspection"
    yard_obstacles: int = Field(
        default=4, ge=0, le=20, description="obstacles in and around the 8 by 8 m training square"
    )


def build_inspection(conf: InspectionConf) -> World:
    """The site of `conf.seed`: 60 by 60 m with a margin of 2 m; the training square is in the south-west."""
    terrain, gully = build_terrain(conf.seed)
    props = place_props(terrain, gully, conf.layout, conf.yard_obstacles)
    x, y = YARD_CENTRE
    region = (x - YARD_HALF_M, x + YARD_HALF_M, y - YARD_HALF_M, y + YARD_HALF_M)
    obstacles = [prop.mesh for prop in props]
    return World(
        "inspection",
        terrain,
        props,
        region=region,
        friction=conf.friction,
        texture_seed=conf.seed,
        grass=grow_grass(terrain, obstacles, conf.grass_cover, conf.grass_height_m, conf.seed),
        surfaces=surface_map(conf.surfaces, terrain, conf.seed, _SURFACES, sinkage=conf.sinkage),
    )


_HOLLOW_RADIUS_M = 11.0
_GAP_M = 1.6
# Wide enough for a robot of up to 0.5 m radius between convex props.
_YARD_GAP_M = 1.3
_YARD_REACH_M = 4.2
_YARD_ARRAY_NEAR_M = 3.6
_YARD_ARRAY_FAR_M = 5.2
_WIDE_YARD_HALF_M = 7.0
_TRIES = 400
_POINT_SPACING_M = 0.25
_YARD_KINDS = ("array", "pipe", "wall", "post", "post", "wall", "post", "stand", "post", "post")

_MAIN_PIPE = ((-4.0, -25.0), (9.0, -25.0), (13.5, -8.5), (26.0, -7.5))
_MAIN_PIPE_LIFTS = (0.15, 1.1, 0.15)
_COUNTS = {"array": 4, "culvert": 5, "wall": 4, "post": 8}


def place_props(terrain: HeightField, gully: Gully, seed: int, yard_obstacles: int) -> list[Prop]:
    """All props of the world of `seed`, with `yard_obstacles` of them in and round the training square."""
    rng = stream(seed, "inspection layout")
    plan = OccupiedRectangles(_POINT_SPACING_M)
    water = _water(terrain)
    plan.add_points(water.vertices[:, :2])
    props: list[Prop] = [water]
    props += site_props.bridge(terrain, "bridge", gully.centre, gully.yaw, BRIDGE_LENGTH_M, BRIDGE_WIDTH_M)
    plan.add(np.array(gully.centre), gully.yaw, BRIDGE_LENGTH_M + 4.0, BRIDGE_WIDTH_M + 2.0)
    props += _main_pipeline(terrain, plan)
    props += _yard(terrain, plan, stream(seed, "inspection yard"), yard_obstacles)
    props += _scatter(terrain, plan, rng)
    return props


def _water(terrain: HeightField) -> Prop:
    x, y = np.meshgrid(np.linspace(-4, 4, 17), np.linspace(-4, 4, 17))
    xy = np.stack([x, y], axis=-1).reshape(-1, 2)
    heights = terrain.height(xy)
    lowest = xy[heights.argmin()]
    return site_props.water_table(terrain, "water table", lowest, float(heights.min()) + 0.6, 8.0)


def _main_pipeline(terrain: HeightField, plan: OccupiedRectangles) -> list[Prop]:
    nodes = np.array(_MAIN_PIPE)
    legs = []
    for i, lift in enumerate(_MAIN_PIPE_LIFTS):
        start, end = nodes[i], nodes[i + 1]
        low = lift < 1.0
        spacing = 2.2 if low else 3.0
        name = f"pipeline {i + 1}"
        pipe = site_props.pipe_run(
            terrain, name, start, end, radius=0.21, lift=lift, spacing=spacing, valve=low
        )
        legs.append(pipe)
        ahead = end - start
        plan.add((start + end) / 2, float(np.arctan2(ahead[1], ahead[0])), float(np.hypot(*ahead)), 0.5)
    return legs


def _find(
    rng: np.random.Generator,
    plan: OccupiedRectangles,
    draw: Callable[[], Array],
    size: tuple[float, float],
    gap: float,
    yaws: tuple[float, float] = (-np.pi, np.pi),
) -> Placement | None:
    # A free position for a rectangle of this length and width, or None.
    for _ in range(_TRIES):
        place = Placement(draw(), float(rng.uniform(*yaws)))
        if plan.gap(*place, *size) >= gap:
            return place
    return None


def _yard(terrain: HeightField, plan: OccupiedRectangles, rng: np.random.Generator, count: int) -> list[Prop]:
    props: list[Prop] = []
    for i, listed in enumerate(islice(cycle(_YARD_KINDS), count)):
        # The square has room for one array and one pipe; later rounds of the list have stands instead.
        kind = "stand" if i >= len(_YARD_KINDS) and listed in ("array", "pipe") else listed
        size = _yard_size(rng, kind)
        place = _find_in_yard(terrain, plan, rng, kind, size)
        if place is None:
            raise WorldError(
                f"The inspection yard has no room for world.yard_obstacles={count}: "
                f"obstacle {i + 1} fits nowhere. Lower it to {i} or less."
            )
        plan.add(*place, *size)
        props += _build(terrain, rng, kind, f"yard {kind} {i + 1}", place, size[0])
    return props


def _find_in_yard(
    terrain: HeightField,
    plan: OccupiedRectangles,
    rng: np.random.Generator,
    kind: str,
    size: tuple[float, float],
) -> Placement | None:
    # In the training square if there is room, else in a larger square round it.
    inner, outer = (_YARD_ARRAY_NEAR_M, _YARD_ARRAY_FAR_M) if kind == "array" else (0.0, _YARD_REACH_M)
    for reach in (outer, max(outer, _WIDE_YARD_HALF_M - size[0] / 2)):

        def draw(reach: float = reach) -> Array:
            while True:
                offset = rng.uniform(-reach, reach, 2)
                if np.abs(offset).max() >= inner:
                    return YARD_CENTRE + offset

        tries = 8 if kind == "array" else 1
        if places := list(filter(None, (_find(rng, plan, draw, size, _YARD_GAP_M) for _ in range(tries)))):
            return min(places, key=lambda place: site_props.array_unevenness(terrain, *place))
    return None


def _yard_size(rng: np.random.Generator, kind: str) -> tuple[float, float]:
    if kind == "wall":
        return float(rng.uniform(1.6, 2.8)), 0.3
    sizes = {
        "array": (site_props.ARRAY_LENGTH_M, site_props.ARRAY_DEPTH_M),
        "pipe": (3.6, 0.5),
        "post": (0.3, 0.3),
        "stand": (0.6, 0.6),
    }
    return sizes[kind]


def _scatter(terrain: HeightField, plan: OccupiedRectangles, rng: np.random.Generator) -> list[Prop]:
    def draw() -> Array:
        while True:
            xy = rng.uniform(-(HALF_MAIN_M - 3.0), HALF_MAIN_M - 3.0, 2)
            in_yard = np.abs(xy - YARD_CENTRE).max() < _WIDE_YARD_HALF_M + 2.0
            if not in_yard and np.hypot(*xy) > _HOLLOW_RADIUS_M:
                return xy

    props: list[Prop] = []
    sizes = {"array": (site_props.ARRAY_LENGTH_M, 3.0), "culvert": (0.8, 2.8), "post": (0.3, 0.3)}
    facing = float(rng.uniform(-np.pi, np.pi))
    for kind, count in _COUNTS.items():
        yaws = (facing - 0.2, facing + 0.2) if kind == "array" else (-np.pi, np.pi)
        for i in range(count):
            size = (float(rng.uniform(3.0, 5.5)), 0.3) if kind == "wall" else sizes[kind]
            places = filter(None, [_find(rng, plan, draw, size, _GAP_M, yaws) for _ in range(8)])
            # The most level of a few positions, as a builder would choose.
            place = min(places, key=lambda place: _unevenness(terrain, kind, place))
            plan.add(*place, *size)
            props += _build(terrain, rng, kind, f"{kind} {i + 1}", place, size[0])
    return props


def _unevenness(terrain: HeightField, kind: str, place: Placement) -> float:
    uneven = site_props.array_unevenness(terrain, *place) if kind == "array" else 0.0
    return uneven + float(terrain.slope(place.xy))


def _build(
    terrain: HeightField, rng: np.random.Generator, kind: str, name: str, place: Placement, length: float
) -> tuple[Prop, ...]:
    xy, yaw = place
    match kind:
        case "array":
            return site_props.solar_array(terrain, name, xy, yaw)
        case "pipe":
            step = length / 2 * unit_vector(yaw)
            return (
                site_props.pipe_run(terrain, name, xy - step, xy + step, radius=0.2, lift=0.1, valve=True),
            )
        case "culvert":
            return (site_props.culvert(terrain, name, xy, yaw),)
        case "wall":
            return (site_props.wall(terrain, name, xy, yaw, length, float(rng.uniform(0.9, 1.5))),)
        case "stand":
            return (site_props.stand(terrain, name, xy, yaw),)
    radius, height = float(rng.uniform(0.05, 0.15)), float(rng.uniform(2.0, 3.0))
    return (site_props.post(terrain, name, xy, radius, height),)
