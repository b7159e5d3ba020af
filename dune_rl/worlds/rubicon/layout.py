"""Placement of the rubicon world's trees, logs, rocks and bushes."""

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds import trees
from dune_rl.worlds.occupancy import OccupiedDiscs
from dune_rl.worlds.props import unit_vector
from dune_rl.worlds.rocks import (
    SMALLEST_M,
    merge_rocks,
    merge_small_rocks,
    power_law_widths,
    relative_count_larger,
    rock,
)
from dune_rl.worlds.world import Prop

_EDGE_M = 1.5
_TRIES = 200
# Between props as wide as a wheel or wider: enough for a robot of up to 0.45 m radius.
_GAP_M = 0.9
_BLOCKS_FROM_M = 0.14
_STONES_PER_PATCH = 9
_PATCH_M = 1.0
_TREES_PER_LOG = 8


def place_props(
    terrain: HeightField, seed: int, rocks_per_100m2: float, trees_per_100m2: float, bushes_per_100m2: float
) -> list[Prop]:
    """All props of the world of `seed`.

    Raises `WorldError`, which names the setting, if they do not fit.
    """
    xmin, xmax, ymin, ymax = terrain.extent
    hundreds = (xmax - xmin) * (ymax - ymin) / 100.0
    occupied = OccupiedDiscs()
    props = _place_trees(terrain, occupied, seed, round(trees_per_100m2 * hundreds), trees_per_100m2)
    count = round(rocks_per_100m2 * hundreds * float(relative_count_larger(SMALLEST_M)))
    props += _place_rocks(terrain, occupied, seed, count, rocks_per_100m2)
    rng = stream(seed, "rubicon undergrowth")
    bushes = _draw_bushes(terrain, rng, round(bushes_per_100m2 * hundreds))
    return props + trees.undergrowth(terrain, bushes, rng)


def _draw_point(terrain: HeightField, rng: np.random.Generator) -> Array:
    xmin, xmax, ymin, ymax = terrain.extent
    low, high = np.array([xmin, ymin]) + _EDGE_M, np.array([xmax, ymax]) - _EDGE_M
    drawn: Array = rng.uniform(low, high)
    return drawn


def _find_free_point(
    terrain: HeightField, occupied: OccupiedDiscs, rng: np.random.Generator, radius: float, gap: float
) -> Array | None:
    for _ in range(_TRIES):
        xy = _draw_point(terrain, rng)
        if occupied.gap(xy, radius) >= gap:
            return xy
    return None


def _place_trees(
    terrain: HeightField, occupied: OccupiedDiscs, seed: int, count: int, per_100m2: float
) -> list[Prop]:
    rng = stream(seed, "rubicon trees")
    props: list[Prop] = []
    # The share of conifers differs from wood to wood.
    conifers = float(rng.choice([0.25, 0.5, 0.75]))
    for number in range(count):
        size = trees.sample_tree_size(rng)
        xy = _find_free_point(terrain, occupied, rng, 1.3 * size.radius_m, _GAP_M)
        if xy is None:
            raise WorldError(_no_room("trees_per_100m2", per_100m2))
        occupied.add(xy, 1.3 * size.radius_m)
        grow = trees.conifer if rng.uniform() < conifers else trees.broadleaf
        props += grow(terrain, f"tree {number + 1}", xy, size, rng)
    for number in range(count // _TREES_PER_LOG):
        length, radius = float(rng.uniform(1.6, 3.2)), float(rng.uniform(0.12, 0.2))
        xy = _find_free_point(terrain, occupied, rng, length / 2, _GAP_M)
        if xy is None:
            break
        yaw = float(rng.uniform(-np.pi, np.pi))
        for s in np.linspace(-length / 2, length / 2, 2 + int(length / radius)):
            occupied.add(xy + s * unit_vector(yaw), radius)
        props.append(trees.fallen_trunk(terrain, f"log {number + 1}", xy, yaw, length, radius))
    return props


def _place_rocks(
    terrain: HeightField, occupied: OccupiedDiscs, seed: int, count: int, per_100m2: float
) -> list[Prop]:
    rng = stream(seed, "rubicon rocks")
    sizes = power_law_widths(count)
    blocking = sizes >= _BLOCKS_FROM_M
    rocks = []
    for number, width in enumerate(sizes[blocking].tolist(), start=1):
        xy = _find_free_point(terrain, occupied, rng, width / 2, _GAP_M)
        if xy is None:
            raise WorldError(_no_room("rocks_per_100m2", per_100m2))
        occupied.add(xy, width / 2)
        rocks.append(rock(terrain, f"rock {number}", xy, width, rng))
    return merge_small_rocks(rocks) + _place_stones(terrain, occupied, rng, sizes[~blocking])


def _place_stones(
    terrain: HeightField, occupied: OccupiedDiscs, rng: np.random.Generator, sizes: Array
) -> list[Prop]:
    # Each patch of stones is one prop, since engines spend time on every body. Nothing spawns on them.
    props = []
    mixed = rng.permutation(sizes)
    for number, patch in enumerate(
        np.array_split(mixed, max(1, round(len(mixed) / _STONES_PER_PATCH))), start=1
    ):
        if not len(patch):
            break
        xy = _find_free_point(terrain, occupied, rng, _PATCH_M / 2, 0.05)
        if xy is None:
            break
        occupied.add(xy, _PATCH_M / 2)
        turn = float(rng.uniform(-np.pi, np.pi))
        stones = []
        for index, width in enumerate(patch.tolist()):
            reach = (_PATCH_M - width) / 2 * np.sqrt((index + 0.5) / len(patch))
            stones.append(rock(terrain, "", xy + reach * unit_vector(turn + 2.4 * index), width, rng))
        props.append(merge_rocks(f"stones {number}", "stones", stones, drivable=True))
    return props


def _draw_bushes(terrain: HeightField, rng: np.random.Generator, count: int) -> Array:
    # Positions (count, 2) in groups of about five.
    places = np.empty((0, 2))
    while len(places) < count:
        group = _draw_point(terrain, rng) + rng.normal(0.0, 0.9, (int(rng.integers(3, 8)), 2))
        inside = np.abs(group - np.mean(np.reshape(terrain.extent, (2, 2)), axis=1)) < [
            (terrain.extent[1] - terrain.extent[0]) / 2 - 0.5,
            (terrain.extent[3] - terrain.extent[2]) / 2 - 0.5,
        ]
        places = np.concatenate([places, group[inside.all(axis=1)]])
    return places[:count]


def _no_room(setting: str, value: float) -> str:
    return f"The rubicon world has no room for world.{setting}={value:g} beside its other props: lower it."
