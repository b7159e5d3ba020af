"""Where the trees, logs, rocks and bushes of the rubicon world stand."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.errors import WorldError
from dune_rl.geometry.heightfield import HeightField
from dune_rl.seeding import stream
from dune_rl.worlds import trees
from dune_rl.worlds.plan import Discs
from dune_rl.worlds.props import unit_vector
from dune_rl.worlds.rocks import SMALLEST_M, gathered, joined, rock, share_larger, widths
from dune_rl.worlds.world import Prop

Array = NDArray[np.float64]

_EDGE_M = 1.5
_TRIES = 200
# Things as wide as a wheel or wider leave a robot of up to 0.45 m radius a way between any two of them.
_GAP_M = 0.9
_BLOCKS_FROM_M = 0.14
_STONES_IN_A_PATCH = 9
_PATCH_M = 1.0
# One trunk in eight has fallen.
_TREES_FOR_A_LOG = 8


def place_props(
    terrain: HeightField, seed: int, rocks_per_100m2: float, trees_per_100m2: float, bushes_per_100m2: float
) -> list[Prop]:
    """All props of the world of `seed`.

    Raises WorldError, naming the setting, where they do not fit.
    """
    xmin, xmax, ymin, ymax = terrain.extent
    hundreds = (xmax - xmin) * (ymax - ymin) / 100.0
    blocked = Discs()
    props = _wood(terrain, blocked, seed, round(trees_per_100m2 * hundreds), trees_per_100m2)
    count = round(rocks_per_100m2 * hundreds * float(share_larger(SMALLEST_M)))
    props += _rocks(terrain, blocked, seed, count, rocks_per_100m2)
    rng = stream(seed, "rubicon undergrowth")
    bushes = _bush_places(terrain, rng, round(bushes_per_100m2 * hundreds))
    return props + trees.undergrowth(terrain, bushes, rng)


def _anywhere(terrain: HeightField, rng: np.random.Generator) -> Array:
    xmin, xmax, ymin, ymax = terrain.extent
    low, high = np.array([xmin, ymin]) + _EDGE_M, np.array([xmax, ymax]) - _EDGE_M
    drawn: Array = rng.uniform(low, high)
    return drawn


def _place(
    terrain: HeightField, blocked: Discs, rng: np.random.Generator, radius: float, gap: float
) -> Array | None:
    for _ in range(_TRIES):
        xy = _anywhere(terrain, rng)
        if blocked.gap(xy, radius) >= gap:
            return xy
    return None


def _wood(terrain: HeightField, blocked: Discs, seed: int, count: int, per_100m2: float) -> list[Prop]:
    rng = stream(seed, "rubicon trees")
    props: list[Prop] = []
    # One kind prevails, and which differs from wood to wood.
    conifers = float(rng.choice([0.25, 0.5, 0.75]))
    for number in range(count):
        size = trees.draw_size(rng)
        xy = _place(terrain, blocked, rng, 1.3 * size.radius_m, _GAP_M)
        if xy is None:
            raise WorldError(_full("trees_per_100m2", per_100m2))
        blocked.take(xy, 1.3 * size.radius_m)
        grow = trees.conifer if rng.uniform() < conifers else trees.broadleaf
        props += grow(terrain, f"tree {number + 1}", xy, size, rng)
    for number in range(count // _TREES_FOR_A_LOG):
        length, radius = float(rng.uniform(1.6, 3.2)), float(rng.uniform(0.12, 0.2))
        xy = _place(terrain, blocked, rng, length / 2, _GAP_M)
        if xy is None:
            break
        yaw = float(rng.uniform(-np.pi, np.pi))
        for s in np.linspace(-length / 2, length / 2, 2 + int(length / radius)):
            blocked.take(xy + s * unit_vector(yaw), radius)
        props.append(trees.log(terrain, f"log {number + 1}", xy, yaw, length, radius))
    return props


def _rocks(terrain: HeightField, blocked: Discs, seed: int, count: int, per_100m2: float) -> list[Prop]:
    rng = stream(seed, "rubicon rocks")
    sizes = widths(count)
    blocking = sizes >= _BLOCKS_FROM_M
    rocks = []
    for number, width in enumerate(sizes[blocking].tolist(), start=1):
        xy = _place(terrain, blocked, rng, width / 2, _GAP_M)
        if xy is None:
            raise WorldError(_full("rocks_per_100m2", per_100m2))
        blocked.take(xy, width / 2)
        rocks.append(rock(terrain, f"rock {number}", xy, width, rng))
    return gathered(rocks) + _stones(terrain, blocked, rng, sizes[~blocking])


def _stones(terrain: HeightField, blocked: Discs, rng: np.random.Generator, sizes: Array) -> list[Prop]:
    # Bumps lie in patches, each one prop: engines take time for each body, and no spawn is on one.
    props = []
    mixed = rng.permutation(sizes)
    for number, patch in enumerate(
        np.array_split(mixed, max(1, round(len(mixed) / _STONES_IN_A_PATCH))), start=1
    ):
        if not len(patch):
            break
        xy = _place(terrain, blocked, rng, _PATCH_M / 2, 0.05)
        if xy is None:
            break
        blocked.take(xy, _PATCH_M / 2)
        turn = float(rng.uniform(-np.pi, np.pi))
        stones = []
        for index, width in enumerate(patch.tolist()):
            reach = (_PATCH_M - width) / 2 * np.sqrt((index + 0.5) / len(patch))
            stones.append(rock(terrain, "", xy + reach * unit_vector(turn + 2.4 * index), width, rng))
        props.append(joined(f"stones {number}", "stones", stones, drivable=True))
    return props


def _bush_places(terrain: HeightField, rng: np.random.Generator, count: int) -> Array:
    # In groups of about five, as bushes spread.
    places = np.empty((0, 2))
    while len(places) < count:
        group = _anywhere(terrain, rng) + rng.normal(0.0, 0.9, (int(rng.integers(3, 8)), 2))
        inside = np.abs(group - np.mean(np.reshape(terrain.extent, (2, 2)), axis=1)) < [
            (terrain.extent[1] - terrain.extent[0]) / 2 - 0.5,
            (terrain.extent[3] - terrain.extent[2]) / 2 - 0.5,
        ]
        places = np.concatenate([places, group[inside.all(axis=1)]])
    return places[:count]


def _full(setting: str, value: float) -> str:
    return (
        f"The rubicon world has no room for world.{setting}={value:g} beside what else stands there: "
        "lower it."
    )
